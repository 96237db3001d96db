"""Lightmaps: against the integral itself, closed forms, real panoramas, and numpy's look-up."""

from __future__ import annotations

import importlib.util
import math

import numpy as np
import pytest
import torch
from scipy.special import lpmv

from assets_procedural.conventions import panorama as pano
from assets_procedural.light.pool import EnvironmentSettings, panorama_of, pool
from totalediting.light.lightmaps import (
    LOBE_INTEGRALS,
    LOBES,
    SHININESS,
    bake,
    brute_force,
    decode,
    encode,
    rotate,
    sample,
    texel_directions,
)

needs_bpy = pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="bpy's panoramas")


def hdr(height: int, seed: int = 0, lead: tuple[int, ...] = ()) -> torch.Tensor:
    values = np.random.default_rng(seed).gamma(0.5, 2.0, (*lead, height, 2 * height, 3))
    return torch.from_numpy(values)


def sky(radiance: np.ndarray) -> torch.Tensor:
    """A grey environment (H, 2H, 3) from (H, 2H) values."""
    return torch.from_numpy(np.repeat(radiance[..., None], 3, axis=-1))


def turn(seed: int) -> torch.Tensor:
    """A random rotation, float64."""
    matrix, _ = torch.linalg.qr(torch.from_numpy(np.random.default_rng(seed).normal(size=(3, 3))))
    return matrix * torch.linalg.det(matrix)


def per_lobe(values: tuple[float, ...]) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)[:, None, None, None]


@pytest.fixture(scope="module")
def panoramas() -> torch.Tensor:
    """The eight of Blender's wheel, at full resolution; suns of up to 35,000."""
    return torch.from_numpy(np.stack([panorama_of(s) for s in pool(EnvironmentSettings(), 0)]))


@pytest.mark.parametrize("height", [1, 5, 37, 64, 512, 700])
def test_constant_light_is_one_everywhere(height: int) -> None:
    maps = bake(torch.ones(height, 2 * height, 3), 8)
    assert maps.shape == (len(LOBES), 3, 8, 16)
    torch.testing.assert_close(maps, torch.ones_like(maps), atol=2e-6, rtol=0)


def test_constant_light_unnormalised_is_the_solid_angle_of_the_lobe() -> None:
    maps = bake(torch.full((64, 128, 3), 2.0).double(), 4, normalised=False)
    expected = per_lobe((math.pi, math.pi, *(2 * math.pi / (e + 1) for e in SHININESS[1:])))
    torch.testing.assert_close(maps, (2 * expected).expand_as(maps), atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.tensor(LOBE_INTEGRALS).double(), expected[:, 0, 0, 0])


@pytest.mark.parametrize(("row", "column"), [(0, 3), (37, 100), (128, 0), (255, 511)])
def test_one_texel_becomes_the_lobe(row: int, column: int) -> None:
    height = 256
    light = np.zeros((height, 2 * height))
    light[row, column] = 1 / pano.texel_solid_angles(height)[row]
    maps = bake(sky(light), 32, normalised=False)
    cosine = pano.texel_directions(32) @ pano.texel_directions(height)[row, column]
    for lobe, exponent in enumerate((1, *SHININESS)):
        expected = torch.from_numpy(np.maximum(cosine, 0) ** exponent).expand(3, -1, -1)
        # The kink of the clamped cosine takes more orders than are kept.
        atol = 6e-3 if exponent == 1 else 4e-4
        torch.testing.assert_close(maps[lobe], expected, atol=atol, rtol=0)
    assert (maps >= 0).all()


def test_gradient_of_light_is_flattened_as_the_lobe_is_wide() -> None:
    z = pano.texel_directions(128)[..., 2]
    maps = bake(sky(1 + z), 16)
    for lobe, exponent in enumerate((1, *SHININESS)):
        slope = (exponent + 1) / (exponent + 2)
        expected = torch.from_numpy(1 + slope * pano.texel_directions(16)[..., 2])
        torch.testing.assert_close(maps[lobe], expected.expand(3, -1, -1), atol=4e-4, rtol=0)


def test_white_upper_half_lights_by_half_the_height_of_the_normal() -> None:
    maps = bake(sky((pano.texel_directions(128)[..., 2] > 0).astype(float)), 16)
    expected = torch.from_numpy((1 + pano.texel_directions(16)[..., 2]) / 2)
    torch.testing.assert_close(maps[0], expected.expand(3, -1, -1), atol=1e-4, rtol=0)


