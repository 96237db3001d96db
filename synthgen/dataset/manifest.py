"""The Parquet manifest: a row per shot with its provenance, quality, cost and place in a shard.

Every shard has its part; `merge` joins the parts of a subset into `manifest/<subset>.parquet`.
Its columns are those of `synthgen.dataset.columns`.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets_procedural.conventions.files import replacing
from synthgen.dataset import ledger
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import schema, schema_of
from synthgen.dataset.folder import DamageError, DatasetFolder, Place, StorageError
from synthgen.dataset.records import read_description

if TYPE_CHECKING:
    import duckdb

ROWS_PER_GROUP = 20_000


# ---------------------------------------------------------------- files


def encode_rows(rows: list[dict[str, Any]]) -> bytes:
    """Rows as JSON lines, the form in which they wait for their shard."""
    return b"".join(encode_json(r) + b"\n" for r in rows)


def decode_rows(path: Path) -> list[dict[str, Any]]:
    """The inverse of `encode_rows`."""
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def write_part(path: Path, rows: list[dict[str, Any]]) -> None:
    """Commit the rows of one shard; `ValueError` if a row has a column that the schema lacks."""
    source = path.with_name(f".{path.name}.{os.getpid()}.rows.tmp")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        source.write_bytes(encode_rows(rows))
        _write_parquet(path, _json_source([source], schema_of(rows)))
    finally:
        source.unlink(missing_ok=True)


def write_answer(path: Path, rows: Path, columns: dict[str, str]) -> None:
    """Make a Parquet file of JSON lines; `columns` has DuckDB's type of each, in order."""
    described = ", ".join(f"'{_escape(name)}': '{_escape(kind)}'" for name, kind in columns.items())
    source = f"read_json({_literal([rows])}, format = 'newline_delimited'"
    _write_parquet(path, f"SELECT * FROM {source}, columns = {{{described}}})")


def read_rows(path: Path, shard: str | None = None) -> list[dict[str, Any]]:
    """The rows of a Parquet file, or those of one shard, as dictionaries."""
    where, values = ("", []) if shard is None else (" WHERE shard = ?", [shard])
    with _database() as connection:
        result = connection.execute(
            f"SELECT * FROM read_parquet({_literal([path])}){where}", values
        )
        names = [column[0] for column in result.description or ()]
        return [dict(zip(names, values, strict=True)) for values in result.fetchall()]


def merge(folder: DatasetFolder, subset: str) -> Path:
    """Join the parts of all committed shards into the subset's manifest; bounded memory."""
    target = folder.manifest(subset)
    if parts := _parts(folder, subset):
        _write_parquet(target, f"SELECT * FROM {_parquet_source(parts)}")
    else:
        columns = ", ".join(f'NULL::{kind} AS "{n}"' for n, kind in schema((), ()).items())
        _write_parquet(target, f"SELECT {columns} LIMIT 0")
    return target


def files(folder: DatasetFolder, subset: str, complete: bool) -> list[Path]:
    """The Parquet files that describe a subset: merged if `complete`, or the parts until then."""
    merged = folder.manifest(subset)
    return [merged] if complete and merged.exists() else _parts(folder, subset)


def _parts(folder: DatasetFolder, subset: str) -> list[Path]:
    shards = ledger.committed(folder, subset)
    return [files.rows for files, record in shards if record.subjects and files.rows.exists()]


def _write_parquet(target: Path, query_text: str) -> None:
    import duckdb

    try:
        with replacing(target) as file, _database() as connection:
            # The open handle stays that of the file DuckDB writes, so that it gets its fsync.
            connection.execute(
                f"COPY ({query_text}) TO '{_escape(file.name)}' (FORMAT parquet, "
                f"COMPRESSION zstd, ROW_GROUP_SIZE {ROWS_PER_GROUP}, USE_TMP_FILE false)"
            )
    except duckdb.IOException as error:
        if "No space left" in str(error) or "quota" in str(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target)) from None
        raise


