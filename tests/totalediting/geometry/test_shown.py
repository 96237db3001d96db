"""What the source shows of points, and the bust's own depth: against a ball seen everywhere."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry import bust_view, shown
from totalediting.geometry.field import Control, tabulate
from totalediting.geometry.moving_least_squares import mls
from totalediting.geometry.projection import project, unproject
from totalediting.geometry.relief import inside, relief_of, skin_normal
from totalediting.geometry.shown import OFF, SIGHT, Shown, colour_of, on_front, sheet_of
from totalediting.geometry.source import Source
from totalediting.geometry.space import on_planes
from totalediting.light.lightmaps import bake, sample, texel_directions
from totalediting.light.phong import display, undisplay

SIDE, RADIUS, FAR = 96, 0.1, 2.0


def rotation(turn: float) -> Tensor:
    angle = torch.tensor(turn)
    cosine, sine = angle.cos(), angle.sin()
    return torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])


def ball(turn: float) -> Control:
    """A ball of 10 cm, turned by some radians about +Z: what its skin was, and where it is."""
    generator = torch.Generator().manual_seed(0)
    normals = functional.normalize(torch.randn(6000, 3, generator=generator), dim=-1)
    posed = normals @ rotation(turn).T
    return Control(*(a[None] for a in (RADIUS * posed, RADIUS * normals, posed, normals)))


def camera() -> tuple[Tensor, Tensor]:
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    pose[:3, 3] = torch.tensor([0.0, -FAR, 0.0])
    lens = torch.tensor([[800.0, 0, SIDE / 2], [0, 800.0, SIDE / 2], [0, 0, 1]])
    return pose[None], lens[None]


def points_seen() -> tuple[Tensor, Tensor]:
    """(SIDE, SIDE, 3) where pixels show the ball, and whether they do."""
    far = torch.full((1, 1, SIDE, SIDE), FAR)
    x, _, z = unproject(far, *camera())[0].unbind(-1)
    inside = RADIUS**2 - x**2 - z**2
    return torch.stack([x, -inside.clamp_min(0).sqrt(), z], -1), inside > 0


def source(turn: float, light: Tensor | None = None) -> Source:
    """Every point of the ball shows its place at rest, in [0, 1]; the background is white."""
    control = ball(turn)
    place, hit = points_seen()
    painted = (place @ rotation(turn)) * 4 + 0.5  # rows: back to rest
    image = torch.where(hit[..., None], painted, 1.0).movedim(-1, 0)[None]
    maps = torch.ones(1, 5, 3, 16, 32) if light is None else light
    alpha = hit.float()[None, None]
    eye = torch.eye(3)[None]
    return Source(image, alpha, torch.zeros(1, 54), control, *camera(), maps, eye)


def sheet(of: Source) -> shown.Sheet:
    back = of.control.back()
    return sheet_of(of, tabulate(lambda p: mls(p, back), 24, of.image, (1,)))


def sights(of: Source, points: Tensor) -> Tensor:
    aligned = torch.zeros(1, 2, 48, 48)
    return Shown(sheet(of), aligned)(points[None])[0]


def front(*at: tuple[float, float]) -> Tensor:
    """Points of the ball at rest in front of (x, z)."""
    x, z = torch.tensor(at).unbind(-1)
    return torch.stack([x, -(RADIUS**2 - x**2 - z**2).sqrt(), z], -1)


def test_projection_and_its_inverse_agree() -> None:
    depth = 0.5 + torch.rand(1, 1, SIDE, SIDE)
    places, back = project(unproject(depth, *camera()).flatten(1, 2), *camera(), SIDE)
    torch.testing.assert_close(back, depth.flatten(1))
    middle = (2 * torch.arange(SIDE) + 1) / SIDE - 1
    wanted = torch.stack(torch.meshgrid(middle, middle, indexing="xy"), -1).flatten(0, 1)
    torch.testing.assert_close(places[0], wanted, atol=1e-5, rtol=0)


def test_the_bust_is_seen_without_a_mesh() -> None:
    control = ball(0.3)
    view = bust_view.view(control.posed, control.posed_normals, *camera(), SIDE, 64)
    place, hit = points_seen()
    depth = functional.interpolate((FAR + place[..., 1])[None, None], (64, 64), mode="area")
    core = functional.interpolate(hit.float()[None, None], (64, 64), mode="area")
    core = -functional.max_pool2d(-core, 5, 1, 2) > 0.99
    error = (view.depth - depth)[core].abs()
    # Of the nearest of a coarse pixel's discs, and the perspective of 2 m is small.
    assert error.mean() < 0.005 and error.quantile(0.95) < 0.012
    empty = functional.interpolate(hit.float()[None, None], (64, 64), mode="area")
    empty = functional.max_pool2d(empty, 5, 1, 2) == 0
    assert (view.depth[empty] == bust_view.FAR).all()
    normal = functional.interpolate(place.movedim(-1, 0)[None] / RADIUS, (64, 64), mode="area")
    cosine = (view.normal * functional.normalize(normal, dim=1)).sum(1, keepdim=True)
    assert cosine[core].min() > 0.95
    assert (view.facing + normal[:, 1:2])[core].abs().mean() < 0.03


def test_skin_goes_on_a_little_beside_the_bust() -> None:
    control = ball(0.0)
    skin = bust_view.skin_near(control.posed, control.posed_normals, *camera(), SIDE, 32)[0, 0]
    _, hit = points_seen()
    covered = functional.interpolate(hit.float()[None, None], (32, 32), mode="area")[0, 0]
    assert skin[covered > 0.99].isfinite().all() and skin.min() > FAR - 0.11
    beside = functional.max_pool2d(covered[None], 3, 1, 1)[0] > 0
    assert skin[beside].isfinite().all()
    assert skin[0, 0] == torch.inf and (skin == torch.inf).float().mean() > 0.1


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.7])
def test_points_are_looked_up_where_the_source_shows_them(turn: float) -> None:
    points = front((0.0, 0.0), (0.03, 0.02), (-0.03, 0.04), (0.02, -0.05))
    found = sights(source(turn), points)
    colour = (found[:, :3] + 1) / 2
    assert ((colour - 0.5) / 4 - points).abs().max() < 0.006
    # The second half is of the mirror image.
    half = found.shape[1] // 2
    other = (found[:, half : half + 3] + 1) / 2
    seen = found[:, half + SIGHT - 2] > 0.6
    assert seen.any()
    mirrored = points * torch.tensor([-1.0, 1, 1])
    assert ((other - 0.5) / 4 - mirrored)[seen].abs().max() < 0.006


def test_what_the_source_hides_comes_from_the_other_side() -> None:
    """Turned far to one side, the ball shows one flank alone; the other has the former's colour."""
    points = front((0.085, 0.0), (-0.085, 0.0))
    found = sights(source(0.9), points)
    own, half = (found[:, SIGHT - 2] + 1) / 2, found.shape[1] // 2
    hidden = int(own.argmin())
    assert own.min() < 0.1 and own.max() > 0.9
    assert (found[hidden, half + SIGHT - 2] + 1) / 2 > 0.9
    colour = colour_of(found, unlit=False)
    seen_place = points[1 - hidden]
    for k in range(2):
        assert ((colour[k] - 0.5) / 4 - seen_place).abs().max() < 0.01