def zonal(exponent: int, degree: int) -> float:
    """A_l of the lobe: what a spherical harmonic of that degree is multiplied by."""
    integrals = [1 / (exponent + 1), 1 / (exponent + 2)]
    for n in range(2, degree + 1):
        integrals.append(integrals[n - 2] * (exponent - n + 2) / (exponent + n + 1))
    return 2 * math.pi * integrals[degree]


@pytest.mark.parametrize(("degree", "order"), [(1, 1), (2, 0), (3, 2), (4, 4), (7, 3), (12, 10)])
def test_spherical_harmonics_are_scaled(degree: int, order: int) -> None:
    def harmonic(height: int) -> np.ndarray:
        x, y, z = np.moveaxis(pano.texel_directions(height), -1, 0)
        values = lpmv(order, degree, z) * np.cos(order * np.arctan2(y, x) + 0.4)
        return values / abs(lpmv(order, degree, pano.texel_directions(128)[..., 2])).max()

    flat = np.ones((128, 256))
    maps = bake(sky(flat + harmonic(128)), 16, normalised=False)
    maps -= bake(sky(flat), 16, normalised=False)
    for lobe, exponent in enumerate((1, *SHININESS)):
        expected = torch.from_numpy(zonal(exponent, degree) * harmonic(16)).expand(3, -1, -1)
        atol = 1e-3 * LOBE_INTEGRALS[lobe]
        torch.testing.assert_close(maps[lobe], expected, atol=atol, rtol=0)


def test_light_adds_up() -> None:
    a, b = hdr(64, 1), hdr(64, 2)
    torch.testing.assert_close(bake(3 * a + 0.5 * b), 3 * bake(a) + 0.5 * bake(b))


def test_turning_the_panorama_turns_the_maps() -> None:
    light = hdr(64)
    torch.testing.assert_close(bake(light.roll(12, 1), 16), bake(light, 16).roll(3, -1))


