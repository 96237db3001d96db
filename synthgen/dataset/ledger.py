"""What is done, what failed and why. The truth is on disk, so any process may ask.

    dataset.json                          the job; written first, completed last
    work/<subset>/<key>.tar, .json        a finished subject that waits for its shard
    work/runs/<i>-of-<n>.json             what a running slice is busy with
    ledger/<subset>/<split>-000000.json   the record of a committed shard: its marker
    ledger/<subset>/<split>-000000.parquet   its rows of the manifest
    ledger/failed/<subset>/<key>.json     attempts of a subject that failed, and the last reason

A subject is done when its .json exists, a shard when its record exists and its tar has the recorded
size. Both are committed after what they vouch for.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from assets_procedural.conventions.errors import UserError
from assets_procedural.conventions.files import write_atomically
from synthgen.dataset.codecs import encode_json

ATTEMPTS = 3


class StorageError(UserError, RuntimeError):
    """A dataset folder that cannot be used as asked; the message is one line for the user."""


def work_file(out: Path, subset: str, key: str, suffix: str) -> Path:
    return out / "work" / subset / f"{key}{suffix}"


def subject_done(out: Path, subset: str, key: str) -> bool:
    """Whether a finished subject waits for its shard."""
    return work_file(out, subset, key, ".json").exists()


def record_file(out: Path, subset: str, name: str) -> Path:
    return out / "ledger" / subset / f"{name}.json"


def part_file(out: Path, subset: str, name: str) -> Path:
    return out / "ledger" / subset / f"{name}.parquet"


def shard_record(out: Path, subset: str, name: str) -> dict[str, Any] | None:
    """The record of a committed shard, or None if there is none or its files are gone."""
    try:
        record = json.loads(record_file(out, subset, name).read_bytes())
        if not record["subjects"]:
            return record
        if (out / record["tar"]).stat().st_size != record["bytes"]:
            return None
        part_file(out, subset, name).stat()
    except (OSError, ValueError, KeyError):
        return None
    return record


def shard_records(out: Path, subset: str) -> Iterator[dict[str, Any]]:
    """Records of all committed shards of a subset in the order of their names."""
    for path in sorted((out / "ledger" / subset).glob("*.json")):
        with contextlib.suppress(OSError, ValueError):
            yield json.loads(path.read_bytes())


def has_records(out: Path) -> bool:
    """Whether anything was rendered: a shard's record, a failure, or a subject that waits."""
    patterns = ("ledger/*/*.json", "ledger/failed/*/*.json", "work/*/s*.json")
    return any(True for pattern in patterns for _ in out.glob(pattern))


# ---------------------------------------------------------------- failures


def failure_file(out: Path, subset: str, key: str) -> Path:
    return out / "ledger" / "failed" / subset / f"{key}.json"


def failure(out: Path, subset: str, key: str) -> dict[str, Any] | None:
    """Attempts, reason and log of a subject that failed; None if it never did."""
    try:
        return json.loads(failure_file(out, subset, key).read_bytes())
    except (OSError, ValueError):
        return None


def record_failure(out: Path, subset: str, key: str, reason: str, log: str) -> int:
    """Count one more failed attempt; returns the number of attempts so far."""
    previous = failure(out, subset, key)
    attempts = (previous["attempts"] if previous else 0) + 1
    reason = " ".join(reason.split())[:200]
    entry = {"subset": subset, "key": key, "attempts": attempts, "reason": reason, "log": log}
    write_atomically(failure_file(out, subset, key), encode_json(entry))
    return attempts


def quarantined(out: Path, subset: str, key: str) -> bool:
    """Whether a subject has used up its attempts."""
    entry = failure(out, subset, key)
    return entry is not None and entry["attempts"] >= ATTEMPTS


def forget_failure(out: Path, subset: str, key: str) -> None:
    failure_file(out, subset, key).unlink(missing_ok=True)


def failures(out: Path) -> list[dict[str, Any]]:
    """All subjects that failed and are not done, in order."""
    entries = []
    for path in sorted((out / "ledger" / "failed").glob("*/*.json")):
        with contextlib.suppress(OSError, ValueError):
            entries.append(json.loads(path.read_bytes()))
    return entries


# ---------------------------------------------------------------- locks


