"""One person learnt by heart: what the model, its labels and its training can express together."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from synthgen.farm.local import render_job
from synthgen.job import JobSpec
from totalediting import losses, training
from totalediting.data import PortraitPairs
from totalediting.presets import PRESETS
from totalediting.reconstruction import ReconstructStage

STEPS = 600
JOB = {
    "name": "one",
    "seed": 3,
    "resolution": 128,
    "samples": 16,
    "subsets": {
        "multiview": {"kind": "multiview", "subjects": 2, "environments": 2, "views": 4},
    },
    "image": {"linear": False},
    "environments": {"bundled": ["sunrise", "city"], "skies": 0, "studios": 0},
    "camera": {
        "focal_mm": [70, 100],
        "yaw": [-40, 40],
        "pitch": [-12, 18],
        "fill": [0.55, 0.65],
    },
    "splits": {"validation": 0.5, "test": 0.0},
}


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.slow
def test_one_person_is_learnt_by_heart(tmp_path: Path, two_threads: None) -> None:
    """Four views under two lights, about ten minutes on two cores: PSNR of at least 30 dB."""
    data, preset = tmp_path / "one", PRESETS["tiny"]
    assert render_job(JobSpec.model_validate(JOB), data).complete
    stage = ReconstructStage(data, preset, seed=0, workers=0, weights=losses.OURS.over(STEPS))
    stage.train = PortraitPairs(data, preset, "train")
    stage.held_out = PortraitPairs(data, preset, "train")
    schedule = training.Schedule(STEPS, batch=4, learning_rate=1e-3, average=0.98, save_every=200)
    figures = training.train(stage, tmp_path / "run", schedule, 0, {})
    assert figures["PSNR"] >= 30
