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
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets_procedural.conventions.errors import one_line
from assets_procedural.conventions.files import read_regular, replacing
from synthgen.dataset import database, ledger, lights
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import misfits, schema, schema_of
from synthgen.dataset.folder import DamageError, DatasetFolder, Place, StorageError
from synthgen.dataset.records import Description, Seal, read_description

if TYPE_CHECKING:
    from collections.abc import Iterable

    import duckdb

    from synthgen.dataset.folder import ShardFiles
    from synthgen.dataset.records import ShardRecord

ROWS_PER_GROUP = 20_000
MOST_SHOTS = 50_000_000
"""Rows of a manifest that are opened: a few bytes of Parquet can claim any number of them."""
_LARGEST = 256 << 20  # bytes of the rows of one subject
_WAITING = 2 << 30  # and of all that wait
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
    rows, seal = _split(read_regular(path, _LARGEST))
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
        write_parquet(path, [source], _json_source(source, schema_of(rows)))
    finally:
        source.unlink(missing_ok=True)


def write_answer(path: Path, rows: Path, columns: dict[str, str]) -> None:
    """Make a Parquet file of JSON lines; `columns` has DuckDB's type of each, in order."""
    write_parquet(path, [rows], _json_source(rows, columns))


def read_rows(path: Path, shard: str | None = None) -> list[dict[str, Any]]:
    """The rows of a Parquet file, or those of one shard, as dictionaries."""
    where, values = ("", []) if shard is None else (" WHERE shard = ?", [shard])
    with database.locked([path]) as connection:
        result = connection.execute(f"SELECT * FROM {parquet_source([path])}{where}", values)
        names = [column[0] for column in result.description or ()]
        return [dict(zip(names, values, strict=True)) for values in result.fetchall()]


def merge(folder: DatasetFolder, subset: str) -> Path:
    """Join the parts of all committed shards into the subset's manifest; bounded memory."""
    target = folder.manifest(subset)
    if parts := _parts(folder, subset):
        write_parquet(target, parts, f"SELECT * FROM {parquet_source(parts)}")
    else:
        columns = (f"NULL::{kind} AS {database.quoted(n)}" for n, kind in schema((), ()).items())
        write_parquet(target, [], f"SELECT {', '.join(columns)} LIMIT 0")
    return target


def _parts(folder: DatasetFolder, subset: str) -> list[Path]:
    return _rows_of(ledger.committed(folder, subset))


def _rows_of(shards: Iterable[tuple[ShardFiles, ShardRecord]]) -> list[Path]:
    return [files.rows for files, record in shards if record.subjects and files.rows.exists()]


def write_parquet(target: Path, sources: list[Path], query_text: str) -> None:
    """Commit what a query over files answers, which reads `sources` alone, as Parquet."""
    import duckdb

    try:
        with replacing(target) as file:
            written = Path(file.name)
            with database.locked(sources, written) as connection:
                # The open handle stays that of the file DuckDB writes, so that it gets its fsync.
                connection.execute(
                    f"COPY ({query_text}) TO {database.literal(written)} (FORMAT parquet, "
                    f"COMPRESSION zstd, ROW_GROUP_SIZE {ROWS_PER_GROUP}, USE_TMP_FILE false)"
                )
    except duckdb.IOException as error:
        if "No space left" in str(error) or "quota" in str(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target)) from None
        raise


def parquet_source(paths: list[Path]) -> str:
    """An SQL table of Parquet files, whatever characters there are in their paths."""
    # Else folders called `name=value` would become a column.
    return f"read_parquet({database.files(paths)}, union_by_name = true, hive_partitioning = false)"


def _json_source(path: Path, columns: dict[str, str]) -> str:
    described = ", ".join(
        f"{database.literal(name)}: {database.literal(kind)}" for name, kind in columns.items()
    )
    return (
        f"SELECT * FROM read_json({database.files([path])}, format = 'newline_delimited', "
        f"hive_partitioning = false, columns = {{{described}}})"
    )


# ---------------------------------------------------------------- queries


def connect(out: Place, unlocked: bool = False) -> duckdb.DuckDBPyConnection:
    """A DuckDB connection with a view per subset and `manifest` over all of them.

    Finished subjects that wait for their shard are included; rows that make no sense are left out.
    It is locked, see `synthgen.dataset.database`, unless `unlocked` is asked for.

    Raises `StorageError` if `out` is no dataset, holds no finished subject, or its manifest is
    damaged.
    """
    import duckdb

    folder = DatasetFolder(out)
    for left in reversed(range(_TRIES)):
        connection = database.connect()
        try:
            _create_views(connection, folder, read_description(folder), unlocked)
            return connection
        except (duckdb.Error, OSError) as error:
            connection.close()
            # Work files go when their shard is committed: look again.
            if not left or not isinstance(error, duckdb.IOException | FileNotFoundError):
                reason = f"{folder}: the manifest cannot be read: {one_line(error)[:200]}"
                raise DamageError(folder, reason) from None
        except BaseException:
            connection.close()
            raise
    raise AssertionError


