"""Rendering a job with worker processes of this machine.

The parent hands out subjects, one at a time, kills what hangs, retries what failed, and commits a
shard when the last of its subjects is done. All state that matters is on disk (see
`synthgen.ledger`): kill anything at any moment and run the same command again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets_procedural.environment import pool, write_pool
from synthgen import console, ledger, manifest, publish
from synthgen.farm.worker import Orders, is_disk_full, work
from synthgen.plan import Plan, ShardPlan, SubjectPlan, subject_key
from synthgen.shards import concatenate, encode_json, sha256, write_atomically

if TYPE_CHECKING:
    from synthgen.job import JobSpec

DEFAULT_RENDERER = "synthgen.stage.render:render_subject"
TIME_LIMIT = 1800.0
SUBJECTS_PER_WORKER = 20
START_LIMIT = 600.0
# So many failures in a row, without one success, mean that the set-up is broken, not the subjects.
HOPELESS = 12


@dataclass
class Summary:
    """What one call of `render_job` did. `complete`: the whole dataset is finished."""

    rendered: int = 0
    frames: int = 0
    seconds: float = 0.0
    shards: int = 0
    failed: list[dict[str, Any]] = field(default_factory=list)
    complete: bool = False


@dataclass
class Task:
    shard: ShardPlan
    subject: SubjectPlan


class Slot:
    """One worker process and what it is busy with."""

    def __init__(self, orders: Orders, number: int) -> None:
        context = get_context("spawn")
        self.number, self.log = number, orders.log
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(orders, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.task: Task | None = None
        self.ready = False
        self.served = 0
        self.since = time.monotonic()

    def give(self, task: Task) -> None:
        self.task, self.since = task, time.monotonic()
        self.pipe.send(task.subject)

    def dismiss(self) -> None:
        """Ask an idle worker to end."""
        with contextlib.suppress(OSError):
            self.pipe.send(None)
        self.process.join(5)
        self.kill()

    def kill(self) -> None:
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.pipe.close()


def render_job(
    job: JobSpec,
    out: Path | str,
    workers: int | None = None,
    threads: int = 1,
    device: str = "cpu",
    shard: tuple[int, int] = (1, 1),
    limit: int | None = None,
    renderer: str = DEFAULT_RENDERER,
    retry_failed: bool = False,
    time_limit: float = TIME_LIMIT,
    subjects_per_worker: int = SUBJECTS_PER_WORKER,
) -> Summary:
    """Render what is missing of a dataset: the whole job, or slice `shard` = (i, n), 1 <= i <= n.

    `workers` defaults to the number of cores / `threads`. `limit` bounds the subjects that this
    call renders. A subject may take `time_limit` seconds, is tried `ledger.ATTEMPTS` times, and
    then left out; `retry_failed` gives such subjects another chance.

    Raises `StorageError` with one line if the folder holds another job, the slice is being
    rendered already, the disk is full, or the renderer cannot start; `KeyboardInterrupt` after
    Ctrl-C or SIGTERM, with everything put away.
    """
    index, count = shard
    if not 1 <= index <= count:
        raise ValueError(f"slice {index}/{count}: must be i/n with 1 <= i <= n")
    out = Path(out)
    workers = workers or max(1, (os.cpu_count() or 1) // threads)
    specs = pool(job.environments, job.seed)
    the_plan = Plan(job, [spec.id for spec in specs])
    with _interruptible(), _one_line_if_full(out):
        if out.exists() and not out.is_dir():
            raise ledger.StorageError(f"{out}: is a file; give a folder that --out may fill")
        with ledger.slice_lock(out, shard):
            with ledger.door(out):
                provenance = [spec.model_dump(mode="json") for spec in specs]
                publish.begin(out, the_plan, provenance, renderer)
                write_pool(specs, out / "environments")
            (out / "work" / "logs").mkdir(parents=True, exist_ok=True)
            orders = Orders(job, out, renderer, device, threads, Path())
            run = Run(the_plan, orders, shard, workers, time_limit, subjects_per_worker)
            summary = run.go(limit, retry_failed)
            with ledger.door(out):
                summary.complete = publish.complete(out)
            if summary.complete and not ledger.failures(out):
                shutil.rmtree(out / "work", ignore_errors=True)
    return summary


class Run:
    """One pass over a slice of the plan."""

    def __init__(
        self,
        the_plan: Plan,
        orders: Orders,
        shard: tuple[int, int],
        workers: int,
        time_limit: float,
        subjects_per_worker: int,
    ) -> None:
        self.plan, self.orders, self.out = the_plan, orders, orders.out
        self.workers, self.time_limit = workers, time_limit
        self.subjects_per_worker = subjects_per_worker
        self.slice = f"{shard[0]}-of-{shard[1]}"
        every = [s for name in the_plan.job.subsets for s in the_plan.shards(name)]
        self.shards = every[shard[0] - 1 :: shard[1]]
        self.missing: dict[str, set[int]] = {}  # open shard -> indices still to render
        self.retries: deque[Task] = deque()
        self.slots: dict[int, Slot] = {}
        self.summary = Summary()
        self.failures_in_a_row = 0
        self.started = time.time()

    def go(self, limit: int | None, retry_failed: bool) -> Summary:
        """Render until nothing is left or `limit` subjects are rendered."""
        clean_temporary(self.out, self.shards)
        if retry_failed:
            self._forgive()
        tasks = self._tasks()
        handed = 0
        try:
            with _progress(self) as advance:
                while True:
                    while sum(s.task is not None for s in self.slots.values()) < self.workers:
                        task = self.retries.popleft() if self.retries else None
                        if task is None and (limit is None or handed < limit):
                            task = next(tasks, None)
                            handed += task is not None
                        if task is None:
                            break
                        self._hand_out(task)
                    if not any(s.task for s in self.slots.values()):
                        break
                    self._note()
                    self._wait()
                    advance()
            for slot in self.slots.values():
                slot.dismiss()
        finally:
            for slot in self.slots.values():
                slot.kill()
            run_file = self.out / "work" / "runs" / f"{self.slice}.json"
            run_file.unlink(missing_ok=True)
        self.summary.seconds = time.time() - self.started
        names = {s.name.split("/")[0] for s in self.shards}
        self.summary.failed = [f for f in ledger.failures(self.out) if f["subset"] in names]
        return self.summary

    # ------------------------------------------------------------ what is to do

    def _tasks(self) -> Iterator[Task]:
        """Subjects still to render, in order; commits shards that need no rendering on the way."""
        for shard in self.shards:
            stem = Path(shard.name).stem
            if ledger.shard_record(self.out, shard.subset, stem) is not None:
                self._tidy(shard)
                continue
            left = {
                index
                for index in shard.subjects
                if not ledger.subject_done(self.out, shard.subset, subject_key(index))
                and not ledger.quarantined(self.out, shard.subset, subject_key(index))
            }
            self.missing[shard.name] = left
            if not left:
                self._commit(shard)
            for index in sorted(left):
                yield Task(shard, self.plan.subject(shard.subset, index))

    def _forgive(self) -> None:
        """Give failed subjects of this slice another chance, opening their shards again."""
        failed = {(f["subset"], f["key"]) for f in ledger.failures(self.out)}
        for shard in self.shards:
            keys = [k for i in shard.subjects if (shard.subset, k := subject_key(i)) in failed]
            for key in keys:
                ledger.forget_failure(self.out, shard.subset, key)
            if keys and ledger.shard_record(self.out, shard.subset, Path(shard.name).stem):
                with ledger.door(self.out):
                    publish.reopen(self.out)
                unpack_shard(self.out, shard)

    # ------------------------------------------------------------ workers

    def _hand_out(self, task: Task) -> None:
        idle = [n for n, s in self.slots.items() if s.task is None]
        for number in idle:
            slot = self.slots[number]
            if slot.served >= self.subjects_per_worker:
                slot.dismiss()
                del self.slots[number]
        idle = [n for n in idle if n in self.slots]
        if not idle:
            number = next(n for n in range(self.workers) if n not in self.slots)
            log = self.out / "work" / "logs" / f"{self.slice}-worker-{number}.log"
            self.slots[number] = Slot(dataclasses.replace(self.orders, log=log), number)
            idle = [number]
        self.slots[idle[0]].give(task)

    def _wait(self) -> None:
        """Block until a worker says something, dies or exceeds its time; act on it."""
        sources: dict[Any, Slot] = {}
        for slot in self.slots.values():
            sources[slot.pipe] = sources[slot.process.sentinel] = slot
        for slot in {sources[source] for source in connection.wait(list(sources), 0.5)}:
            self._listen(slot)
        now = time.monotonic()
        for slot in list(self.slots.values()):
            allowed = self.time_limit if slot.ready else self.time_limit + START_LIMIT
            if slot.task is not None and now - slot.since > allowed:
                self._lose(slot, f"hung: killed after {now - slot.since:.0f} s")

    def _listen(self, slot: Slot) -> None:
        try:
            message = slot.pipe.recv() if slot.pipe.poll() else None
        except (EOFError, OSError):
            message = None
        if message is None:
            slot.process.join(5)
            self._lose(slot, _death(slot.process.exitcode))
        elif message[0] == "ready":
            slot.ready, slot.since = True, time.monotonic()
        elif message[0] == "broken":
            raise ledger.StorageError(
                f"{self.orders.renderer}: cannot start: {message[1]} (log: {slot.log})"
            )
        elif message[0] == "full":
            raise ledger.StorageError(_full(self.out))
        elif message[0] == "failed":
            # Blender may be left in any state by an exception: go on with a fresh process.
            self._lose(slot, message[1])
        elif message[0] == "done" and slot.task is not None:
            task, slot.task = slot.task, None
            slot.served += 1
            self.failures_in_a_row = 0
            self.summary.rendered += 1
            self.summary.frames += task.subject.frames
            ledger.forget_failure(self.out, task.subject.subset, task.subject.key)
            self._finish(task)

    def _lose(self, slot: Slot, reason: str) -> None:
        """A worker is gone, and with it the attempt at its subject."""
        task = slot.task
        slot.kill()
        del self.slots[slot.number]
        if task is None:
            return
        subset, key = task.subject.subset, task.subject.key
        if ledger.subject_done(self.out, subset, key):  # it died after its commit
            self._finish(task)
            return
        log = slot.log.relative_to(self.out).as_posix()
        attempts = ledger.record_failure(self.out, subset, key, reason, log)
        self.failures_in_a_row += 1
        if self.failures_in_a_row >= HOPELESS and not self.summary.rendered:
            raise ledger.StorageError(
                f"the first {self.failures_in_a_row} attempts all failed, the last with: {reason} "
                f"(log: {slot.log}); mend it, then run again with --retry-failed"
            )
        if attempts < ledger.ATTEMPTS:
            self.retries.append(task)
        else:
            self._finish(task)

    # ------------------------------------------------------------ shards

    def _finish(self, task: Task) -> None:
        left = self.missing[task.shard.name]
        left.discard(task.subject.index)
        if not left:
            self._commit(task.shard)

    def _commit(self, shard: ShardPlan) -> None:
        commit_shard(self.out, shard)
        del self.missing[shard.name]
        self._tidy(shard)
        self.summary.shards += 1

    def _tidy(self, shard: ShardPlan) -> None:
        """Remove the work files of a committed shard."""
        folder = self.out / "work" / shard.subset
        if folder.is_dir() and any(folder.iterdir()):
            for index in shard.subjects:
                for suffix in (".json", ".tar"):
                    path = ledger.work_file(self.out, shard.subset, subject_key(index), suffix)
                    path.unlink(missing_ok=True)

    def _note(self) -> None:
        """Tell `status`, in another process, what this run is busy with."""
        now, clock = time.time(), time.monotonic()
        busy = [s for s in self.slots.values() if s.task is not None]
        note = {
            "pid": os.getpid(),
            "started": self.started,
            "workers": len(self.slots),
            "frames": self.summary.frames,
            "running": [
                [s.task.subject.subset, s.task.subject.key, now - (clock - s.since)]
                for s in busy
                if s.task is not None
            ],
        }
        path = self.out / "work" / "runs" / f"{self.slice}.json"
        path.parent.mkdir(exist_ok=True)
        temporary = path.with_suffix(".tmp")
        temporary.write_text(json.dumps(note))
        temporary.replace(path)


def commit_shard(out: Path, shard: ShardPlan) -> dict[str, Any]:
    """Make a shard of its finished subjects: tar, then manifest part, then the record."""
    stem = Path(shard.name).stem
    keys = [subject_key(index) for index in shard.subjects]
    present = [key for key in keys if ledger.subject_done(out, shard.subset, key)]
    tar = out / "data" / shard.name
    record: dict[str, Any] = {
        "tar": tar.relative_to(out).as_posix(),
        "subjects": present,
        "failed": [key for key in keys if key not in set(present)],
        "shots": 0,
        "frames": 0,
        "bytes": 0,
    }
    if present:
        parts = [ledger.work_file(out, shard.subset, key, ".tar") for key in present]
        starts, record["bytes"], record["sha256"] = concatenate(parts, tar)
        rows = []
        for key, start in zip(present, starts, strict=True):
            path = ledger.work_file(out, shard.subset, key, ".json")
            rows += [_moved(r, record["tar"], start) for r in manifest.decode_rows(path)]
        part = ledger.part_file(out, shard.subset, stem)
        manifest.write_part(part, rows)
        record["part_sha256"] = sha256(part)
        record["shots"] = len(rows)
        record["frames"] = sum(len(r["environments"]) for r in rows)
    write_atomically(ledger.record_file(out, shard.subset, stem), encode_json(record))
    return record


def unpack_shard(out: Path, shard: ShardPlan) -> None:
    """The reverse of `commit_shard`, so that a missing subject can be added."""
    stem = Path(shard.name).stem
    record = ledger.shard_record(out, shard.subset, stem)
    if record is None:
        return
    if record["subjects"]:
        rows = manifest.read_rows(ledger.part_file(out, shard.subset, stem))
        tar = out / record["tar"]
        for key in record["subjects"]:
            own = [r for r in rows if r["subject"] == key]
            start = own[0]["offset"]
            size = own[-1]["offset"] + own[-1]["size"] - start
            work_tar = ledger.work_file(out, shard.subset, key, ".tar")
            with tar.open("rb") as file:
                file.seek(start)
                write_atomically(work_tar, file.read(size))
            place = work_tar.relative_to(out).as_posix()
            content = manifest.encode_rows([_moved(r, place, -start) for r in own])
            write_atomically(work_tar.with_suffix(".json"), content)
    ledger.record_file(out, shard.subset, stem).unlink()


def _moved(row: dict[str, Any], shard: str, by: int) -> dict[str, Any]:
    members = [{**m, "offset": m["offset"] + by} for m in row["members"]]
    return {**row, "shard": shard, "offset": row["offset"] + by, "members": members}


def clean_temporary(out: Path, shards: list[ShardPlan]) -> None:
    """Remove what killed processes of this slice left under temporary names."""
    mine = {s.name for s in shards}
    own = {(s.subset, subject_key(i)) for s in shards for i in s.subjects}
    for subset in {s.subset for s in shards}:
        for folder in ("data", "work", "subjects"):
            for path in (out / folder / subset).glob(".*.tmp"):
                stem = path.name[1:].split(".", 1)[0]
                if f"{subset}/{stem}.tar" in mine or (subset, stem) in own:
                    path.unlink(missing_ok=True)


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            return f"crashed: worker died of {signal.Signals(-code).name}"
    return f"crashed: worker ended with code {code}"


def _full(out: Path) -> str:
    return f"{out}: the disk is full; make room and run the same command to continue"


@contextlib.contextmanager
def _one_line_if_full(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if is_disk_full(error):
            raise ledger.StorageError(_full(out)) from None
        raise


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM, by which schedulers preempt, ends a run as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


@contextlib.contextmanager
def _progress(run: Run) -> Iterator[Callable[[], None]]:
    """A bar with rate and time left; nothing at all when the output is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    total = sum(
        len(s.subjects) * (spec.shots * spec.environments)
        for s in run.shards
        for spec in [run.plan.job.subsets[s.subset]]
    )
    before = frames_done(run.out, run.plan, run.shards)
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} frames"),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console.stderr()) as bar:
        task = bar.add_task("rendering", total=total, completed=before, note="starting workers")

        def advance() -> None:
            done = run.summary.frames
            elapsed = time.time() - run.started
            note = "starting workers" if not any(s.ready for s in run.slots.values()) else ""
            if done:
                left = (total - before - done) * elapsed / done
                note = f"{done / elapsed:.2f} frames/s, {console.duration(left)} left"
            bad = len(ledger.failures(run.out)) if run.failures_in_a_row else 0
            note += f", {bad} failed" if bad else ""
            bar.update(task, completed=before + done, note=note)

        yield advance


def frames_done(out: Path, the_plan: Plan, shards: list[ShardPlan]) -> int:
    """Frames of these shards that are on disk."""
    done = 0
    for shard in shards:
        spec = the_plan.job.subsets[shard.subset]
        record = ledger.shard_record(out, shard.subset, Path(shard.name).stem)
        if record is not None:
            done += record["frames"]
            continue
        waiting = sum(
            ledger.subject_done(out, shard.subset, subject_key(i)) for i in shard.subjects
        )
        done += waiting * spec.shots * spec.environments
    return done
