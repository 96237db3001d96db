"""The picture of two tri-planes: samples on rays, moved to canonical space, decoded, integrated.

Symbols: B batch, h = preset.neural, R = h^2 rays (row by row), S samples on a ray, N points. Model
space and canonical space: metres, Z up, the head looks along -Y, the origin in its middle. Rays are
sampled in the box of posed model space; planes hold the same box of canonical space, both as
`space` says. Cameras as in `totalediting.geometry.volume`, with `camera_to_world` into model space.
Volume rendering is in single precision, also under autocast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from totalediting.geometry import volume
from totalediting.geometry.field import Field
from totalediting.geometry.relief import skin_normal
from totalediting.geometry.space import box, on_planes
from totalediting.networks.decoders import Decoders, Shading, ToPosed
from totalediting.networks.density import Looks, Volume, density, full
from totalediting.presets import Preset

AROUND = 0.03
"""Metres before and behind the bust's skin where most samples lie."""
BEFORE, BEHIND = 0.15, 0.2
"""Metres before and behind it where a ray begins and ends: hair and clothes are not thicker."""

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
    relief: Tensor,
    shown: Looks,
    decoders: Decoders,
    camera_to_world: Tensor,
    intrinsics: Tensor,
    lightmaps: Tensor,
    to_light: Tensor,
    deformation: Deformation | None,
    preset: Preset,
    generator: torch.Generator | None = None,
    skin: Tensor | None = None,
    chunk: int | None = None,
    side: int | None = None,
) -> Rendering:
    """Volume-render h x h pixels (paper, sections 3.1 "image formation" and 3.3).

    Where the bust's `skin` is known, samples lie about it. Else a first pass finds where on a ray
    there is density; it has no gradient. The second decodes all samples, those of the first once
    more.

    Args:
        geometry_planes, shading_planes: (B, 3, C, H, W), see `volume.triplane`.
        relief: (B, 8, n, n) of the bust at rest, see `relief`.
        shown: what the source shows of canonical points.
        decoders: `geometry` and `shading`.
        camera_to_world: (B, 4, 4) into model space.
        intrinsics: (B, 3, 3) for a picture of h x h, see `volume.resize_intrinsics`.
        lightmaps, to_light: see `ShadingDecoder.forward`.
        deformation: from posed to canonical space; None where there is no motion. Where
            `preset.rotation` is "none", its positions count but normals stay canonical.
        generator: places samples at random in their strata, on the device of the planes; without
            one they lie in the middle.
        skin: (B, 1, h, h) planar depth of the bust's nearest skin, metres, infinite where there is
            none near; None for two passes.
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
            geometry_planes=full(geometry_planes),
            shading_planes=full(shading_planes),
            relief=full(relief),
            shown=shown,
            decoders=decoders,
            lightmaps=full(lightmaps),
            to_light=full(to_light),
            deformation=deformation,
            turned=preset.rotation != "none",
        )
        camera_to_world = full(camera_to_world)
        origin, direction = volume.rays(camera_to_world, full(intrinsics), side, side)
        directions = direction.flatten(1, 2)
        origins = origin.flatten(1, 2).expand_as(directions)
        near, far, _ = volume.box_interval(origins, directions, *box(directions))

        # All random numbers are drawn for all rays at once, so that chunks do not change them.
        with torch.no_grad():
            rays = _Rays(origins, directions, near, far, near[..., None])
            if skin is None:
                rays = _by_importance(subject, rays, preset, generator, chunk)
            else:
                slope = -(directions * camera_to_world[:, None, :3, 2]).sum(-1)
                rays = _about(skin.flatten(1) / slope, rays, preset, generator)

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


def shading_features(planes: Tensor, relief: Tensor, points: Tensor, seen: Tensor) -> Tensor:
    """t_shd (B, N, C + 3 + L) at canonical points (B, N, 3), of which the source shows `seen`."""
    places = on_planes(points)
    return torch.cat([volume.triplane(planes, places), skin_normal(relief, places), seen], -1)


class _Subject(NamedTuple):
    """What is rendered, and its light."""

    geometry_planes: Tensor
    shading_planes: Tensor
    relief: Tensor
    shown: Looks
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


def _decode(subject: _Subject, rays: _Rays) -> tuple[Tensor, Tensor, Tensor, ToPosed]:
    """Weights (B, R, S) and canonical points (B, R * S, 3) of samples, what the source shows of
    them, and what turns normals there."""
    points = volume.along(rays.origins, rays.directions, rays.distances).flatten(1, 2)
    to_posed: ToPosed = _unturned
    if subject.deformation is not None:
        deformed = subject.deformation(points)
        points = deformed.position
        if subject.turned:
            to_posed = deformed.to_posed
    seen = subject.shown(points)
    geometry = subject.decoders.geometry
    of = Volume(subject.geometry_planes, subject.relief, subject.shown, geometry)
    sigma = density(of, points, seen)
    sigma = sigma.view_as(rays.distances)
    weights = volume.quadrature(sigma, rays.distances, rays.near, rays.far)
    return weights, points, seen, to_posed


def _integrate(subject: _Subject, rays: _Rays) -> _Integrals:
    weights, points, looks, to_posed = _decode(subject, rays)
    features = shading_features(subject.shading_planes, subject.relief, points, looks)
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


def _by_importance(
    subject: _Subject,
    rays: _Rays,
    preset: Preset,
    generator: torch.Generator | None,
    chunk: int | None,
) -> _Rays:
    """Rays with samples where a first pass finds density."""
    near, far = rays.near, rays.far
    coarse = volume.stratified(near, far, preset.coarse_samples, generator)
    rays = rays._replace(distances=coarse)
    weights = torch.cat([_decode(subject, part)[0] for part in rays.split(chunk)], 1)
    weights = volume.widen(weights)
    fine = volume.importance(weights, coarse, near, far, preset.fine_samples, generator)
    return rays._replace(distances=volume.merge(coarse, fine)[0])


def _about(skin: Tensor, rays: _Rays, preset: Preset, generator: torch.Generator | None) -> _Rays:
    """Rays with samples about the skin at distances (B, R), and no longer than hair is thick.

    Those that pass it by are sampled evenly.
    """
    known = skin.isfinite()
    skin = torch.where(known, skin, 0.0)
    near = torch.where(known, rays.near.clamp(min=skin - BEFORE), rays.near)
    far = torch.where(known, rays.far.clamp(max=skin + BEHIND), rays.far)
    far = torch.maximum(near, far)
    first = torch.where(known, (skin - AROUND).clamp(near, far), near)
    last = torch.where(known, (skin + AROUND).clamp(near, far), far)
    close = volume.stratified(first, last, preset.skin_samples, generator)
    more = volume.stratified(near, far, preset.hair_samples, generator)
    distances = volume.merge(more, close)[0]
    return rays._replace(near=near, far=far, distances=distances)


def _unturned(directions: Tensor) -> Tensor:
    return directions


def _check(geometry: Tensor, shading: Tensor, camera_to_world: Tensor, preset: Preset) -> None:
    channels = preset.plane_channels
    for name, planes in (("geometry_planes", geometry), ("shading_planes", shading)):
        if planes.ndim != 5 or planes.shape[:3] != (len(geometry), 3, channels):
            raise ValueError(f"{name} must be (B, 3, {channels}, H, W), got {tuple(planes.shape)}")
    if camera_to_world.shape != (len(geometry), 4, 4):
        raise ValueError(
            f"camera_to_world must be {(len(geometry), 4, 4)}, got {tuple(camera_to_world.shape)}"
        )
