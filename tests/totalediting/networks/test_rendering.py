"""Rendering of tri-planes against a sphere, super-resolution, background and discriminator.

The sphere is analytic: planes that hold coordinates make a decoder's features the canonical point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry import volume
from totalediting.geometry.field import Control, Field, tabulate
from totalediting.geometry.moving_least_squares import mls
from totalediting.geometry.relief import CHANNELS as RELIEF
from totalediting.geometry.space import BOX_HIGH, BOX_LOW, off_planes, on_planes
from totalediting.light.lightmaps import bake, sample
from totalediting.light.phong import display, undisplay
from totalediting.networks import density as densities
from totalediting.networks import discriminator as adversary
from totalediting.networks.decoders import Decoders, Shading, shown_channels
from totalediting.networks.density import Volume
from totalediting.networks.discriminator import CHANNELS, Discriminator
from totalediting.networks.rendering import Rendering, render
from totalediting.networks.superresolution import Background, SuperResolution, fine_structure, over
from totalediting.presets import PRESETS, Preset

SMALL = replace(
    PRESETS["tiny"],
    name="test",
    image=64,
    neural=32,
    plane_size=32,
    plane_channels=3,
    coarse_samples=64,
    fine_samples=64,
    upsample_channels=8,
)
LEARNT = replace(SMALL, plane_channels=8, neural=16, coarse_samples=8, fine_samples=8)
CENTRE, RADIUS = (0.02, -0.03, 0.01), 0.12
LOW, HIGH = torch.tensor(BOX_LOW), torch.tensor(BOX_HIGH)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def f32(*values: Sequence[float] | Sequence[Sequence[float]]) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)


def nudge(module: nn.Module) -> None:
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=seeded(0))


class Sphere:
    """Decoders of a sphere of `density` within RADIUS of CENTRE, whose edge is `soft` metres."""

    def __init__(self, density: float = 4000.0, soft: float = 1e-4) -> None:
        self.peak, self.soft = density, soft

    def outward(self, points: Tensor) -> Tensor:
        return points - points.new_tensor(CENTRE)

    def geometry(self, features: Tensor, *_: Tensor) -> Tensor:
        inside = (RADIUS - self.outward(off_planes(features)).norm(dim=-1)) / self.soft
        return self.peak * torch.sigmoid(inside)

    def shading(
        self, features: Tensor, to_posed: Any, view: Tensor, lightmaps: Tensor, to_light: Tensor
    ) -> Shading:
        """White and matt; the features hold the direction to the viewer."""
        canonical = functional.normalize(self.outward(off_planes(features[..., :3])), dim=-1)
        normal = to_posed(canonical)
        one = torch.ones_like(normal)
        s_d = sample(lightmaps[:, 0], normal @ to_light.mT)
        w = functional.pad(view, (0, SMALL.features - 3))
        empty = torch.zeros_like(one)
        return Shading(
            s_d, one, normal, canonical, s_d, empty, 0.1 * one, w, one, s_d, one, one[..., None]
        )


def coordinates(batch: int = 1) -> Tensor:
    """Planes (B, 3, 3, 32, 32) whose look-up gives the place itself: each axis is on two planes."""
    planes = torch.zeros(3, 3, 32, 32)
    share = (torch.arange(32) + 0.5) / 32
    for plane, axes in enumerate(volume.PLANE_AXES):
        for axis, vary in zip(axes, ((1, 32), (32, 1)), strict=True):
            planes[plane, axis] = 1.5 * (2 * share - 1).view(vary)
    return planes.expand(batch, -1, -1, -1, -1)


def relief(batch: int = 1) -> Tensor:
    return torch.rand(batch, RELIEF, 48, 48, generator=seeded(5))


def look(points: Tensor) -> Tensor:
    """What a source might show of points: any smooth functions of them, within [-1, 1]."""
    waves = torch.linspace(5, 40, shown_channels(SMALL)) * points.sum(-1, keepdim=True)
    return waves.sin()


def camera(yaw: float = 0.4, distance: float = 1.2, side: int = 32) -> tuple[Tensor, Tensor]:
    """Looks at the origin from in front, `yaw` to the subject's left; nearly the sphere's size."""
    back = torch.tensor([math.sin(yaw), -math.cos(yaw), 0.0])
    up = torch.tensor([0.0, 0.0, 1.0])
    pose = torch.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = torch.linalg.cross(up, back), up, back
    pose[:3, 3] = distance * back
    focal = 2.6 * side
    return pose[None], torch.tensor(
        [[[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]]], dtype=torch.float32
    )


def light(batch: int = 1) -> Tensor:
    return bake(torch.rand(batch, 8, 16, 3, generator=seeded(0)), 16)


def rotation(seed: int = 3, angle: float = 0.3) -> Tensor:
    axis = functional.normalize(torch.randn(3, generator=seeded(seed)), dim=0)
    cross = torch.linalg.cross(axis.expand(3, 3), torch.eye(3), dim=1).mT
    return torch.linalg.matrix_exp(angle * cross)


def picture_of(
    decoders: Any,
    view: tuple[Tensor, Tensor],
    field: Any = None,
    to_light: Tensor | None = None,
    preset: Preset = SMALL,
) -> Rendering:
    planes = coordinates()
    to_light = torch.eye(3)[None] if to_light is None else to_light
    return render(planes, planes, relief(), look, decoders, *view, light(), to_light, field, preset)


def sphere_distances(pose: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Distance along each ray to the sphere (NaN beside it), the closest approach, directions."""
    origins, directions = volume.rays(pose[0], intrinsics[0], 32, 32)
    offset = origins - torch.tensor(CENTRE)
    along = (offset * directions).sum(-1)
    closest = (offset.square().sum(-1) - along.square()).clamp_min(0).sqrt()
    return -along - (RADIUS**2 - closest.square()).sqrt(), closest, directions


