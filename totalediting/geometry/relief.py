"""The relief of the bust: where its front and its back are along Y, and where they face, over the
planes' XZ plane.

Symbols: B batch, V control points, n = `GRID` texels along a side; places as of `space.on_planes`.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry import volume
from totalediting.geometry.space import on_planes

CHANNELS = 8
"""Of a relief."""
GRID = 64
"""Texels along a side that control points are gathered in: they lie about as densely."""
_CLOSING = {-1.0: 3, 1.0: 9}  # texels, by side along Y: pits so wide are closed, front and back
_NOTHING = -2.0  # height of the skin where there is none
_SKIN = 0.05  # of places: control points so far behind the foremost one are of the same skin
_BETWEEN = 0.05  # of places, in the middle of the head, over which front passes into back
_TRUST = 0.2  # control points that a texel's coarser surroundings count as


def relief_of(canonical: Tensor, normals: Tensor) -> Tensor:
    """(B, `CHANNELS`, n, n) the relief of a bust at rest, control points and normals (B, V, 3):
    places along Y of its front and its back, 1 and -1 where there is no skin, and the normals of
    both, beside the skin those of its surroundings."""
    places = on_planes(canonical)
    texel = texels_of(places)
    heights = front_and_back(places, normals, texel)
    return torch.cat([heights, _facing(places, normals, texel, heights)], 1)


def inside(relief: Tensor, places: Tensor) -> Tensor:
    """How far (B, P) points at `places` (B, P, 3) are behind the front and before the back of the
    skin along Y, in places; below 0 outside."""
    front, back = volume.plane(relief[:, :2], places[..., 0::2]).unbind(-1)
    return torch.minimum(places[..., 1] - front, back - places[..., 1])


def skin_normal(relief: Tensor, places: Tensor) -> Tensor:
    """(B, P, 3) unit normals of the front or the back of the skin, whichever is nearer to `places`
    (B, P, 3)."""
    found = volume.plane(relief, places[..., 0::2])
    middle = found[..., :2].mean(-1, keepdim=True)
    towards_back = torch.sigmoid((places[..., 1:2] - middle) / _BETWEEN)
    return functional.normalize(found[..., 2:5].lerp(found[..., 5:], towards_back), dim=-1)


def texels_of(places: Tensor) -> Tensor:
    """Number (B, V) of the texel, counted by rows, that places (B, V, 3) lie in; at the border
    also those beyond."""
    column, _, row = ((places + 1) / 2 * GRID).long().clamp(0, GRID - 1).unbind(-1)
    return row * GRID + column


def front_and_back(places: Tensor, normals: Tensor, texel: Tensor) -> Tensor:
    """Places (B, 2, n, n) along Y of the foremost and the hindmost skin in each texel.

    Control points at `places` (B, V, 3), with `normals` (B, V, 3), lie in the `texel` (B, V).
    """
    sides = []
    for towards, pit in _CLOSING.items():
        counts = (places.abs() < 1).all(-1) & (towards * normals[..., 1] > 0)
        height = torch.where(counts, towards * places[..., 1], _NOTHING)
        found = torch.full_like(height[:, :1], _NOTHING).repeat(1, GRID**2)
        found = found.scatter_reduce(1, texel, height, "amax").unflatten(-1, (1, GRID, GRID))
        # Points are sparser than texels, and some lie within mouth and eye sockets.
        closed = close(found, pit)
        known = (closed > _NOTHING).float()
        filled = fill_holes(torch.cat([known, known * closed], 1))
        skin = close(known, 5)
        height = torch.where(known > 0, closed, filled)
        sides.append(torch.where(skin > 0, towards * height, -towards))
    return torch.cat(sides, 1)


def _facing(places: Tensor, normals: Tensor, texel: Tensor, heights: Tensor) -> Tensor:
    """Normals (B, 6, n, n) of the skin at the `heights` (B, 2, n, n) of front and back; other
    arguments as of `front_and_back`."""
    sides = []
    for k, towards in enumerate(_CLOSING):
        skin = heights[:, k].flatten(1).gather(1, texel)
        near = (towards * normals[..., 1] > 0) & ((places[..., 1] - skin).abs() < _SKIN)
        weight = ((places.abs() < 1).all(-1) & near).to(places)[..., None]
        values = weight * torch.cat([torch.ones_like(weight), normals], -1)
        sums = values.new_zeros(len(places), GRID**2, 4)
        sums.scatter_add_(1, texel[..., None].expand_as(values), values)
        mean = fill_holes(sums.mT.unflatten(-1, (GRID, GRID)))
        sides.append(functional.normalize(mean, dim=1))
    return torch.cat(sides, 1)


def close(picture: Tensor, side: int) -> Tensor:
    """Grey-scale closing by a square of `side`: pits narrower than that are filled."""
    grown = functional.max_pool2d(picture, side, 1, side // 2)
    return -functional.max_pool2d(-grown, side, 1, side // 2)


def fill_holes(sums: Tensor) -> Tensor:
    """Weighted sums (B, 1 + C, n, n), weight first, to means (B, C, n, n) without holes.

    A texel's mean leans on that of the coarser one around it, the less the more weight it has.
    """
    levels = [sums]
    while levels[-1].shape[-1] > 1:
        levels.append(4 * functional.avg_pool2d(levels[-1], 2))
    last = levels.pop()
    mean = last[:, 1:] / last[:, :1].clamp_min(1e-6)
    for level in reversed(levels):
        around = functional.interpolate(mean, scale_factor=2.0, mode="bilinear")
        mean = (level[:, 1:] + _TRUST * around) / (level[:, :1] + _TRUST)
    return mean
