"""The lightmap estimator: shapes, lobes, gradients, what its parts are made of."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from totalediting.geometry.mirroring import mirrored_lightmaps
from totalediting.light import lightmaps, phong
from totalediting.networks import lightmap_estimator
from totalediting.networks.lightmap_estimator import (
    Illumination,
    LightmapEstimator,
    fold,
    sphere,
    texel_weights,
    unfold,
)
from totalediting.presets import PRESETS

TINY = replace(PRESETS["tiny"], lightmap_height=8)  # few queries, for speed


@pytest.fixture
def estimator() -> LightmapEstimator:
    torch.manual_seed(0)
    return LightmapEstimator(TINY)


@pytest.fixture
def image() -> torch.Tensor:
    return torch.rand(2, 3, 128, 128, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_gives_maps_and_normals(name: str) -> None:
    preset = PRESETS[name]
    with torch.device("meta"):
        estimator = LightmapEstimator(preset)
        image = torch.empty(2, 3, preset.image, preset.image)
        maps = unfold(estimator(image).code, preset.lightmap_height)
        code, normal = estimator(image, torch.zeros(7, dtype=torch.long))
    rows = preset.lightmap_height
    assert maps.shape == (2, 5, 3, rows, 2 * rows)
    assert code.shape == (2, 7, 3)
    assert normal.shape == (2, 3, preset.image // 2, preset.image // 2)


def test_fold_and_unfold_are_inverse() -> None:
    maps = torch.rand(2, 5, 3, 16, 32)
    maps[:, 0] = maps[:, 1]
    assert torch.equal(unfold(fold(maps), 16), maps)


def test_some_queries_are_answered_as_all_are(estimator, image) -> None:
    texels = torch.tensor([0, 300, estimator.queries - 1])
    whole, some = estimator(image), estimator(image, texels)
    torch.testing.assert_close(some.code, whole.code[:, texels])


def test_a_mirror_image_is_in_mirrored_light(estimator, image) -> None:
    maps, turned = estimator.lightmaps(image), estimator.lightmaps(image.flip(-1))
    torch.testing.assert_close(turned, mirrored_lightmaps(maps))
    assert not torch.allclose(maps, mirrored_lightmaps(maps), atol=1e-3)


def test_without_rolls_and_scales_the_maps_are_the_mean_of_the_answer_and_its_mirror_image(
    estimator, image, monkeypatch
) -> None:
    monkeypatch.setattr(lightmap_estimator, "_AUGMENTATIONS", ((0.0, 0.0),))
    image = (image + image.flip(-1)) / 2
    answer = unfold(estimator(image).code, TINY.lightmap_height)
    mean = (answer + mirrored_lightmaps(answer)) / 2
    torch.testing.assert_close(estimator.lightmaps(image), lightmaps.decode(mean))


def test_in_a_rolled_picture_light_is_found_where_it_is(estimator, image) -> None:
    """Of an estimator that sees light where the picture is bright, by its four sides: however the
    camera is rolled, it finds the same light, in the upright picture's frame."""
    towards = lightmaps.texel_directions(TINY.lightmap_height)
    x, y = towards[..., 0], towards[..., 1]

    def answer(image: torch.Tensor) -> Illumination:
        top, bottom = (part.mean((2, 3)) for part in image.chunk(2, 2))
        left, right = (part.mean((2, 3)) for part in image.chunk(2, 3))
        sides = ((right, x), (left, -x), (top, y), (bottom, -y))
        light = torch.stack([s[..., None, None] * d.clamp_min(0) for s, d in sides]).sum(0)
        return Illumination(fold(light.log1p()[:, None].expand(-1, 5, -1, -1, -1)), image)

    image[:, :, :40], image[:, :, :, 64:] = 0, 0.5
    estimator.forward = answer
    upright, tilted, over = (
        estimator._augmented(image, roll, 0.0) for roll in (0.0, math.pi / 2, math.pi)
    )
    torch.testing.assert_close(upright, unfold(answer(image).code, len(x)))
    torch.testing.assert_close(over, upright, atol=1e-4, rtol=0)
    torch.testing.assert_close(tilted, upright, atol=0.02, rtol=0)  # texels between texels
    assert (upright - upright.flip(-1)).abs().max() > 0.1