def test_coordinate_planes_hold_coordinates() -> None:
    places = 1.9 * torch.rand(1, 99, 3, generator=seeded(0)) - 0.95
    torch.testing.assert_close(volume.triplane(coordinates(), places), places)


def test_the_box_fills_the_planes_which_are_finest_at_the_face() -> None:
    torch.testing.assert_close(on_planes(torch.stack([LOW, HIGH])), f32([-1] * 3, [1] * 3))
    points = torch.lerp(LOW, HIGH, torch.rand(99, 3, generator=seeded(0)))
    torch.testing.assert_close(off_planes(on_planes(points)), points, atol=1e-6, rtol=1e-5)
    texel = on_planes(f32([0, -0.09, 0], [2e-3, -0.088, 2e-3])).diff(dim=0) / 2e-3
    assert (texel > 2 * 2 / 0.6).all()  # twice as fine as planes that are so everywhere
    x = on_planes(f32([0.03, 0, 0], [-0.03, 0, 0]))[:, 0]
    # The mirror image of a picture on them is that of the face.
    torch.testing.assert_close(x[0], -x[1])


def test_a_surface_shows_what_the_source_shows_there() -> None:
    """The decoders see what the source shows of a point, at the point itself."""
    seen = []

    class Painted(Sphere):
        def shading(self, features: Tensor, *rest: Any) -> Shading:
            seen.append(features)
            return super().shading(features, *rest)

    picture_of(Painted(), camera())
    places, _, found = seen[0].split([3, 3, shown_channels(SMALL)], -1)
    inside = (places.abs() < 0.95).all(-1)  # beyond, the coordinates' planes stand still
    expected = look(off_planes(places))
    torch.testing.assert_close(found[inside], expected[inside], atol=1e-3, rtol=1e-3)


def test_an_opaque_sphere_has_its_silhouette_depth_and_normals() -> None:
    view = camera()
    seen = picture_of(Sphere(), view)
    distance, closest, directions = sphere_distances(*view)
    inside, outside = closest < RADIUS - 0.01, closest > RADIUS + 0.01
    assert inside.sum() > 150 and outside.sum() > 150
    opacity = seen.opacity[0, 0]
    assert opacity[inside].min() > 0.999
    assert opacity[outside].max() < 1e-3

    depth = volume.planar_depth(distance, directions, view[0][0])
    error = (seen.depth[0, 0] - depth)[inside].abs()
    assert error.mean() < 1e-3 and error.max() < 5e-3
    assert not seen.depth[0, 0][closest > RADIUS + 0.05].any()

    surface = view[0][0, :3, 3] + distance[..., None] * directions
    normal = (surface - torch.tensor(CENTRE)) / RADIUS
    cosine = (seen.normal[0].movedim(0, -1) * normal).sum(-1)[inside]
    assert cosine.min() > 0.99
    assert (seen.canonical[0].movedim(0, -1) - surface)[inside].norm(dim=-1).max() < 6e-3
    towards = seen.features[0, :3].movedim(0, -1)[inside]
    torch.testing.assert_close(towards, -directions[inside], atol=2e-3, rtol=0)
    lit = sample(light()[0, 0], normal[inside])
    assert (seen.colour[0].movedim(0, -1)[inside] - lit).abs().max() < 0.02


