"""A rolled and scaled picture is that of the camera and the light that are told of it."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.nn import functional

from assets_procedural.conventions.camera import CameraSample, resolve
from totalediting.geometry.camera_jitter import jittered, jittered_light, photographed
from totalediting.geometry.tracking import FILL, FOCAL_MM, Tracking
from totalediting.light.lightmaps import bake, sample

SIDE = 96


def test_a_jittered_picture_is_that_of_the_camera_told() -> None:
    drawn = CameraSample(yaw=0.4, pitch=0.1, roll=0.1, focal_mm=80, fill=0.5, shift=(0.06, -0.04))
    truth = Tracking(
        torch.zeros(1, 52), torch.zeros(1, 2), torch.zeros(1, 3), torch.zeros(1, 32),
        torch.tensor([[drawn.yaw, drawn.pitch, drawn.roll]]),
        torch.tensor([[math.log(drawn.focal_mm / FOCAL_MM)]]),
        torch.tensor([[math.log(drawn.fill / FILL)]]),
        torch.tensor([drawn.shift]), torch.zeros(1, 10),
    )  # fmt: skip
    centre, points = np.array([0.0, -0.1, 1.6]), np.array([[0.05, -0.1, 1.6], [-0.03, -0.05, 1.68]])
    image = torch.zeros(1, 3, SIDE, SIDE)
    before, _ = resolve(drawn, centre, 0.25, SIDE).project(points)
    truth.face[0, :4] = torch.from_numpy((before / SIDE - 0.5) * [1, -1]).flatten()
    for channel, (x, y) in enumerate(before):  # a soft dot for each point
        rows, columns = torch.meshgrid(*2 * [torch.arange(SIDE) + 0.5], indexing="ij")
        image[0, channel] = torch.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 8)
    picture, told = jittered(image, truth, torch.tensor([0.3]), torch.tensor([-0.15]))
    yaw, pitch, roll = told.camera_yaw_pitch_roll[0].tolist()
    right, up = told.shift[0].tolist()
    found = CameraSample(
        yaw=yaw, pitch=pitch, roll=roll, focal_mm=told.focal_mm.item(), fill=told.fill.item(),
        shift=(right, up),
    )  # fmt: skip
    wanted, _ = resolve(found, centre, 0.25, SIDE).project(points)
    np.testing.assert_allclose(told.points(SIDE)[0, :2], wanted, atol=0.01)
    rows, columns = torch.meshgrid(*2 * [torch.arange(SIDE) + 0.5], indexing="ij")
    for channel, (x, y) in enumerate(wanted):
        dot = picture[0, channel] / picture[0, channel].sum()
        assert abs(float((dot * columns).sum()) - x) < 0.1
        assert abs(float((dot * rows).sum()) - y) < 0.1
    assert np.abs(wanted - before).max() > 3


def test_the_jittered_ball_is_lit_by_the_jittered_light() -> None:
    """A white matt ball shows its lightmap at its normals, before and after."""
    place = (torch.arange(SIDE) + 0.5) / SIDE * 2 - 1
    x, y = place.expand(SIDE, SIDE) / 0.7, -place[:, None].expand(SIDE, SIDE) / 0.7
    z = (1 - x**2 - y**2).clamp_min(0).sqrt()
    alpha = (x**2 + y**2 < 0.95).float()[None, None]
    normal = functional.normalize(torch.stack([x, y, z]), dim=0)[None]
    panorama = torch.zeros(1, 16, 32, 3)
    panorama[0, 4, 6:9] = torch.tensor([30.0, 20.0, 10.0])
    maps = bake(panorama, 32)

    def shaded(maps: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        return sample(maps[:, 0], normal.flatten(2).mT).mT.view_as(normal)

    shown = (shaded(maps, normal), normal, alpha, maps)
    jitter = (torch.tensor([0.4]), torch.tensor([-0.2]))
    image, normal, alpha, maps = jittered_light(*shown, *jitter)
    inside = (alpha > 0.99).expand_as(image)
    assert inside.float().mean() > 0.2
    torch.testing.assert_close(image[inside], shaded(maps, normal)[inside], atol=0.01, rtol=0)
    still = shaded(shown[-1], normal)
    assert (image - still)[inside].abs().max() > 0.05


def test_a_photograph_without_chance_is_the_picture(monkeypatch) -> None:
    """Every change is by a random number; where all are 0, nothing changes."""
    image = 0.01 + 0.98 * torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    changed = photographed(image)
    assert (changed - image).abs().mean((1, 2, 3)).min() > 0.02
    assert changed.min() >= 0 and changed.max() <= 1
    monkeypatch.setattr(torch, "randn", torch.zeros)
    torch.testing.assert_close(photographed(image), image, atol=1e-6, rtol=0)
