"""The Parquet manifest: a row per shot with its provenance, quality, cost and place in a shard.

Every shard has its part; `merge` joins the parts of a subset into `manifest/<subset>.parquet`.
Its columns are those of `synthgen.dataset.columns`.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets_procedural.conventions.files import replacing
from synthgen.dataset import ledger
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import misfits, schema, schema_of
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import Description, Seal, read_description

if TYPE_CHECKING:
    from collections.abc import Iterable

    import duckdb

    from synthgen.dataset.folder import ShardFiles
    from synthgen.dataset.records import ShardRecord

ROWS_PER_GROUP = 20_000
_TRIES = 5


# ---------------------------------------------------------------- files


def encode_rows(rows: list[dict[str, Any]]) -> bytes:
    """Rows as JSON lines, the form in which they wait for their shard."""
    return b"".join(encode_json(r) + b"\n" for r in rows)


def encode_waiting(rows: list[dict[str, Any]], seal: Seal) -> bytes:
    """The rows of a subject that waits for its shard, and the seal of its files as last line.

    `seal` is completed with the checksum of the rows.
    """
    content = encode_rows(rows)
    sealed = seal.model_copy(update={"rows_sha256": hashlib.sha256(content).hexdigest()})
    return content + encode_json({"seal": sealed.to_json()}) + b"\n"


def decode_waiting(path: Path) -> tuple[list[dict[str, Any]], Seal | None]:
    """The inverse of `encode_waiting`; older versions wrote no seal.

    Raises `ValueError` if the file is not what was written, or a row does not fit the manifest.
    """
    rows, seal = _split(path.read_bytes())
    decoded = [json.loads(line) for line in rows.splitlines()]
    if not decoded or not rows.endswith(b"\n"):
        raise ValueError(f"{path}: is cut short")
    for row in decoded:
        for problem in misfits(row):
            raise ValueError(f"{path}: {problem}")
    return decoded, seal


def decode_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a subject that waits for its shard; raises as `decode_waiting`."""
    return decode_waiting(path)[0]


def _split(content: bytes) -> tuple[bytes, Seal | None]:
    """The rows, and their seal if they have one, which must hold."""
    rows, found, last = content.removesuffix(b"\n").rpartition(b"\n")
    if not last.startswith(b'{"seal":'):
        return content, None
    rows += found
    try:
        seal = Seal.parse(encode_json(json.loads(last)["seal"]), "seal")
    except (StorageError, KeyError, RecursionError) as error:
        raise ValueError(str(error)) from None
    if encode_json({"seal": seal.to_json()}) + b"\n" != content[len(rows) :]:
        raise ValueError("its last line changed since it was written")
    if hashlib.sha256(rows).hexdigest() != seal.rows_sha256:
        raise ValueError("its rows changed since they were written")
    return rows, seal


def write_part(path: Path, rows: list[dict[str, Any]]) -> None:
    """Commit the rows of one shard; `ValueError` if a row has a column that the schema lacks."""
    source = path.with_name(f".{path.name}.{os.getpid()}.rows.tmp")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        source.write_bytes(encode_rows(rows))
        _write_parquet(path, _json_source([source], schema_of(rows)))
    finally:
        source.unlink(missing_ok=True)


def read_rows(path: Path, shard: str | None = None) -> list[dict[str, Any]]:
    """The rows of a Parquet file, or those of one shard, as dictionaries."""
    where, values = ("", []) if shard is None else (" WHERE shard = ?", [shard])
    with _database() as connection:
        result = connection.execute(f"SELECT * FROM {parquet_source([path])}{where}", values)
        names = [column[0] for column in result.description or ()]
        return [dict(zip(names, values, strict=True)) for values in result.fetchall()]


def merge(folder: DatasetFolder, subset: str) -> Path:
    """Join the parts of all committed shards into the subset's manifest; bounded memory."""
    target = folder.manifest(subset)
    if parts := _parts(folder, subset):
        _write_parquet(target, f"SELECT * FROM {parquet_source(parts)}")
    else:
        columns = ", ".join(f'NULL::{kind} AS "{n}"' for n, kind in schema((), ()).items())
        _write_parquet(target, f"SELECT {columns} LIMIT 0")
    return target


def _parts(folder: DatasetFolder, subset: str) -> list[Path]:
    return _rows_of(ledger.committed(folder, subset))


def _rows_of(shards: Iterable[tuple[ShardFiles, ShardRecord]]) -> list[Path]:
    return [files.rows for files, record in shards if record.subjects and files.rows.exists()]


