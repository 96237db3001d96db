"""The source picture laid onto the bust to show, at rest, as it would be seen from the front.

Every texel of the planes' XZ plane gets the colour that the source shows at the point of the skin
in front of it. So the appearance encoder sees a face where the planes will hold it, whatever the
pose in the source, and need not learn where that is (face frontalisation, Hassner et al. 2015);
and the shading decoder sees the colour itself at each point (pixel-aligned features, Saito et al.
2019), so that what is fine need not pass through the encoders. At rest the bust has the expression
to show, so that brows and lips of the source move as the skin does. Beyond the skin, where hair and
clothes are, the motion of the skin is continued.

Symbols: B batch, V control points, S side of pictures. Axes of the result are those of the plane:
columns along +X, rows along +Z, downwards, over the box as `space` lays it onto planes.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.field import Control
from totalediting.space import off_planes, on_planes

CHANNELS = 4
"""Colour, and how squarely the camera sees the skin."""
LAID = 2 * CHANNELS
"""Channels of `both_sides`."""

_GRID = 64  # texels along a side that control points are gathered in: about as many as lie there
_TRUST = 0.2  # control points that a texel's coarser surroundings count as


@torch.no_grad()
def frontalise(
    image: Tensor, control: Control, camera_to_world: Tensor, intrinsics: Tensor
) -> Tensor:
    """Pictures (B, 3, S, S) on the front of the bust at rest: (B, 4, S, S).

    The last channel is the cosine between the skin's normal and the direction to the camera in
    [0, 1]: 0 where the source hides the skin, or there is none. Colours are given everywhere.

    Args:
        image: in [0, 1].
        control: the bust as the source shows it, and at rest with the expression to show
            (B, V, 3), model space: `Control.showing`.
        camera_to_world: (B, 4, 4) into model space.
        intrinsics: (B, 3, 3) in pixels of side S.

    Raises:
        ValueError: a shape does not fit.
    """
    batch, side = len(image), image.shape[-1]
    if image.shape != (batch, 3, side, side):
        raise ValueError(f"image must be (B, 3, S, S), got {tuple(image.shape)}")
    if control.posed.ndim != 3 or len(control.posed) != batch:
        raise ValueError(f"control must be ({batch}, V, 3), got {tuple(control.posed.shape)}")
    with torch.autocast(image.device.type, enabled=False):
        return _lay(image, control, camera_to_world, intrinsics)


def both_sides(frontal: Tensor) -> Tensor:
    """(B, 8, S, S) in [-1, 1]: a picture (B, 4, S, S) of `frontalise`, and its mirror image, which
    shows what the pose hides."""
    laid = 2 * frontal - 1
    return torch.cat([laid, laid.flip(-1)], 1)


def _lay(image: Tensor, control: Control, camera_to_world: Tensor, intrinsics: Tensor) -> Tensor:
    batch, side = len(image), image.shape[-1]
    place = _project(control.posed, camera_to_world, intrinsics, side)
    to_camera = camera_to_world[:, None, :3, 3] - control.posed
    facing = (control.posed_normals * functional.normalize(to_camera, dim=-1)).sum(-1)

    at = on_planes(control.canonical)[..., 0::2]
    front = (-control.canonical_normals[..., 1]).clamp_min(0)
    inside = (at.abs() < 1).all(-1)
    weight = (front * inside)[..., None]

    # What an affine motion explains goes on beyond the skin; the rest fades into its surroundings.
    basis = torch.cat([control.canonical[..., 0::2], torch.ones_like(at[..., :1])], -1)
    gram = (weight * basis).mT @ basis + 1e-6 * torch.eye(3).to(basis)
    affine = torch.linalg.solve(gram, (weight * basis).mT @ place)
    known = torch.cat([place - basis @ affine, facing.clamp(0, 1)[..., None]], -1)

    texel = ((at + 1) / 2 * _GRID).long().clamp(0, _GRID - 1)
    index = texel[..., 1] * _GRID + texel[..., 0]
    sums = weight.new_zeros(batch, _GRID**2, 4)
    values = torch.cat([weight, weight * known], -1)
    sums.scatter_add_(1, index[..., None].expand_as(values), values)
    sums = sums.mT.unflatten(-1, (_GRID, _GRID))
    filled = functional.interpolate(_fill(sums), (side, side), mode="bilinear")
    skin = functional.max_pool2d((sums[:, :1] > 0).float(), 5, 1, 2)
    skin = functional.interpolate(skin, (side, side), mode="bilinear")

    middle = (2 * torch.arange(side, device=image.device) + 1) / side - 1
    rows, columns = torch.meshgrid(middle, middle, indexing="ij")
    texels = off_planes(torch.stack([columns, torch.zeros_like(rows), rows], -1))
    grid = torch.stack([texels[..., 0], texels[..., 2], torch.ones_like(rows)], -1)
    flow = (grid.flatten(0, 1) @ affine).unflatten(1, (side, side)) + filled[:, :2].movedim(1, -1)
    colour = functional.grid_sample(image, flow, padding_mode="border", align_corners=False)
    return torch.cat([colour, skin * filled[:, 2:].clamp(0, 1)], 1)


def _project(points: Tensor, camera_to_world: Tensor, intrinsics: Tensor, side: int) -> Tensor:
    """(B, V, 2) where points (B, V, 3) appear, in [-1, 1] from left and top."""
    local = (points - camera_to_world[:, None, :3, 3]) @ camera_to_world[:, :3, :3]
    depth = (-local[..., 2:]).clamp_min(1e-3)
    focal = torch.stack([intrinsics[:, 0, 0], -intrinsics[:, 1, 1]], -1)[:, None]
    pixels = focal * local[..., :2] / depth + intrinsics[:, None, :2, 2]
    return 2 * pixels / side - 1


def _fill(sums: Tensor) -> Tensor:
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
