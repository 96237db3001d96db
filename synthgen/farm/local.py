"""Rendering a job with worker processes of this machine.

The parent hands out subjects, one at a time, kills what hangs, retries what failed, and commits a
shard when the last of its subjects is done. All state that matters is on disk (see
`synthgen.dataset.ledger`): kill anything at any moment and run the same command again.
"""

from __future__ import annotations

import contextlib
import shutil
import signal
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets_procedural.conventions import console
from assets_procedural.conventions.files import sha256
from assets_procedural.light.pool import pool, provenance, write_pool
from assets_procedural.motion import recorded
from synthgen.dataset import ledger
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import read_description
from synthgen.errors import JobError
from synthgen.farm import DEFAULT_RENDERER, Device, calibration, preflight
from synthgen.farm.commit import clean_shared
from synthgen.farm.run import Run, Summary, disk_is_full
from synthgen.farm.worker import Orders, is_disk_full
from synthgen.planning.plan import Plan
from synthgen.publish import extending, publish

if TYPE_CHECKING:
    from assets_procedural.light.pool import EnvironmentSpec
    from synthgen.planning.job import JobSpec

SUBJECTS_PER_WORKER = 20


def render_job(
    job: JobSpec,
    out: Place,
    workers: int | None = None,
    threads: int = 1,
    device: Device = "cpu",
    shard: tuple[int, int] = (1, 1),
    limit: int | None = None,
    renderer: str = DEFAULT_RENDERER,
    retry_failed: bool = False,
    time_limit: float | None = None,
    subjects_per_worker: int = SUBJECTS_PER_WORKER,
) -> Summary:
    """Render what is missing of a dataset: the whole job, or slice `shard` = (i, n), 1 <= i <= n.

    `workers` defaults to the number of cores / `threads`. `limit` bounds the subjects that this
    call renders. A subject may take `time_limit` seconds, by default by far more than it needs
    (`run.time_allowed`); it is tried `ledger.ATTEMPTS` times, and then left out; `retry_failed`
    gives such subjects another chance. Workers are spawned, so a script must call this below
    `if __name__ == "__main__":`.

    Raises `JobError` for a wrong slice or too small a pool; `PanoramaError` for a panorama that
    cannot be read; `ModuleNotFoundError` where Blender is not installed; `StorageError` if the
    folder cannot be used for this job (see `publish.check`; it is left untouched), the slice is
    being rendered already, the disk is full, or the renderer cannot start; `KeyboardInterrupt`
    after Ctrl-C or SIGTERM, with everything put away.
    """
    index, count = shard
    if not 1 <= index <= count:
        raise JobError("shard", "", f"{index}/{count}", "i of (i, n) runs from 1 to n")
    preflight.check_renderer(renderer)
    folder = DatasetFolder(out)
    workers = workers or max(1, calibration.cores() // threads)
    specs, the_plan = _planned(job)
    with _interruptible(), _telling_of_a_full_disk(folder):
        origins = [provenance(spec) for spec in specs]
        publish.check(folder, the_plan, origins, renderer)
        with ledger.slice_lock(folder, shard):
            with ledger.shared_files_lock(folder):
                publish.begin(folder, the_plan, origins, renderer)
                clean_shared(folder)
                mended = _write_panoramas(folder, specs)
                _write_tracks(folder, the_plan)
            folder.logs.mkdir(parents=True, exist_ok=True)
            orders = Orders(job, folder.root, renderer, device, threads, Path())
            run = Run(the_plan, orders, shard, workers, time_limit, subjects_per_worker)
            run.summary.mended += mended
            summary = run.render(limit, retry_failed)
            with ledger.shared_files_lock(folder):
                summary.complete = publish.complete(folder)
            if summary.complete and not ledger.failures(folder):
                shutil.rmtree(folder.work, ignore_errors=True)
    return summary


def extend_job(
    job: JobSpec,
    out: Place,
    workers: int | None = None,
    threads: int = 1,
    device: Device = "cpu",
    renderer: str = DEFAULT_RENDERER,
) -> Summary:
    """Render what a larger job has on top of a complete dataset, into that dataset.

    More subjects in its subsets, or more subsets; all else must be as it was. Once begun, it is a
    dataset of the larger job, which `render_job` finishes, too.

    Raises what `extending.extend` and `render_job` do.
    """
    preflight.check_renderer(renderer)
    specs, the_plan = _planned(job)
    extending.extend(out, the_plan, [provenance(spec) for spec in specs], renderer)
    return render_job(job, out, workers, threads, device, renderer=renderer)


def _planned(job: JobSpec) -> tuple[Sequence[EnvironmentSpec], Plan]:
    """The panoramas of a job, and its plan."""
    specs = pool(job.environments, job.seed)
    return specs, Plan(job, [spec.id for spec in specs])


def _write_panoramas(folder: DatasetFolder, specs: Sequence[EnvironmentSpec]) -> list[str]:
    """Store the panoramas, and record their hashes: all subjects are rendered with the same.

    Those that changed since are made again; returns a line for each.
    """
    recorded = read_description(folder).files
    begun, mended, missing = folder.has_results(), [], []
    for spec in specs:
        path = folder.environment(spec.id)
        name = folder.relative(path)
        if not path.exists():
            missing.append(spec)
            if name in recorded:
                mended.append(f"{name}: was missing; made again")
        elif name in recorded and sha256(path) != recorded[name]:
            path.unlink()  # one with the right header would be kept
            missing.append(spec)
            mended.append(f"{name}: was damaged; made again")
        elif name not in recorded and not begun:
            missing.append(spec)
    if missing:
        write_pool(console.track(missing, "storing panoramas"), folder.environments)
    hashes = {}
    for spec in specs:
        path = folder.environment(spec.id)
        name = folder.relative(path)
        known = None if spec in missing else recorded.get(name)
        hashes[name] = known or sha256(path)
        if hashes[name] != recorded.get(name, hashes[name]):
            raise StorageError(
                f"{path}: cannot be made again as it was when the dataset was begun; "
                "put a copy of it there"
            )
    publish.record_files(folder, hashes)
    return mended


def _write_tracks(folder: DatasetFolder, plan: Plan) -> None:
    """Store what the plan takes of recorded motions, so that the dataset can be planned alone."""
    tracks = plan.job.poses.tracks
    if tracks is None:
        return
    folder.tracks.mkdir(exist_ok=True)
    known_hashes = read_description(folder).files
    hashes = {}
    for name in sorted({one.table for one in plan.recordings}):
        kept = folder.tracks / name
        known = known_hashes.get(folder.relative(kept))
        if not kept.exists() or (known is not None and sha256(kept) != known):
            recorded.copy(folder.tracks, tracks / name)
        hashes[folder.relative(kept)] = sha256(kept)
    kept = recorded.read(folder.tracks)
    if not recorded.same(kept, plan.recordings):
        raise StorageError(
            f"{tracks}: its tracks are not those that the dataset was begun with; "
            "put them back, or use a new folder"
        )
    publish.record_files(folder, hashes)


@contextlib.contextmanager
def _telling_of_a_full_disk(folder: DatasetFolder) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if is_disk_full(error):
            raise StorageError(disk_is_full(folder.root)) from None
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
