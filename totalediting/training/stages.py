"""The stages of training: one table. Command line, order, checkpoints and help derive from it.

Nothing here imports torch, so that the command line can name the stages at once. CONTRIBUTING.md
tells how to add one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to train."""

    steps: int
    """Steps in all."""
    batch: int
    """Samples per step, over all processes."""
    learning_rate: float = 1e-4
    """The peak; reached after `warmup` steps, then decays as a cosine to a twentieth."""
    warmup: int = 100
    """Steps until the learning rate peaks."""
    weight_decay: float = 0.01
    """Of AdamW."""
    clip: float = 1.0
    """Largest norm of a step's gradient."""
    average: float = 0.998
    """Decay of the moving average of the weights, which is what is validated and used."""
    save_every: int = 500
    """Steps between checkpoints, each of which is validated."""


@dataclass(frozen=True)
class StageSpec:
    """One stage of training."""

    name: str
    """Its name on the command line, and of its folder in a run."""
    schedule: Schedule
    """For the preset `tiny`: what two AVX2 cores have time for in `make train-demo`."""
    build: str
    """"module:function" from `stage.StageSettings` to a `stage.Stage`, imported when needed."""
    needs: tuple[str, ...] = ()
    """Stages of the same run that must be trained before; others may train at the same time."""

    def folder(self, run: Path) -> Path:
        """Where a run keeps this stage: its checkpoints, logs and configuration."""
        return run / self.name


STAGES: dict[str, StageSpec] = {
    spec.name: spec
    # Of stages that may train at the same time, the longest first: two cores then end together.
    for spec in (
        StageSpec(
            "reconstruct",
            Schedule(steps=700, batch=4, learning_rate=8e-4),
            "totalediting.training.reconstruction:build",
        ),
        StageSpec(
            "tracker",
            Schedule(steps=2000, batch=8, learning_rate=5e-4),
            "totalediting.training.tracker:build",
        ),
        StageSpec(
            "lightmaps",
            Schedule(steps=3400, batch=8, learning_rate=1.5e-3),
            "totalediting.training.lightmaps:build",
        ),
        StageSpec(
            "joint",
            Schedule(steps=60, batch=4, learning_rate=2e-4, warmup=20),
            "totalediting.training.joint:build",
            needs=("reconstruct", "tracker", "lightmaps"),
        ),
    )
}
"""Every stage, by name."""


def waves() -> Iterator[tuple[str, ...]]:
    """Names of the stages in training order; those of one wave do not need each other.

    Raises:
        graphlib.CycleError: stages need each other.
    """
    sorter = TopologicalSorter({spec.name: spec.needs for spec in STAGES.values()})
    sorter.prepare()
    while sorter.is_active():
        ready = set(sorter.get_ready())
        yield tuple(name for name in STAGES if name in ready)
        sorter.done(*ready)
