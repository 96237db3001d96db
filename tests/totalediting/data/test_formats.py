"""Datasets of format 1 are read as they are, by the gate and for training."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from assets_procedural.conventions import first_curve
from assets_procedural.conventions.colour import to_bytes
from synthgen.dataset import open_dataset
from synthgen.dataset.gate import inspect
from totalediting.data import shots
from totalediting.light import phong


def test_the_gate_takes_each_formats_curve(small_dataset: Path) -> None:
    shot = open_dataset(small_dataset)[0]
    assert shot.hdr is not None
    assert inspect(shot)[0] == [] != inspect(shot, 1)[0]
    light = np.array(shot.meta["exposures"])[:, None, None, None] * shot.hdr[..., :3]
    there = (shot.alpha > 0)[None, ..., None]
    shot.rgb = np.where(there, to_bytes(first_curve.display(light)), shot.rgb)
    assert inspect(shot, 1)[0] == [] != inspect(shot)[0]


@pytest.mark.parametrize("channels", [3, 4])
def test_training_sees_the_same_light_in_both_formats(channels: int) -> None:
    rng = np.random.default_rng(0)
    light = rng.random((16, 16, 3)) * 0.7 + 0.05
    opaque = np.full((16, 16, channels - 3), 255, np.uint8)
    old, new = (
        np.concatenate([to_bytes(curve(light)), opaque], -1)
        for curve in (first_curve.display, lambda x: phong.display(torch.from_numpy(x)).numpy())
    )
    ours, theirs = shots.picture(old, 16, 1), shots.picture(new, 16)
    torch.testing.assert_close(ours, theirs, atol=0.01, rtol=0)
    found = phong.undisplay(ours, 0).permute(1, 2, 0).numpy()
    np.testing.assert_allclose(found, light, atol=0.02)


def test_shots_know_their_format(small_dataset: Path, tmp_path: Path) -> None:
    assert shots.Shots(small_dataset, "train").format == 2
    for path in small_dataset.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "dataset.json").unlink()
    info = json.loads((small_dataset / "dataset.json").read_bytes()) | {"format": 1}
    (tmp_path / "dataset.json").write_text(json.dumps(info))
    assert shots.Shots(tmp_path, "train").format == 1
