"""The picture of two tri-planes: samples on rays, moved to canonical space, decoded, integrated.

Symbols: B batch, h = preset.neural, R = h^2 rays (row by row), S = coarse + fine samples on a ray,
N points. Model space and canonical space: metres, Z up, the head looks along -Y, the origin in its
middle. Rays are sampled in the box of posed model space; planes hold the same box of canonical
space, both as `space` says. Cameras as in `totalediting.geometry.volume`, with `camera_to_world`
into model space. Volume rendering is in single precision, also under autocast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

from totalediting.geometry import volume
from totalediting.geometry.field import Field
from totalediting.geometry.frontal import inside
from totalediting.geometry.space import box, on_planes
from totalediting.networks.decoders import Decoders, Shading, ToPosed
from totalediting.presets import Preset

NORMAL_STEP = 2e-3
"""Metres on either side of a point between which the density's gradient is measured: about a texel
of the finest preset's planes, 2.3 mm, within which bilinear look-ups have no detail."""
JITTER = 2.4e-3
"""Standard deviation in metres, along each axis, of the shift in `density_jitter`: 0.004 of the
box's side, as in EG3D."""

Deformation = Callable[[Tensor], Field]
"""T and R at points (B, P, 3) of posed space: a `field.Table`, or any other callable like it."""


class Rendering(NamedTuple):
    """Pictures (B, channels, h, w), and what losses need of the samples behind them.

    All pictures but opacity and depth are premultiplied by the opacity: nothing seen is 0.
    """

    colour: Tensor
    """(B, 3, h, w), linear Rec.709 (display-referred where `preset.colour` is "srgb")."""
    albedo: Tensor
    """(B, 3, h, w)."""
    normal: Tensor
    """(B, 3, h, w) in model space; of what is seen, at most as long as the opacity."""
    diffuse: Tensor
    """(B, 3, h, w), a part of the colour, as specular and residual; 0 of a `PlainDecoder`."""
    specular: Tensor
    """(B, 3, h, w)."""
    residual: Tensor
    """(B, 3, h, w)."""
    features: Tensor
    """(B, preset.features, h, w), w for super-resolution."""
    canonical: Tensor
    """(B, 3, h, w) canonical coordinates in metres, for the dual discriminator."""
    opacity: Tensor
    """(B, 1, h, w) in [0, 1]."""
    depth: Tensor
    """(B, 1, h, w) along the viewing axis, metres; 0 where nothing is."""
    weights: Tensor
    """(B, R, S) of the samples in all integrals."""
    points: Tensor
    """(B, R, S, 3), canonical positions of the samples."""
    canonical_normals: Tensor
    """(B, R, S, 3), n^c at the samples."""
    residual_l1: Tensor
    """(B,) mean absolute residual of what is seen; by weights that pass no gradient."""