def relative(found: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Relative L2 error over points and colours, (..., N, 3) to (...)."""
    return (found.double() - truth).flatten(-2).norm(dim=-1) / truth.flatten(-2).norm(dim=-1)


def test_bake_is_the_integral_at_any_height() -> None:
    light = hdr(75)
    maps = bake(light, 7, normalised=False).flatten(-2).mT
    directions = texel_directions(7, torch.float64).flatten(0, 1)
    for lobe, exponent in enumerate((1, *SHININESS)):
        assert relative(maps[lobe], brute_force(light, directions, exponent)) < 1e-3


@needs_bpy
def test_bake_is_the_integral_of_real_panoramas(panoramas: torch.Tensor) -> None:
    maps = bake(panoramas, normalised=False)
    # Around the brightest texel of each, where errors would be largest, and anywhere.
    bright = maps[:, -1].sum(1).flatten(1).argmax(1)
    rows, columns = (bright // 64)[:, None], (bright % 64)[:, None]
    rows = (rows + torch.tensor([-1, 0, 0, 0, 1])).clamp(0, 31)
    columns = (columns + torch.tensor([0, -1, 0, 1, 0])) % 64
    anywhere = torch.from_numpy(np.random.default_rng(0).choice(2048, 40, replace=False))
    texels = torch.cat([(rows * 64 + columns).flatten(), anywhere])
    directions = texel_directions(32, torch.float64).flatten(0, 1)[texels]
    found = maps.flatten(-2)[..., texels].mT  # panorama, lobe, point, colour
    for exponent, bound in zip(SHININESS, (2e-3, 3e-5, 4e-5, 6e-5), strict=True):
        truth = brute_force(panoramas, directions, exponent)
        for lobe, other in enumerate((1, *SHININESS)):
            if other == exponent:
                assert relative(found[:, lobe], truth).max() < bound


@needs_bpy
def test_rotated_bake_is_the_integral_in_the_other_frame(panoramas: torch.Tensor) -> None:
    rotation = turn(3)
    maps = bake(panoramas[[0, 6]], rotation=rotation, normalised=False)
    bright = maps[:, -1].sum(1).flatten(1).argmax(1)
    anywhere = torch.from_numpy(np.random.default_rng(0).choice(2048, 46, replace=False))
    texels = torch.cat([bright, anywhere])
    directions = texel_directions(32, torch.float64).flatten(0, 1)[texels] @ rotation.T
    found = maps.flatten(-2)[..., texels].mT
    for lobe, bound in ((0, 3e-3), (4, 0.01)):
        truth = brute_force(panoramas[[0, 6]], directions, (1, *SHININESS)[lobe])
        assert relative(found[:, lobe], truth).max() < bound


def test_small_panoramas_are_patches_of_sky() -> None:
    light = hdr(8)
    patches = light.repeat_interleave(8, 0).repeat_interleave(8, 1)
    torch.testing.assert_close(bake(light), bake(patches))


def test_maps_in_a_cameras_frame_of_an_environment_that_was_turned() -> None:
    angle, camera = 0.8, turn(5)
    light = hdr(64) + 0.1
    back = torch.from_numpy(pano.rotate_z(np.eye(3), -angle)).T
    maps = bake(light, rotation=back @ camera, normalised=False)
    seen = texel_directions(32, torch.float64)
    truth = pano.irradiance(light.numpy(), (seen @ camera.T).numpy(), angle)
    assert relative(maps[0].flatten(1).mT, torch.from_numpy(truth).flatten(0, 1)) < 2e-3


def test_rotate_turns_directions_of_the_new_frame_into_the_old() -> None:
    maps = bake(hdr(64), 64)
    rotation = turn(7)
    turned = rotate(maps, rotation)
    directions = texel_directions(64, torch.float64)[20, 30:40]
    expected = sample(maps.flatten(0, 1), directions @ rotation.T)
    torch.testing.assert_close(turned[..., 20, 30:40].flatten(0, 1).mT, expected)
    torch.testing.assert_close(rotate(maps, torch.eye(3)), maps)
    quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    torch.testing.assert_close(rotate(maps, quarter), maps.roll(32, -1))
    assert rotate(maps, rotation, 8).shape == (5, 3, 8, 16)


def test_rotations_may_come_in_batches() -> None:
    rotations = torch.stack([turn(1), turn(2)])
    light = hdr(16)
    together = bake(light, 8, rotations)
    assert together.shape == (2, 5, 3, 8, 16)
    for rotation, maps in zip(rotations, together, strict=True):
        torch.testing.assert_close(maps, bake(light, 8, rotation))


def directions_of_all_kinds() -> np.ndarray:
    random = np.random.default_rng(0).normal(size=(500, 3))
    seam = pano.uv_to_direction(np.array([[1e-9, 0.4], [1 - 1e-9, 0.4], [0, 0.6], [1, 0.6]]))
    near = pano.uv_to_direction(np.array([[0.1, 1e-9], [0.6, 1e-9], [0.3, 1 - 1e-9]]))
    poles = np.array([[0, 0, 1.0], [0, 0, -2.0], [-1, 0, 0], [-1, -0.0, 0]])
    return np.concatenate([random, 1e-6 * random, 1e6 * random, seam, near, poles])


@pytest.mark.parametrize("height", [1, 2, 16])
def test_sample_is_the_panoramas_look_up(height: int) -> None:
    image = hdr(height).numpy().astype(np.float32)
    directions = directions_of_all_kinds()
    found = sample(torch.from_numpy(image).movedim(-1, 0), torch.from_numpy(directions))
    np.testing.assert_allclose(found, pano.lookup(image, directions), atol=1e-4)


def test_sample_returns_texels_at_their_centres() -> None:
    maps = torch.rand(7, 16, 32, generator=torch.Generator().manual_seed(0))
    found = sample(maps, texel_directions(16).flatten(0, 1))
    torch.testing.assert_close(found.mT.reshape(7, 16, 32), maps, atol=2e-5, rtol=0)


def test_sample_broadcasts() -> None:
    maps, directions = torch.rand(3, 1, 4, 8, 16), torch.randn(2, 9, 3)
    found = sample(maps, directions)
    assert found.shape == (3, 2, 9, 4)
    torch.testing.assert_close(found[2, 1], sample(maps[2, 0], directions[1]))


def test_sample_passes_nan_on() -> None:
    found = sample(torch.ones(1, 4, 8), torch.tensor([[math.nan, 0, 1], [0, 0, 0]]))
    assert found[0].isnan().all() and found[1] == 1


def test_sample_has_its_gradients() -> None:
    maps = hdr(4, lead=(2,)).movedim(-1, -3).requires_grad_()
    directions = torch.from_numpy(np.random.default_rng(1).normal(size=(2, 6, 3))).requires_grad_()
    assert torch.autograd.gradcheck(sample, (maps, directions))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_poles_and_zero(dtype: torch.dtype) -> None:
    rows = [[0, 0, 1], [0, 0, -1], [0, 0, 0], [-1, 0, 0], [1e-30, 0, 1], [1e-6, 1e-6, 1]]
    directions = torch.tensor(rows, dtype=dtype, requires_grad=True)
    maps = hdr(16).movedim(-1, 0).to(dtype).requires_grad_()
    sample(maps, directions).square().sum().backward()
    assert maps.grad is not None and maps.grad.isfinite().all()
    assert directions.grad is not None and directions.grad.isfinite().all()


def test_bake_has_its_gradient() -> None:
    light = (hdr(2) + 0.5).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: bake(x, 1), light)
    assert torch.autograd.gradcheck(lambda x: bake(x, 2, turn(1)), light, fast_mode=True)


def test_a_batch_is_its_members() -> None:
    lights = hdr(32, lead=(2, 3)).float()
    together = bake(lights, 16)
    assert together.shape == (2, 3, 5, 3, 16, 32)
    torch.testing.assert_close(together[1, 2], bake(lights[1, 2], 16))


def test_single_precision_is_close_to_double() -> None:
    light = hdr(64)
    light[20, 30] = 3e4
    exact = bake(light)
    single = bake(light.float())
    assert single.dtype == torch.float32
    assert ((single - exact).abs().flatten(1).amax(1) < 2e-6 * exact.flatten(1).amax(1)).all()


def test_the_same_call_gives_the_same_bytes_also_under_autocast() -> None:
    light, rotation = hdr(64).float(), turn(2)
    once = bake(light, 8, rotation)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(bake(light, 8, rotation), once)
    assert torch.equal(bake(light, 8, rotation), once)


def test_a_first_call_in_inference_mode_does_not_spoil_training() -> None:
    light = hdr(9).float()  # a size of its own: nothing of it is cached
    with torch.inference_mode():
        bake(light, 7)
    light.requires_grad_()
    bake(light, 7).sum().backward()
    assert light.grad is not None


def test_encoding_round_trips() -> None:
    maps = torch.tensor([0.0, 1e-6, 1.0, 5e3])
    torch.testing.assert_close(decode(encode(maps)), maps)
    assert decode(torch.tensor(-0.3)) == 0


good = torch.ones(4, 8, 3)
maps = torch.ones(5, 3, 4, 8)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: bake(torch.ones(4, 4, 3)), r"environment.*\(4, 4, 3\)"),
        (lambda: bake(torch.ones(3, 4, 8)), r"environment.*\(3, 4, 8\)"),
        (lambda: bake(torch.ones(0, 0, 3)), r"environment.*\(0, 0, 3\)"),
        (lambda: bake(good.to(torch.uint8)), r"environment \(4, 8, 3\).*low dynamic range"),
        (lambda: bake(good * math.nan), r"environment \(4, 8, 3\).*NaN"),
        (lambda: bake(good * math.inf), r"environment \(4, 8, 3\).*Inf"),
        (lambda: bake(good - 2), r"environment \(4, 8, 3\).*negative.*clamp"),
        (lambda: bake(good, 0), "height.*0"),
        (lambda: bake(good, 2.5), "height.*2.5"),  # type: ignore[arg-type]
        (lambda: bake(good, rotation=torch.eye(4)), r"rotation.*\(4, 4\)"),
        (lambda: bake(good, rotation=2 * torch.eye(3)), r"rotation \(3, 3\).*orthonormal"),
        (lambda: bake(good, rotation=-torch.eye(3)), r"rotation \(3, 3\).*determinant"),
        (lambda: bake(good, rotation=torch.eye(3) * math.nan), r"rotation \(3, 3\)"),
        (
            lambda: bake(good.expand(2, 4, 8, 3), 4, torch.eye(3).expand(3, 3, 3)),
            r"rotation.*\(2,\)",
        ),
        (lambda: rotate(maps[:4], torch.eye(3)), r"maps.*\(4, 3, 4, 8\)"),
        (lambda: sample(torch.ones(3, 4, 9), torch.ones(1, 3)), r"maps.*\(3, 4, 9\)"),
        (lambda: sample(maps, torch.ones(3)), r"directions.*\(3,\)"),
        (lambda: sample(maps, torch.ones(5, 4)), r"directions.*\(5, 4\)"),
        (lambda: sample(maps, torch.ones(4, 5, 3)), r"directions \(4, 5, 3\).*maps \(5, 3, 4, 8\)"),
    ],
)
def test_bad_input_is_named(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
