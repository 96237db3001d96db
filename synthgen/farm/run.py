"""One pass over a slice of the plan: hand out subjects, listen to workers, commit shards."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synthgen.dataset import ledger
from synthgen.dataset.folder import DatasetFolder, StorageError
from synthgen.farm import progress
from synthgen.farm.commit import clean_temporary, commit_shard, drop_waiting, unpack_shard
from synthgen.farm.mend import find_damage, mend_shard
from synthgen.farm.process import reason_of_death
from synthgen.farm.slot import Slot, Task
from synthgen.farm.state import RunState, Summary
from synthgen.farm.worker import Broken, DiskFull, Done, Failed, Orders, Ready
from synthgen.planning.plan import Plan, ShardPlan, subject_key
from synthgen.publish import publish

if TYPE_CHECKING:
    from synthgen.planning.job import JobSpec

START_LIMIT = 600.0
# This many subjects failing in a row, or attempts before the first success, mean that the set-up is
# broken, not the subjects.
HOPELESS = 12


def time_allowed(job: JobSpec, frames: int) -> float:
    """Seconds after which a subject of this many frames counts as hung: several times its need.

    One thread takes about 0.5 s per sample of a frame of 256 x 256 pixels.
    """
    return 600.0 + frames * (job.resolution / 256) ** 2 * (10.0 + 3.0 * job.samples)


class Run(RunState):
    """One pass over a slice of the plan."""

    def __init__(
        self,
        the_plan: Plan,
        orders: Orders,
        shard: tuple[int, int],
        workers: int,
        time_limit: float | None,
        subjects_per_worker: int,
    ) -> None:
        every = [s for name in the_plan.job.subsets for s in the_plan.shards(name)]
        super().__init__(
            plan=the_plan,
            folder=DatasetFolder(orders.out),
            slice=f"{shard[0]}-of-{shard[1]}",
            shards=every[shard[0] - 1 :: shard[1]],
        )
        self.orders, self.workers, self.time_limit = orders, workers, time_limit
        self.subjects_per_worker = subjects_per_worker
        self.missing: dict[str, set[int]] = {}  # open shard -> indices still to render
        self.retries: deque[Task] = deque()

    def render(self, limit: int | None, retry_failed: bool) -> Summary:
        """Render until nothing is left or `limit` subjects are rendered."""
        clean_temporary(self.folder, self.shards)
        self._clean_temporary_folders()
        self._mend()
        if retry_failed:
            self._forgive()
        tasks = self._tasks()
        handed = 0
        try:
            with progress.shown(self, limit) as advance:
                while True:
                    while sum(s.task is not None for s in self.slots.values()) < self.workers:
                        # After a failure, another subject first: if that fails too, the machine
                        # may be the reason, and no subject should lose its attempts to it.
                        task = None
                        new = limit is None or handed < limit
                        if new and (self.streak or not self.retries):
                            task = next(tasks, None)
                            handed += task is not None
                        if task is None and self.retries:
                            task = self.retries.popleft()
                        if task is None:
                            break
                        self._hand_out(task)
                    if not any(s.task for s in self.slots.values()):
                        break
                    progress.note(self)
                    self._wait()
                    advance()
            for slot in self.slots.values():
                slot.dismiss()
        finally:
            for slot in self.slots.values():
                slot.kill()
            with contextlib.suppress(OSError):
                self.folder.temporary.rmdir()
            self.folder.run_note(self.slice).unlink(missing_ok=True)
        self.summary.seconds = time.time() - self.started
        names = {s.name.split("/")[0] for s in self.shards}
        self.summary.failed = [f for f in ledger.failures(self.folder) if f.subset in names]
        return self.summary

    # ------------------------------------------------------------ what is to do

    def _tasks(self) -> Iterator[Task]:
        """Subjects still to render, in order; commits shards that need no rendering on the way."""
        reopened = False
        for shard in self.shards:
            record = ledger.shard_record(self.folder, shard.name)
            if record is not None and publish.lacks_subjects(record, shard):
                with ledger.shared_files_lock(self.folder):
                    publish.reopen(self.folder)
                unpack_shard(self.folder, shard, record)
            elif record is not None:
                self._tidy(shard)
                continue
            left = set()
            for index in shard.subjects:
                key = subject_key(index)
                if ledger.waiting(self.folder, shard.subset, key):
                    ledger.forget_failure(self.folder, shard.subset, key)
                elif not ledger.quarantined(self.folder, shard.subset, key):
                    left.add(index)
            self.missing[shard.name] = left
            if not left:
                self._commit(shard)
            elif not reopened:  # a complete dataset may have lost a shard
                with ledger.shared_files_lock(self.folder):
                    publish.reopen(self.folder)
                reopened = True
            for index in sorted(left):
                yield Task(shard, self.plan.subject(shard.subset, index))

    def _mend(self) -> None:
        """Open what is damaged of this slice, so that it is rendered again."""
        damage = find_damage(self.folder, self.shards)
        if damage.shards or damage.waiting:
            with ledger.shared_files_lock(self.folder):
                publish.reopen(self.folder)
        for shard in damage.shards:
            lost = mend_shard(self.folder, shard)
            what = f"rendering again {', '.join(lost)}" if lost else "its manifest is written again"
            tar = self.folder.relative(self.folder.shard(shard.name).tar)
            self.summary.mended.append(f"{tar}: it or what belongs to it was damaged; {what}")
        for subset, key in damage.waiting:
            drop_waiting(self.folder, subset, key)
            name = f"{subset}/{key}"
            self.summary.mended.append(f"{name}: its work files were damaged; rendering it again")

    def _clean_temporary_folders(self) -> None:
        """Remove those of workers that were killed; other slices may have some in use."""
        if self.folder.temporary.is_dir():
            for path in self.folder.temporary.iterdir():
                name = path.name.rpartition("_worker_")[0]
                if name == self.slice or not ledger.slice_busy(self.folder, name):
                    shutil.rmtree(path, ignore_errors=True)

    def _forgive(self) -> None:
        """Give failed subjects of this slice another chance, opening their shards again."""
        failed = {(f.subset, f.key) for f in ledger.failures(self.folder)}
        for shard in self.shards:
            keys = [k for i in shard.subjects if (shard.subset, k := subject_key(i)) in failed]
            if keys and (record := ledger.shard_record(self.folder, shard.name)):
                with ledger.shared_files_lock(self.folder):
                    publish.reopen(self.folder)
                unpack_shard(self.folder, shard, record)
            for key in keys:  # last: a shard without them and without their failures loses them
                ledger.forget_failure(self.folder, shard.subset, key)

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
            log = self.folder.log(self.slice, number)
            self.folder.temporary.mkdir(parents=True, exist_ok=True)
            prefix = f"{self.slice}_worker_"
            temporary = Path(tempfile.mkdtemp(prefix=prefix, dir=self.folder.temporary))
            orders = dataclasses.replace(self.orders, log=log, temporary=temporary)
            self.slots[number] = Slot(orders, number)
            idle = [number]
        slot = self.slots[idle[0]]
        try:
            slot.give(task)
        except OSError:  # it died a moment ago
            self._lose_dead(slot)

    def _wait(self) -> None:
        """Block until a worker says something, dies or exceeds its time; act on it."""
        sources: dict[Any, Slot] = {}
        for slot in self.slots.values():
            sources[slot.pipe] = sources[slot.process.sentinel] = slot
        for slot in {sources[source] for source in connection.wait(list(sources), 0.5)}:
            self._listen(slot)
        now = time.monotonic()
        for slot in list(self.slots.values()):
            if slot.task is None:
                continue
            allowed = self.time_limit
            if allowed is None:
                allowed = time_allowed(self.plan.job, slot.task.subject.frames)
            allowed += 0.0 if slot.ready else START_LIMIT
            if now - slot.since > allowed:
                self._lose(slot, f"hung: killed after {now - slot.since:.0f} s (--time-limit)")

    def _listen(self, slot: Slot) -> None:
        match slot.message():
            case None:
                self._lose_dead(slot)
            case Ready():
                slot.ready, slot.since = True, time.monotonic()
            case Broken(reason):
                raise StorageError(
                    f"{self.orders.renderer}: cannot start: {reason} (log: {slot.log})"
                )
            case DiskFull(folder, reason):
                raise StorageError(f"{disk_is_full(folder)} ({reason}; log: {slot.log})")
            case Failed(reason):
                # Blender may be left in any state by an exception: go on with a fresh process.
                self._lose(slot, reason)
            case Done() if slot.task is not None:
                task, slot.task = slot.task, None
                slot.served += 1
                self.streak.clear()
                self.summary.rendered += 1
                self.summary.frames += task.subject.frames
                ledger.forget_failure(self.folder, task.subject.subset, task.subject.key)
                self._finish(task)

    def _lose_dead(self, slot: Slot) -> None:
        slot.process.join(5)
        self._lose(slot, f"crashed: worker {reason_of_death(slot.process.exitcode)}")

    def _lose(self, slot: Slot, reason: str) -> None:
        """A worker is gone, and with it the attempt at its subject."""
        task = slot.task
        slot.kill()
        del self.slots[slot.number]
        if task is None:
            return
        subset, key = task.subject.subset, task.subject.key
        if ledger.waiting(self.folder, subset, key):  # it died after its commit
            ledger.forget_failure(self.folder, subset, key)
            self._finish(task)
            return
        log = self.folder.relative(slot.log)
        attempts = ledger.record_failure(self.folder, subset, key, reason, log)
        self.streak.append((subset, key))
        if len(self.streak if not self.summary.rendered else set(self.streak)) >= HOPELESS:
            raise StorageError(
                f"the last {len(self.streak)} attempts all failed, the last with: {reason} "
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
        if damaged := commit_shard(self.folder, shard):
            self._render_again(shard, set(damaged))
            return
        del self.missing[shard.name]
        self._tidy(shard)

    def _render_again(self, shard: ShardPlan, keys: set[str]) -> None:
        """Subjects whose work files changed since they were written: each loses an attempt."""
        reason = "its work files were damaged before they got into their shard"
        left = self.missing[shard.name]
        for index in shard.subjects:
            if (key := subject_key(index)) not in keys:
                continue
            attempts = ledger.record_failure(self.folder, shard.subset, key, reason, "")
            if attempts < ledger.ATTEMPTS:
                left.add(index)
                self.retries.append(Task(shard, self.plan.subject(shard.subset, index)))
        if not left:
            self._commit(shard)

    def _tidy(self, shard: ShardPlan) -> None:
        """Remove the work files of a committed shard."""
        waiting = self.folder.waiting(shard.subset)
        if waiting.is_dir() and any(waiting.iterdir()):
            for index in shard.subjects:
                files = self.folder.subject(shard.subset, subject_key(index))
                files.waiting_rows.unlink(missing_ok=True)
                files.waiting_tar.unlink(missing_ok=True)


def disk_is_full(folder: Path) -> str:
    """The line that a user gets when the disk of a folder is full."""
    return f"{folder}: the disk is full; make room and run the same command to continue"
