"""How long rendering takes: the cost model, the store of what was measured, reference figures.

The model is linear: a subject costs `subject_s`, each of its shots `shot_s` more, each frame (shot
x environment) `frame_s` more; and in bytes likewise. Environments that share a pass (see
`synthgen.planning.light_basis`) cost less, in one proportion for all machines.
`synthgen.farm.measure` finds the costs of one process that runs alone; many at once are each a
little slower where they share caches. `synthgen.farm.recorded` reads them out of a dataset that was
rendered.
"""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from assets_procedural.conventions.files import cache_folder, write_atomically
from assets_procedural.settings import Parameters
from synthgen.planning.job import JobSpec, SubsetSpec
from synthgen.planning.light_basis import passes

Kind = Literal["multiview", "video"]
Source = Literal["named", "calibration", "rendered", "reference"]
SAMPLING = 0.75
"""The share of a frame that is sampling, roughly: the rest is denoising and setting up."""


class Calibration(Parameters):
    """Seconds and bytes per subject, shot and frame of one kind of subset, at one setting."""

    machine: str
    renderer: str
    device: str
    threads: int
    kind: Kind
    resolution: int
    samples: int
    linear: bool
    subject_s: float
    shot_s: float
    frame_s: float
    shot_bytes: float
    frame_bytes: float
    measured: str
    dataset: str = ""
    """The dataset that was rendered, where nothing but that was done to measure."""

    def scaled(self, job: JobSpec, threads: int) -> Calibration:
        """This measurement carried over to another job's resolution and samples, and to threads.

        Pixels scale shots and frames; samples scale the `SAMPLING` of a frame; threads of a CPU
        share the work of a frame.
        """
        pixels = (job.resolution / self.resolution) ** 2
        samples = 1 - SAMPLING + SAMPLING * job.samples / self.samples
        speed = threads / self.threads if self.device == "cpu" else 1.0
        return self.model_copy(
            update={
                "threads": threads,
                "resolution": job.resolution,
                "samples": job.samples,
                "shot_s": self.shot_s * pixels,
                "frame_s": self.frame_s * pixels * samples / speed,
                "shot_bytes": self.shot_bytes * pixels,
                "frame_bytes": self.frame_bytes * pixels,
            }
        )

    def seconds(self, spec: SubsetSpec, job: JobSpec) -> float:
        """Seconds that one process takes for one subject of a subset of `job`."""
        lights = lights_paid(job, spec)
        return self.subject_s + spec.shots * (self.shot_s + lights * self.frame_s)

    def bytes(self, spec: SubsetSpec) -> float:
        """Bytes on disk of one subject of a subset."""
        return spec.shots * (self.shot_bytes + spec.environments * self.frame_bytes)


def lights_paid(job: JobSpec, spec: SubsetSpec) -> float:
    """Environments of a shot as they cost: passes may serve several."""
    sampled = passes(job, spec.environments)
    return (1 - SAMPLING) * spec.environments + SAMPLING * sampled


REFERENCE = Calibration(
    machine="a shared x86-64 core with AVX2",
    renderer="synthgen.stage.render:render_subject",
    device="cpu",
    threads=1,
    kind="multiview",
    resolution=256,
    samples=16,
    linear=True,
    subject_s=2.8,
    shot_s=0.86,
    frame_s=11.2,
    shot_bytes=987_000,
    frame_bytes=188_000,
    measured="2026-11-28",
)
"""Figures for want of better ones: render_jobs/demo.toml, all of its 60 frames, by two processes on
two cores. Both kinds of subset cost the same within what ten people differ."""


@dataclass(frozen=True)
class Found:
    """What a job is reckoned with: `costs`, carried over to it from `measured` if need be."""

    costs: Calibration
    measured: Calibration
    source: Source
    exact: bool
    """Whether resolution, samples and threads were measured as they are."""


def machine_name() -> str:
    """Host and processor, which a measurement is valid for."""
    return f"{platform.node()} {platform.machine()} {os.cpu_count()} cores"


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def store() -> Path:
    """The file in which measurements are kept."""
    return cache_folder() / "calibration.json"


def load() -> list[Calibration]:
    """All measurements kept; a damaged store counts as empty."""
    try:
        entries = json.loads(store().read_text(encoding="utf-8"))
        return [Calibration.model_validate(entry) for entry in entries]
    except (OSError, ValueError):
        return []


def save(new: Sequence[Calibration]) -> None:
    """Keep measurements; one replaces an older one of the same setting."""
    kept = {_setting(c): c for c in [*load(), *new]}
    text = json.dumps([c.model_dump(mode="json") for c in kept.values()], indent=1)
    write_atomically(store(), text.encode())


def find(
    job: JobSpec,
    kind: Kind,
    device: str,
    threads: int,
    renderer: str,
    named: Sequence[Calibration] = (),
) -> Found:
    """The measurement that fits a job best, carried over to it.

    The first of these that there is, and of it the nearest: `named`; calibrations of this renderer
    on this machine with this device; datasets rendered so; the reference.
    """
    wanted = machine_name(), renderer, device, kind
    here = [c for c in load() if (c.machine, c.renderer, c.device, c.kind) == wanted]
    sources: dict[Source, list[Calibration]] = {
        "named": [c for c in named if c.kind == kind] or list(named),
        "calibration": [c for c in here if not c.dataset],
        "rendered": [c for c in here if c.dataset],
        "reference": [REFERENCE],
    }
    source: Source = next(name for name, known in sources.items() if known)

    def distance(c: Calibration) -> tuple[float, float, bool]:
        pixels = abs(math.log(c.resolution / job.resolution))
        samples = abs(math.log(c.samples / job.samples))
        return abs(c.threads - threads), 2 * pixels + samples, c.linear != job.image.linear

    best = min(sources[source], key=distance)
    exact = source != "reference" and distance(best) == (0, 0, False)
    return Found(best.scaled(job, threads), best, source, exact)


def _setting(c: Calibration) -> tuple[Any, ...]:
    return (
        *(c.machine, c.renderer, c.device, c.threads, c.kind, c.resolution, c.samples, c.linear),
        bool(c.dataset),
    )
