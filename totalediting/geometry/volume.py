"""Volume rendering of a radiance field over tri-planes: rays, samples, look-ups, integrals.

A ray is p(t) = o + t d, d unit, t the distance in metres. Along it an attribute c is seen as
C = ∫ T(t) σ(p(t)) c(p(t)) dt over [near, far], where T(t) = exp(-∫ σ(p(s)) ds over [near, t]); the
density σ is in 1/metre, finite and not negative. World: metres, Z up. `camera_to_world` is 4x4 with
OpenGL axes (x right, y up, looks along -z); `intrinsics` is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
in pixels, x right, y down, the centre of the upper left pixel at (0.5, 0.5). S = samples on a ray,
B = batch, P = points, C = channels, H, W = rows and columns.

A sample stands for its cell: the cells of a ray meet halfway between neighbouring samples and fill
[near, far]. σ is constant within a cell, for the integral as for the drawing of further samples, so
that the opacity of a homogeneous interval is exact wherever the samples lie.

Tensors are float32 or float64, on one device. All but `importance` is differentiable.
Sums of products are written out where a matrix product would be shorter: autocast and TF32 would
round rays and weights to three digits.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

PLANE_AXES = ((0, 1), (0, 2), (1, 2))
"""World axes along the (columns, rows) of each plane: XY, XZ, YZ."""


def rays(
    camera_to_world: Tensor, intrinsics: Tensor, height: int, width: int
) -> tuple[Tensor, Tensor]:
    """The rays through all pixel centres of a picture of `height` x `width` pixels.

    `camera_to_world` (..., 4, 4), `intrinsics` (..., 3, 3) for that size, see `resize_intrinsics`.
    Gives origins (..., 1, 1, 3) in metres, which broadcast with the unit directions (..., H, W, 3).
    """
    _check("camera_to_world", camera_to_world, "...", 4, 4)
    _check("intrinsics", intrinsics, "...", 3, 3)
    _positive(height=height, width=width)
    fx, fy = intrinsics[..., 0, 0, None, None], intrinsics[..., 1, 1, None, None]
    cx, cy = intrinsics[..., 0, 2, None, None], intrinsics[..., 1, 2, None, None]
    if not bool(((fx > 0) & (fy > 0) & (intrinsics[..., 0, 1, None, None] == 0)).all()):
        raise ValueError(f"intrinsics must have fx > 0, fy > 0 and no skew, got {intrinsics}")
    columns = torch.arange(width, dtype=intrinsics.dtype, device=intrinsics.device) + 0.5
    rows = torch.arange(height, dtype=intrinsics.dtype, device=intrinsics.device) + 0.5
    x = (columns - cx) / fx
    y = (cy - rows[:, None]) / fy
    right, up, back, origins = camera_to_world[..., None, None, :3, :].unbind(-1)
    directions = x[..., None] * right + y[..., None] * up - back
    return origins, functional.normalize(directions, dim=-1)


def resize_intrinsics(intrinsics: Tensor, size: tuple[int, int], to: tuple[int, int]) -> Tensor:
    """`intrinsics` (..., 3, 3) of a picture of `size` once it is resized to `to`: (height, width).

    Pixel coordinates start at the corner of the picture, so they simply scale.
    """
    _check("intrinsics", intrinsics, "...", 3, 3)
    _positive(height=size[0], width=size[1])
    _positive(to_height=to[0], to_width=to[1])
    scale = [[to[1] / size[1]], [to[0] / size[0]], [1.0]]
    return intrinsics * intrinsics.new_tensor(scale)


def box_interval(
    origins: Tensor, directions: Tensor, low: Tensor, high: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Where rays are inside the box from `low` (3,) to `high` (3,), low < high, in metres.

    `origins` and `directions` (..., 3) broadcast. Gives the distances near and far (...) with
    0 <= near <= far, and whether the box is hit (...). A ray that misses the box, or has it behind
    its origin, gets near = far = 0: an interval without length, hence without opacity. One that
    lies in a face may count either way. Slab method, Kay and Kajiya 1986.
    """
    _check("origins", origins, "...", 3)
    _check("directions", directions, "...", 3)
    _check("low", low, 3)
    _check("high", high, 3)
    # Of a ray parallel to a face, the distances to it become huge with the right signs.
    tiny = torch.finfo(directions.dtype).tiny
    slope = torch.where(directions.abs() < tiny, tiny, directions)
    to_low, to_high = (low - origins) / slope, (high - origins) / slope
    near = torch.minimum(to_low, to_high).amax(-1).clamp(min=0.0)
    far = torch.maximum(to_low, to_high).amin(-1)
    hit = near < far
    return torch.where(hit, near, 0.0), torch.where(hit, far, 0.0), hit


def along(origins: Tensor, directions: Tensor, distances: Tensor) -> Tensor:
    """World points (..., S, 3) at `distances` (..., S) along rays from `rays`, in metres."""
    _check("origins", origins, "...", 3)
    _check("directions", directions, "...", 3)
    _check("distances", distances, *directions.shape[:-1], "S")
    return origins[..., None, :] + distances[..., None] * directions[..., None, :]


