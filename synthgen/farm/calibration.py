"""How long rendering takes on this machine: the cost model, and the store of what was measured.

The model is linear: a subject costs `subject_s`, each of its shots `shot_s` more, each frame (shot
x environment) `frame_s` more; and in bytes likewise. `synthgen.farm.measure` finds the costs of one
process that runs alone; many at once are each a little slower where they share caches.
"""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from assets_procedural.conventions.files import cache_folder
from assets_procedural.settings import Parameters
from synthgen.planning.job import JobSpec, SubsetSpec

Kind = Literal["multiview", "video"]


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

    def scaled(self, job: JobSpec) -> Calibration:
        """This measurement carried over to another job's resolution and samples.

        Pixels scale shots and frames; samples scale three quarters of a frame, roughly the share
        of sampling against denoising and setting up.
        """
        pixels = (job.resolution / self.resolution) ** 2
        samples = 0.25 + 0.75 * job.samples / self.samples
        return self.model_copy(
            update={
                "resolution": job.resolution,
                "samples": job.samples,
                "shot_s": self.shot_s * pixels,
                "frame_s": self.frame_s * pixels * samples,
                "shot_bytes": self.shot_bytes * pixels,
                "frame_bytes": self.frame_bytes * pixels,
            }
        )

    def seconds(self, spec: SubsetSpec) -> float:
        """Seconds that one process takes for one subject of a subset."""
        return self.subject_s + spec.shots * (self.shot_s + spec.environments * self.frame_s)

    def bytes(self, spec: SubsetSpec) -> float:
        """Bytes on disk of one subject of a subset."""
        return spec.shots * (self.shot_bytes + spec.environments * self.frame_bytes)


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
    path = store()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    text = json.dumps([c.model_dump(mode="json") for c in kept.values()], indent=1)
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def find(
    job: JobSpec, kind: Kind, device: str, threads: int, renderer: str
) -> tuple[Calibration, bool] | None:
    """The measurement that fits a job best, carried over to it, and whether it was exact.

    None if this renderer was never measured on this machine with this device.
    """
    wanted = machine_name(), renderer, device, kind
    here = [c for c in load() if (c.machine, c.renderer, c.device, c.kind) == wanted]
    if not here:
        return None

    def distance(c: Calibration) -> tuple[float, float, bool]:
        pixels = abs(math.log(c.resolution / job.resolution))
        samples = abs(math.log(c.samples / job.samples))
        return abs(c.threads - threads), 2 * pixels + samples, c.linear != job.image.linear

    best = min(here, key=distance)
    exact = distance(best) == (0, 0, False)
    return best.scaled(job), exact


def _setting(c: Calibration) -> tuple[Any, ...]:
    return c.machine, c.renderer, c.device, c.threads, c.kind, c.resolution, c.samples, c.linear
