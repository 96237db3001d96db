"""Volume rendering: rays, boxes, tri-planes, samples and integrals against closed forms."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from assets_procedural.conventions.camera import Camera, CameraSample, resolve
from totalediting.geometry import volume


def f64(*values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


HEAD = f64(0.01, -0.05, 0.7)
LOW, HIGH = HEAD - f64(0.15, 0.2, 0.18), HEAD + f64(0.15, 0.16, 0.2)


def on_planes(points: Tensor) -> Tensor:
    """The box from LOW to HIGH on [-1, 1]."""
    return 2 * (points - LOW.to(points)) / (HIGH - LOW).to(points) - 1


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=seeded(seed), dtype=torch.float64)


def tilted_camera(yaw: float = 0.5) -> Camera:
    """Rolled and shifted, neither square nor centred, with unequal focal lengths: 24 x 16."""
    sample = CameraSample(yaw=yaw, pitch=0.3, roll=0.7, shift=(0.1, -0.05))
    pose = resolve(sample, HEAD.numpy(), 0.25, 16).camera_to_world
    return Camera(pose, np.array([[38.0, 0, 11], [0, 41, 9], [0, 0, 1]]), 24, 16)


def rays_of(camera: Camera) -> tuple[Tensor, Tensor]:
    pose, intrinsics = torch.tensor(camera.camera_to_world), torch.tensor(camera.intrinsics)
    return volume.rays(pose, intrinsics, camera.height, camera.width)


def render(planes: Tensor, pose: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """All of it, without randomness: colours (B, H, W, C), opacity and depth (B, H, W)."""
    low, high = LOW.to(planes), HIGH.to(planes)
    origins, directions = volume.rays(pose, intrinsics, 16, 24)
    near, far, _ = volume.box_interval(origins, directions, low, high)

    def look_up(t: Tensor) -> tuple[Tensor, Tensor]:
        points = volume.along(origins, directions, t)
        found = volume.triplane(planes, on_planes(points).flatten(1, -2)).view(*t.shape, -1)
        return 30.0 * found[..., 0], found[..., 1:]

    t = volume.stratified(near, far, 12)
    weights = volume.quadrature(look_up(t)[0], t, near, far)
    t, _ = volume.merge(t, volume.importance(volume.widen(weights), t, near, far, 12))
    density, colours = look_up(t)
    weights = volume.quadrature(density, t, near, far)
    depth = volume.planar_depth(volume.expected_distance(weights, t), directions, pose)
    return volume.composite(weights, colours), volume.opacity(weights), depth


def scene() -> tuple[Tensor, Tensor, Tensor]:
    cameras = [tilted_camera(), tilted_camera(-0.8)]
    poses = torch.tensor(np.stack([c.camera_to_world for c in cameras]))
    return random(2, 3, 5, 8, 8), poses, torch.tensor(np.stack([c.intrinsics for c in cameras]))


def test_rays_and_planar_depth_are_those_of_the_camera() -> None:
    camera = tilted_camera()
    depth = 0.5 + random(16, 24).numpy()
    points = torch.tensor(camera.unproject(camera.pixel_centres(), depth))
    origins, directions = rays_of(camera)
    assert origins.shape == (1, 1, 3)
    distance = torch.linalg.norm(points - origins, dim=-1)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(16, 24).double())
    reached = volume.along(origins, directions, distance[..., None])[..., 0, :]
    torch.testing.assert_close(reached, points)
    planar = volume.planar_depth(distance, directions, torch.tensor(camera.camera_to_world))
    torch.testing.assert_close(planar, torch.tensor(depth))


def test_resized_intrinsics_see_the_same() -> None:
    camera = tilted_camera()
    resized = volume.resize_intrinsics(torch.tensor(camera.intrinsics), (16, 24), (4, 8))
    origins, directions = volume.rays(torch.tensor(camera.camera_to_world), resized, 4, 8)
    # Pixel (2, 5) of 4 x 8 has its centre at (16.5, 10) in 16 x 24.
    point = torch.tensor(camera.unproject(np.array([16.5, 10.0]), np.array(1.0)))
    toward = torch.nn.functional.normalize(point - origins[0, 0], dim=-1)
    torch.testing.assert_close(directions[2, 5], toward)


def test_box_interval_agrees_with_marching() -> None:
    origins = HEAD + 1.2 * (random(300, 3, seed=1) - 0.5)
    directions = HEAD - origins + 0.7 * (random(300, 3, seed=2) - 0.5)
    # A fifth is parallel to faces, both ways; a tenth begins inside.
    directions[:60] = torch.eye(3).repeat(20, 1) * f64(1, -1).repeat(30)[:, None]
    origins[:30] = LOW + (HIGH - LOW) * random(30, 3, seed=3)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    near, far, hit = volume.box_interval(origins, directions, LOW, HIGH)
    step = 5e-4
    t = torch.arange(0.0, 2.0, step, dtype=torch.float64).expand(300, -1)
    points = volume.along(origins, directions, t)
    inside = ((points >= LOW) & (points <= HIGH)).all(-1)
    seen = inside.any(-1)
    assert 100 < seen.sum() < 250
    assert hit[seen].all() and ((far - near)[~seen] <= step).all()
    first = torch.where(inside, t, math.inf).amin(-1)
    last = torch.where(inside, t, -math.inf).amax(-1)
    assert ((first - near)[seen] >= 0).all() and ((first - near)[seen] <= step).all()
    assert ((far - last)[seen] >= 0).all() and ((far - last)[seen] <= step).all()
    assert (near[:30] == 0).all() and not near[~hit].any() and not far[~hit].any()


def test_missed_rays_are_empty_and_finite() -> None:
    low, high = torch.zeros(3), torch.ones(3)
    origins = torch.tensor([[2.0, 0.5, 0.5], [0.5, 2.0, 0.5], [0.0, 0.5, 3.0]])
    directions = torch.tensor([[1.0, 0, 0], [1.0, 0, 0], [-0.0, 0, 1.0]]).requires_grad_()
    near, far, hit = volume.box_interval(origins, directions, low, high)
    t = volume.stratified(near, far, 4)
    t = volume.merge(t, volume.importance(torch.zeros(3, 4), t, near, far, 4))[0]
    weights = volume.quadrature(torch.full((3, 8), 1e5), t, near, far)
    seen = volume.expected_distance(weights, t) + volume.opacity(weights)
    seen.sum().backward()
    assert not hit.any() and not seen.any()
    assert directions.grad is not None and directions.grad.isfinite().all()


def test_triplane_agrees_with_its_reference() -> None:
    planes = random(2, 3, 4, 5, 7) - 0.5
    # Half of the points are outside.
    places = random(2, 500, 3) * 3 - 1.5
    expected = volume.triplane_reference(planes, places)
    torch.testing.assert_close(volume.triplane(planes, places), expected)


def test_triplane_is_exact_on_linear_functions() -> None:
    rows, columns = 6, 9
    factors = f64([1, 2, -3], [-0.5, 4, 1], [2, 0.3, 5])
    across = (torch.arange(columns).double() + 0.5) / columns
    down = (torch.arange(rows).double() + 0.5) / rows
    planes = torch.stack([a + b * across + c * down[:, None] for a, b, c in factors])
    share = random(1, 200, 3) * 1.4 - 0.2

    def value(k: int, u: Tensor, v: Tensor) -> Tensor:
        # Constant beyond the outermost texel centres.
        u, v = u.clamp(across[0], across[-1]), v.clamp(down[0], down[-1])
        return factors[k, 0] + factors[k, 1] * u + factors[k, 2] * v

    x, y, z = share[0].unbind(-1)
    expected = (value(0, x, y) + value(1, x, z) + value(2, y, z)) / 3
    found = volume.triplane(planes[None, :, None], 2 * share - 1)
    torch.testing.assert_close(found[0, :, 0], expected)


@pytest.mark.parametrize(("plane", "across", "down"), [(0, 0, 1), (1, 0, 2), (2, 1, 2)])
def test_orientation_of_planes(plane: int, across: int, down: int) -> None:
    planes = torch.zeros(1, 3, 1, 4, 4, dtype=torch.float64)
    planes[0, plane, 0, 3, 1] = 3.0
    share = random(1, 20, 3)
    share[..., across], share[..., down] = 1.5 / 4, 3.5 / 4
    found = volume.triplane(planes, 2 * share - 1)
    torch.testing.assert_close(found, torch.ones_like(found))
    assert (volume.triplane(planes, torch.ones(1, 1, 3).double()) == 0).all()


def test_stratified_fills_its_bins() -> None:
    near, far = f64(1, 0), f64(3, 0.5)
    expected = f64([1.25, 1.75, 2.25, 2.75], [0.0625, 0.1875, 0.3125, 0.4375])
    torch.testing.assert_close(volume.stratified(near, far, 4), expected)
    jittered = volume.stratified(near.expand(5000, 2), far.expand(5000, 2), 4, seeded(0))
    place = (jittered - near[:, None]) / (far - near)[:, None] * 4 - torch.arange(4)
    assert ((place >= 0) & (place <= 1)).all()
    np.testing.assert_allclose(place.mean((0, 1)), 0.5, atol=0.015)
    np.testing.assert_allclose(place.std((0, 1)), math.sqrt(1 / 12), atol=0.01)


@pytest.mark.parametrize("jitter", [False, True])
def test_importance_inverts_the_distribution(jitter: bool) -> None:
    t, weights, count = f64([1.1, 1.2, 1.6, 2.0, 2.9]), f64([0, 0.3, 0.1, 0, 0.2]), 6000
    generator = seeded(4) if jitter else None
    drawn = volume.importance(weights, t, f64(1), f64(3), count, generator)[0]
    edges = [1, 1.15, 1.4, 1.8, 2.45, 3]
    distribution = np.cumsum([0, 0, 0.3, 0.1, 0, 0.2]) / 0.6
    # One draw in each stratum of the distribution, uniform within it; so none where it is flat.
    place = np.interp(drawn, edges, distribution) * count - np.arange(count)
    if jitter:
        assert place.min() >= -1e-6 and place.max() <= 1 + 1e-6
        assert place.mean() == pytest.approx(0.5, abs=0.02)
        assert place.std() == pytest.approx(math.sqrt(1 / 12), abs=0.01)
    else:
        np.testing.assert_allclose(place, 0.5, atol=1e-6)


def test_importance_without_weights_is_uniform_and_has_no_gradient() -> None:
    t = f64([0.1, 0.2, 1.5]).requires_grad_()
    drawn = volume.importance(0.0 * t, t, f64(0), f64(2), 8)
    torch.testing.assert_close(drawn, volume.stratified(f64(0), f64(2), 8))
    assert not drawn.requires_grad


def test_widen_reaches_the_neighbours() -> None:
    spread = volume.widen(torch.tensor([0.0, 0, 0.8, 0, 0.2]))
    torch.testing.assert_close(spread, torch.tensor([0.0, 0.4, 0.8, 0.5, 0.2]))


def test_merge_sorts_and_tells_the_order() -> None:
    coarse, fine = random(4, 5, seed=1).sort().values, random(4, 3, seed=2).sort().values
    merged, order = volume.merge(coarse, fine)
    both = torch.cat([coarse, fine], -1)
    assert (merged.diff() > 0).all()
    torch.testing.assert_close(torch.take_along_dim(both, order, -1), merged)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_opacity_of_a_constant_slab_is_exact(dtype: torch.dtype) -> None:
    near, far = 1.0 + random(50).to(dtype), 2.5 + random(50, seed=1).to(dtype)
    weights = random(50, 7).to(dtype)
    coarse = volume.stratified(near, far, 7, seeded(2))
    merged, _ = volume.merge(coarse, volume.importance(weights, coarse, near, far, 9, seeded(3)))
    for t in (volume.stratified(near, far, 7), coarse, merged, merged[:, :1]):
        for density in (1e-4, 0.7, 20.0):
            found = volume.opacity(volume.quadrature(torch.full_like(t, density), t, near, far))
            exact = -torch.expm1(-density * (far - near))
            # In relative terms, however thin the slab.
            torch.testing.assert_close(found, exact, rtol=20 * torch.finfo(dtype).eps, atol=0)


@pytest.mark.parametrize("count", [10, 40, 160])
def test_expected_distance_in_a_slab_converges(count: int) -> None:
    near, far, density = f64(1), f64(3), 2.0
    t = volume.stratified(near, far, count)
    weights = volume.quadrature(torch.full_like(t, density), t, near, far)
    gone = math.exp(-density * 2.0)
    expected = 1.0 + 1.0 / density - 2.0 * gone / (1.0 - gone)
    # Within a cell of length d, light stops d² σ / 12 before the middle.
    error = abs(volume.expected_distance(weights, t).item() - expected)
    assert error < 1.1 * density / 12 * (2.0 / count) ** 2


@pytest.mark.parametrize("count", [30, 300, 3000])
def test_two_slabs_converge(count: int) -> None:
    near, far = f64(1).expand(20), f64(3).expand(20)
    t = volume.stratified(near, far, count, seeded(0))
    density = 2.0 * (t < 1.5) + 5.0 * ((t > 1.7) & (t < 2.2))
    weights = volume.quadrature(density, t, near, far)
    thin, through = math.exp(-2.0 * 0.5), math.exp(-2.0 * 0.5 - 5.0 * 0.5)
    moment = (1.0 - thin) * (1.0 + 1 / 2) - 0.5 * thin  # of t over the first slab
    moment += thin * 1.7 + (thin - through) / 5.0 - through * 2.2  # and the second
    spacing = 2.0 / count
    opacity, expected = 1.0 - through, moment / (1.0 - through)
    assert (volume.opacity(weights) - opacity).abs().max() < spacing
    assert (volume.expected_distance(weights, t) - expected).abs().max() < 2 * spacing


@pytest.mark.parametrize("seed", [None, 5])
def test_depth_of_an_opaque_sphere(seed: int | None) -> None:
    camera, radius, count = tilted_camera(), 0.14, 64
    generator = None if seed is None else seeded(seed)
    origins, directions = rays_of(camera)
    near, far, _ = volume.box_interval(origins, directions, LOW, HIGH)

    def density(t: Tensor) -> Tensor:
        points = volume.along(origins, directions, t)
        return 1e6 * ((points - HEAD).norm(dim=-1) < radius)

    t = volume.stratified(near, far, count, generator)
    weights = volume.widen(volume.quadrature(density(t), t, near, far))
    t, _ = volume.merge(t, volume.importance(weights, t, near, far, count, generator))
    weights = volume.quadrature(density(t), t, near, far)
    distance = volume.expected_distance(weights, t)

    middle = ((HEAD - origins) * directions).sum(-1)
    aside = (HEAD - origins - middle[..., None] * directions).norm(dim=-1)
    half = (radius**2 - aside**2).clamp(min=0).sqrt()
    spacing = (far - near) / count
    through = half > spacing  # so that no coarse sample pattern steps over it
    assert through.sum() > 50 and (aside > radius).sum() > 50
    assert (volume.opacity(weights)[through] > 1 - 1e-9).all()
    error = (distance - (middle - half))[through]
    # A quarter of the fine samples share the cell in which the sphere begins. Jitter makes cells
    # up to half as wide again, and gaps twice.
    finest = spacing[through] / (count / 4) * (1 if seed is None else 3)
    assert (error > -1e-9).all() and (error < 1.01 * finest).all()
    pose = torch.tensor(camera.camera_to_world)
    surface = volume.along(origins, directions, (middle - half)[..., None])[..., 0, :]
    planar = volume.planar_depth(distance, directions, pose)
    expected = torch.tensor(camera.project(surface.numpy())[1])
    assert ((planar - expected)[through].abs() < 1.01 * finest).all()
    assert not distance[aside > radius].any()


def test_composite_is_linear_and_premultiplied() -> None:
    weights, a, b = random(6, 5) / 5, random(6, 5, 3, seed=1), random(6, 5, 3, seed=2)
    both = 2 * volume.composite(weights, a) - volume.composite(weights, b)
    torch.testing.assert_close(volume.composite(weights, 2 * a - b), both)
    ones = volume.composite(weights, torch.ones(6, 5, 1).double())
    torch.testing.assert_close(ones[..., 0], volume.opacity(weights))
    assert not volume.composite(torch.zeros(6, 5).double(), a).any()


def test_gradients_of_the_look_up() -> None:
    planes = random(2, 3, 2, 3, 4).requires_grad_()
    places = (2 * random(2, 6, 3, seed=1) - 1).requires_grad_()
    assert torch.autograd.gradcheck(volume.triplane, (planes, places))


def test_gradients_of_the_integrals() -> None:
    def integrals(density: Tensor, t: Tensor, far: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        weights = volume.quadrature(density, t, torch.zeros_like(far), far)
        return volume.composite(weights, seen), volume.expected_distance(weights, t)

    t = (random(4, 6) * 0.5).cumsum(-1)
    inputs = (3 * random(4, 6, seed=1), t, t[:, -1] + 0.2, random(4, 6, 3, seed=2))
    assert torch.autograd.gradcheck(integrals, [x.requires_grad_() for x in inputs])


@pytest.mark.parametrize("pattern", [[0.0] * 4, [1e38] * 4, [0, 1e38, 0, 1e38], [1e-38, 1, 0, 9e9]])
def test_extreme_densities_stay_finite(pattern: list[float]) -> None:
    density = torch.tensor([pattern], requires_grad=True)
    near, far = torch.ones(1), torch.full((1,), 9.0)
    t = volume.stratified(near, far, 4).requires_grad_()
    weights = volume.quadrature(density, t, near, far)
    assert ((weights >= 0) & (weights <= 1)).all() and weights.sum() <= 1 + 1e-6
    seen = volume.composite(weights, t[..., None]) + volume.expected_distance(weights, t)
    seen.sum().backward()
    assert density.grad is not None and density.grad.isfinite().all()
    assert t.grad is not None and t.grad.isfinite().all()


def test_float32_agrees_with_float64() -> None:
    double = render(*scene())
    single = render(*(x.float() for x in scene()))
    for a, b in zip(single, double, strict=True):
        assert a.dtype == torch.float32
        torch.testing.assert_close(a.double(), b, rtol=0, atol=2e-5)


def test_batches_are_independent() -> None:
    planes, poses, intrinsics = scene()
    together = render(planes, poses, intrinsics)
    for i in range(2):
        one = render(planes[i : i + 1], poses[i : i + 1], intrinsics[i : i + 1])
        for a, b in zip(one, together, strict=True):
            torch.testing.assert_close(a[0], b[i])


def test_randomness_comes_from_the_generator_alone() -> None:
    near, far = torch.zeros(3), torch.ones(3)
    state = torch.get_rng_state()

    def draw(seed: int) -> Tensor:
        generator = seeded(seed)
        t = volume.stratified(near, far, 5, generator)
        fine = volume.importance(t, t, near, far, 5, generator)
        assert (t.diff() > 0).all() and (fine.diff() > 0).all()
        return volume.merge(t, fine)[0]

    assert torch.equal(draw(1), draw(1)) and not torch.equal(draw(1), draw(2))
    assert torch.equal(torch.get_rng_state(), state)


Z, EYE = torch.zeros, torch.eye


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: volume.rays(Z(4), EYE(3), 2, 2), "camera_to_world must be (..., 4, 4), got (4,)"),
        (lambda: volume.rays(EYE(4), EYE(3), 0, 2), "height must be positive, got 0"),
        (lambda: volume.rays(EYE(4), Z(2, 3, 3), 2, 2), "intrinsics must have fx > 0"),
        (lambda: volume.resize_intrinsics(EYE(3), (8, 8), (4, 0)), "to_width must be positive"),
        (lambda: volume.box_interval(Z(2), Z(3), Z(3), Z(3)), "origins must be (..., 3), got (2,)"),
        (lambda: volume.triplane(Z(1, 1, 3, 4, 8, 8), Z(1, 5, 3)), "(B, 3, C, H, W)"),
        (lambda: volume.triplane(Z(2, 3, 4, 8, 8), Z(1, 5, 3)), "must be (2, P, 3)"),
        (lambda: volume.plane(Z(2, 4, 8, 8), Z(2, 5, 3)), "must be (2, P, 2)"),
        (lambda: volume.stratified(Z(3), Z(4), 2), "far must be (3), got (4,)"),
        (lambda: volume.stratified(Z(3), Z(3), 0), "count must be positive, got 0"),
        (lambda: volume.importance(Z(3, 4), Z(3, 5), Z(3), Z(3), 2), "weights must be (3, 5)"),
        (lambda: volume.merge(Z(3, 4), Z(2, 4)), "fine must be (3, N), got (2, 4)"),
        (lambda: volume.quadrature(Z(3, 4), Z(3, 4), Z(4), Z(3)), "near must be (3), got (4,)"),
        (lambda: volume.composite(Z(3, 4), Z(3, 4)), "attributes must be (3, 4, C), got (3, 4)"),
        (lambda: volume.planar_depth(Z(3, 4), Z(4, 3, 3), EYE(4)), "must be (..., 3, 4, 3)"),
    ],
)
def test_bad_arguments(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        call()