def render(
    geometry_planes: Tensor,
    shading_planes: Tensor,
    laid: Tensor,
    decoders: Decoders,
    camera_to_world: Tensor,
    intrinsics: Tensor,
    lightmaps: Tensor,
    to_light: Tensor,
    deformation: Deformation | None,
    preset: Preset,
    generator: torch.Generator | None = None,
    chunk: int | None = None,
    side: int | None = None,
) -> Rendering:
    """Volume-render h x h pixels (paper, sections 3.1 "image formation" and 3.3).

    A first pass finds where on a ray there is density; it has no gradient. The second decodes all
    samples, those of the first once more.

    Args:
        geometry_planes, shading_planes: (B, 3, C, H, W), see `volume.triplane`.
        laid: (B, LAID, S, S) what the source shows, see `frontal.both_sides`.
        decoders: `geometry` and `shading`.
        camera_to_world: (B, 4, 4) into model space.
        intrinsics: (B, 3, 3) for a picture of h x h, see `volume.resize_intrinsics`.
        lightmaps, to_light: see `ShadingDecoder.forward`.
        deformation: from posed to canonical space; None where there is no motion. Where
            `preset.rotation` is "none", its positions count but normals stay canonical.
        generator: places samples at random in their strata, on the device of the planes; without
            one they lie in the middle.
        chunk: rays at once. The result is the same, to rounding; of a chunk only the result is kept
            for the backward pass, which computes the rest again.

    Raises:
        ValueError: a shape does not fit, or chunk is not positive.
    """
    if chunk is not None and chunk < 1:
        raise ValueError(f"chunk must be a positive number of rays, got {chunk}")
    _check(geometry_planes, shading_planes, camera_to_world, preset)
    side = preset.neural if side is None else side
    with torch.autocast(geometry_planes.device.type, enabled=False):
        subject = _Subject(
            geometry_planes=_full(geometry_planes),
            shading_planes=_full(shading_planes),
            laid=_full(laid),
            decoders=decoders,
            lightmaps=_full(lightmaps),
            to_light=_full(to_light),
            deformation=deformation,
            turned=preset.rotation != "none",
        )
        camera_to_world = _full(camera_to_world)
        origin, direction = volume.rays(camera_to_world, _full(intrinsics), side, side)
        directions = direction.flatten(1, 2)
        origins = origin.flatten(1, 2).expand_as(directions)
        near, far, _ = volume.box_interval(origins, directions, *box(directions))

        # All random numbers are drawn for all rays at once, so that chunks do not change them.
        with torch.no_grad():
            coarse = volume.stratified(near, far, preset.coarse_samples, generator)
            rays = _Rays(origins, directions, near, far, coarse)
            weights = torch.cat([_decode(subject, part)[0] for part in rays.split(chunk)], 1)
            weights = volume.widen(weights)
            fine = volume.importance(weights, coarse, near, far, preset.fine_samples, generator)
            rays = rays._replace(distances=volume.merge(coarse, fine)[0])

        if chunk is None:
            found = _integrate(subject, rays)
        else:
            parts = [
                checkpoint(_integrate, subject, part, use_reentrant=False, preserve_rng_state=False)
                for part in rays.split(chunk)
            ]
            found = _Integrals(*(torch.cat(tensors, 1) for tensors in zip(*parts, strict=True)))

        distance = found.distance.unflatten(1, (side, side))
        depth = volume.planar_depth(distance, direction, camera_to_world)
        opacity = volume.opacity(found.weights)
        strength = found.strength.sum(1) / opacity.detach().sum(1).clamp_min(1e-6)

    def picture(values: Tensor) -> Tensor:
        return values.mT.unflatten(-1, (side, side))

    return Rendering(
        colour=picture(found.colour),
        albedo=picture(found.albedo),
        normal=picture(found.normal),
        diffuse=picture(found.diffuse),
        specular=picture(found.specular),
        residual=picture(found.residual),
        features=picture(found.features),
        canonical=picture(found.canonical),
        opacity=picture(opacity[..., None]),
        depth=depth[:, None],
        weights=found.weights,
        points=found.points,
        canonical_normals=found.canonical_normals,
        residual_l1=strength,
    )


Geometry = Callable[[Tensor, Tensor], Tensor]
"""A `GeometryDecoder`, or any other callable like it."""


def density(planes: Tensor, laid: Tensor, geometry: Geometry, points: Tensor) -> Tensor:
    """sigma (B, N) in 1/metre at canonical `points` (B, N, 3) of geometry `planes` and of what is
    `laid` on them. Single precision, also under autocast."""
    with torch.autocast(planes.device.type, enabled=False):
        places = on_planes(_full(points))
        return geometry(volume.triplane(_full(planes), places), inside(_full(laid), places))


def density_normals(planes: Tensor, laid: Tensor, geometry: Geometry, points: Tensor) -> Tensor:
    """-grad sigma / |grad sigma| (B, N, 3) at canonical `points` (B, N, 3): where surfaces face.

    Central differences over `NORMAL_STEP`, six densities a point: `grid_sample` has no second
    derivative, and a difference over a texel does not see the creases of bilinear look-ups. The
    result is a first-order graph, differentiable in planes and decoder; under `no_grad` it is a
    target. Where sigma changes by less than 1/metre in a metre, vectors are shorter than 1, down to
    0: nothing faces anywhere there.
    """
    if points.ndim != 3 or points.shape[-1] != 3:
        raise ValueError(f"points must be (B, N, 3), got {tuple(points.shape)}")
    points = _full(points)
    shifts = NORMAL_STEP * torch.eye(3, dtype=points.dtype, device=points.device)
    around = points[:, None] + torch.cat([shifts, -shifts])[:, None]
    found = density(planes, laid, geometry, around.flatten(1, 2)).unflatten(1, (2, 3, -1))
    gradient = (found[:, 0] - found[:, 1]).mT / (2.0 * NORMAL_STEP)
    return -functional.normalize(gradient, dim=-1, eps=1.0)


