"""Point-wise decoders: the shading equation, its light, its frames and its fresh state."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry import volume
from totalediting.geometry.shown import COVERAGE, OFF, SIGHT
from totalediting.light import phong
from totalediting.light.lightmaps import bake
from totalediting.networks import decoders
from totalediting.networks.decoders import (
    DENSITY_SCALE,
    Decoders,
    GeometryDecoder,
    PlainDecoder,
    Shading,
    ShadingDecoder,
    shown_channels,
)
from totalediting.presets import PRESETS, Preset

TINY = PRESETS["tiny"]
SHOWN = shown_channels(TINY)
B, N = 2, 50


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def units(seed: int) -> Tensor:
    return functional.normalize(torch.randn(B, N, 3, generator=seeded(seed)), dim=-1)


def rotations(seed: int) -> Tensor:
    """(B, 3, 3), with determinant 1."""
    q, _ = torch.linalg.qr(torch.randn(B, 3, 3, generator=seeded(seed)))
    return q * torch.det(q)[:, None, None]


def lightmaps(seed: int = 0) -> Tensor:
    return bake(torch.rand(B, 16, 32, 3, generator=seeded(seed)) ** 4 * 5, 16)


def features(seed: int = 0) -> Tensor:
    return torch.randn(B, N, TINY.plane_channels + 3 + SHOWN, generator=seeded(seed))


def of_geometry(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """t_geo, how far points are inside the skin, and what the source shows."""
    generator = seeded(seed)
    inside = 0.02 * torch.randn(B, N, generator=generator)
    features = torch.randn(B, N, TINY.plane_channels, generator=generator)
    return features, inside, 2 * torch.rand(B, N, SHOWN, generator=generator) - 1


def same(directions: Tensor) -> Tensor:
    return directions


def trained(module: nn.Module, seed: int = 0) -> nn.Module:
    """Away from the fresh state, in which some weights are 0."""
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=seeded(seed))
    return module


@pytest.fixture
def decoder() -> ShadingDecoder:
    torch.manual_seed(0)
    module = trained(ShadingDecoder(TINY))
    assert isinstance(module, ShadingDecoder)
    return module


def shade(decoder: nn.Module, light: Tensor, turn: Tensor | None = None) -> Shading:
    """Of the same points; `turn` (B, 3, 3) turns model space and what is told about it."""
    turn = torch.eye(3).expand(B, 3, 3) if turn is None else turn
    to_light = rotations(1) @ turn.mT
    return decoder(features(), lambda n: n @ turn.mT, units(2) @ turn.mT, light, to_light)


def test_density_is_positive_and_follows_the_last_layer() -> None:
    torch.manual_seed(0)
    decoder = GeometryDecoder(TINY)
    density = decoder(*of_geometry())
    assert density.shape == (B, N)
    assert (density > 0).all()
    last = decoder.net[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.weight.zero_()
        last.bias.fill_(41.0)
    features, inside, seen = of_geometry()
    skin, bare = torch.sigmoid(inside / decoders.SKIN), (1 - seen[..., COVERAGE]) / 2
    beside = decoders.HAIR * (1 + seen[..., OFF]) / 2 - decoders.CLEAR * bare
    full = DENSITY_SCALE * (40.0 + decoders.FULL * skin + (1 - skin) * beside)
    torch.testing.assert_close(decoder(features, inside, seen), full)


def test_a_fresh_volume_is_the_skin_in_a_translucent_fog() -> None:
    torch.manual_seed(0)
    decoder = GeometryDecoder(TINY)
    features = torch.randn(1, 4096, TINY.plane_channels)
    seen = 2 * torch.rand(1, 4096, SHOWN) - 1
    seen[..., COVERAGE], seen[..., OFF] = 1, -1
    outside, inside = (decoder(features, torch.full((1, 4096), i), seen) for i in (-1.0, 1.0))
    seen[..., COVERAGE] = -1
    bare = decoder(features, torch.full((1, 4096), -1.0), seen)
    assert 1.0 - math.exp(-0.6 * bare.mean().item()) < 0.01, "none beside what the source covers"
    none = torch.zeros(1, 1, SHOWN)
    blank = decoder(torch.zeros(1, 1, TINY.plane_channels), torch.zeros(1, 1), none).item()
    beside = decoders.HAIR / 2 - decoders.CLEAR / 2  # half covered
    fog = decoders.FRESH + decoders.FULL / 2 + beside / 2  # on the skin
    assert blank == pytest.approx(DENSITY_SCALE * math.log1p(math.exp(fog - 1.0)), rel=1e-5)
    assert 0.1 < 1.0 - math.exp(-0.6 * outside.mean().item()) < 0.8
    assert (1.0 - (-0.015 * inside).exp()).min() > 0.9, "within 15 mm"


def test_a_fresh_volume_has_hair_where_the_source_shows_it() -> None:
    torch.manual_seed(0)
    decoder = GeometryDecoder(TINY)
    features, outside, seen = of_geometry()
    outside = torch.full_like(outside, -1.0)
    seen[..., COVERAGE], seen[..., OFF] = 1, -1
    fog = decoder(features, outside, seen)
    seen[..., OFF] = 1
    hair = decoder(features, outside, seen)
    assert (1 - (-0.05 * hair).exp()).mean() > 0.6, "in a thickness of 5 cm"
    assert hair.mean() > 8 * fog.mean()


def test_a_fresh_surface_is_matt_and_has_no_residual() -> None:
    torch.manual_seed(0)
    shading = shade(ShadingDecoder(TINY), lightmaps())
    assert (shading.k_d - 1.0).abs().max() < 0.05
    assert (shading.k_s - decoders.FRESH_SPECULAR).abs().max() < 0.02
    assert not shading.residual.any()
    skin = functional.normalize(features()[..., -SHOWN - 3 : -SHOWN], dim=-1)
    torch.testing.assert_close(shading.canonical_normal, skin)


def test_shapes_and_ranges(decoder: ShadingDecoder) -> None:
    shading = shade(decoder, lightmaps())
    sizes = {"features": (TINY.features,), "k_d": (1,), "k_s": (4,), "s_s": (4, 3)}
    for name, value in shading._asdict().items():
        assert value.shape == (B, N, *sizes.get(name, (3,))), name
    assert shading.albedo.min() >= 0 and shading.albedo.max() <= 1
    assert shading.k_d.min() >= 0 and shading.k_d.max() <= 2
    assert shading.k_s.min() >= 0 and shading.k_s.max() <= 1
    for normal in (shading.normal, shading.canonical_normal):
        torch.testing.assert_close(normal.norm(dim=-1), torch.ones(B, N))


def test_colour_is_the_render_equation(decoder: ShadingDecoder) -> None:
    s = shade(decoder, lightmaps())
    composed = phong.compose(s.albedo, s.k_d, s.s_d, s.k_s, s.s_s, s.residual)
    torch.testing.assert_close(s.colour, composed)
    torch.testing.assert_close(s.colour, s.diffuse + s.specular + s.residual)
    to_light = rotations(1)
    shaded = phong.shade(
        lightmaps(), s.normal @ to_light.mT, units(2) @ to_light.mT, s.albedo, s.k_d, s.k_s
    )
    torch.testing.assert_close(s.diffuse + s.specular, shaded)


def test_shading_is_linear_in_light(decoder: ShadingDecoder) -> None:
    """The residual as well, which is a sum of shadings."""
    first, second = lightmaps(0), lightmaps(1)

    def lit(light: Tensor) -> Tensor:
        return shade(decoder, light).colour

    assert shade(decoder, first).residual.abs().max() > 0.01
    torch.testing.assert_close(lit(2.0 * first), 2.0 * lit(first), atol=0, rtol=1e-5)
    torch.testing.assert_close(lit(first + second), lit(first) + lit(second))
    assert not lit(torch.zeros_like(first)).any()


def test_transfer_lobes_gather_light_from_elsewhere_and_stay_linear() -> None:
    torch.manual_seed(0)
    decoder = ShadingDecoder(replace(TINY, occlusion="lobes"))
    plain = ShadingDecoder(TINY)
    plain.load_state_dict(decoder.state_dict(), strict=False)
    fresh, without = shade(decoder, lightmaps()), shade(plain, lightmaps())
    more = fresh.diffuse - without.diffuse
    assert (more > 0).all() and (more < 0.35 * without.diffuse + 0.3).all()
    trained(decoder)
    first, second = lightmaps(0), lightmaps(1)
    one, other, both = (shade(decoder, m).colour for m in (first, second, first + second))
    torch.testing.assert_close(both, one + other)
    # All of k_d gone, what is left has none of the light at n itself.
    with torch.no_grad():
        last = decoder.diffuse[-1]
        assert isinstance(last, nn.Linear)
        last.weight.zero_()
        last.bias.fill_(-30.0)
    assert shade(decoder, lightmaps()).diffuse.min() > 0
    decoder.zero_grad()
    shade(decoder, lightmaps()).diffuse.sum().backward()
    assert decoder.transfer is not None
    assert all(p.grad is not None and p.grad.any() for p in decoder.transfer.parameters())


def test_the_papers_residual_is_a_switch() -> None:
    torch.manual_seed(0)
    decoder = trained(ShadingDecoder(replace(TINY, residual="paper")))
    one, two = (shade(decoder, k * lightmaps()).residual for k in (1.0, 2.0))
    assert not torch.allclose(two, 2 * one, rtol=0.05)


def test_material_knows_no_light(decoder: ShadingDecoder) -> None:
    one, other = shade(decoder, lightmaps(0)), shade(decoder, lightmaps(1))
    for name in ("albedo", "normal", "canonical_normal", "features", "k_d", "k_s"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    for name in ("colour", "diffuse", "specular", "residual"):
        assert not torch.allclose(getattr(one, name), getattr(other, name)), name


def test_light_stays_where_it_is_when_model_space_turns(decoder: ShadingDecoder) -> None:
    turn = rotations(5)
    one, other = shade(decoder, lightmaps()), shade(decoder, lightmaps(), turn)
    torch.testing.assert_close(other.normal, one.normal @ turn.mT)
    for name in ("s_d", "s_s", "albedo", "features", "canonical_normal"):
        torch.testing.assert_close(getattr(other, name), getattr(one, name), atol=1e-4, rtol=1e-4)
    assert not torch.allclose(other.k_d, one.k_d), "D_d sees normals of model space"


def test_constant_light_is_not_seen_to_turn(decoder: ShadingDecoder) -> None:
    shading = shade(decoder, torch.full((B, 5, 3, 16, 32), 3.0))
    torch.testing.assert_close(shading.s_d, torch.full((B, N, 3), 3.0))
    torch.testing.assert_close(shading.s_s, torch.full((B, N, 4, 3), 3.0))


def test_gradients_reach_all_that_is_learnt(decoder: ShadingDecoder) -> None:
    inputs, light = features().requires_grad_(), lightmaps().requires_grad_()
    shading = decoder(inputs, same, units(2), light, rotations(1))
    (shading.colour.square().mean() + shading.features.square().mean()).backward()
    for name, tensor in [*decoder.named_parameters(), ("t_shd", inputs), ("light", light)]:
        assert tensor.grad is not None and tensor.grad.isfinite().all(), name
        assert tensor.grad.any(), name
    geometry = GeometryDecoder(TINY)
    geometry(*of_geometry()).sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in geometry.parameters())


@pytest.mark.parametrize(("kind", "first"), [(ShadingDecoder, 3), (PlainDecoder, 0)])
@pytest.mark.parametrize("mirrored", [False, True])
def test_fresh_colour_is_the_sources(kind: type[nn.Module], first: int, mirrored: bool) -> None:
    """Unlit for the one, lit for the other; of the side that is seen, whatever the other shows."""
    torch.manual_seed(0)
    given = features()
    shown = torch.rand(B, N, 3, generator=seeded(3)) * 0.6 + 0.2
    told = given[..., -SHOWN:].unflatten(-1, (2, -1))
    told[..., :6] = torch.rand(B, N, 2, 6, generator=seeded(4))
    told[..., SIGHT - 2] = -1.0
    told[..., int(mirrored), SIGHT - 2] = 1.0
    told[..., int(mirrored), first : first + 3] = 2 * shown - 1
    found = kind(TINY)(given, same, units(2), lightmaps(), rotations(1)).albedo
    torch.testing.assert_close(phong.display(found), shown, atol=0.02, rtol=0)


def test_plain_colour_knows_neither_light_nor_view() -> None:
    torch.manual_seed(0)
    decoder = PlainDecoder(TINY)
    shading = shade(decoder, lightmaps())
    other = decoder(features(), same, units(9), 7.0 * lightmaps(3), rotations(4))
    assert torch.equal(shading.colour, other.colour)
    assert torch.equal(shading.colour, shading.albedo)
    assert all((shading.colour > 0).flatten())
    torch.testing.assert_close(shading.normal.norm(dim=-1), torch.ones(B, N))
    phongs = shade(ShadingDecoder(TINY), lightmaps())
    for name, value in shading._asdict().items():
        assert value.shape == getattr(phongs, name).shape, name
        if name in ("diffuse", "specular", "residual", "k_d", "s_d", "k_s", "s_s"):
            assert not value.any(), name
    with torch.no_grad():
        for p in decoder.parameters():
            p.add_(3.0)
    bright = decoder(features(), same, units(2), lightmaps(), rotations(1)).colour
    assert bright.max() > 1, "linear light has no upper bound"
    torch.manual_seed(0)
    shown = shade(trained(PlainDecoder(replace(TINY, colour="srgb"))), lightmaps()).colour
    assert shown.max() <= 1


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_presets(preset: Preset) -> None:
    with torch.device("meta"):
        both = Decoders(preset)
        t = torch.zeros(1, 7, preset.plane_channels)
        assert both.geometry(t, t[..., 0], torch.zeros(1, 7, shown_channels(preset))).shape == (
            1,
            7,
        )
    assert isinstance(both.shading, ShadingDecoder)
    plain = Decoders(replace(preset, decoder="plain"))
    assert isinstance(plain.shading, PlainDecoder)


def test_the_seed_decides(decoder: ShadingDecoder) -> None:
    torch.manual_seed(0)
    again = trained(ShadingDecoder(TINY))
    assert torch.equal(shade(decoder, lightmaps()).colour, shade(again, lightmaps()).colour)


def test_wrong_shapes_are_named(decoder: ShadingDecoder) -> None:
    good = {
        "features": features(),
        "view": units(0),
        "lightmaps": lightmaps(),
        "to_light": rotations(0),
    }
    for name in good:
        bad = good | {name: good[name][0]}
        with pytest.raises(ValueError, match=name):
            decoder(to_posed=same, **bad)


def test_planes_are_trained_through_the_decoders(decoder: ShadingDecoder) -> None:
    planes = torch.randn(B, 3, TINY.plane_channels + 3 + SHOWN, 8, 8, requires_grad=True)
    found = volume.triplane(planes, 2 * torch.rand(B, N, 3) - 1)
    decoder(found, same, units(2), lightmaps(), rotations(1)).colour.sum().backward()
    assert planes.grad is not None and planes.grad.abs().sum((0, 3, 4)).all()