def test_pictures_are_premultiplied_and_weights_add_up() -> None:
    thin = Sphere(density=3.0)
    seen = picture_of(thin, camera())
    assert 0.2 < seen.opacity.max() < 0.6
    torch.testing.assert_close(seen.albedo, seen.opacity.expand(-1, 3, -1, -1))
    torch.testing.assert_close(seen.weights.sum(-1), seen.opacity.flatten(1))
    torch.testing.assert_close(seen.residual_l1, torch.tensor([0.1]))
    middle = seen.weights[:, 16 * 32 + 16, :, None] * seen.points[:, 16 * 32 + 16]
    torch.testing.assert_close(middle.sum(1), seen.canonical[:, :, 16, 16])


def test_samples_find_a_surface_between_coarse_ones() -> None:
    """The first coarse sample inside lies up to a step behind the surface, and its cell half."""
    view = camera()
    preset = replace(SMALL, coarse_samples=8, fine_samples=64)
    seen = picture_of(Sphere(), view, preset=preset)
    distance, closest, directions = sphere_distances(*view)
    depth = volume.planar_depth(distance, directions, view[0][0])
    error = (seen.depth[0, 0] - depth)[closest < RADIUS - 0.02].abs()
    assert error.max() < 6e-3


def test_samples_about_the_skin_find_what_two_passes_find() -> None:
    """Sixteen of them, where the bust is known to a centimetre, are nearer to the surface than
    thirty-two that have to look for it; what no bust is near is sampled as well."""
    view = camera()
    distance, closest, directions = sphere_distances(*view)
    depth = volume.planar_depth(distance, directions, view[0][0])
    near = closest < RADIUS - 0.02
    skin = torch.where(near, depth + 0.01, torch.inf)[None, None]
    planes, eye = coordinates(), torch.eye(3)[None]

    def rendered(skin: Tensor | None, preset: Preset) -> Rendering:
        sphere: Any = Sphere()
        first = planes, planes, relief(), look, sphere, *view, light(), eye, None
        return render(*first, preset, seeded(0), skin)

    few = replace(SMALL, coarse_samples=16, fine_samples=16, skin_samples=10, hair_samples=6)
    about, passes = rendered(skin, few), rendered(None, few)
    assert about.weights.shape[-1] == 16 < passes.weights.shape[-1]
    errors = [(r.depth[0, 0] - depth)[near].abs().mean() for r in (about, passes)]
    assert errors[0] < 0.004 and errors[0] < errors[1]
    assert about.opacity[0, 0][near].min() > 0.99
    assert about.opacity[0, 0][closest > RADIUS + 0.01].max() < 1e-3
    rim = (closest > RADIUS - 0.02) & (closest < RADIUS - 0.008)
    assert about.opacity[0, 0][rim].mean() > 0.9


def moved() -> tuple[Tensor, Tensor]:
    """A rigid motion (R, t) from posed to canonical space."""
    return rotation(), torch.tensor([0.02, -0.01, 0.015])


def rigid_field() -> Any:
    turn, shift = moved()
    canonical = torch.randn(1, 200, 3, generator=seeded(1)) * 0.1
    normals = functional.normalize(torch.randn(1, 200, 3, generator=seeded(2)), dim=-1)
    control = Control((canonical - shift) @ turn, canonical, normals @ turn, normals)
    return tabulate(lambda points: mls(points, control), 5, canonical, (1,))


def test_moving_the_subject_is_moving_the_camera() -> None:
    turn, shift = moved()
    pose, intrinsics = camera()
    canonical_pose = pose.clone()
    canonical_pose[0, :3, :3] = turn @ pose[0, :3, :3]
    canonical_pose[0, :3, 3] = turn @ pose[0, :3, 3] + shift
    soft = Sphere(density=300.0, soft=0.01)
    one = picture_of(soft, (pose, intrinsics), rigid_field())
    other = picture_of(soft, (canonical_pose, intrinsics), None, turn.mT[None])
    for name in ("opacity", "colour", "albedo", "canonical", "depth"):
        gap = (getattr(one, name) - getattr(other, name)).abs()
        hit = (other.opacity > 0.05).expand_as(gap)
        assert gap[hit].max() < 5e-3, name
    gap = one.normal - torch.einsum("ji,bjhw->bihw", turn, other.normal)
    assert gap.abs().max() < 5e-3


