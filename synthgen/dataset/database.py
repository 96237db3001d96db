"""DuckDB over files that anybody may have written: the one place where connections are made.

A connection reads the files that it is given and no other, and writes at most one: the file system,
extensions and settings are shut to it, whatever the SQL says and however names and contents of a
dataset are chosen. Memory and threads are limited. Names go into SQL by `quoted`, texts by
`literal` or bound.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from assets_procedural.conventions.files import check_regular
from synthgen.dataset.folder import StorageError

if TYPE_CHECKING:
    import duckdb

T = TypeVar("T")

MEMORY = "2GB"
"""What a connection may hold; nothing is put on disk instead."""
COLUMN = re.compile(r"\w{1,128}", re.ASCII)
"""A column as rows that wait may name it."""
_MAGIC = re.compile(r"[*?\[]")


def quoted(name: str) -> str:
    """A name as an SQL identifier."""
    return '"' + name.replace('"', '""') + '"'


def literal(text: str | Path) -> str:
    """A text as an SQL literal."""
    return "'" + str(text).replace("'", "''") + "'"


def files(paths: Iterable[Path]) -> str:
    """Files as functions such as read_parquet take them: a list, in which nothing is a pattern.

    Raises `StorageError` for a path that DuckDB cannot be told.
    """
    return "[" + ", ".join(literal(_pattern(path)) for path in paths) + "]"


def _pattern(path: Path) -> str:
    """A pattern that matches this path alone: DuckDB takes every path that it reads for one."""
    # Absolute, so that none begins with ~ or with the name of a protocol.
    name = str(path.absolute())
    if _MAGIC.search(name) and "\\" in name:
        raise StorageError(
            f"{path}: DuckDB reads no path that has both \\ and one of *, ?, [ in it"
        )
    return _MAGIC.sub(r"[\g<0>]", name)


def connect(threads: int = 1, **settings: Any) -> duckdb.DuckDBPyConnection:
    """A database in memory without extensions, to be given its tables and then to be locked."""
    import duckdb

    return duckdb.connect(
        ":memory:",
        config={
            "threads": threads,
            "memory_limit": MEMORY,
            "autoinstall_known_extensions": False,
            "autoload_known_extensions": False,
            "allow_community_extensions": False,
            # Else names in FROM may be variables of this program.
            "python_enable_replacements": False,
            **settings,
        },
    )


def lock(
    connection: duckdb.DuckDBPyConnection,
    readable: Iterable[Path],
    written: Path | None = None,
    memory: str = MEMORY,
) -> None:
    """Shut a database to all files but those `readable` and the one `written`, and to settings.

    Raises `OSError` if one of the files is missing or a pipe, which would block.
    """
    run, allowed = connection.execute, []
    for path in readable:
        check_regular(path)
        # What is asked for is the pattern, and what is opened the file that it matches.
        allowed += {literal(path.absolute()), literal(_pattern(path))}
    if written is not None:
        allowed.append(literal(written))
    run(f"SET memory_limit = {literal(memory)}")
    run("SET temp_directory = ''")
    if allowed:
        run(f"SET allowed_paths = [{', '.join(allowed)}]")
    run("SET enable_external_access = false")
    run("SET lock_configuration = true")


def locked(readable: Iterable[Path], written: Path | None = None) -> duckdb.DuckDBPyConnection:
    """A database that reads these files and writes at most one; `OSError` as `lock`."""
    connection = connect()
    try:
        lock(connection, readable, written)
    except BaseException:
        connection.close()
        raise
    return connection


def only_reads(connection: duckdb.DuckDBPyConnection, sql: str) -> bool:
    """Whether SQL is one SELECT, in any of its forms (also FROM, DESCRIBE, SUMMARIZE, SHOW).

    Raises `duckdb.Error` if it is not SQL.
    """
    import duckdb

    return [s.type for s in connection.extract_statements(sql)] == [duckdb.StatementType.SELECT]


def interruptible(connection: duckdb.DuckDBPyConnection, work: Callable[[], T]) -> T:
    """What `work` returns or raises; Ctrl-C ends it at once, which DuckDB alone does not see.

    Raises `KeyboardInterrupt` when nothing runs any more.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    answer: list[T] = []
    failure: list[BaseException] = []

    ended = threading.Event()

    def run() -> None:
        try:
            answer.append(work())
        except BaseException as error:
            failure.append(error)
        finally:
            ended.set()

    threading.Thread(target=run, daemon=True).start()
    try:
        # Not `join`, which takes a thread for ended once it was interrupted itself.
        ended.wait()
    except BaseException:
        while not ended.is_set():  # between two queries there is nothing to interrupt
            connection.interrupt()
            ended.wait(0.05)
        raise
    if failure:
        raise failure[0]
    return answer[0]