def _database() -> duckdb.DuckDBPyConnection:
    import duckdb

    return duckdb.connect(config={"threads": 1, "memory_limit": "1GB"})


def _parquet_source(paths: list[Path]) -> str:
    return f"read_parquet({_literal(paths)}, union_by_name = true)"


def _json_source(paths: list[Path], columns: dict[str, str]) -> str:
    described = ", ".join(f"\"{name}\": '{kind}'" for name, kind in columns.items())
    return (
        f"SELECT * FROM read_json({_literal(paths)}, format = 'newline_delimited', "
        f"columns = {{{described}}})"
    )


def _literal(paths: list[Path]) -> str:
    return "[" + ", ".join(f"'{_escape(path)}'" for path in paths) + "]"


def _escape(path: Path | str) -> str:
    return str(path).replace("'", "''")


# ---------------------------------------------------------------- queries


def connect(out: Place) -> duckdb.DuckDBPyConnection:
    """A DuckDB connection with a view per subset and `manifest` over all of them.

    Finished subjects that wait for their shard are included. Raises `StorageError` if `out` is no
    dataset, holds no finished subject, or its manifest is damaged.
    """
    import duckdb

    try:
        return _connect(DatasetFolder(out))
    except (duckdb.Error, ValueError) as error:
        reason = f"{out}: the manifest cannot be read: {' '.join(str(error).split())[:200]}"
        raise DamageError(out, reason) from None


def _connect(folder: DatasetFolder) -> duckdb.DuckDBPyConnection:
    info = read_description(folder)
    connection = _database()
    views = []
    for subset in info.plan:
        sources = []
        if parquet := files(folder, subset, info.complete):
            sources.append(f"SELECT * FROM {_parquet_source(parquet)}")
        waiting = sorted(folder.waiting(subset).glob("*.json"))
        if waiting:
            sources.append(_json_source(waiting, schema_of(decode_rows(waiting[0]))))
        if sources:
            connection.execute(f'CREATE VIEW "{subset}" AS {" UNION ALL BY NAME ".join(sources)}')
            views.append(f'SELECT * FROM "{subset}"')
    if not views:
        raise StorageError(f"{folder}: no subject is finished yet")
    connection.execute(f"CREATE VIEW manifest AS {' UNION ALL BY NAME '.join(views)}")
    return connection


@dataclass(frozen=True)
class Answer:
    """What a query answers: names and DuckDB types of the columns, and the rows, once."""

    column_names: list[str]
    column_types: list[str]
    chunks: Iterator[list[tuple[Any, ...]]]


@contextlib.contextmanager
def answering(out: Place, sql: str) -> Iterator[Answer]:
    """Run SQL as `query` does, and hand its rows out in chunks; memory stays bounded."""
    import duckdb

    with connect(out) as connection:
        try:
            found = connection.execute(sql)
            if found is None:  # nothing but spaces or a comment
                raise StorageError('query: is empty; write "SELECT … FROM manifest"')
            columns = found.description or ()
            chunks = iter(lambda: found.fetchmany(ROWS_PER_GROUP), [])
            yield Answer([str(c[0]) for c in columns], [str(c[1]) for c in columns], chunks)
        except duckdb.Error as error:
            raise StorageError(f"query: {' '.join(str(error).split())}") from None


@dataclass(frozen=True)
class Result:
    """The result of a query."""

    column_names: list[str]
    rows: list[tuple[Any, ...]]

    def to_pylist(self) -> list[dict[str, Any]]:
        """A dictionary per row."""
        return [dict(zip(self.column_names, row, strict=True)) for row in self.rows]


def query(out: Place, sql: str) -> Result:
    """Run SQL over the manifest: tables `manifest` (all subsets) and one per subset.

    Raises `StorageError` with one line for a wrong query or a folder that is no dataset.
    """
    import duckdb

    with connect(out) as connection:
        try:
            result = connection.execute(sql)
            names = [column[0] for column in result.description or ()]
            return Result(names, result.fetchall())
        except duckdb.Error as error:
            raise StorageError(f"query: {' '.join(str(error).split())}") from None