@contextlib.contextmanager
def slice_lock(out: Path, shard: tuple[int, int]) -> Iterator[None]:
    """Hold slice `i` of `n` of a dataset; `StorageError` if another process holds it.

    Slices of different `n` overlap, so a running `n` keeps every other `n` out. The locks vanish
    with the process, however it ends.
    """
    import fcntl

    index, count = shard
    folder = out / "work" / "locks"
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held:

        def lock(name: str, mode: int, patience: float) -> bool:
            file = held.enter_context((folder / name).open("a"))
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

        with door(out):
            for path in folder.glob("split-*"):
                if path.name != f"split-{count}" and not lock(path.name, fcntl.LOCK_EX, 0.5):
                    other = path.name.removeprefix("split-")
                    raise StorageError(
                        f"{out}: being rendered in {other} slice(s), which overlap with a split "
                        f"into {count}; wait for that run or use the same --shard i/{other}"
                    )
            lock(f"split-{count}", fcntl.LOCK_SH, 0.5)
            if not lock(f"slice-{index}-of-{count}", fcntl.LOCK_EX, 0.5):
                what = "this dataset" if count == 1 else f"slice {index}/{count}"
                raise StorageError(
                    f"{out}: another process is rendering {what}; `synthgen status {out}` shows it"
                )
        yield


@contextlib.contextmanager
def door(out: Path) -> Iterator[None]:
    """Wait for one's turn to write what all slices share: dataset.json, panoramas, manifests."""
    import fcntl

    (out / "work" / "locks").mkdir(parents=True, exist_ok=True)
    with (out / "work" / "locks" / "door").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def slice_busy(out: Path, name: str) -> bool:
    """Whether a process holds the slice `<i>-of-<n>`."""
    import fcntl

    try:
        with (out / "work" / "locks" / f"slice-{name}").open() as file:
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


@dataclass
class Status:
    """State of a dataset folder.

    `running`: one entry per busy subject (subset, key, seconds). `failures`: entries with subset,
    key, attempts, reason, log. `frames_per_second` and `seconds_left` are None if nothing runs or
    no subject of the run is finished yet.
    """

    out: Path
    name: str
    complete: bool
    subsets: list[SubsetStatus]
    running: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)
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


def read_dataset_json(out: Path) -> dict[str, Any]:
    """The dataset's dataset.json; `StorageError` if the folder is no dataset."""
    path = Path(out) / "dataset.json"
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise StorageError(f"{out}: no dataset here (no dataset.json)") from None
    except NotADirectoryError:
        raise StorageError(f"{out}: is a file, not a dataset folder") from None
    except ValueError as error:
        raise StorageError(f"{path}: not valid JSON ({error})") from None


def status(out: Path) -> Status:
    """Read the state of a dataset from disk; quick, and safe while it is being rendered.

    Raises `StorageError` if `out` is no dataset.
    """
    out = Path(out)
    info = read_dataset_json(out)
    subsets = []
    for name, counts in info["plan"].items():
        subset = SubsetStatus(name, counts["subjects"], counts["frames_per_subject"])
        for record in shard_records(out, name):
            subset.in_shards += len(record["subjects"])
            subset.shards += 1
            subset.bytes += record["bytes"]
        folder = out / "work" / name
        if folder.is_dir():
            with os.scandir(folder) as entries:
                subset.waiting = sum(e.name.endswith(".json") for e in entries)
        subsets.append(subset)
    result = Status(out, info["name"], bool(info.get("complete")), subsets, failures=failures(out))
    by_name = {s.name: s for s in subsets}
    for entry in result.failures:
        if entry["attempts"] >= ATTEMPTS and entry["subset"] in by_name:
            by_name[entry["subset"]].failed += 1
    _add_runs(out, result)
    return result


def _add_runs(out: Path, result: Status) -> None:
    rate, now = 0.0, time.time()
    for path in sorted((out / "work" / "runs").glob("*.json")):
        if not slice_busy(out, path.stem):
            continue
        try:
            run = json.loads(path.read_bytes())
        except (OSError, ValueError):
            continue
        result.workers += run["workers"]
        rate += run["frames"] / max(now - run["started"], 1e-3)
        result.running += [
            {"subset": s, "key": k, "seconds": now - since} for s, k, since in run["running"]
        ]
    if rate > 0:
        left = sum((s.subjects - s.done - s.failed) * s.frames_per_subject for s in result.subsets)
        result.frames_per_second, result.seconds_left = rate, max(left, 0) / rate
