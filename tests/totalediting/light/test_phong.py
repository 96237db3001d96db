"""The Phong model against its equations, and the display transform against the dataset's."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from assets_procedural.conventions import colour as dataset
from totalediting.light.lightmaps import SHININESS, bake, brute_force
from totalediting.light.phong import compose, display, reflect, shade, undisplay


def normal_values(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=shape))


def units(*shape: int, seed: int = 0) -> torch.Tensor:
    return F.normalize(normal_values(*shape, 3, seed=seed), dim=-1)


def surface(count: int, seed: int = 0) -> dict[str, torch.Tensor]:
    """Arguments of `shade` for random points."""
    rng = np.random.default_rng(seed)
    return {
        "normal": units(count, seed=seed),
        "view": units(count, seed=seed + 1),
        "albedo": torch.from_numpy(rng.uniform(size=(count, 3))),
        "k_d": torch.from_numpy(rng.uniform(size=(count, 1))),
        "k_s": torch.from_numpy(rng.uniform(size=(count, 4))),
    }


def test_reflection_is_unit_and_leaves_at_the_angle_of_arrival() -> None:
    view, normal = units(200), units(200, seed=1)
    reflected = reflect(view, normal)
    torch.testing.assert_close(reflected.norm(dim=-1), torch.ones(200).double())
    torch.testing.assert_close((reflected * normal).sum(-1), (view * normal).sum(-1))
    coplanar = torch.stack([view, normal, reflected], dim=-1)
    assert torch.linalg.det(coplanar).abs().max() < 1e-12
    torch.testing.assert_close(reflect(reflected, normal), view)
    torch.testing.assert_close(reflect(normal, normal), normal)


def test_reflection_counts_only_the_direction_of_normals() -> None:
    view, normal = units(9), units(9, seed=1)
    torch.testing.assert_close(reflect(view, 3.7 * normal), reflect(view, normal))
    zero = torch.zeros(9, 3, dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(reflect(view, zero), -view)
    reflect(view, zero).sum().backward()
    assert zero.grad is not None and zero.grad.isfinite().all()


def test_composition_is_the_render_equation() -> None:
    rng = np.random.default_rng(0)
    shapes = {"albedo": 3, "k_d": 1, "s_d": 3, "k_s": 4, "residual": 3}
    values = {name: rng.uniform(size=(2, 5, size)) for name, size in shapes.items()}
    s_s = rng.uniform(size=(2, 5, 4, 3))
    tensors = {name: torch.from_numpy(value) for name, value in values.items()}
    found = compose(**tensors, s_s=torch.from_numpy(s_s))
    for i, j, colour in np.ndindex(2, 5, 3):
        a, s_d = values["albedo"][i, j, colour], values["s_d"][i, j, colour]
        expected = values["k_d"][i, j, 0] * a * s_d
        for lobe in range(len(SHININESS)):
            expected += values["k_s"][i, j, lobe] * s_s[i, j, lobe, colour]
        expected += values["residual"][i, j, colour]
        assert found[i, j, colour] == pytest.approx(expected)
    without = compose(**{**tensors, "residual": None}, s_s=torch.from_numpy(s_s))
    torch.testing.assert_close(without, found - tensors["residual"])


def test_shading_is_the_integral_over_the_light() -> None:
    coarse = np.random.default_rng(0).gamma(0.5, 2.0, (8, 16, 3))
    light = torch.from_numpy(coarse.repeat(12, axis=0).repeat(12, axis=1))
    points = surface(60)
    found = shade(bake(light, 96, normalised=False), **points)
    reflected = reflect(points["view"], points["normal"])
    specular = [brute_force(light, reflected, exponent) for exponent in SHININESS]
    diffuse = brute_force(light, points["normal"], 1)
    shadings = diffuse, points["k_s"], torch.stack(specular, dim=-2)
    expected = compose(points["albedo"], points["k_d"], *shadings)
    assert (found - expected).norm() / expected.norm() < 2e-3


def test_each_map_is_read_for_its_own_lobe() -> None:
    points = surface(8)
    maps = (
        torch.tensor([1.0, 10, 100, 1000, 10000]).double()[:, None, None, None].expand(5, 3, 4, 8)
    )
    expected = points["k_d"] * points["albedo"] + (points["k_s"] @ maps[1:, 0, 0, 0])[:, None]
    torch.testing.assert_close(shade(maps, **points), expected)


def test_twice_the_light_is_twice_the_shading_and_lights_add() -> None:
    points = surface(40)
    maps = torch.from_numpy(np.random.default_rng(3).gamma(0.5, 2.0, (2, 5, 3, 8, 16)))
    one, other = shade(maps[0], **points), shade(maps[1], **points)
    torch.testing.assert_close(shade(2 * maps[0], **points), 2 * one)
    torch.testing.assert_close(shade(maps.sum(0), **points), one + other)
    torch.testing.assert_close(shade(maps, **points), torch.stack([one, other]))


def test_shading_has_its_gradients() -> None:
    points = {name: value.requires_grad_() for name, value in surface(3).items()}
    maps = torch.rand(5, 3, 4, 8, dtype=torch.float64, requires_grad=True)
    arguments = (maps, *points.values())
    assert torch.autograd.gradcheck(lambda m, *p: shade(m, *p), arguments)


def linear_values() -> np.ndarray:
    rng = np.random.default_rng(4)
    ends = [-1.0, 0.0, 1e-9, 1e-6, 0.0031308, dataset.CLIP, dataset.CLIP + 1e-6, 100.0]
    greys = np.concatenate([ends, np.linspace(0, 0.01, 100), np.linspace(0, 20, 2_000)])
    colours = rng.random((20_000, 3)) * 10 ** rng.uniform(-5, 2, (20_000, 1))
    return np.concatenate([greys[:, None].repeat(3, 1), colours])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_display_is_the_datasets(dtype: torch.dtype) -> None:
    linear = torch.from_numpy(linear_values()).to(dtype)
    shown = display(linear)
    assert shown.dtype == dtype and shown.max() <= 1
    np.testing.assert_allclose(shown, dataset.display(linear.numpy()), atol=1e-6)
    torch.testing.assert_close(display(linear.T, 0).T, shown)
    levels = torch.rand(9_999, 3, dtype=dtype) * 1.2 - 0.1
    back = undisplay(levels)
    assert back.dtype == dtype and back.max() <= dataset.CLIP
    np.testing.assert_allclose(back, dataset.undisplay(levels.numpy()), rtol=2e-4, atol=1e-5)
    torch.testing.assert_close(undisplay(levels.T, 0).T, back)


def test_display_round_trips_and_passes_nan_on() -> None:
    linear = torch.rand(999, 3, dtype=torch.float64) * dataset.CLIP
    torch.testing.assert_close(undisplay(display(linear)), linear)
    nan = torch.tensor([0.1, torch.nan, 0.2])
    assert display(nan).isnan().all() and undisplay(nan).isnan().all()


def test_display_has_its_gradient() -> None:
    linear = torch.tensor([[0.001, 0.02, 0.3], [0.7, 0.9, 3.0], [7.5, 4.0, 9.0]]).double()
    assert torch.autograd.gradcheck(display, linear.requires_grad_())
    shown = display(linear.detach()).requires_grad_()
    assert torch.autograd.gradcheck(undisplay, shown)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_of_display_are_finite_everywhere(dtype: torch.dtype) -> None:
    linear = torch.from_numpy(linear_values()).to(dtype).requires_grad_()
    display(linear).sum().backward()
    assert linear.grad is not None and linear.grad.isfinite().all()
    black = torch.zeros(1, 3, dtype=dtype, requires_grad=True)
    display(black).sum().backward()
    assert black.grad is not None and black.grad.min() > 0.5  # black can become brighter
    levels = torch.linspace(-0.5, 1.5, 41, dtype=dtype)
    shown = torch.cartesian_prod(levels, levels, levels).requires_grad_()
    undisplay(shown).sum().backward()
    assert shown.grad is not None and shown.grad.isfinite().all()


def three(last: int = 3) -> torch.Tensor:
    return torch.ones(7, last)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: reflect(three(2), three()), r"view.*\(7, 2\)"),
        (lambda: reflect(three(), three(4)), r"normal.*\(7, 4\)"),
        (lambda: reflect(three(), torch.ones(6, 3)), r"view \(7, 3\), normal \(6, 3\)"),
        (
            lambda: compose(three(), three(3), three(), three(4), torch.ones(7, 4, 3)),
            r"k_d must be \(\.\.\., 1\), not \(7, 3\)",
        ),
        (
            lambda: compose(three(), three(1), three(), three(4), torch.ones(7, 12)),
            r"s_s must be \(\.\.\., 4, 3\), not \(7, 12\)",
        ),
        (
            lambda: compose(three(), three(1), three(), three(4), torch.ones(6, 4, 3)),
            r"s_s \(6, 4, 3\) do not broadcast",
        ),
        (
            lambda: shade(torch.ones(15, 4, 8), three(), three(), three(), three(1), three(4)),
            r"lightmaps.*\(15, 4, 8\)",
        ),
    ],
)
def test_bad_shapes_are_named(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