def test_an_own_look_is_not_blurred_with_the_mirror_image() -> None:
    found = torch.full((1, 2 * SIGHT), -1.0)
    found[:, :3], found[:, SIGHT - 2] = 0.6, 1.0
    found[:, 2 * SIGHT - 2] = 1.0  # as well seen, and black
    torch.testing.assert_close(colour_of(found, False), torch.full((1, 3), 0.8), atol=2e-3, rtol=0)


def test_what_stands_behind_is_hidden() -> None:
    points = front((0.0, 0.0), (0.02, 0.01))
    behind = points * torch.tensor([1.0, -1.0, 1.0])  # on the back of the ball
    found = sights(source(0.0), torch.cat([points, behind]))
    sight = (found[:, SIGHT - 2] + 1) / 2
    assert sight[:2].min() > 0.9 and sight[2:].max() < 0.01
    assert found[2:, SIGHT - 1].min() > 0.95


def test_the_background_is_not_painted_onto_the_rim() -> None:
    """Beside a pixel of the background, all that is looked up is the subject's."""
    points = front(*[(0.1 * r, 0.0) for r in (0.9, 0.95, 0.98, 0.99)])
    found = sights(source(0.0), points)
    covered = found[:, 6] > -0.9
    assert covered[:3].all()
    blue = (found[covered, 2] + 1) / 2  # z = 0 is 0.5 there, the background 1
    assert (blue - 0.5).abs().max() < 0.03


