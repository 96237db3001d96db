"""Mixed light: pictures add up in linear light, and their lightmaps with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from totalediting.data.light_mixing import Light, draw_light
from totalediting.data.portraits import Portraits
from totalediting.data.shots import Shots, picture
from totalediting.light.phong import display, undisplay
from totalediting.presets import PRESETS

SMALL = replace(PRESETS["tiny"], image=24)


def test_a_mixture_is_the_sum_in_linear_light(small_dataset: Path):
    shots = Shots(small_dataset, "train")
    stored = shots.read(0, "rgb_00", "rgb_01", "meta")
    factors = torch.tensor([0.3, 0.4, 0.5]), torch.tensor([0.6, 0.5, 0.1])
    light = Light((0, 1), factors)
    linear = [undisplay(picture(stored[f"rgb_{k:02d}"], 24), 0) for k in range(2)]
    by_light = torch.stack(factors)[:, :, None, None]
    summed = (by_light * torch.stack(linear)).sum(0)
    pictures = [picture(stored[name], 24) for name in light.members()]
    assert torch.allclose(light.picture(pictures), display(summed, 0), atol=1e-6)
    maps = [shots.lightmaps(stored["meta"], k, 8) for k in range(2)]
    wanted = (by_light[:, None] * torch.stack(maps)).sum(0)
    assert torch.allclose(light.lightmaps(maps), wanted)


def test_one_environment_is_left_as_it_was_rendered(small_dataset: Path):
    shots = Shots(small_dataset, "train")
    stored = shots.read(0, "rgb_01", "meta")
    shown, maps = picture(stored["rgb_01"], 24), shots.lightmaps(stored["meta"], 1, 8)
    light = Light((1,), (torch.ones(3),))
    assert torch.equal(light.picture([shown]), shown)
    assert torch.equal(light.lightmaps([maps]), maps)


def test_draws_mix_half_of_the_time_and_keep_brightness_within_reason():
    rng = np.random.default_rng(0)
    drawn = [draw_light(rng, 3, mix=True) for _ in range(600)]
    mixed = [light for light in drawn if not light.is_one()]
    assert 240 < len(mixed) < 360
    assert {light.environments[0] for light in drawn} == {0, 1, 2}
    assert all(len(set(light.environments)) == 2 for light in mixed)
    total = torch.stack([torch.stack(light.factors).sum(0) for light in mixed])
    assert 0.9 < total.log().mean().exp() < 1.1 and total.min() > 0.3 and total.max() < 3
    assert all(draw_light(rng, 3, mix=False).is_one() for _ in range(50))
    single = [draw_light(rng, 1, mix=True) for _ in range(50)]
    assert {light.environments for light in single} == {(0,)}
    assert any(not light.is_one() for light in single)


def test_portraits_mix_light_and_nothing_else(small_dataset: Path):
    plain, mixed = (Portraits(small_dataset, SMALL, mix=m) for m in (False, True))
    changed = 0
    for number in range(10):
        a, b = plain[number], mixed[number]
        assert torch.equal(a.normal, b.normal) and torch.equal(a.alpha, b.alpha)
        changed += not torch.equal(a.lightmaps, b.lightmaps)
    assert 0 < changed < 10
