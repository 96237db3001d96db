"""Baked light against Cycles: balls that both shade under the same panoramas, at 64 pixels.

PSNR is of linear light, without a fitted scale: its peak is the largest value of the ball that
Cycles rendered, and only pixels count that lie more than one inside the rim. What is left is
Cycles' noise: each case gains its 3 dB with twice the samples.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import stage_scenes as scenes
import torch

from assets_procedural.conventions import panorama_reading
from assets_procedural.light.pool import EnvironmentSettings, pool
from totalediting.light import lightmaps
from totalediting.light.ball import shade_ball

pytestmark = pytest.mark.blender


@pytest.mark.parametrize(("name", "rotation"), [("sunset", 0.0), ("courtyard", 0.7)])
def test_a_matte_ball_is_what_cycles_renders(blender, name, rotation):
    path = bundled(name)
    colour = (0.8, 0.5, 0.2)
    rendered = blender(scenes.matte_ball, path, rotation, colour, 512)
    ours = shaded(path, rotation, colour, 1.0, (0.0, 0.0, 0.0, 0.0))
    assert psnr(ours, rendered) > 38


# The wider the lobe, the noisier is a pixel that Blender integrates from its samples.
@pytest.mark.parametrize(
    ("exponent", "samples", "least"), [(1, 256, 36), (16, 64, 44), (64, 64, 46)]
)
def test_a_specular_ball_is_what_blender_integrates(blender, exponent, samples, least):
    path = bundled("courtyard")  # the one whose lights are dim enough to be hit by chance
    rendered = blender(scenes.phong_ball, path, 0.7, exponent, samples)
    k_s = [float(exponent == e) for e in lightmaps.SHININESS]
    assert psnr(shaded(path, 0.7, (0.5, 0.5, 0.5), 0.0, k_s), rendered) > least


def bundled(name: str) -> Path:
    (spec,) = pool(EnvironmentSettings.model_validate({"bundled": [name]}), 0)
    assert spec.path is not None
    return spec.path


def shaded(path: Path, rotation: float, colour, k_d: float, k_s) -> np.ndarray:
    cosine, sine = math.cos(rotation), math.sin(rotation)
    back = torch.tensor([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    maps = lightmaps.bake(torch.from_numpy(panorama_reading.load(path)), rotation=back)
    return shade_ball(maps, scenes.SIZE, colour, k_d, k_s)[0].numpy()


def psnr(ours: np.ndarray, rendered: np.ndarray) -> float:
    middle = (scenes.SIZE - 1) / 2
    row, column = np.indices(rendered.shape[:2]) - middle
    inside = np.hypot(row, column) < middle - 1
    error = np.mean((ours[inside] - rendered[inside]) ** 2)
    return 10 * math.log10(rendered[inside].max() ** 2 / error)