def test_lobes_are_those_that_lightmaps_are_baked_with(estimator) -> None:
    """A lobe's mean over lights that are spread evenly is the lightmap of their light."""
    towards = estimator.light
    light = 1 + 0.8 * towards[:, 2] + 0.5 * towards[:, 0]
    seen = estimator.lobes(torch.arange(estimator.queries)) @ light[:, None] / len(light)
    direction = lightmaps.texel_directions(64)
    panorama = (1 + 0.8 * direction[..., 2] + 0.5 * direction[..., 0])[..., None].expand(-1, -1, 3)
    baked = lightmaps.bake(panorama.contiguous(), TINY.lightmap_height)[None]
    # 128 directions are few for the sharpest lobe.
    error = (seen[None, :, 0] - fold(baked)[..., 0]).abs()[0].unflatten(0, (4, -1))
    assert (error.amax(1) < torch.tensor([0.01, 0.02, 0.06, 0.15])).all()


def test_directions_are_spread_evenly() -> None:
    directions = sphere(512)
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(512).double())
    assert directions.mean(0).abs().max() < 1e-3
    nearest = (directions @ directions.T - 2 * torch.eye(512)).amax(1).arccos()
    assert nearest.min() > 0.6 * math.sqrt(4 * math.pi / 512)


def test_weights_are_solid_angles() -> None:
    weights = texel_weights(16)
    assert weights.mean() == pytest.approx(1)
    assert weights[0] / weights[8 * 32] == pytest.approx(
        (1 - math.cos(math.pi / 16)) / math.sin(math.pi / 16), rel=1e-4
    )


def test_gradients_reach_every_parameter(estimator, image) -> None:
    code, normal = estimator(image)
    (code.square().mean() + normal[:, 0].mean()).backward()
    for name, parameter in estimator.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


def test_no_gradient_of_light_reaches_the_normal_decoder(estimator, image) -> None:
    """It learns from true normals alone, and stands still after pre-training."""
    estimator.lightmaps(image).mean().backward()
    assert all(p.grad is None for p in estimator.to_normal.parameters())


def test_a_token_faces_where_its_patch_does(estimator) -> None:
    """What E_face is told of a normal is the lobe of a light from there, on a scale of mean 1."""
    normal = torch.zeros(1, 3, 64, 64)
    normal[:, 2, :, :32] = 1
    normal[:, 0, :, 32:] = -1
    facing = estimator._facing(normal)[0]
    towards = estimator.light[facing[[0, 15], :-1].argmax(-1)]
    assert (towards * torch.tensor([[0, 0, 1.0], [-1, 0, 0]])).sum(-1).min() > 0.97
    assert facing[:, :-1].mean().item() == pytest.approx(1, abs=0.02)
    assert torch.equal(facing[:, -1], torch.ones(256))


def test_a_token_knows_the_light_that_its_patch_shows() -> None:
    """The mean of linear light, not of what is displayed, patch by patch and channel by channel."""
    light = torch.zeros(1, 3, 128, 128)
    light[:, 0, :, 4:8], light[:, 1] = 0.6, 0.1  # red in half of the first column of patches
    seen = lightmap_estimator._light_shown(phong.display(light, 1))[0].unflatten(0, (16, 16))
    for column, shown in ((0, [0.3, 0.1, 0.0]), (1, [0.0, 0.1, 0.0])):
        wanted = torch.tensor([math.log1p(c) for c in shown] + [math.log(c + 0.02) for c in shown])
        torch.testing.assert_close(seen[:, column], wanted.expand(16, -1), atol=1e-5, rtol=1e-5)


def test_normals_are_unit_and_light_is_not_negative(estimator, image) -> None:
    torch.testing.assert_close(estimator(image).normal.norm(dim=1), torch.ones(2, 64, 64))
    assert estimator.lightmaps(image).min() >= 0


def test_a_picture_of_another_size_is_refused(estimator) -> None:
    with pytest.raises(ValueError, match=r"image must be \(B, 3, 128, 128\), got \(1, 3, 64, 64\)"):
        estimator(torch.zeros(1, 3, 64, 64))