def triplane(planes: Tensor, places: Tensor) -> Tensor:
    """Features (B, P, C) at `places` (B, P, 3) from `planes` (B, 3, C, H, W).

    The mean of three look-ups as of `plane`. The planes are XY, XZ and YZ, see `PLANE_AXES`: the
    first axis runs along the columns, the second along the rows. Places are in [-1, 1] along each
    axis; `space` says where that is in the world. Differentiable once, in planes and places.
    """
    _check("planes", planes, "B", 3, "C", "H", "W")
    _check("places", places, planes.shape[0], "P", 3)
    grid = torch.stack([places[..., axis] for axes in PLANE_AXES for axis in axes], dim=-1)
    grid = grid.unflatten(-1, (3, 2)).movedim(2, 1).flatten(0, 1)  # (B * 3, P, 2)
    return plane(planes.flatten(0, 1), grid).unflatten(0, (-1, 3)).mean(1)


def plane(picture: Tensor, places: Tensor) -> Tensor:
    """Features (B, P, C) at `places` (B, P, 2) of `picture` (B, C, H, W), by a bilinear look-up.

    Places are to the right and down, [-1, 1] is the picture. Texels have area
    (align_corners=False): the centre of column j is the share (j + 0.5) / W of the way. Beyond the
    outermost centres the value at the border continues.
    """
    _check("picture", picture, "B", "C", "H", "W")
    _check("places", places, picture.shape[0], "P", 2)
    found = functional.grid_sample(
        picture, places[:, None], padding_mode="border", align_corners=False
    )
    return found[:, :, 0].mT


def triplane_reference(planes: Tensor, places: Tensor) -> Tensor:
    """The same as `triplane`, spelled out and slow: what it is tested against."""
    batch = torch.arange(planes.shape[0], device=planes.device)[:, None]
    size = (planes.shape[4], planes.shape[3])  # along columns, along rows
    total = places.new_zeros(*places.shape[:2], planes.shape[2])
    for k, axes in enumerate(PLANE_AXES):
        texels, shares = [], []
        for i, axis in enumerate(axes):
            place = (places[..., axis] + 1) / 2 * size[i] - 0.5
            place = place.clamp(0.0, size[i] - 1.0)
            first = place.floor().long()
            texels.append((first, (first + 1).clamp(max=size[i] - 1)))
            shares.append((1.0 - (place - first), place - first))
        for column, across in zip(texels[0], shares[0], strict=True):
            for row, down in zip(texels[1], shares[1], strict=True):
                total = total + (across * down)[..., None] * planes[batch, k, :, row, column]
    return total / 3.0


def stratified(
    near: Tensor, far: Tensor, count: int, generator: torch.Generator | None = None
) -> Tensor:
    """`count` sorted distances (..., S) that cover [near, far], both (...), in equal bins.

    One in the centre of each bin or, with a generator (on the device of `near`), uniformly
    distributed within it.
    """
    _check("far", far, *near.shape)
    _positive(count=count)
    return torch.lerp(near[..., None], far[..., None], _strata(near, count, generator))


@torch.no_grad()
def importance(
    weights: Tensor,
    distances: Tensor,
    near: Tensor,
    far: Tensor,
    count: int,
    generator: torch.Generator | None = None,
) -> Tensor:
    """`count` more distances (..., count), rising, where the `weights` (..., S) of a ray are.

    Drawn by the inverse of the distribution whose density is constant in each cell of `distances`
    (..., S) and has the cell's weight as mass; uniform over [near, far], both (...), where all
    weights are 0. In each of `count` equal strata of probability the middle is taken or, with a
    generator, a random point. No gradient flows through. NeRF, Mildenhall et al. 2020, section 5.2.
    """
    _check("weights", weights, *distances.shape)
    _positive(count=count)
    edges = _edges(distances, near, far)
    mass = torch.where(weights.sum(-1, keepdim=True) > 0, weights, edges.diff())
    below = functional.pad(mass.cumsum(-1), (1, 0))
    drawn = _strata(near, count, generator) * below[..., -1:]
    # The first edge that is not below a draw > 0 ends a cell with mass. On rays without length
    # nothing has mass, and sums in parallel may fall by a rounding: hence the clamps.
    last = torch.searchsorted(below, drawn).clamp(1, distances.shape[-1])
    start, end = below.gather(-1, last - 1), below.gather(-1, last)
    tiny = torch.finfo(mass.dtype).tiny
    share = ((drawn - start) / (end - start).clamp(min=tiny)).clamp(0.0, 1.0)
    return torch.lerp(edges.gather(-1, last - 1), edges.gather(-1, last), share)