def density_jitter(
    planes: Tensor,
    laid: Tensor,
    geometry: Geometry,
    count: int,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """sigma (B, count) at points anywhere in the box, and where a jitter takes them, in 1/metre.

    Their mean absolute difference is EG3D's total variation. Points are uniformly distributed, the
    jitter is normal with `JITTER`; `generator` is on the device of the planes.
    """
    low, high = box(_full(planes))
    size = (len(planes), count, 3)
    place = torch.rand(size, generator=generator, dtype=low.dtype, device=low.device)
    shift = torch.randn(size, generator=generator, dtype=low.dtype, device=low.device)
    points = torch.lerp(low, high, place)
    both = torch.cat([points, points + JITTER * shift], 1)
    at, beside = density(planes, laid, geometry, both).split(count, 1)
    return at, beside


class _Subject(NamedTuple):
    """What is rendered, and its light."""

    geometry_planes: Tensor
    shading_planes: Tensor
    laid: Tensor
    decoders: Decoders
    lightmaps: Tensor
    to_light: Tensor
    deformation: Deformation | None
    turned: bool


class _Rays(NamedTuple):
    """(B, R, ...): origins, directions (3), near, far (), distances of the samples (S)."""

    origins: Tensor
    directions: Tensor
    near: Tensor
    far: Tensor
    distances: Tensor

    def split(self, chunk: int | None) -> list[_Rays]:
        if chunk is None:
            return [self]
        return [_Rays(*part) for part in zip(*(a.split(chunk, 1) for a in self), strict=True)]


class _Integrals(NamedTuple):
    """(B, R, ...) along rays; `strength` is the absolute residual that is seen. See `Rendering`."""

    colour: Tensor
    albedo: Tensor
    normal: Tensor
    diffuse: Tensor
    specular: Tensor
    residual: Tensor
    features: Tensor
    canonical: Tensor
    distance: Tensor
    strength: Tensor
    weights: Tensor
    points: Tensor
    canonical_normals: Tensor


def _decode(subject: _Subject, rays: _Rays) -> tuple[Tensor, Tensor, ToPosed]:
    """Weights (B, R, S) and canonical points (B, R * S, 3) of samples; what turns normals there."""
    points = volume.along(rays.origins, rays.directions, rays.distances).flatten(1, 2)
    to_posed: ToPosed = _unturned
    if subject.deformation is not None:
        deformed = subject.deformation(points)
        points = deformed.position
        if subject.turned:
            to_posed = deformed.to_posed
    sigma = density(subject.geometry_planes, subject.laid, subject.decoders.geometry, points)
    sigma = sigma.view_as(rays.distances)
    weights = volume.quadrature(sigma, rays.distances, rays.near, rays.far)
    return weights, points, to_posed


def _integrate(subject: _Subject, rays: _Rays) -> _Integrals:
    weights, points, to_posed = _decode(subject, rays)
    places = on_planes(points)
    features = torch.cat(
        [
            volume.triplane(subject.shading_planes, places),
            volume.plane(subject.laid, places[..., 0::2]),
        ],
        -1,
    )
    samples = rays.distances.shape[1:]
    view = -rays.directions[:, :, None].expand(-1, -1, samples[1], -1).flatten(1, 2)
    shading: Shading = subject.decoders.shading(
        features, to_posed, view, subject.lightmaps, subject.to_light
    )

    def seen(values: Tensor) -> Tensor:
        return volume.composite(weights, values.unflatten(1, samples))

    return _Integrals(
        colour=seen(shading.colour),
        albedo=seen(shading.albedo),
        normal=seen(shading.normal),
        diffuse=seen(shading.diffuse),
        specular=seen(shading.specular),
        residual=seen(shading.residual),
        features=seen(shading.features),
        canonical=seen(points),
        distance=volume.expected_distance(weights, rays.distances),
        strength=(weights.detach() * shading.residual.abs().mean(-1).view_as(weights)).sum(-1),
        weights=weights,
        points=points.unflatten(1, samples),
        canonical_normals=shading.canonical_normal.unflatten(1, samples),
    )


def _unturned(directions: Tensor) -> Tensor:
    return directions


def _full(tensor: Tensor) -> Tensor:
    """At least single precision."""
    return tensor if tensor.dtype == torch.float64 else tensor.float()


def _check(geometry: Tensor, shading: Tensor, camera_to_world: Tensor, preset: Preset) -> None:
    channels = preset.plane_channels
    for name, planes in (("geometry_planes", geometry), ("shading_planes", shading)):
        if planes.ndim != 5 or planes.shape[:3] != (len(geometry), 3, channels):
            raise ValueError(f"{name} must be (B, 3, {channels}, H, W), got {tuple(planes.shape)}")
    if camera_to_world.shape != (len(geometry), 4, 4):
        raise ValueError(
            f"camera_to_world must be {(len(geometry), 4, 4)}, got {tuple(camera_to_world.shape)}"
        )
