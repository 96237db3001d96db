"""The density of a volume, and what losses ask of it: where its surfaces face, how it varies.

Symbols: B batch, N points; spaces as of `rendering`. Single precision, also under autocast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry import volume
from totalediting.geometry.relief import inside
from totalediting.geometry.space import box, on_planes

NORMAL_STEP = 2e-3
"""Metres on either side of a point between which the density's gradient is measured: about a texel
of the finest preset's planes, 2.3 mm, within which bilinear look-ups have no detail."""
JITTER = 2.4e-3
"""Standard deviation in metres, along each axis, of the shift in `density_jitter`: 0.004 of the
box's side, as in EG3D."""


Geometry = Callable[[Tensor, Tensor, Tensor], Tensor]
"""A `GeometryDecoder`, or any other callable like it."""
Looks = Callable[[Tensor], Tensor]
"""What the source shows of canonical points (B, N, 3): (B, N, L), see `shown.Shown`."""


class Volume(NamedTuple):
    """What density is made of."""

    planes: Tensor
    """(B, 3, C, P, P), T_geo."""
    relief: Tensor
    """(B, 8, n, n) of the bust at rest, see `relief`."""
    shown: Looks
    geometry: Geometry


def density(of: Volume, points: Tensor, seen: Tensor | None = None) -> Tensor:
    """sigma (B, N) in 1/metre at canonical `points` (B, N, 3). `seen` is what the source shows
    there, if that is known."""
    with torch.autocast(of.planes.device.type, enabled=False):
        points = full(points)
        places = on_planes(points)
        seen = of.shown(points) if seen is None else seen
        features = volume.triplane(full(of.planes), places)
        return of.geometry(features, inside(full(of.relief), places), seen)


def density_normals(of: Volume, points: Tensor) -> Tensor:
    """-grad sigma / |grad sigma| (B, N, 3) at canonical `points` (B, N, 3): where surfaces face.

    Central differences over `NORMAL_STEP`, six densities a point: `grid_sample` has no second
    derivative, and a difference over a texel does not see the creases of bilinear look-ups. The
    result is a first-order graph, differentiable in planes and decoder; under `no_grad` it is a
    target. Where sigma changes by less than 1/metre in a metre, vectors are shorter than 1, down to
    0: nothing faces anywhere there.
    """
    if points.ndim != 3 or points.shape[-1] != 3:
        raise ValueError(f"points must be (B, N, 3), got {tuple(points.shape)}")
    points = full(points)
    shifts = NORMAL_STEP * torch.eye(3, dtype=points.dtype, device=points.device)
    around = points[:, None] + torch.cat([shifts, -shifts])[:, None]
    found = density(of, around.flatten(1, 2)).unflatten(1, (2, 3, -1))
    gradient = (found[:, 0] - found[:, 1]).mT / (2.0 * NORMAL_STEP)
    return -functional.normalize(gradient, dim=-1, eps=1.0)


def density_jitter(of: Volume, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """sigma (B, count) at points anywhere in the box, and where a jitter takes them, in 1/metre.

    Their mean absolute difference is EG3D's total variation. Points are uniformly distributed, the
    jitter is normal with `JITTER`; `generator` is on the device of the planes.
    """
    low, high = box(full(of.planes))
    size = (len(of.planes), count, 3)
    place = torch.rand(size, generator=generator, dtype=low.dtype, device=low.device)
    shift = torch.randn(size, generator=generator, dtype=low.dtype, device=low.device)
    points = torch.lerp(low, high, place)
    both = torch.cat([points, points + JITTER * shift], 1)
    at, beside = density(of, both).split(count, 1)
    return at, beside


def full(tensor: Tensor) -> Tensor:
    """At least single precision."""
    return tensor if tensor.dtype == torch.float64 else tensor.float()