def widen(weights: Tensor) -> Tensor:
    """`weights` (..., S) spread to the neighbours, for `importance`: a surface that coarse samples
    first meet in one cell may begin in the cell before. Not normalised.

    The mean of the maxima with either neighbour, Mip-NeRF, Barron et al. 2021.
    """
    _check("weights", weights, "...", "S")
    padded = functional.pad(weights, (1, 1))
    larger = torch.maximum(padded[..., :-1], padded[..., 1:])
    return 0.5 * (larger[..., :-1] + larger[..., 1:])


def merge(coarse: Tensor, fine: Tensor) -> tuple[Tensor, Tensor]:
    """Distances (..., S) and (..., N) as one sorted (..., S + N), and the order, int64.

    merged = cat(coarse, fine)[order] along the last axis; what is known of the samples follows with
    `torch.take_along_dim`.
    """
    _check("fine", fine, *coarse.shape[:-1], "N")
    return torch.cat([coarse, fine], dim=-1).sort(dim=-1, stable=True)


def quadrature(density: Tensor, distances: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """The weights (..., S) of the samples of a ray in all integrals along it, each in [0, 1].

    w_i = T_i (1 - exp(-σ_i δ_i)), T_i = exp(-Σ σ_j δ_j, j < i): NeRF, Mildenhall et al. 2020,
    equation 3, where δ is the length of a sample's cell, in metres. `density` (..., S) in 1/metre,
    >= 0 and finite; `distances` (..., S) sorted within `near` and `far` (...). The weights sum to
    1 - exp(-Σ σ δ) and the δ to far - near.
    """
    _check("density", density, *distances.shape)
    depth = density * _edges(distances, near, far).diff()
    # Summed without the sample's own: the difference would drown in a dense one.
    before = functional.pad(depth[..., :-1].cumsum(-1), (1, 0))
    return torch.exp(-before) * -torch.expm1(-depth)


def opacity(weights: Tensor) -> Tensor:
    """The share (...) of light that the samples with `weights` (..., S) stop, in [0, 1]."""
    _check("weights", weights, "...", "S")
    return weights.sum(-1)


def composite(weights: Tensor, attributes: Tensor) -> Tensor:
    """Any attribute (..., C) as seen: the sum of those of the samples (..., S, C) by `weights`
    (..., S). Premultiplied: nothing seen is 0."""
    _check("attributes", attributes, *weights.shape, "C")
    return (weights[..., None] * attributes).sum(-2)


def expected_distance(weights: Tensor, distances: Tensor) -> Tensor:
    """The mean distance (...) along the ray, metres, of what is seen, by `weights` (..., S).

    0, without gradient, where nothing is: where the opacity is no more than rounding.
    """
    _check("distances", distances, *weights.shape)
    seen = weights.sum(-1)
    hit = seen > torch.finfo(weights.dtype).eps
    return torch.where(hit, (weights * distances).sum(-1) / torch.where(hit, seen, 1.0), 0.0)


def planar_depth(distance: Tensor, directions: Tensor, camera_to_world: Tensor) -> Tensor:
    """Depth (..., H, W) along the viewing axis, metres, as the dataset's, of `distance` (..., H, W)
    along the unit `directions` (..., H, W, 3) of the `rays` of `camera_to_world` (..., 4, 4)."""
    _check("directions", directions, "...", *distance.shape[-2:], 3)
    _check("camera_to_world", camera_to_world, "...", 4, 4)
    forward = -camera_to_world[..., None, None, :3, 2]
    return distance * (directions * forward).sum(-1)


def _edges(distances: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """The ends (..., S + 1) of the cells of the samples at `distances` (..., S)."""
    _check("near", near, *distances.shape[:-1])
    _check("far", far, *distances.shape[:-1])
    between = 0.5 * (distances[..., :-1] + distances[..., 1:])
    return torch.cat([near[..., None], between, far[..., None]], dim=-1)


def _strata(like: Tensor, count: int, generator: torch.Generator | None) -> Tensor:
    """One number in each of `count` equal parts of (0, 1], rising: (..., count), or (count,)."""
    first = torch.arange(count, dtype=like.dtype, device=like.device)
    if generator is None:
        return (first + 0.5) / count
    random = torch.rand(
        *like.shape, count, generator=generator, dtype=like.dtype, device=like.device
    )
    return (first + 1.0 - random) / count


def _check(name: str, tensor: Tensor, *shape: int | str) -> None:
    """Raise unless the shape fits. A word allows any size, a leading "..." any leading sizes."""
    leading = shape[:1] == ("...",)
    sizes, got = shape[leading:], tuple(tensor.shape)
    extra = len(got) - len(sizes)
    if (
        extra < 0
        or (extra > 0 and not leading)
        or any(isinstance(s, int) and s != g for s, g in zip(sizes, got[extra:], strict=True))
    ):
        raise ValueError(f"{name} must be ({', '.join(map(str, shape))}), got {got}")


def _positive(**counts: int) -> None:
    for name, count in counts.items():
        if count < 1:
            raise ValueError(f"{name} must be positive, got {count}")
