"""The manifest as it is now, in a sandboxed database: the table `manifest`, a row per shot.

A `Snapshot` never changes. `Library` holds the current one and makes the next when the folder has
grown. The first answers come from Parquet itself, where every query reads files; meanwhile the
columns are read into memory, where they take a tenth of the time.

Subjects that failed are rows, too: `failed` is true, `reason` says why, and the rest is NULL.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import duckdb

from assets_procedural.conventions.files import read_regular
from synthgen.browse.folder import Folder, Refused
from synthgen.browse.table.codes import Codes
from synthgen.browse.table.fields import LEFT_OUT, Column, column
from synthgen.browse.table.matches import Matches
from synthgen.browse.table.sandbox import Sandbox
from synthgen.dataset import ledger, lights, manifest
from synthgen.dataset.columns import IDENTITY, PLACE, schema_of
from synthgen.dataset.database import quoted
from synthgen.dataset.folder import NAME, StorageError
from synthgen.dataset.ledger import ATTEMPTS
from synthgen.dataset.records import LARGEST_RECORD, Failure, ShardRecord

_SETTLE = 2.0  # seconds between two checks of the folder
_REST = 10.0  # loads' durations of rest between two: rendering needs the cores, too
_SMALL = 20_000  # shots that are read into memory before anything is served
_PATIENCE = 1.0  # seconds that a larger manifest waits for the first page to be served


@dataclass(frozen=True)
class Snapshot:
    """A manifest at one moment. `revision` names it, `shots` and `frames` are what is finished."""

    sandbox: Sandbox
    columns: dict[str, Column]
    shots: int
    frames: int
    failures: int
    revision: str
    info: dict[str, Any]
    in_memory: bool
    matches: Matches
    codes: Codes


class Library:
    """The current snapshot of a folder; may be used by several threads.

    Raises `StorageError` if the folder is no dataset, or its manifest cannot be read.
    """

    def __init__(
        self, folder: Folder, threads: int = 2, added: dict[str, str] | None = None
    ) -> None:
        """`added` are more columns: SQL expressions by name."""
        self.folder, self.threads, self.added = folder, threads, added or {}
        self._lock = threading.Lock()
        self._looked = time.monotonic()
        self._pause = _SETTLE
        self._filling: Sandbox | None = None
        self._closed = False
        self._answered = threading.Event()
        self._loading: threading.Thread | None = None
        try:
            self._current = _read(folder, Sandbox(threads), False, self.added)
            if self._current.shots <= _SMALL:
                self._current = _read(folder, Sandbox(threads), True, self.added)
                return
        except (duckdb.Error, Refused) as error:
            reason = " ".join(str(error).splitlines()[:1])[:200]
            raise StorageError(f"{folder.given}: its manifest is damaged: {reason}") from None
        self._load(patience=_PATIENCE)

    def snapshot(self) -> Snapshot:
        """The newest snapshot that is ready; looks at the folder now and then."""
        with self._lock:
            idle = self._loading is None or not self._loading.is_alive()
            if idle and time.monotonic() - self._looked > self._pause:
                self._looked = time.monotonic()
                if revision(self.folder) != self._current.revision:
                    self._load()
            return self._current

    def wait(self) -> Snapshot:
        """The snapshot after whatever is being loaded now."""
        if self._loading is not None:
            self._loading.join()
        return self._current

    def close(self) -> None:
        """End what is being loaded: a thread inside DuckDB would not survive the program's end."""
        self._closed = True
        self.answered()
        while self._loading is not None and self._loading.is_alive():
            if self._filling is not None:
                self._filling.connection.interrupt()
            self._loading.join(0.1)

    def answered(self) -> None:
        """Say that somebody has a first page: now the cores are free to load."""
        self._answered.set()

    def _load(self, patience: float = 0.0) -> None:
        self._loading = threading.Thread(target=self._replace, args=(patience,), daemon=True)
        self._loading.start()

    def _replace(self, patience: float) -> None:
        self._answered.wait(patience)
        # A folder in the middle of a change may not make sense: the next look tells.
        if self._closed:
            return
        start = time.monotonic()
        with contextlib.suppress(duckdb.Error, StorageError, Refused, OSError):
            self._filling = Sandbox(self.threads)
            loaded = _read(self.folder, self._filling, True, self.added)
            with self._lock:
                self._current = loaded
            self._prepare(loaded)
        self._looked = time.monotonic()
        self._pause = max(_SETTLE, _REST * (self._looked - start))

    def _prepare(self, snapshot: Snapshot) -> None:
        for described in snapshot.columns.values():
            if described.kind in ("facet", "range") and not self._closed:
                snapshot.codes.of(described)


def revision(folder: Folder) -> str:
    """A name for the state of the folder: it changes when a subject or a shard is added."""
    digest = hashlib.sha256()
    info = folder.description()
    layout = folder.layout
    places = [layout.description, layout.manifests]
    for subset in info["plan"]:
        places += [layout.records(subset), layout.failed(subset), layout.waiting(subset)]
    for place in places:
        try:
            found = place.stat()
            digest.update(f"{place} {found.st_mtime_ns} {found.st_size}\n".encode())
        except OSError:
            digest.update(f"{place} -\n".encode())
    return digest.hexdigest()[:16]


