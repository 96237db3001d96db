"""A stage that learns a line, and a script that trains it: RUN, processes, step to be killed at."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor, nn

from totalediting.training.loop import Machine, train
from totalediting.training.stage import Loss, Stage, Validation
from totalediting.training.stages import Schedule

SCHEDULE = Schedule(steps=60, batch=8, learning_rate=0.05, warmup=5, save_every=20)


class Line(Stage):
    """y = 3 x + 1 with noise; `broken` steps have a loss that is no number."""

    def __init__(self, broken: range = range(0), killed: int | None = None) -> None:
        torch.manual_seed(0)
        self.network = nn.Sequential(nn.Linear(1, 16), nn.Dropout(0.2), nn.Linear(16, 1))
        self.broken, self.killed = broken, killed

    def batches(self, first: int, size: int, rank: int, ranks: int) -> Iterator[Tensor]:
        step = first
        while True:
            generator = torch.Generator().manual_seed(step)
            whole = torch.rand(size * ranks, 1, generator=generator)
            yield whole[rank * size : (rank + 1) * size]
            step += 1

    def loss(self, network: nn.Module, batch: Tensor, step: int) -> Loss:
        if step == self.killed:
            os.kill(os.getpid(), signal.SIGKILL)
        noise = 0.01 * torch.randn(len(batch), 1)
        loss = (network(batch) - 3 * batch - 1 - noise).square().mean()
        return (loss * torch.nan if step in self.broken else loss), {"square": loss.item()}

    def validate_on(self, data: Path, split: str) -> None:
        """A line has no data."""

    def validate(self, network: nn.Module) -> Validation:
        x = torch.linspace(0, 1, 50)[:, None]
        error = float((network(x) - 3 * x - 1).square().mean())
        return Validation(error, {"error": error}, {"line": torch.zeros(3, 4, 4)})


if __name__ == "__main__":
    run, devices, killed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    stage = Line(killed=killed if killed >= 0 else None)
    train(stage, run, SCHEDULE, seed=0, facts={"data": "line"}, machine=Machine(devices=devices))