def test_rotation_none_leaves_normals_canonical_and_nothing_else() -> None:
    turn, _ = moved()
    plain = picture_of(Sphere(), camera(), rigid_field())
    seen = picture_of(Sphere(), camera(), rigid_field(), preset=replace(SMALL, rotation="none"))
    expected = torch.einsum("ij,bjhw->bihw", turn, plain.normal)
    torch.testing.assert_close(seen.normal, expected, atol=1e-4, rtol=0)
    for name in ("opacity", "depth", "albedo", "canonical", "canonical_normals", "weights"):
        assert torch.equal(getattr(seen, name), getattr(plain, name)), name


def test_the_identity_field_is_no_field() -> None:
    def identity(points: Tensor) -> Field:
        quaternion = torch.tensor([1.0, 0, 0, 0]).expand(*points.shape[:-1], 4)
        return Field(points, quaternion)

    for a, b in zip(
        picture_of(Sphere(), camera(), identity), picture_of(Sphere(), camera()), strict=True
    ):
        torch.testing.assert_close(a, b)


def learnt(batch: int = 2, **changes: Any) -> dict[str, Any]:
    """Arguments of `render` with real decoders and random planes."""
    preset = replace(LEARNT, **changes)
    torch.manual_seed(0)
    shape = (batch, 3, preset.plane_channels, preset.plane_size, preset.plane_size)
    pose, intrinsics = camera(side=16)
    return {
        "geometry_planes": (2.0 * torch.randn(shape)).requires_grad_(),
        "shading_planes": torch.randn(shape).requires_grad_(),
        "relief": relief(batch),
        "shown": look,
        "decoders": Decoders(preset),
        "camera_to_world": pose.expand(batch, -1, -1),
        "intrinsics": intrinsics.expand(batch, -1, -1),
        "lightmaps": light(batch).requires_grad_(),
        "to_light": rotation(4).expand(batch, -1, -1),
        "deformation": None,
        "preset": preset,
    }


def backward(seen: Rendering) -> None:
    pictures = [seen.colour, seen.normal, seen.features, seen.depth]
    torch.stack([p.square().mean() for p in pictures]).sum().backward()


def test_what_is_between_front_and_back_of_the_skin_is_full() -> None:
    """A fresh volume over a slab of skin, 6 cm thick, that covers the planes."""
    given = learnt()
    front, back = on_planes(f32([0, -0.04, 0], [0, 0.02, 0]))[:, 1]
    given["relief"][:, 0], given["relief"][:, 1] = front, back
    at = f32([0, -0.06, 0], [0, -0.035, 0], [0, 0.01, 0], [0, 0.04, 0]).expand(2, -1, -1)
    planes, geometry = given["geometry_planes"] * 0, given["decoders"].geometry
    volume_ = Volume(planes, given["relief"], lambda points: 0 * look(points), geometry)
    before, within, end, behind = densities.density(volume_, at)[0].tolist()
    assert min(within, end) > 100 > 10 > max(before, behind)
    facing = densities.density_normals(volume_, f32([[0.0, -0.04, 0.0]]).expand(2, -1, -1))
    torch.testing.assert_close(facing, f32([[0.0, -1.0, 0.0]]).expand(2, -1, -1))


def test_gradients_reach_planes_decoders_and_light() -> None:
    given = learnt()
    seen = render(**given)
    backward(seen)
    for name in ("geometry_planes", "shading_planes", "lightmaps"):
        assert given[name].grad.isfinite().all() and given[name].grad.any(), name
    late = {"shading.residual.0.weight", "shading.residual.0.bias"}  # behind zeros, at first
    for name, parameter in given["decoders"].named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), name
        assert parameter.grad.any() or name in late, name


@pytest.mark.parametrize("seed", [None, 7])
def test_chunks_change_neither_pictures_nor_gradients(seed: int | None) -> None:
    results = []
    for chunk in (None, 100):
        given = learnt()
        generator = None if seed is None else seeded(seed)
        seen = render(**given, generator=generator, chunk=chunk)
        backward(seen)
        results.append((seen, given))
    (one, given), (other, chunked) = results
    for name, a, b in zip(Rendering._fields, one, other, strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4, msg=lambda m, n=name: f"{n}: {m}")
    for name in ("geometry_planes", "shading_planes", "lightmaps"):
        torch.testing.assert_close(given[name].grad, chunked[name].grad, atol=1e-6, rtol=1e-3)


