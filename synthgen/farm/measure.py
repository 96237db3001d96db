"""Measuring what rendering costs on this machine, through the renderer itself.

The job's own first subjects are rendered, in a process of its own, with few and with more shots and
environments, for each kind of subset apart: a video shot moves the head, a view only the camera.
"""

from __future__ import annotations

import datetime
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets_procedural.light.pool import pool, write_pool
from synthgen.dataset.shards import encode
from synthgen.errors import JobError
from synthgen.farm.calibration import Calibration, Kind, machine_name
from synthgen.farm.process import start
from synthgen.farm.run import time_allowed
from synthgen.farm.worker import end_process, load_renderer, redirect
from synthgen.planning.job import JobSpec, SubsetSpec
from synthgen.planning.plan import Plan, SubjectPlan

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

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
    kinds: list[Kind] = sorted({s.kind for s in plan.job.subsets.values()})
    rounds: dict[Kind, list[SubjectPlan]] = {kind: _rounds(plan, kind) for kind in kinds}
    total, done, results = sum(len(r) for r in rounds.values()), 0, []
    progress(done, total)
    for kind, subjects in rounds.items():
        rows = []
        for row in _in_process(plan.job, subjects, renderer, device, threads):
            rows.append(row)
            done += 1
            progress(done, total)
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
                **figures,
            )
        )
    return results


def _rounds(plan: Plan, kind: Kind) -> list[SubjectPlan]:
    """Subjects to be rendered one after another: a warm-up, then three sizes of each subject."""
    most = min(MOST, len(plan.environment_ids))
    count = {"views": MOST} if kind == "multiview" else {"frames": MOST}
    spec = SubsetSpec(kind=kind, subjects=SUBJECTS, environments=most, **count)
    small = Plan(plan.job.model_copy(update={"subsets": {kind: spec}}), plan.environment_ids)
    sizes = [(1, 1), (MOST, 1), (1, most)]
    rounds = [
        subject.model_copy(
            update={"shots": subject.shots[:shots], "environments": subject.environments[:lights]}
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


def _in_process(
    job: JobSpec, subjects: Sequence[SubjectPlan], renderer: str, device: str, threads: int
) -> Iterator[tuple[float, ...]]:
    """Yield a row per subject from a spawned process, which prints to a log of its own."""
    receiver, sender = multiprocessing.get_context("spawn").Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="synthgen-calibration-") as folder:
        log = Path(folder) / "log.txt"
        arguments = (
            job.model_dump_json(),
            [s.model_dump_json() for s in subjects],
            renderer,
            device,
            threads,
            folder,
            sender,
        )
        process = start(_measure, *arguments)
        sender.close()
        try:
            for subject in subjects:
                allowed = time_allowed(job, subject.frames)
                if not receiver.poll(allowed):
                    raise _failure(f"the renderer took more than {allowed:.0f} s for a subject")
                try:
                    row = receiver.recv()
                except EOFError:
                    raise _failure(f"the renderer died: {_last_line(log)}") from None
                if isinstance(row, str):
                    raise _failure(f"the renderer failed: {row}")
                yield row
        finally:
            process.kill()
            process.join()


def _measure(
    job_json: str,
    subjects_json: Sequence[str],
    renderer: str,
    device: str,
    threads: int,
    folder: str,
    sender: Connection,
) -> None:
    """Body of the measuring process: sends (shots, frames, seconds, bytes, bytes) per subject."""
    redirect(Path(folder) / "log.txt")
    try:
        job = JobSpec.model_validate_json(job_json)
        subjects = [SubjectPlan.model_validate_json(text) for text in subjects_json]
        panoramas = Path(folder) / "environments"
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
            sender.send((len(subject.shots), subject.frames, seconds, per_shot, per_frame))
    except Exception as error:
        sender.send(f"{type(error).__name__}: {error}".splitlines()[0])
    finally:
        sender.close()
        end_process(0)


def _failure(reason: str) -> JobError:
    return JobError("--calibrate", "", "", reason)


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines() if log.exists() else []
    return lines[-1] if lines else "it said nothing"
