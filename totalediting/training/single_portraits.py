"""What stages that learn from single portraits share: data in and out of training, and jitter."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor

from totalediting.data.endless import loader, to_device
from totalediting.data.portraits import Portrait, Portraits
from totalediting.geometry.camera_jitter import ROLL, SCALE
from totalediting.presets import Preset
from totalediting.training.reconstruction import VALIDATED
from totalediting.training.stage import Stage

_VALIDATION_BATCH = 8  # portraits


class PortraitStage(Stage):
    """A stage that learns from single portraits, mirrored and in mixed light."""

    most = VALIDATED

    def __init__(self, data: Path, preset: Preset, seed: int, workers: int = 1) -> None:
        self.preset, self.workers = preset, workers
        self.train = Portraits(data, preset, "train", seed, mirror=True, mix=True)
        self.held_out = Portraits(data, preset, "validation")

    def validate_on(self, data: Path, split: str) -> None:
        self.held_out = Portraits(data, self.preset, split)
        self.most = len(self.held_out)

    @property
    def skipped(self) -> dict[str, str]:
        return self.train.skipped

    def batches(self, first: int, size: int, rank: int, ranks: int) -> Iterator[Portrait]:
        start = first * size * ranks
        return iter(loader(self.train, size, self.workers, start, rank=rank, world=ranks))

    def validation_batches(self, device: torch.device) -> Iterator[Portrait]:
        """Batches of the held-out portraits, the same every time."""
        stop = min(self.most, len(self.held_out))
        for batch in loader(self.held_out, _VALIDATION_BATCH, stop=stop):
            yield to_device(batch, device)


def draw_jitter(batch: Portrait, wider: float = 1.0) -> tuple[Tensor, Tensor]:
    """Roll (B,), radians, and logarithm of the scale (B,), that one `wider` times as wide, from the
    global generator."""
    roll, log_scale = torch.randn(2, len(batch.image)).to(batch.image.device)
    return ROLL * roll, wider * SCALE * log_scale
