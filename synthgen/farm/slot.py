"""One worker process, seen from the parent."""

from __future__ import annotations

import contextlib
import shutil
import time
from dataclasses import dataclass
from multiprocessing import get_context

from synthgen.farm.process import start
from synthgen.farm.worker import Message, Orders, work
from synthgen.planning.plan import ShardPlan, SubjectPlan


@dataclass(frozen=True)
class Task:
    """A subject to render, and the shard that it goes into."""

    shard: ShardPlan
    subject: SubjectPlan


class Slot:
    """One worker process and what it is busy with."""

    def __init__(self, orders: Orders, number: int) -> None:
        self.number, self.orders, self.log = number, orders, orders.log
        self.pipe, theirs = get_context("spawn").Pipe()
        self.process = start(work, orders, theirs)
        theirs.close()
        self.task: Task | None = None
        self.ready = False
        self.served = 0
        self.since = time.monotonic()

    def give(self, task: Task) -> None:
        """Hand a task to the worker, which must be idle. Raises `OSError` if it is dead."""
        self.task, self.since = task, time.monotonic()
        self.pipe.send(task.subject)

    def message(self) -> Message | None:
        """What the worker has said, None if it has said nothing: it is dead then."""
        try:
            return self.pipe.recv() if self.pipe.poll() else None
        except Exception:  # half a message, of a worker that was killed, raises anything
            return None

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
        if self.orders.temporary is not None:
            shutil.rmtree(self.orders.temporary, ignore_errors=True)