def _write_parquet(target: Path, query_text: str) -> None:
    import duckdb

    try:
        with replacing(target) as file, _database() as connection:
            # The open handle stays that of the file DuckDB writes, so that it gets its fsync.
            connection.execute(
                f"COPY ({query_text}) TO {_text(file.name)} (FORMAT parquet, "
                f"COMPRESSION zstd, ROW_GROUP_SIZE {ROWS_PER_GROUP}, USE_TMP_FILE false)"
            )
    except duckdb.IOException as error:
        if "No space left" in str(error) or "quota" in str(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target)) from None
        raise


def _database() -> duckdb.DuckDBPyConnection:
    import duckdb

    return duckdb.connect(config={"threads": 1, "memory_limit": "1GB"})


def parquet_source(paths: list[Path]) -> str:
    """An SQL table of Parquet files, whatever characters there are in their paths."""
    # Else folders called `name=value` would become a column.
    return f"read_parquet({_literal(paths)}, union_by_name = true, hive_partitioning = false)"


def _json_source(paths: list[Path], columns: dict[str, str]) -> str:
    described = ", ".join(f"\"{name}\": '{kind}'" for name, kind in columns.items())
    return (
        f"SELECT * FROM read_json({_literal(paths)}, format = 'newline_delimited', "
        f'hive_partitioning = false, columns = {{{described}}}) WHERE "key" IS NOT NULL'
    )


def _literal(paths: list[Path]) -> str:
    return "[" + ", ".join(_text(_pattern(path)) for path in paths) + "]"


def _pattern(path: Path) -> str:
    """A pattern that matches this path alone: DuckDB takes every path that it reads for one."""
    # Absolute, so that none begins with ~ or with the name of a protocol.
    name = str(path.absolute())
    if not re.search(r"[*?\[]", name):
        return name
    if "\\" in name:
        raise StorageError(
            f"{path}: DuckDB reads no path that has both \\ and one of *, ?, [ in it"
        )
    return re.sub(r"([*?\[])", r"[\1]", name)


def _text(text: Path | str) -> str:
    return "'" + str(text).replace("'", "''") + "'"


# ---------------------------------------------------------------- queries


def connect(out: Place) -> duckdb.DuckDBPyConnection:
    """A DuckDB connection with a view per subset and `manifest` over all of them.

    Finished subjects that wait for their shard are included. Raises `StorageError` if `out` is no
    dataset or holds no finished subject.
    """
    import duckdb

    folder = DatasetFolder(out)
    for left in reversed(range(_TRIES)):
        connection = _database()
        try:
            _create_views(connection, folder, read_description(folder))
            return connection
        except (
            duckdb.IOException,
            FileNotFoundError,
        ):  # work files go when their shard is committed: look again
            connection.close()
            if not left:
                raise
        except BaseException:
            connection.close()
            raise
    raise AssertionError


def _create_views(
    connection: duckdb.DuckDBPyConnection, folder: DatasetFolder, info: Description
) -> None:
    views = []
    for subset in info.plan:
        shards, keys = ledger.contents(folder, subset)
        merged = folder.manifest(subset)
        parquet = [merged] if info.complete and merged.exists() else _rows_of(shards)
        sources = [f"SELECT * FROM {parquet_source(parquet)}"] if parquet else []
        waiting = [folder.subject(subset, key).waiting_rows for key in keys]
        if sound := [path for path in waiting if _is_sound(path)]:
            table = _quoted(f"waiting {subset}")
            columns = schema_of(decode_rows(sound[0]))
            connection.execute(f"CREATE TABLE {table} AS {_json_source(sound, columns)}")
            sources.append(f"SELECT * FROM {table}")
        if sources:
            view = _quoted(subset)
            connection.execute(f"CREATE VIEW {view} AS {' UNION ALL BY NAME '.join(sources)}")
            views.append(f"SELECT * FROM {view}")
    if not views:
        raise StorageError(f"{folder}: no subject is finished yet")
    connection.execute(f"CREATE VIEW manifest AS {' UNION ALL BY NAME '.join(views)}")


def _is_sound(path: Path) -> bool:
    """Whether the rows of a waiting subject can be read; those that cannot are rendered again."""
    with contextlib.suppress(OSError, ValueError):
        _, seal = _split(path.read_bytes())
        return seal is not None or bool(decode_rows(path))
    return False


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


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
