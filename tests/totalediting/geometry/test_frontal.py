"""Pictures laid onto the bust: against a bust whose picture is known everywhere."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.field import Control
from totalediting.geometry.frontal import frontalise
from totalediting.geometry.space import off_planes

SIDE = 96


def ball(turn: float) -> Control:
    """A ball of 10 cm, turned by some radians about +Z: what its skin was, and where it is."""
    generator = torch.Generator().manual_seed(0)
    normals = functional.normalize(torch.randn(6000, 3, generator=generator), dim=-1)
    angle = torch.tensor(turn)
    cosine, sine = angle.cos(), angle.sin()
    rotation = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    posed = normals @ rotation.T
    return Control(*(a[None] for a in (0.1 * posed, 0.1 * normals, posed, normals)))


def view() -> tuple[Tensor, Tensor]:
    camera = torch.eye(4)
    camera[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera[:3, 3] = torch.tensor([0.0, -2.0, 0.0])
    intrinsics = torch.tensor([[480.0, 0, SIDE / 2], [0, 480.0, SIDE / 2], [0, 0, 1]])
    return camera[None], intrinsics[None]


def picture(control: Control) -> Tensor:
    """The ball as the camera of `view` sees it: every point shows its place at rest, in [0, 1]."""
    middle = (torch.arange(SIDE) + 0.5 - SIDE / 2) / 480.0 * 2
    x, z = middle[None, :].expand(SIDE, SIDE), -middle[:, None].expand(SIDE, SIDE)
    y = -(0.01 - x**2 - z**2).clamp_min(0).sqrt()  # the perspective of 2 m is small
    place = torch.stack([x, y, z], -1).flatten(0, 1)
    nearest = torch.cdist(place, control.posed[0]).argmin(1)
    shown = control.canonical[0][nearest] * 5 + 0.5
    return shown.T.reshape(1, 3, SIDE, SIDE)


def texels() -> Tensor:
    """(SIDE, SIDE, 2) x and z of the result's texels."""
    place = (2 * torch.arange(SIDE) + 1.0) / SIDE - 1
    x, z = off_planes(place[:, None].expand(-1, 3))[:, 0::2].unbind(-1)
    return torch.stack(torch.meshgrid(x, z, indexing="xy"), -1)


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.7])
def test_skin_lies_where_it_is_at_rest(turn: float) -> None:
    control = ball(turn)
    found = frontalise(picture(control), control, *view())[0]
    at = texels()
    radius = at.norm(dim=-1)
    seen = (radius < 0.07) & (found[3] > 0.4)
    assert seen.sum() > 200
    for channel, axis in ((0, 0), (2, 1)):
        error = ((found[channel] - 0.5) / 5 - at[..., axis])[seen].abs()
        assert error.mean() < 0.003 and error.quantile(0.95) < 0.008


def test_skin_moves_to_the_expression_to_show() -> None:
    source, shown = ball(0.3), ball(0.0)
    shown = shown._replace(canonical=0.8 * shown.canonical)
    found = frontalise(picture(source), source.showing(shown), *view())[0]
    at = texels()
    seen = (at.norm(dim=-1) < 0.055) & (found[3] > 0.4)
    for channel, axis in ((0, 0), (2, 1)):
        error = ((found[channel] - 0.5) / 5 - at[..., axis] / 0.8)[seen].abs()
        assert error.mean() < 0.004 and error.quantile(0.95) < 0.01


def test_the_last_channel_says_what_the_camera_sees() -> None:
    control = ball(0.6)
    facing = frontalise(picture(control), control, *view())[0, 3]
    at = texels()
    # At rest, a point on the front is at (x, -sqrt, z); turned, its normal's -y is the cosine.
    x, z = at.unbind(-1)
    y = -(0.01 - x**2 - z**2).clamp_min(0).sqrt()
    angle = torch.tensor(0.6)
    cosine = (-(angle.sin() * x + angle.cos() * y) / 0.1).clamp(0, 1)
    inside = at.norm(dim=-1) < 0.075
    assert (facing - cosine)[inside].abs().mean() < 0.03
    assert facing[at.norm(dim=-1) > 0.15].max() == 0


def test_the_relief_is_where_the_skin_is() -> None:
    """Front and back of the ball along Y, and nothing beside it."""
    control = ball(0.6)
    front, back = frontalise(picture(control), control, *view())[0, 4:]
    at = texels()
    radius = at.norm(dim=-1)
    inside = radius < 0.08
    depth = (0.01 - at.square().sum(-1)).clamp_min(0).sqrt()
    for found, side in ((front, -1), (back, 1)):
        place = torch.zeros(SIDE, SIDE, 3)
        place[..., 1] = 2 * found - 1
        error = (off_planes(place)[..., 1] - side * depth)[inside].abs()
        assert error.mean() < 0.003 and error.max() < 0.012
    assert (front > back)[radius > 0.125].all()


def test_all_is_finite_also_without_skin_in_the_box() -> None:
    near = ball(0.0)
    control = near._replace(posed=near.posed + 5, canonical=near.canonical + 5)
    assert frontalise(torch.rand(1, 3, SIDE, SIDE), control, *view()).isfinite().all()


def test_wrong_shapes_are_refused() -> None:
    image, control = torch.rand(1, 3, SIDE, SIDE), ball(0.0)
    with pytest.raises(ValueError, match=r"image .*\(1, 3, 96, 95\)"):
        frontalise(image[..., 1:], control, *view())
    with pytest.raises(ValueError, match=r"control .*\(1, 6000, 3\)"):
        frontalise(image.expand(2, -1, -1, -1), control, *view())