def _create_views(
    connection: duckdb.DuckDBPyConnection,
    folder: DatasetFolder,
    info: Description,
    unlocked: bool,
) -> None:
    parquet, waiting = {}, {}
    for subset in info.plan:
        shards, keys = ledger.contents(folder, subset)
        merged = folder.manifest(subset)
        parquet[subset] = [merged] if info.complete and merged.exists() else _rows_of(shards)
        waiting[subset] = _waiting_rows(folder, subset, keys)
    if not unlocked:
        database.lock(connection, [path for paths in parquet.values() for path in paths])
    views, known = [], {"manifest"}  # SQL takes names in any case
    for number, subset in enumerate(info.plan):
        sources = []
        if paths := parquet[subset]:
            sources.append(f"SELECT * FROM {parquet_source(paths)}")
        if rows := waiting[subset]:
            fill(connection, f"waiting {number}", schema_of(rows), rows)
            sources.append(f"SELECT * FROM {database.quoted(f'waiting {number}')}")
        if sources:
            source = _with_light(connection, " UNION ALL BY NAME ".join(sources), info)
            views.append(source)
            if subset.casefold() not in known:
                known.add(subset.casefold())
                connection.execute(f"CREATE VIEW {database.quoted(subset)} AS {source}")
    if not views:
        raise StorageError(f"{folder}: no subject is finished yet")
    connection.execute(f"CREATE VIEW manifest AS {' UNION ALL BY NAME '.join(views)}")
    ((shots,),) = connection.execute("SELECT count(*) FROM manifest").fetchall()
    if shots > MOST_SHOTS:
        raise StorageError(f"{folder}: lists {shots:,} shots; at most {MOST_SHOTS:,} are read")


def _with_light(connection: duckdb.DuckDBPyConnection, source: str, info: Description) -> str:
    """A query of rows, and what `lights` adds to them."""
    described = connection.execute(f"DESCRIBE {source}").fetchall()
    lit = lights.columns(info.environments, {name: kind for name, kind, *_ in described})
    added = "".join(f", {sql} AS {name}" for name, sql in lit.items())
    return f"SELECT *{added} FROM ({source})" if lit else source


def _waiting_rows(folder: DatasetFolder, subset: str, keys: list[str]) -> list[dict[str, Any]]:
    """Rows of subjects that wait for their shard; those that are damaged are left out.

    Raises `FileNotFoundError` if one has gone meanwhile: it is in its shard now.
    """
    rows: list[dict[str, Any]] = []
    names: dict[str, str] = {}  # SQL takes them in any case
    left = _WAITING
    for path in (folder.subject(subset, key).waiting_rows for key in keys):
        try:
            left -= path.stat().st_size
            if left < 0:
                break
            found = decode_rows(path)
            if all(names.setdefault(name.casefold(), name) == name for name in schema_of(found)):
                rows += found
        except FileNotFoundError:
            if not path.is_symlink():
                raise
        except (OSError, ValueError, RecursionError, StorageError):
            continue  # it is rendered again
    return rows


def fill(
    connection: duckdb.DuckDBPyConnection,
    table: str,
    columns: dict[str, str],
    rows: list[dict[str, Any]],
) -> None:
    """A table of rows, which DuckDB reads as JSON: lists, maps and structures keep their types.

    A value of another type than its column's becomes NULL.
    """
    described = ", ".join(f"{database.quoted(n)} {kind}" for n, kind in columns.items())
    connection.execute(f"CREATE TABLE {database.quoted(table)} ({described})")
    if rows:
        connection.execute(
            f"INSERT INTO {database.quoted(table)} SELECT unnest(from_json(line, ?)) "
            "FROM (SELECT unnest(?) AS line)",
            [json.dumps(columns), [_line(r) for r in rows]],
        )


def _line(row: dict[str, Any]) -> str:
    """A row as JSON; half characters, which JSON can name and UTF-8 cannot hold, become `?`."""
    return json.dumps(row, ensure_ascii=False).encode(errors="replace").decode()


@dataclass(frozen=True)
class Answer:
    """What a query answers: names and DuckDB types of the columns, and the rows, once."""

    column_names: list[str]
    column_types: list[str]
    chunks: Iterator[list[tuple[Any, ...]]]


@contextlib.contextmanager
def answering(out: Place, sql: str, unlocked: bool = False) -> Iterator[Answer]:
    """Run SQL as `query` does, and hand its rows out in chunks; memory stays bounded."""
    import duckdb

    with connect(out, unlocked) as connection:

        def fetch() -> list[tuple[Any, ...]]:
            return database.interruptible(connection, lambda: found.fetchmany(ROWS_PER_GROUP))

        try:
            check_query(connection, sql, unlocked)
            found = database.interruptible(connection, lambda: connection.execute(sql))
            columns = found.description or ()
            chunks = iter(fetch, [])
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


def query(out: Place, sql: str, unlocked: bool = False) -> Result:
    """Run SQL over the manifest: tables `manifest` (all subsets) and one per subset.

    One SELECT, to which all other files are shut, unless `unlocked` is asked for.

    Raises `StorageError` with one line for a wrong query or a folder that is no dataset.
    """
    import duckdb

    with connect(out, unlocked) as connection:
        try:
            check_query(connection, sql, unlocked)

            def ask() -> Result:
                result = connection.execute(sql)
                names = [column[0] for column in result.description or ()]
                return Result(names, result.fetchall())

            return database.interruptible(connection, ask)
        except duckdb.Error as error:
            raise StorageError(f"query: {' '.join(str(error).split())}") from None


def check_query(connection: duckdb.DuckDBPyConnection, sql: str, unlocked: bool) -> None:
    """Raise `StorageError` unless SQL only reads, or anything is allowed."""
    try:
        sql.encode()
    except UnicodeEncodeError as error:
        raise StorageError(f"query: {ascii(sql)[:80]}: is no text ({error.reason})") from None
    if not connection.extract_statements(sql):  # nothing but spaces or a comment
        raise StorageError('query: is empty; write "SELECT … FROM manifest"')
    if not unlocked and not database.only_reads(connection, sql):
        raise StorageError(
            "query: must be one SELECT; what writes files or changes settings needs --unlocked"
        )
