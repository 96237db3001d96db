"""One worker process, seen from the parent."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from multiprocessing import get_context

from synthgen.farm.process import start
from synthgen.farm.worker import Orders, work
from synthgen.planning.plan import ShardPlan, SubjectPlan


@dataclass
class Task:
    shard: ShardPlan
    subject: SubjectPlan


class Slot:
    """One worker process and what it is busy with."""

    def __init__(self, orders: Orders, number: int) -> None:
        self.number, self.log = number, orders.log
        self.pipe, theirs = get_context("spawn").Pipe()
        self.process = start(work, orders, theirs)
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
