"""What the training loop asks of a stage; `stages` lists the stages there are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from torch import Tensor, nn

from totalediting.presets import Preset

Loss = tuple[Tensor, dict[str, float]]
"""The scalar to minimise, and figures of it to log, by snake_case name."""


@dataclass(frozen=True)
class RealVideo:
    """Real clips to train on beside the dataset, and how their light is found."""

    folder: Path
    """Videos, or folders of frames, see `data.clips`."""
    share: float = 0.5
    """Share of the steps that use them: 0 trains on synthetic data alone, 1 on real data alone."""
    light: Literal["random", "same", "consistent"] = "random"
    """What the estimator sees: another frame of the clip, which gives nothing of the target away
    (the paper's), the target itself, or the target, held by L1 to what it sees in another frame."""


@dataclass(frozen=True)
class StageSettings:
    """What a stage is built from."""

    data: Path
    """A dataset's folder."""
    preset: Preset
    run: Path
    """The run's folder, where the stages that this one needs were trained."""
    steps: int
    """Length of training, which the schedules of losses are stretched or shrunk to."""
    seed: int = 0
    workers: int = 0
    """Processes that read data."""
    real: RealVideo | None = None


@dataclass(frozen=True)
class Validation:
    """How good a network is on people held out of training."""

    score: float
    """What checkpoints are ranked by: lower is better."""
    figures: dict[str, float]
    """By a name of `figures.FIGURES`, or any other short snake_case one."""
    pictures: dict[str, Tensor] = field(default_factory=dict)
    """(3, H, W) in [0, 1], for TensorBoard."""


class Stage(ABC):
    """What is trained and how it is judged. Randomness comes from torch's global generator, which
    the loop seeds in every step."""

    network: nn.Module
    """The network to train."""

    @abstractmethod
    def batches(self, first: int, size: int, rank: int, ranks: int) -> Iterator[Any]:
        """The batches of steps `first`, `first` + 1, …, without end: the `size` samples of each
        that this process, number `rank` of `ranks`, takes."""

    @abstractmethod
    def loss(self, network: nn.Module, batch: Any, step: int) -> Loss:
        """The loss of a batch on the network's device; `network` is `self.network`, possibly
        wrapped for several devices."""

    @abstractmethod
    def validate(self, network: nn.Module) -> Validation:
        """Judge a network in evaluation mode, without gradients."""

    @abstractmethod
    def validate_on(self, data: Path, split: str) -> None:
        """From now on, validate on all of a split of a dataset.

        Raises:
            InputError: no such dataset or split.
        """

    def start_from(self, run: Path) -> None:  # noqa: B027 - most stages start from nothing
        """Before the first step: take over what the stages that this one needs have learnt.

        Raises:
            InputError: one of them was not trained in `run`.
        """

    @property
    def skipped(self) -> dict[str, str]:
        """Samples that could not be read, and why."""
        return {}

    @property
    def off(self) -> dict[str, str]:
        """Terms of the loss that are left out, and why."""
        return {}

    @property
    def facts(self) -> dict[str, Any]:
        """What makes the run another one beside dataset, preset and schedule; for config.json."""
        return {}