def test_the_sources_light_is_divided_out() -> None:
    """A grey ball in strong light from the side: its unlit colour is even, its colour is not."""
    ramp = (texel_directions(32) @ torch.tensor([0.8, -0.6, 0.0])).clamp_min(0)[..., None] + 0.15
    light = bake(ramp.expand(-1, -1, 3).contiguous(), 16)[None]
    place, hit = points_seen()
    shade = sample(light[:, 0], (place / RADIUS).flatten(0, 1)[None])[0].view(SIDE, SIDE, 3)
    lit = display((0.4 * shade * hit[..., None]).movedim(-1, 0), 0)[None]
    points = front((0.06, 0.0), (0.0, 0.0), (-0.06, 0.0), (0.0, 0.06))
    found = sights(source(0.0, light)._replace(image=lit), points)
    colour, unlit = undisplay((found[:, :3] + 1) / 2), undisplay((found[:, 3:6] + 1) / 2)
    assert colour.max() / colour.min() > 2
    assert (unlit - 0.4).abs().max() < 0.05


def test_hair_is_where_the_source_is_covered_beside_the_bust() -> None:
    """About the silhouette's depth; where the bust hides a point, as on the other side."""
    _, hit = points_seen()
    hair = functional.max_pool2d(hit.float()[None, None], 9, 1, 4)  # a centimetre around
    of = source(0.0)._replace(alpha=hair)
    beside, before, skin = (0.108, -0.03, 0.0), (0.104, -0.13, 0.0), (0.0, -RADIUS, 0.0)
    off = (sights(of, torch.tensor([beside, before, skin]))[:, OFF] + 1) / 2
    assert off[0] > 0.6 and off[1:].max() < 0.01
    bald = (sights(source(0.0), torch.tensor([beside]))[:, OFF] + 1) / 2
    assert bald.max() < 0.05

    # Turned far to one side: what hides behind the ball has the hair of its mirror image.
    of = source(0.9)._replace(alpha=hair)
    angle = torch.linspace(0, 2 * torch.pi, 73)[:-1]
    around = 0.108 * torch.stack([angle.cos(), angle.sin(), 0 * angle], -1)
    hidden = (around @ rotation(0.9).T)[:, 1] > 0.06
    found, none = ((sights(s, around)[hidden, OFF] + 1) / 2 for s in (of, source(0.9)))
    assert found.mean() > 0.02 and found.mean() > 5 * none.mean()


def test_features_follow_the_pixels_and_learn() -> None:
    one = source(0.4)
    aligned = one.image.clone().requires_grad_()
    points = front((0.0, 0.0), (0.02, 0.03))
    found = Shown(sheet(one), aligned)(points[None])[0]
    half = found.shape[1] // 2
    torch.testing.assert_close(found[:, SIGHT:half], (found[:, :3] + 1) / 2, atol=0.01, rtol=0)
    found.sum().backward()
    assert aligned.grad is not None and aligned.grad.any()


def test_the_front_is_that_of_the_bust_at_rest() -> None:
    points = on_front(sheet(source(0.6)), 48)[0]
    x, y, z = points.unbind(-1)
    core = (x**2 + z**2).sqrt() < 0.07
    assert core.sum() > 100
    assert (y + (RADIUS**2 - x**2 - z**2).clamp_min(0).sqrt())[core].abs().mean() < 0.004


def test_the_relief_is_where_the_skin_is() -> None:
    """Front and back of the ball along Y, and nothing beside it."""
    control = ball(0.6)
    relief = relief_of(control.canonical, control.canonical_normals)
    at = torch.tensor([[0.0, 0, 0], [0, -0.095, 0], [0, -0.115, 0], [0, 0.115, 0], [0.15, 0, 0]])
    depth = inside(relief, on_planes(at)[None])[0]
    assert (depth > 0).tolist() == [True, True, False, False, False]


def test_normals_of_the_relief_are_those_of_the_skin() -> None:
    """Front and back, on the skin as well as before and behind it."""
    control = ball(0.6)
    relief = relief_of(control.canonical, control.canonical_normals)
    away = functional.normalize(control.canonical[0], dim=-1)
    away = away[away[:, 1].abs() > 0.4]
    for factor in (0.9, 1.0, 1.05):
        at = on_planes(factor * RADIUS * away[None])
        cosine = (skin_normal(relief, at)[0] * away).sum(-1)
        assert cosine.mean() > 0.99 and cosine.min() > 0.85, factor


def test_all_is_finite_also_without_skin_in_sight() -> None:
    one = source(0.0)
    away = one.control._replace(posed=one.control.posed + 50)
    found = sights(one._replace(control=away), front((0.0, 0.0), (0.05, 0.05)))
    assert found.isfinite().all()
