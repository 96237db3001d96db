"""The whole model can hold one person: rendered by Blender, learnt by heart at the preset tiny."""

from __future__ import annotations

from pathlib import Path

import pytest

from synthgen.farm.local import render_job
from synthgen.planning.job import JobSpec
from totalediting.data.pairs import PortraitPairs
from totalediting.presets import PRESETS
from totalediting.training import loop, losses
from totalediting.training.reconstruction import ReconstructStage
from totalediting.training.stages import Schedule

STEPS = 1000


@pytest.mark.slow
@pytest.mark.blender
@pytest.mark.timeout(3600)  # 27 minutes on one core
def test_one_person_is_learnt_by_heart(tmp_path: Path) -> None:
    """Three views in a studio's light, each from another; of two people, one is held out."""
    views = {"kind": "multiview", "subjects": 2, "environments": 1, "views": 3}
    spec = JobSpec.model_validate(
        {
            "name": "one",
            "seed": 11,
            "resolution": 128,
            "samples": 16,
            "subsets": {"multiview": views},
            "image": {"linear": False},
            "environments": {"bundled": ["studio"]},
            "camera": {
                "focal_mm": [70, 100],
                "yaw": [-40, 40],
                "pitch": [-12, 18],
                "fill": [0.55, 0.65],
            },
            "splits": {"validation": 0.5, "test": 0.0},
        }
    )
    data = tmp_path / "data"
    assert render_job(spec, data, workers=1).complete
    tiny = PRESETS["tiny"]
    stage = ReconstructStage(data, tiny, seed=0, workers=0, weights=losses.OURS.over(STEPS))
    stage.train = stage.held_out = PortraitPairs(data, tiny, "train", seed=0)
    schedule = Schedule(STEPS, batch=4, learning_rate=1.5e-3, average=0.98)
    figures = loop.train(stage, tmp_path / "run", schedule, 0, {"preset": "tiny", "set": []})
    assert figures["psnr"] >= 30 > figures["source_psnr"]
