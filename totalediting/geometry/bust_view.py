"""What a camera sees of a bust: depth and normals of its nearest skin, without a mesh.

Control points are splatted as small discs across their normals into a coarse picture (surfels,
Pfister et al. 2000); so any bust will do, whatever connects its points. B batch, V control points,
n side of the result; model space, cameras as of `projection`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.projection import project
from totalediting.geometry.relief import close, fill_holes

FAR = 10.0
"""Depth, metres, where there is no skin."""
_DISC = 0.005  # metres between a disc's middle and its rim: about the spacing of control points
_GRIDS = 64, 128  # sides of the view that are taken
_SIDEWAYS = 20  # a silhouette goes on, twice, for so many'th parts of the frame
_SKIN = 0.008  # metres: points so far behind the nearest one are still of the same skin


class BustView(NamedTuple):
    """The nearest skin, on n x n pixels over the whole frame."""

    depth: Tensor
    """(B, 1, n, n) planar, metres; `FAR` where there is none."""
    normal: Tensor
    """(B, 3, n, n) unit, model space; beside the skin, that of its surroundings."""
    facing: Tensor
    """(B, 1, n, n) cosine between normal and the direction to the camera, in [0, 1]."""


@torch.no_grad()
def view(
    points: Tensor, normals: Tensor, camera_to_world: Tensor, intrinsics: Tensor, side: int, n: int
) -> BustView:
    """The view of control points and their unit normals (B, V, 3) by a camera (B, 4, 4), (B, 3, 3)
    for pictures of `side`; n is a power of 2."""
    batch = len(points)
    towards = functional.normalize(camera_to_world[:, None, :3, 3] - points, dim=-1)
    cosine = (normals * towards).sum(-1)
    # Any two directions across the normal.
    other = functional.one_hot(normals.abs().argmin(-1), 3).to(normals)
    first = functional.normalize(torch.linalg.cross(normals, other), dim=-1)
    second = torch.linalg.cross(normals, first)
    discs = torch.stack(
        [points + _DISC * (a * first + b * second) for a in (-1, 0, 1) for b in (-1, 0, 1)], 2
    ).flatten(1, 2)
    places, depth = project(discs, camera_to_world, intrinsics, side)
    seen = (cosine > 0)[..., None].expand(-1, -1, 9).flatten(1) & (places.abs() < 1).all(-1)
    column, row = ((places + 1) / 2 * n).long().clamp(0, n - 1).unbind(-1)
    texel = row * n + column

    depth = torch.where(seen, depth, FAR)
    nearest = depth.new_full((batch, n * n), FAR).scatter_reduce(1, texel, depth, "amin")
    skin = seen & (depth < nearest.gather(1, texel) + _SKIN)
    weight = skin.to(depth)[..., None]
    known = [depth[..., None], normals.repeat_interleave(9, 1)]
    values = weight * torch.cat([torch.ones_like(weight), *known], -1)
    sums = depth.new_zeros(batch, n * n, 5)
    sums.scatter_add_(1, texel[..., None].expand_as(values), values)
    filled = fill_holes(sums.mT.unflatten(-1, (n, n)))

    nearest = nearest.view(batch, 1, n, n)
    covered = (nearest < FAR).to(depth)
    hole = close(covered, 3) > covered
    normal = functional.normalize(filled[:, 1:], dim=1)
    pixel = (torch.arange(n, device=points.device) + 0.5) * (side / n)
    x = (pixel - intrinsics[:, 0, 2, None]) / intrinsics[:, 0, 0, None]
    y = (intrinsics[:, 1, 2, None] - pixel) / intrinsics[:, 1, 1, None]
    ray = torch.stack(
        [
            x[:, None].expand(-1, n, -1),
            y[..., None].expand(-1, -1, n),
            -torch.ones_like(normal[:, 0]),
        ],
        1,
    )
    back = -functional.normalize(camera_to_world[:, :3, :3] @ ray.flatten(2), dim=1)
    facing = (normal.flatten(2) * back).sum(1).view_as(nearest).clamp(0, 1)
    return BustView(torch.where(hole, filled[:, :1], nearest), normal, facing)


@torch.no_grad()
def skin_near(
    points: Tensor, normals: Tensor, camera_to_world: Tensor, intrinsics: Tensor, side: int, n: int
) -> Tensor:
    """(B, 1, n, n) planar depth, metres, of the nearest skin of a bust, also a little beside it;
    infinite beyond. Arguments as of `view`, for any n."""
    with torch.autocast(points.device.type, enabled=False):
        grid = _GRIDS[0] if n <= _GRIDS[0] else _GRIDS[1]
        depth = widened(view(points, normals, camera_to_world, intrinsics, side, grid).depth)
        depth = functional.interpolate(depth, (n, n), mode="nearest")
        return torch.where(depth < FAR, depth, torch.inf)


def widened(depth: Tensor) -> Tensor:
    """Depth (B, 1, n, n) of a `BustView`, with each silhouette gone on to its sides."""
    reach = depth.shape[-1] // _SIDEWAYS
    for _ in range(2):
        around = -functional.max_pool2d(-depth, 2 * reach + 1, 1, reach)
        depth = torch.where(depth < FAR, depth, around)
    return depth