def test_the_generator_decides() -> None:
    given = learnt()
    with torch.no_grad():
        plain, again = render(**given), render(**given)
        one, same, other = (render(**given, generator=seeded(s)) for s in (0, 0, 1))
    assert all(torch.equal(a, b) for a, b in zip(plain, again, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(one, same, strict=True))
    assert not torch.equal(one.colour, other.colour)
    assert not torch.equal(one.colour, plain.colour)


def test_the_penalty_on_residuals_does_not_clear_the_volume() -> None:
    given = learnt()
    nudge(given["decoders"])
    seen = render(**given)
    assert (seen.residual_l1 > 0).all()
    seen.residual_l1.sum().backward()
    assert given["geometry_planes"].grad is None
    assert given["decoders"].shading.residual[0].weight.grad.any()


def test_light_is_linear_up_to_the_picture() -> None:
    given = learnt()
    with torch.no_grad():
        once = render(**given)
        twice = render(**(given | {"lightmaps": 2.0 * given["lightmaps"]}))
    assert not once.residual.any()
    torch.testing.assert_close(twice.colour, 2.0 * once.colour)
    torch.testing.assert_close(once.colour, once.diffuse + once.specular + once.residual)
    for name in ("albedo", "normal", "opacity", "depth", "features"):
        assert torch.equal(getattr(once, name), getattr(twice, name)), name


def test_the_plain_decoder_renders_the_same_in_any_light() -> None:
    given = learnt(decoder="plain")
    once = render(**given)
    twice = render(**(given | {"lightmaps": 2.0 * given["lightmaps"]}))
    assert torch.equal(once.colour, twice.colour)
    assert once.colour.any() and not once.diffuse.any()


def test_nothing_is_seen_of_a_box_behind_the_camera() -> None:
    given = learnt()
    pose = given["camera_to_world"].clone()
    pose[:, :3, :2], pose[:, :3, 2] = -pose[:, :3, :2], -pose[:, :3, 2]
    pose[:, :3, 1] *= -1
    seen = render(**(given | {"camera_to_world": pose}))
    assert not any(picture.any() for picture in seen[:10])
    assert not seen.residual_l1.any()
    backward(seen)
    assert given["geometry_planes"].grad.isfinite().all()


def test_autocast_does_not_round_the_volume() -> None:
    given = learnt()
    with torch.no_grad():
        exact = render(**given)
        with torch.autocast("cpu", torch.bfloat16):
            seen = render(**given)
    assert all(torch.equal(a, b) for a, b in zip(exact, seen, strict=True))
    planes, geometry = given["geometry_planes"], given["decoders"].geometry
    points = torch.lerp(LOW, HIGH, torch.rand(2, 30, 3, generator=seeded(0)))
    volume_ = Volume(planes, given["relief"], lambda points: 0 * look(points), geometry)
    normals = densities.density_normals(volume_, points)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(densities.density_normals(volume_, points), normals)


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_presets_render(preset: Preset) -> None:
    """Of the sizes of the preset, on a picture of 4 x 4."""
    given = learnt(1, **{n: getattr(preset, n) for n in ("plane_channels", "hidden", "features")})
    given["preset"] = replace(
        preset, neural=4, plane_size=given["preset"].plane_size, image=preset.image
    )
    seen = render(**given)
    samples = preset.coarse_samples + preset.fine_samples
    assert seen.features.shape == (1, preset.features, 4, 4)
    assert seen.weights.shape == (1, 16, samples)
    assert seen.points.shape == seen.canonical_normals.shape == (1, 16, samples, 3)
    three = ("colour", "albedo", "normal", "diffuse", "specular", "residual", "canonical")
    assert all(getattr(seen, name).shape == (1, 3, 4, 4) for name in three)
    assert seen.opacity.shape == seen.depth.shape == (1, 1, 4, 4)


def test_wrong_arguments_of_render_are_named() -> None:
    given = learnt()
    for name in ("geometry_planes", "shading_planes", "camera_to_world", "lightmaps", "to_light"):
        with pytest.raises(ValueError, match=name):
            render(**(given | {name: given[name][0]}))
    with pytest.raises(ValueError, match="chunk"):
        render(**given, chunk=0)


def test_density_normals_point_out_of_the_sphere() -> None:
    away = functional.normalize(torch.randn(1, 60, 3, generator=seeded(0)), dim=-1)
    points = torch.tensor(CENTRE) + RADIUS * away
    sphere = Sphere(density=300.0, soft=0.01)
    found = densities.density_normals(
        Volume(coordinates(), relief(), look, sphere.geometry), points
    )
    torch.testing.assert_close(found, away, atol=1e-3, rtol=0)
    even = lambda p, *_: 0.0 * p[..., 0] + 5.0  # noqa: E731
    flat = densities.density_normals(Volume(coordinates(), relief(), look, even), points)
    assert not flat.any()


def test_density_normals_train_planes_and_decoder() -> None:
    given = learnt()
    planes, geometry = given["geometry_planes"], given["decoders"].geometry
    points = torch.lerp(LOW, HIGH, torch.rand(2, 30, 3))
    found = densities.density_normals(Volume(planes, given["relief"], look, geometry), points)
    assert found.shape == (2, 30, 3)
    assert found.norm(dim=-1).max() < 1 + 1e-5
    found[..., 1].sum().backward()
    assert planes.grad.any() and planes.grad.isfinite().all()
    assert geometry.net[0].weight.grad.any()
    with pytest.raises(ValueError, match="points"):
        densities.density_normals(Volume(planes, given["relief"], look, geometry), points[0])


def test_density_jitter_measures_variation() -> None:
    slope = lambda p, *_: 100.0 * (off_planes(p)[..., 0] + 0.3)  # noqa: E731
    at, beside = densities.density_jitter(
        Volume(coordinates(2), relief(2), look, slope), 4000, seeded(0)
    )
    assert at.shape == beside.shape == (2, 4000)
    expected = 100.0 * densities.JITTER * math.sqrt(2 / math.pi)  # mean |normal|
    inside = (at - 30).abs() < 25  # at the ends, planes stand still
    assert abs((at - beside).abs()[inside].mean() / expected - 1) < 0.05
    assert abs(at.mean() / 30.0 - 1) < 0.05, "points fill the box"
    again = densities.density_jitter(
        Volume(coordinates(2), relief(2), look, slope), 4000, seeded(0)
    )
    assert torch.equal(again[1], beside)


# What follows the volume.


def all_have_gradients(module: nn.Module) -> None:
    for name, parameter in module.named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), name
        assert parameter.grad.any(), name


