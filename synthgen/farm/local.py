"""Rendering a job with worker processes of this machine.

The parent hands out subjects, one at a time, kills what hangs, retries what failed, and commits a
shard when the last of its subjects is done. All state that matters is on disk (see
`synthgen.ledger`): kill anything at any moment and run the same command again.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets_procedural.environment import pool, write_pool
from synthgen import ledger, publish
from synthgen.farm import DEFAULT_RENDERER
from synthgen.farm.run import Run, Summary, full
from synthgen.farm.worker import Orders, is_disk_full
from synthgen.plan import Plan

if TYPE_CHECKING:
    from synthgen.job import JobSpec

TIME_LIMIT = 1800.0
SUBJECTS_PER_WORKER = 20


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
    with _interruptible(), _one_line_iffull(out):
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


@contextlib.contextmanager
def _one_line_iffull(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if is_disk_full(error):
            raise ledger.StorageError(full(out)) from None
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