def _read(folder: Folder, sandbox: Sandbox, in_memory: bool, added: dict[str, str]) -> Snapshot:
    name = revision(folder)
    info = folder.description()
    run = sandbox.connection.execute
    files: list[Path] = []
    for subset in info["plan"]:
        files += _parquet(folder, info, subset)
    sources = []
    if files:
        sources.append(f"SELECT * FROM {manifest.parquet_source(files)}")
    if _waiting(folder, info, sandbox):
        sources.append("SELECT * FROM waiting")
    if not sources:
        described = IDENTITY | PLACE | {"environments": "VARCHAR[]"}
        empty = ", ".join(f"NULL::{kind} AS {quoted(n)}" for n, kind in described.items())
        sources.append(f"SELECT {empty} LIMIT 0")
    source = f"({' UNION ALL BY NAME '.join(sources)})"
    ((rows,),) = run(f"SELECT count(*) FROM {source}").fetchall()
    if rows > manifest.MOST_SHOTS:
        raise Refused(f"lists {rows:,} shots; at most {manifest.MOST_SHOTS:,} are read")
    described = run(f"DESCRIBE SELECT * FROM {source}").fetchall()
    kept = [n for n, *_ in described if n not in LEFT_OUT | {"failed", "reason"}]
    lit = lights.columns(info.get("environments"), {n: kind for n, kind, *_ in described})
    more = {n: sql for n, sql in (lit | added).items() if n not in kept}
    names = ", ".join([*map(quoted, kept), *(f"{sql} AS {quoted(n)}" for n, sql in more.items())])
    failures = _failures(folder, info, sandbox)
    body = (
        f"SELECT {names}, false AS failed, NULL::VARCHAR AS reason FROM {source} "
        "UNION ALL BY NAME SELECT * FROM failures"
    )
    run(f"CREATE {'TABLE' if in_memory else 'VIEW'} manifest AS {body}")
    if in_memory:
        run("DROP TABLE IF EXISTS waiting")
    sandbox.lock([] if in_memory else files)
    columns = {n: column(n, kind) for n, kind, *_ in run("DESCRIBE manifest").fetchall()}
    if in_memory:
        columns = _without_constants(sandbox, columns)
    ((shots, frames),) = sandbox.ask(
        "SELECT count(*), coalesce(sum(len(environments)), 0) FROM manifest WHERE NOT failed"
    )
    return Snapshot(
        sandbox,
        columns,
        int(shots),
        int(frames),
        failures,
        name,
        info,
        in_memory,
        Matches(sandbox, in_memory),
        Codes(sandbox),
    )


def _without_constants(sandbox: Sandbox, columns: dict[str, Column]) -> dict[str, Column]:
    """The columns, those marked that have one value throughout: no filter would change anything."""
    asked = [name for name, c in columns.items() if c.kind in ("facet", "range") and not c.listed]
    shots = "FILTER (WHERE NOT failed)"
    terms = [
        f"count({name}) {shots} = 0 OR (min({name}) {shots} IS NOT DISTINCT FROM max({name}) "
        f"{shots} AND count({name}) {shots} = count(*) {shots})"
        for name in map(quoted, asked)
    ]
    if not terms:
        return columns
    (found,) = sandbox.ask(f"SELECT {', '.join(terms)} FROM manifest")
    constant = {name for name, one in zip(asked, found, strict=True) if one} - {"failed"}
    return {n: replace(c, constant=n in constant) for n, c in columns.items()}


def _parquet(folder: Folder, info: dict[str, Any], subset: str) -> list[Path]:
    """The Parquet files of a subset: merged, or while it is rendered those of its shards."""
    if info.get("complete"):
        with contextlib.suppress(Refused):
            return [folder.file(folder.layout.manifest(subset))]
    found = []
    for path in folder.files(folder.layout.records(subset), ".json"):
        with contextlib.suppress(OSError, StorageError, Refused):
            if ShardRecord.parse(read_regular(path, LARGEST_RECORD), path).subjects:
                rows = folder.layout.shard(f"{subset}/{path.stem}.tar").rows
                found.append(folder.file(rows))
    return found


def _waiting(folder: Folder, info: dict[str, Any], sandbox: Sandbox) -> bool:
    """Read the finished subjects that wait for their shard into a table; whether there are any."""
    rows: list[dict[str, Any]] = []
    for subset in info["plan"]:
        recorded = {
            key for _, record in ledger.committed(folder.layout, subset) for key in record.subjects
        }
        for path in folder.files(folder.layout.waiting(subset), ".json"):
            if path.stem in recorded:
                continue
            try:
                found = manifest.decode_rows(path)
                schema_of(found)
                rows += found
            except (OSError, ValueError, RecursionError):
                continue
    if not rows:
        return False
    manifest.fill(sandbox.connection, "waiting", schema_of(rows), rows)
    return True


def _failures(folder: Folder, info: dict[str, Any], sandbox: Sandbox) -> int:
    rows = []
    for subset in info["plan"]:
        for path in folder.files(folder.layout.failed(subset), ".json"):
            try:
                entry = Failure.parse(read_regular(path, LARGEST_RECORD), path)
            except (OSError, StorageError):
                continue
            if NAME.fullmatch(entry.key) and entry.attempts >= ATTEMPTS:
                row = {"key": entry.key, "subject": entry.key, "subset": subset}
                rows.append(row | {"reason": entry.reason})
    described = dict.fromkeys(("key", "subject", "subset", "reason"), "VARCHAR")
    manifest.fill(
        sandbox.connection,
        "failures",
        described | {"failed": "BOOLEAN"},
        [r | {"failed": True} for r in rows],
    )
    return len(rows)


def threads() -> int:
    """How many threads queries get: two, or one on a machine with one core."""
    return min(2, os.cpu_count() or 1)
