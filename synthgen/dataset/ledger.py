"""What is done, what failed and why. All state is on disk, so any process can read it.

`synthgen.dataset.folder` says where it lies, `synthgen.dataset.records` what is written. A subject
is done when its rows of the manifest exist, a shard when its record exists and its tar has the
recorded size. Both are committed after what they vouch for, and hold the hashes of it, which
`synthgen.farm.commit` compares.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from assets_procedural.conventions.files import open_regular, read_regular, write_atomically
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.folder import NAME, DatasetFolder, Place, ShardFiles, StorageError
from synthgen.dataset.records import (
    LARGEST_RECORD,
    Failure,
    RunNote,
    ShardRecord,
    read_description,
)

ATTEMPTS = 3
_LOOKS = 5


@dataclass(frozen=True)
class WaitingSubject:
    """A finished subject that waits for its shard: its tar entries, its rows of the manifest."""

    subset: str
    key: str
    tar: Path
    rows: Path


def waiting(folder: DatasetFolder, subset: str, key: str) -> WaitingSubject | None:
    """A subject that waits for its shard; None if it is not finished, or in its shard."""
    files = folder.subject(subset, key)
    if not files.waiting_rows.exists():
        return None
    return WaitingSubject(subset, key, files.waiting_tar, files.waiting_rows)


def record_of(folder: DatasetFolder, shard: str) -> ShardRecord | None:
    """The record of a shard ("<subset>/<split>-000000.tar"), whatever has become of its files.

    None if there is none, or it is damaged.
    """
    files = folder.shard(shard)
    with contextlib.suppress(OSError, StorageError):
        record = ShardRecord.parse(read_regular(files.record, LARGEST_RECORD), files.record)
        if record.tar == folder.relative(files.tar):
            return record
    return None


def shard_record(folder: DatasetFolder, shard: str) -> ShardRecord | None:
    """As `record_of`; None too if files that it vouches for are gone or have another length."""
    files, record = folder.shard(shard), record_of(folder, shard)
    try:
        if record is not None and record.subjects:
            if files.tar.stat().st_size != record.bytes:
                return None
            files.rows.stat()
    except OSError:
        return None
    return record


def committed(folder: DatasetFolder, subset: str) -> Iterator[tuple[ShardFiles, ShardRecord]]:
    """All committed shards of a subset, by name; those with damaged records are left out."""
    for files in folder.committed(subset):
        with contextlib.suppress(OSError, StorageError):
            content = read_regular(files.record, LARGEST_RECORD)
            yield files, ShardRecord.parse(content, files.record)


def contents(
    folder: DatasetFolder, subset: str
) -> tuple[list[tuple[ShardFiles, ShardRecord]], list[str]]:
    """The committed shards of a subset, and the keys of the subjects that wait for theirs.

    No subject is in both, and none is missed, although shards may be committed at this moment: the
    work files of a subject are removed after the record that lists it is written.
    """
    shards, keys = [], []
    for _ in range(_LOOKS):
        before = {files.record for files in folder.committed(subset)}
        keys = [path.stem for path in sorted(folder.waiting(subset).glob("*.json"))]
        shards = list(committed(folder, subset))
        # Else a shard was opened again, and its subjects may just have become waiting ones.
        if before <= {files.record for files in folder.committed(subset)}:
            break
    recorded = {key for _, record in shards for key in record.subjects}
    named = (key for key in keys if NAME.fullmatch(key))
    return shards, [key for key in named if key not in recorded]


# ---------------------------------------------------------------- failures


def failure(folder: DatasetFolder, subset: str, key: str) -> Failure | None:
    """What is known of a subject that failed; None if it never did."""
    path = folder.subject(subset, key).failure
    try:
        return Failure.parse(read_regular(path, LARGEST_RECORD), path)
    except (OSError, StorageError):
        return None


def record_failure(folder: DatasetFolder, subset: str, key: str, reason: str, log: str) -> int:
    """Count one more failed attempt; returns the number of attempts so far."""
    previous = failure(folder, subset, key)
    entry = Failure(
        subset=subset,
        key=key,
        attempts=(previous.attempts if previous else 0) + 1,
        reason=" ".join(reason.split())[:200],
        log=log,
    )
    write_atomically(folder.subject(subset, key).failure, encode_json(entry.to_json()))
    return entry.attempts


def quarantined(folder: DatasetFolder, subset: str, key: str) -> bool:
    """Whether a subject has used up its attempts."""
    entry = failure(folder, subset, key)
    return entry is not None and entry.attempts >= ATTEMPTS


def forget_failure(folder: DatasetFolder, subset: str, key: str) -> None:
    """Remove the note of a subject's failures, if there is one."""
    folder.subject(subset, key).failure.unlink(missing_ok=True)


def failures(folder: DatasetFolder) -> list[Failure]:
    """All subjects that failed and are not done, in order; damaged notes are left out."""
    entries = []
    for path in folder.failure_notes():
        with contextlib.suppress(OSError, StorageError):
            entries.append(Failure.parse(read_regular(path, LARGEST_RECORD), path))
    return entries


# ---------------------------------------------------------------- locks


