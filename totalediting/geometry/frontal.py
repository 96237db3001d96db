"""The source picture laid onto the bust to show, at rest, as it would be seen from the front.

Every texel of the planes' XZ plane gets the colour that the source shows at the point of the skin
in front of it. So the appearance encoder sees a face where the planes will hold it, whatever the
pose in the source, and need not learn where that is (face frontalisation, Hassner et al. 2015);
and the shading decoder sees the colour itself at each point (pixel-aligned features, Saito et al.
2019), so that what is fine need not pass through the encoders. At rest the bust has the expression
to show, so that brows and lips of the source move as the skin does. Beyond the skin, where hair and
clothes are, the motion of the skin is continued.

With it comes the bust's `relief`: what is between its front and its back is full, so that the
density decoder has only hair and clothes to find, and the relief's errors.

Symbols: B batch, V control points, S side of pictures. Axes of the result are those of the plane:
columns along +X, rows along +Z, downwards, over the box as `space` lays it onto planes.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry import volume
from totalediting.geometry.field import Control
from totalediting.geometry.relief import GRID, fill_holes, front_and_back, texels_of
from totalediting.geometry.space import off_planes, on_planes

_SHOWN, _RELIEF = 4, 2  # channels: colour and how squarely it is seen; front and back
CHANNELS = _SHOWN + _RELIEF
"""Colour, how squarely the camera sees the skin, and its relief."""
LAID = 2 * _SHOWN + _RELIEF
"""Channels of `both_sides`."""

_BEHIND = 0.06  # places behind the front, 8 mm, from where on skin is within a mouth or a socket
_EITHER = 0.01  # weight of a side that the camera does not see


@torch.no_grad()
def frontalise(
    image: Tensor, control: Control, camera_to_world: Tensor, intrinsics: Tensor
) -> Tensor:
    """Pictures (B, 3, S, S) on the front of the bust at rest: (B, 6, S, S) in [0, 1].

    After the colour comes the cosine between the skin's normal and the direction to the camera: 0
    where the source hides the skin, or there is none. Colours are filled in everywhere. Last come
    the places of front and back along Y, as shares of the planes' side; 1 and 0 where there is no
    skin.

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
    """(B, 10, S, S) in [-1, 1]: what a picture (B, 6, S, S) of `frontalise` shows, its mirror
    image, which shows what the pose hides, and the relief."""
    seen, relief = (2 * frontal - 1).split([_SHOWN, _RELIEF], 1)
    return torch.cat([seen, seen.flip(-1), relief], 1)


def colour_of(laid: Tensor) -> Tensor:
    """(..., 3) display-referred colour in [0, 1] that `laid` (..., LAID), channels of `both_sides`,
    shows: of the two sides, by the square of how squarely the camera sees them."""
    one, other = ((laid[..., k : k + _SHOWN] + 1) / 2 for k in (0, _SHOWN))
    weights = [part[..., 3:].square() + _EITHER for part in (one, other)]
    total = weights[0] * one[..., :3] + weights[1] * other[..., :3]
    return total / (weights[0] + weights[1])


def inside(laid: Tensor, places: Tensor) -> Tensor:
    """How far (B, P) points at `places` (B, P, 3) are behind the front and before the back of the
    skin along Y, in places; below 0 outside. `laid` (B, LAID, S, S) is of `both_sides`."""
    front, back = volume.plane(laid[:, -_RELIEF:], places[..., 0::2]).unbind(-1)
    return torch.minimum(places[..., 1] - front, back - places[..., 1])


def _lay(image: Tensor, control: Control, camera_to_world: Tensor, intrinsics: Tensor) -> Tensor:
    batch, side = len(image), image.shape[-1]
    place = _project(control.posed, camera_to_world, intrinsics, side)
    to_camera = camera_to_world[:, None, :3, 3] - control.posed
    facing = (control.posed_normals * functional.normalize(to_camera, dim=-1)).sum(-1)

    places = on_planes(control.canonical)
    texel = texels_of(places)
    relief = front_and_back(places, control.canonical_normals, texel)
    behind = places[..., 1] - relief[:, 0].flatten(1).gather(1, texel)
    front = (-control.canonical_normals[..., 1]).clamp_min(0)
    weight = (front * (places.abs() < 1).all(-1) * (behind < _BEHIND))[..., None]

    # The affine part of the motion continues beyond the skin; the rest fades into its surroundings.
    basis = torch.cat([control.canonical[..., 0::2], torch.ones_like(weight)], -1)
    gram = (weight * basis).mT @ basis + 1e-6 * torch.eye(3).to(basis)
    affine = torch.linalg.solve(gram, (weight * basis).mT @ place)
    known = torch.cat([place - basis @ affine, facing.clamp(0, 1)[..., None]], -1)

    sums = weight.new_zeros(batch, GRID**2, 4)
    values = torch.cat([weight, weight * known], -1)
    sums.scatter_add_(1, texel[..., None].expand_as(values), values)
    sums = sums.mT.unflatten(-1, (GRID, GRID))
    filled = functional.interpolate(fill_holes(sums), (side, side), mode="bilinear")
    skin = functional.max_pool2d((sums[:, :1] > 0).float(), 5, 1, 2)
    skin = functional.interpolate(skin, (side, side), mode="bilinear")

    middle = (2 * torch.arange(side, device=image.device) + 1) / side - 1
    rows, columns = torch.meshgrid(middle, middle, indexing="ij")
    points = off_planes(torch.stack([columns, torch.zeros_like(rows), rows], -1))
    grid = torch.stack([points[..., 0], points[..., 2], torch.ones_like(rows)], -1)
    flow = (grid.flatten(0, 1) @ affine).unflatten(1, (side, side)) + filled[:, :2].movedim(1, -1)
    colour = functional.grid_sample(image, flow, padding_mode="border", align_corners=False)
    facing = skin * filled[:, 2:].clamp(0, 1)
    relief = functional.interpolate(relief, (side, side), mode="bilinear")
    return torch.cat([colour, facing, (relief + 1) / 2], 1)


def _project(points: Tensor, camera_to_world: Tensor, intrinsics: Tensor, side: int) -> Tensor:
    """(B, V, 2) where points (B, V, 3) appear, in [-1, 1] from left and top."""
    local = (points - camera_to_world[:, None, :3, 3]) @ camera_to_world[:, :3, :3]
    depth = (-local[..., 2:]).clamp_min(1e-3)
    focal = torch.stack([intrinsics[:, 0, 0], -intrinsics[:, 1, 1]], -1)[:, None]
    pixels = focal * local[..., :2] / depth + intrinsics[:, None, :2, 2]
    return 2 * pixels / side - 1
