"""What more training people are worth to the lightmap estimator.

    python benchmarks/lightmap_subjects.py DATA UNSEEN [--subjects 25,50,100] [--steps 600]
        [--device cpu]

Trains the stage `lightmaps` of the preset tiny from scratch on the first so many people of DATA's
training split, for the same number of steps each, and prints a Markdown table: the training loss of
the last hundred steps and, on the split `test` of UNSEEN, the log-L1 as a share of what the mean
lightmaps of those people score, the median error of the dominant light and that of the normals.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import report
import torch

from totalediting.data.endless import EndlessDataset
from totalediting.data.portraits import Portrait, Portraits
from totalediting.presets import PRESETS
from totalediting.training import loop
from totalediting.training.lightmaps import LightmapStage
from totalediting.training.stages import STAGES


class FirstPeople(EndlessDataset[Portrait]):
    """The portraits of the first `count` people of others."""

    def __init__(self, of: Portraits, count: int, seed: int = 0) -> None:
        people = list(dict.fromkeys(of.shots.subjects))[:count]
        self.of = of
        self.items = [k for k, subject in enumerate(of.shots.subjects) if subject in people]
        super().__init__([of.keys[k] for k in self.items], seed)

    def make(self, item: int, rng: np.random.Generator) -> Portrait:
        return self.of.make(self.items[item], rng)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("unseen", type=Path)
    parser.add_argument("--subjects", default="25,50,100")
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    arguments = parser.parse_args()
    if arguments.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device: cuda: PyTorch finds no CUDA device here; use --device cpu")
    preset = PRESETS["tiny"]
    device = arguments.device
    machine = loop.Machine(device, precision=loop.fastest_precision(device))
    schedule = replace(STAGES["lightmaps"].schedule, steps=arguments.steps, save_every=10**9)

    def row(count: int) -> list[object]:
        stage = LightmapStage(arguments.data, preset, seed=0)
        people = FirstPeople(stage.train, count)
        stage.train = people  # pyright: ignore[reportAttributeAccessIssue]
        stage.validate_on(arguments.unseen, "test")
        with tempfile.TemporaryDirectory() as folder:
            found = loop.train(stage, Path(folder), schedule, 0, {}, machine)
            lines = (Path(folder) / "losses.jsonl").read_text().splitlines()[-100:]
        loss = np.mean([json.loads(line)["loss"] for line in lines])
        light, angle, normal = (
            found[f"{name}_error"] for name in ("relative_light", "dominant_light", "normal")
        )
        figures = [f"{loss:.3f}", f"{light:.3f}", f"{angle:.0f}°", f"{normal:.1f}°"]
        return [count, len(people), *figures]

    header = ["people", "pictures", "training loss"]
    header += ["light / mean light", "dominant light", "normals"]
    report.table(header, (row(int(count)) for count in arguments.subjects.split(",")))


if __name__ == "__main__":
    main()