@contextlib.contextmanager
def slice_lock(folder: DatasetFolder, shard: tuple[int, int]) -> Iterator[None]:
    """Hold slice `i` of `n` of a dataset; `StorageError` if another process holds it.

    Slices of different `n` overlap, so a running `n` keeps every other `n` out. The locks vanish
    with the process, however it ends.
    """
    import fcntl

    index, count = shard
    folder.locks.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held, contextlib.ExitStack() as tried:

        def lock(held: contextlib.ExitStack, name: str, mode: int, patience: float) -> bool:
            file = held.enter_context((folder.locks / name).open("a"))
            deadline = time.monotonic() + patience
            while True:
                try:
                    fcntl.flock(file, mode | fcntl.LOCK_NB)
                    return True
                except BlockingIOError:
                    # `status` holds a lock for an instant only: a short wait tells it from a run.
                    if time.monotonic() > deadline:
                        return False
                    time.sleep(0.05)

        with shared_files_lock(folder):
            for path in folder.locks.glob("split-*"):
                own = path.name == f"split-{count}"
                if not own and not lock(tried, path.name, fcntl.LOCK_EX, 0.5):
                    other = path.name.removeprefix("split-")
                    raise StorageError(
                        f"{folder}: being rendered in {other} slice(s), which overlap with a split "
                        f"into {count}; wait for that run or use the same --shard i/{other}"
                    )
            tried.close()  # else the next slice of this split would take us for another split
            lock(held, f"split-{count}", fcntl.LOCK_SH, 0.5)
            if not lock(held, f"slice-{index}-of-{count}", fcntl.LOCK_EX, 0.5):
                what = "this dataset" if count == 1 else f"slice {index}/{count}"
                raise StorageError(
                    f"{folder}: another process is rendering {what}; "
                    f"`synthgen status {folder}` shows it"
                )
        yield


@contextlib.contextmanager
def shared_files_lock(folder: DatasetFolder) -> Iterator[None]:
    """Wait for the lock on what all slices write: dataset.json, panoramas, manifests."""
    import fcntl

    folder.locks.mkdir(parents=True, exist_ok=True)
    # Older versions know the file by this name, and may render beside this one.
    with (folder.locks / "door").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def slice_busy(folder: DatasetFolder, name: str) -> bool:
    """Whether a process holds the slice `<i>-of-<n>`."""
    import fcntl

    try:
        with open_regular(folder.locks / f"slice-{name}") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


# ---------------------------------------------------------------- status


@dataclass
class SubsetStatus:
    """Counts of one subset. `waiting` subjects are finished but not yet in a shard."""

    name: str
    subjects: int
    frames_per_subject: int
    in_shards: int = 0
    waiting: int = 0
    failed: int = 0
    shards: int = 0
    bytes: int = 0

    @property
    def done(self) -> int:
        return self.in_shards + self.waiting


@dataclass(frozen=True)
class RunningSubject:
    """A subject that is being rendered, for so many seconds."""

    subset: str
    key: str
    seconds: float


@dataclass
class Status:
    """State of a dataset folder.

    `frames_per_second` and `seconds_left` are None if nothing runs or no subject of the run is
    finished yet.
    """

    out: Path
    name: str
    complete: bool
    subsets: list[SubsetStatus]
    running: list[RunningSubject] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    workers: int = 0
    frames_per_second: float | None = None
    seconds_left: float | None = None

    @property
    def frames(self) -> tuple[int, int]:
        """(done, total) frames."""
        return (
            sum(s.done * s.frames_per_subject for s in self.subsets),
            sum(s.subjects * s.frames_per_subject for s in self.subsets),
        )


def status(out: Place) -> Status:
    """Read the state of a dataset from disk; quick, and safe while it is being rendered.

    Raises `StorageError` if `out` is no dataset.
    """
    folder = DatasetFolder(out)
    info = read_description(folder)
    subsets = []
    for name, planned in info.plan.items():
        subset = SubsetStatus(name, planned.subjects, planned.frames_per_subject)
        shards, keys = contents(folder, name)
        subset.waiting = len(keys)
        for _, record in shards:
            subset.in_shards += len(record.subjects)
            subset.shards += 1
            subset.bytes += record.bytes
        if info.selections:
            subset.subjects = subset.in_shards
        subsets.append(subset)
    result = Status(folder.root, info.name, info.complete, subsets, failures=failures(folder))
    by_name = {s.name: s for s in subsets}
    for entry in result.failures:
        if entry.attempts >= ATTEMPTS and entry.subset in by_name:
            by_name[entry.subset].failed += 1
    _add_runs(folder, result)
    return result


def _add_runs(folder: DatasetFolder, result: Status) -> None:
    rate, now = 0.0, time.time()
    for path in folder.run_notes():
        if not slice_busy(folder, path.stem):
            continue
        try:
            run = RunNote.parse(read_regular(path, LARGEST_RECORD), path)
        except (OSError, StorageError):
            continue
        result.workers += run.workers
        rate += run.frames / max(now - run.started, 1e-3)
        result.running += [RunningSubject(s, k, now - since) for s, k, since in run.running]
    if rate > 0:
        left = sum((s.subjects - s.done - s.failed) * s.frames_per_subject for s in result.subsets)
        result.frames_per_second, result.seconds_left = rate, max(left, 0) / rate