def test_fine_structure_is_that_of_the_shaded_surface() -> None:
    """Stripes finer than a rendered pixel: on the surface, and nowhere else; none without them."""
    size, scale = 64, 2
    stripes = torch.where(torch.arange(size) % 2 < 1, 0.7, 0.3).expand(1, 3, size, size)
    opacity = (torch.arange(size) < 32).float().expand(1, 1, size, size)
    found = fine_structure(stripes, opacity, scale)
    assert torch.equal(found[..., 32:], torch.ones_like(found[..., 32:]))
    seen, shown = found[0, 0, 10, 4:28], stripes[0, 0, 10, 4:28]
    assert seen.max() > 1.2 and seen.min() < 0.8
    assert torch.corrcoef(torch.stack([seen, shown]))[0, 1] > 0.8
    plain = fine_structure(0 * stripes + 0.4, opacity, scale)
    torch.testing.assert_close(plain, torch.ones_like(plain))


@pytest.mark.parametrize("image", [32, 64, 128])
def test_fresh_super_resolution_is_bilinear(image: int) -> None:
    preset = replace(SMALL, image=image)
    network = SuperResolution(preset)
    raw = torch.rand(2, 3, 32, 32, generator=seeded(0))
    w = torch.randn(2, preset.features, 32, 32, generator=seeded(1))
    seen = network(raw, w)
    plain = raw
    for _ in range((image // 32).bit_length() - 1):
        plain = functional.interpolate(plain, scale_factor=2, mode="bilinear")
    torch.testing.assert_close(seen, plain, atol=1e-6, rtol=0)
    nudge(network)
    network(raw, w).square().mean().backward()
    all_have_gradients(network)


def test_super_resolution_is_clamped_in_evaluation_only() -> None:
    network = SuperResolution(SMALL)
    raw, w = torch.full((1, 3, 32, 32), 1.4), torch.zeros(1, SMALL.features, 32, 32)
    torch.testing.assert_close(network(raw, w).max(), torch.tensor(1.4))
    assert network.eval()(raw, w).max() == 1.0


def test_super_resolution_refuses_other_sizes() -> None:
    with pytest.raises(ValueError, match="fourfold"):
        SuperResolution(replace(SMALL, image=256))
    with pytest.raises(ValueError, match="doubled"):
        SuperResolution(replace(SMALL, image=96))
    network = SuperResolution(SMALL)
    with pytest.raises(ValueError, match="features"):
        network(torch.rand(1, 3, 16, 16), torch.rand(1, SMALL.features, 32, 32))
    with pytest.raises(ValueError, match="raw"):
        network(torch.rand(1, 4, 32, 32), torch.rand(1, SMALL.features, 32, 32))
    with pytest.raises(ValueError, match="features"):
        network(torch.rand(1, 3, 32, 32), torch.rand(1, 5, 32, 32))


def test_background_is_a_picture_and_features() -> None:
    network = Background(SMALL)
    image = torch.rand(2, 3, 64, 64, generator=seeded(0))
    found = network(image)
    assert found.shape == (2, 3 + SMALL.features, 32, 32)
    assert found[:, :3].min() > 0 and found[:, :3].max() < 1
    found.square().mean().backward()
    all_have_gradients(network)
    with pytest.raises(ValueError, match="image"):
        network(image[..., 1:])


def test_background_sees_past_a_head() -> None:
    network = Background(SMALL)
    image = torch.rand(1, 3, 64, 64, requires_grad=True)
    network(image)[0, :, 16, 16].sum().backward()
    assert image.grad is not None
    assert image.grad[0, :, 5, 5].any(), "the centre depends on what is near a corner"


def test_over_shows_the_background_where_the_subject_is_not() -> None:
    colour, w = torch.rand(2, 3, 8, 8), torch.rand(2, 5, 8, 8)
    behind = 0.1 + 0.5 * torch.rand(2, 1, 8, 8).expand(-1, 8, -1, -1)
    for linear in (False, True):
        light = undisplay(colour, 1) if linear else colour
        solid = over(light, w, torch.ones(2, 1, 8, 8), behind, linear)
        shown = display(light, 1) if linear else colour
        torch.testing.assert_close(solid[0], shown)
        assert torch.equal(solid[1], w)
        empty = over(0 * light, 0 * w, torch.zeros(2, 1, 8, 8), behind, linear)
        torch.testing.assert_close(torch.cat(empty, 1), behind, atol=1e-4, rtol=1e-3)
    half = over(0.5 * colour, 0.5 * w, torch.full((2, 1, 8, 8), 0.5), behind, False)
    torch.testing.assert_close(torch.cat(half, 1), 0.5 * (torch.cat([colour, w], 1) + behind))
    with pytest.raises(ValueError, match="background"):
        over(colour, w, torch.ones(2, 1, 8, 8), behind[:, 1:], True)


def test_light_adds_up_before_it_is_shown() -> None:
    """A rim, half covered: D(a c + (1 - a) b) as in the data, not D(a c) + (1 - a) b."""
    light, behind = torch.full((1, 3, 1, 1), 0.8), torch.full((1, 3, 1, 1), 0.6)
    a, none = torch.full((1, 1, 1, 1), 0.5), torch.zeros(1, 0, 1, 1)
    raw, _ = over(0.5 * light, none, a, behind, True)
    torch.testing.assert_close(raw, display(0.5 * light + 0.5 * undisplay(behind, 1), 1))
    halo = display(0.5 * light, 1) + 0.5 * behind - raw
    assert halo.min() > 0.04


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_presets_of_what_follows(preset: Preset) -> None:
    side, h = preset.image, preset.neural
    with torch.device("meta"):
        raw, w = torch.zeros(2, 3, h, h), torch.zeros(2, preset.features, h, h)
        picture = SuperResolution(preset)(raw, w)
        assert picture.shape == (2, 3, side, side)
        assert Background(preset)(picture).shape == (2, 3 + preset.features, h, h)
        stacked = adversary.stack(picture, raw, raw, raw[:, :1])
        assert Discriminator(preset)(stacked, torch.zeros(2, 16)).shape == (2,)


def judged(batch: int = 4) -> tuple[Discriminator, Tensor, Tensor]:
    torch.manual_seed(0)
    network = Discriminator(SMALL)
    shown = torch.randn(batch, CHANNELS, 64, 64, generator=seeded(0))
    return network, shown, torch.randn(batch, 16, generator=seeded(1))


def test_the_discriminator_depends_on_picture_and_camera() -> None:
    network, shown, cameras = judged()
    logits = network(shown, cameras)
    assert logits.shape == (4,) and logits.isfinite().all()
    assert not torch.allclose(network(shown, cameras.flip(0)), logits)
    for channel in range(CHANNELS):
        other = shown.clone()
        other[:, channel] = 0
        assert not torch.allclose(network(other, cameras), logits, atol=1e-7), channel
    loss = adversary.discriminator_loss(logits, network(shown.flip(0), cameras))
    loss.backward()
    all_have_gradients(network)
    with pytest.raises(ValueError, match="pictures"):
        network(shown[:, 1:], cameras)
    with pytest.raises(ValueError, match="camera"):
        network(shown, cameras[:, 1:])


def test_minibatch_deviation_sees_equal_pictures() -> None:
    network, shown, cameras = judged()
    alone = network(shown[:1], cameras[:1])
    equal = network(shown[:1].expand(4, -1, -1, -1), cameras[:1].expand(4, -1))
    torch.testing.assert_close(equal, alone.expand(4))
    assert not torch.allclose(network(shown, cameras)[:1], alone)
    # Of eight, every other one makes a group: those that are equal stay as if alone.
    mixed = torch.stack([shown[:1].expand_as(shown), shown], 1).flatten(0, 1)
    torch.testing.assert_close(network(mixed, cameras[:1].expand(8, -1))[::2], alone.expand(4))


def test_r1_is_the_squared_gradient() -> None:
    class Linear(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.weight = nn.Parameter(torch.full((10, 1, 1), 0.5))

        def forward(self, pictures: Tensor, camera: Tensor) -> Tensor:
            return (pictures * self.weight).sum((1, 2, 3))

    _, shown, cameras = judged()
    linear: Any = Linear()
    penalty = adversary.r1_penalty(linear, shown, cameras)
    torch.testing.assert_close(penalty, torch.tensor(10 * 64 * 64 * 0.25))
    penalty.backward()
    torch.testing.assert_close(linear.weight.grad, torch.full((10, 1, 1), 64.0 * 64.0))

    network, shown, cameras = judged()
    adversary.r1_penalty(network, shown, cameras).backward()
    first = next(network.parameters()).grad
    assert first is not None and first.any()


def test_losses_at_known_logits() -> None:
    zero, far = torch.zeros(3), torch.full((3,), 50.0)
    assert adversary.generator_loss(zero).item() == pytest.approx(math.log(2))
    assert adversary.generator_loss(far).item() == pytest.approx(0, abs=1e-6)
    assert adversary.generator_loss(-far).item() == pytest.approx(50)
    assert adversary.discriminator_loss(far, -far).item() == pytest.approx(0, abs=1e-6)
    assert adversary.discriminator_loss(zero, zero).item() == pytest.approx(2 * math.log(2))


def test_what_the_discriminator_is_shown() -> None:
    picture, raw = torch.ones(1, 3, 8, 8), torch.zeros(1, 3, 4, 4)
    canonical = torch.full((1, 3, 4, 4), adversary.EXTENT)
    stacked = adversary.stack(picture, raw, canonical, torch.full((1, 1, 4, 4), 0.5))
    expected = torch.tensor([1.0] * 3 + [-1.0] * 3 + [1.0] * 3 + [0.5])
    torch.testing.assert_close(stacked, expected[:, None, None].expand(1, -1, 8, 8))
    with pytest.raises(ValueError, match="opacity"):
        adversary.stack(picture, raw, canonical, torch.zeros(1, 1, 8, 8))

    pose, intrinsics = camera(side=32)
    code = adversary.camera_code(pose, intrinsics, 32)
    torch.testing.assert_close(code[0, :12].view(3, 4), pose[0, :3])
    torch.testing.assert_close(code[0, 12:], torch.tensor([2.6, 2.6, 0.5, 0.5]))
    torch.testing.assert_close(adversary.camera_code(*camera(side=64), 64), code)
    with pytest.raises(ValueError, match="intrinsics"):
        adversary.camera_code(pose, intrinsics[0], 32)
