"""Measuring what rendering costs on this machine, through the renderer itself.

The job's own first subjects are rendered, in a process of its own, with few and with more shots and
environments, for each kind of subset apart: a video shot moves the head, a view only the camera.
"""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from assets_procedural.light.pool import pool, write_pool
from synthgen.dataset.shards import encode
from synthgen.errors import JobError
from synthgen.farm import preflight
from synthgen.farm.calibration import Calibration, Kind, machine_name
from synthgen.farm.isolated import IsolatedError, isolated_steps
from synthgen.farm.run import time_allowed
from synthgen.farm.temporary import temporary_folder
from synthgen.farm.worker import load_renderer
from synthgen.planning.job import JobSpec, SubsetSpec
from synthgen.planning.plan import Plan, SubjectPlan

SUBJECTS = 2
"""Subjects that are measured per kind."""
MOST = 3
"""Shots and environments of the larger measurements."""


def measure(
    plan: Plan,
    renderer: str,
    device: str,
    threads: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Calibration]:
    """Render a little of every kind of subset in `plan` and return what it took.

    `renderer` is "module:function" as in `synthgen.farm`. `progress` is called with measurements
    done and their number. Nothing is stored: see `save`.

    Raises `JobError` if the renderer fails.
    """
    preflight.check_renderer(renderer)
    kinds: list[Kind] = sorted({s.kind for s in plan.job.subsets.values()})
    rounds: dict[Kind, list[SubjectPlan]] = {kind: _rounds(plan, kind) for kind in kinds}
    total, done, results = sum(len(r) for r in rounds.values()), 0, []
    progress(done, total)
    for kind, subjects in rounds.items():
        rows = []
        limit = max(time_allowed(plan.job, subject.frames) for subject in subjects)
        # The folder is ours, so that it goes even if the process is killed.
        with temporary_folder() as folder:
            arguments = (plan.job, subjects, renderer, device, threads, folder)
            try:
                for row in isolated_steps(_timed, *arguments, time_limit=limit):
                    rows.append(row)
                    done += 1
                    progress(done, total)
            except IsolatedError as error:
                raise JobError("--calibrate", "", "", f"the renderer failed: {error}") from None
        # The first round warms caches up: loading the head, compiling shaders.
        figures = _fit(np.array(rows[1:]))
        results.append(
            Calibration(
                machine=machine_name(),
                renderer=renderer,
                device=device,
                threads=threads,
                kind=kind,
                resolution=plan.job.resolution,
                samples=plan.job.samples,
                linear=plan.job.image.linear,
                measured=datetime.date.today().isoformat(),
                dataset="",
                **figures,
            )
        )
    return results


def _rounds(plan: Plan, kind: Kind) -> list[SubjectPlan]:
    """Subjects to be rendered one after another: a warm-up, then three sizes of each subject."""
    most = min(MOST, len(plan.environment_ids))
    views, frames = (MOST, None) if kind == "multiview" else (None, MOST)
    spec = SubsetSpec(kind=kind, subjects=SUBJECTS, environments=most, views=views, frames=frames)
    small = Plan(plan.job.model_copy(update={"subsets": {kind: spec}}), plan.environment_ids)
    sizes = [(1, 1), (MOST, 1), (1, most)]
    rounds = [
        subject.model_copy(
            update={
                "shots": subject.shots[:shots],
                "environments": subject.environments[:lights],
                "keys": subject.keys[:lights],
            }
        )
        for subject in small
        for shots, lights in sizes
    ]
    return [rounds[0], *rounds]


def _fit(rows: np.ndarray) -> dict[str, float]:
    """Least squares with no negative cost; rows are (shots, frames, seconds, and bytes of both)."""
    from scipy.optimize import nnls

    shots, frames, seconds, shot_bytes, frame_bytes = rows.T
    (subject_s, shot_s, frame_s), _ = nnls(
        np.stack([np.ones_like(shots), shots, frames], axis=1), seconds
    )
    return {
        "subject_s": float(subject_s),
        "shot_s": float(shot_s),
        "frame_s": float(frame_s),
        "shot_bytes": float(shot_bytes.sum() / shots.sum()),
        "frame_bytes": float(frame_bytes.sum() / frames.sum()),
    }


def _timed(
    job: JobSpec,
    subjects: Sequence[SubjectPlan],
    renderer: str,
    device: str,
    threads: int,
    panoramas: Path,
) -> Iterator[tuple[float, ...]]:
    """Yield (shots, frames, seconds, bytes of both) of each subject; runs in its own process.

    `panoramas` is an empty folder.
    """
    used = {use.id for subject in subjects for use in subject.environments}
    write_pool((s for s in pool(job.environments, job.seed) if s.id in used), panoramas)
    render = load_renderer(renderer)
    for subject in subjects:
        start = time.perf_counter()
        rendered = render(subject, job, panoramas, device, threads)
        members = [encode(shot) for shot in rendered.shots]
        seconds = time.perf_counter() - start
        sizes = [(name[:3], len(data)) for m in members for name, data in m.items()]
        per_frame = sum(size for prefix, size in sizes if prefix in ("rgb", "hdr"))
        per_shot = sum(size for _, size in sizes) - per_frame
        yield len(subject.shots), subject.frames, seconds, per_shot, per_frame
