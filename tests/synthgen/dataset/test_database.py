"""Databases that touch a dataset are shut to everything else."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import duckdb
import pytest

from synthgen.dataset import database


def parquet(path: Path, value: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with database.locked([], path) as connection:
        text = f"COPY (SELECT {database.literal(value)} AS v) TO {database.literal(path)}"
        connection.execute(f"{text} (FORMAT parquet, USE_TMP_FILE false)")
    return path


def read(*paths: Path) -> list[tuple[str]]:
    with database.locked(paths) as connection:
        return connection.execute(f"FROM read_parquet({database.files(paths)})").fetchall()


@pytest.mark.parametrize(
    "statement",
    [
        "FROM read_text('{secret}')",
        "FROM '{secret}'",
        "FROM glob('{folder}/*')",
        "COPY (SELECT 1) TO '{folder}/written.csv'",
        "ATTACH '{folder}/other.db'",
        "EXPORT DATABASE '{folder}/exported'",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "SET threads = 9",
        "SET memory_limit = '100GB'",
        "RESET lock_configuration",
        "SELECT * FROM statement",
    ],
)
def test_a_locked_database_reaches_nothing_but_its_files(tmp_path: Path, statement: str):
    secret, mine = tmp_path / "secret.txt", parquet(tmp_path / "mine.parquet", "mine")
    secret.write_text("secret")
    before = sorted(tmp_path.iterdir())
    with database.locked([mine]) as connection:
        with pytest.raises(duckdb.Error):
            connection.execute(statement.format(secret=secret, folder=tmp_path)).fetchall()
        assert connection.execute(f"FROM '{mine}'").fetchall() == [("mine",)]
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["a*", "a?", "a[12]", "*", "[a]*'?"])
def test_a_file_is_no_pattern(tmp_path: Path, name: str):
    for other in ("a", "a1", "a2", "[a]x'y"):
        parquet(tmp_path / other / "m.parquet", "another")
    mine = parquet(tmp_path / name / "m.parquet", "mine")
    assert read(mine) == [("mine",)]


def test_a_pipe_is_refused_at_once(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is a pipe"):
        read(tmp_path / "pipe")


@pytest.mark.parametrize(
    ("sql", "reads"),
    [
        ("SELECT 1", True),
        ("FROM range(3)", True),
        ("WITH a AS (SELECT 1) FROM a", True),
        ("DESCRIBE SELECT 1", True),
        ("SUMMARIZE SELECT 1", True),
        ("SELECT 1; SELECT 2", False),
        ("COPY (SELECT 1) TO 'x'", False),
        ("EXPLAIN ANALYZE COPY (SELECT 1) TO 'x'", False),
        ("CREATE TABLE x AS SELECT 1", False),
        ("SET threads = 1", False),
        ("ATTACH 'x'", False),
        ("", False),
    ],
)
def test_only_a_select_reads(sql: str, reads: bool):
    with database.locked([]) as connection:
        assert database.only_reads(connection, sql) is reads


def test_ctrl_c_ends_a_query():
    slow = "SELECT count(*) FROM range(1000000) a(i), range(1000000) b(j) WHERE hash(i, j) = 1"
    with database.locked([]) as connection:
        timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        start = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            database.interruptible(connection, lambda: connection.execute(slow).fetchall())
        assert time.monotonic() - start < 5
        # The database is of use again.
        assert connection.execute("SELECT 1").fetchall() == [(1,)]


def test_names_and_texts_cannot_leave_their_quotes():
    with database.locked([]) as connection:
        for text in ('x" AS y; --', "x' || 'y", 'a""b', "é\n"):
            sql = f"SELECT {database.literal(text)} AS {database.quoted(text)}"
            answer = connection.execute(sql)
            assert [c[0] for c in answer.description or ()] == [text]
            assert answer.fetchall() == [(text,)]
