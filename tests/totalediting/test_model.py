"""The whole model: shapes, gradients, determinism, and switches that change what they should."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from assets_procedural.body.head import HeadModel
from assets_procedural.motion.poses import Pose
from assets_procedural.person import Person
from totalediting.geometry.field import Control
from totalediting.geometry.source import Source
from totalediting.model import Edit, TotalEditing, Window
from totalediting.presets import PRESETS, Preset

SMALLEST = dataclasses.replace(
    PRESETS["tiny"], image=64, neural=32, window=16, tokens=8, plane_size=32, coarse_samples=6,
    fine_samples=6, deformation_nodes=8, lightmap_height=8,
)  # fmt: skip


def faces() -> Tensor:
    model = HeadModel.load()
    quads = np.searchsorted(model.groups["skin"], model.faces["skin"])
    return torch.from_numpy(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def control(yaw: float) -> Control:
    """Two busts that look to the side, in model space; every 20th control point."""
    bust = HeadModel.load().identity(Person()).pose(Pose(head=(0.0, 0.0, yaw)))
    skin, rest = bust.model.groups["skin"], bust.canonical
    origin = np.array([0.0, -0.06, 0.72])
    arrays = (bust.vertices - origin, rest.vertices - origin, bust.normals, rest.normals)
    return Control(*(torch.from_numpy(a[skin]).float().expand(2, -1, -1) for a in arrays))


@pytest.fixture(scope="module")
def sources() -> dict[str, Any]:
    generator = torch.Generator().manual_seed(0)
    camera = torch.eye(4)
    camera[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera[:3, 3] = torch.tensor([0.0, -1.2, 0.0])
    intrinsics = torch.tensor([[150.0, 0, 32], [0, 150, 32], [0, 0, 1]])
    app = Source(
        torch.rand(2, 3, 64, 64, generator=generator),
        torch.ones(2, 1, 64, 64),
        torch.rand(2, 54, generator=generator),
        control(0.2),
        camera.expand(2, 4, 4),
        intrinsics.expand(2, 3, 3),
        torch.rand(2, 5, 3, 8, 16, generator=generator) + 0.3,
        torch.eye(3).expand(2, 3, 3),
    )
    return {
        "source": app,
        "e_mot": torch.rand(2, 54, generator=generator),
        "control": control(0.5),
        "camera_to_world": camera.expand(2, 4, 4),
        "intrinsics": intrinsics.expand(2, 3, 3),
        "lightmaps": torch.rand(2, 5, 3, 8, 16, generator=generator),
    }


def made(preset: Preset = SMALLEST, stirred: bool = True, **arguments) -> TotalEditing:
    """A model; `stirred` takes it off the zeros that it starts with."""
    torch.manual_seed(0)
    model = TotalEditing(preset, **arguments)
    if stirred:
        with torch.no_grad():
            for parameter in model.parameters():
                parameter += 0.02 * torch.randn_like(parameter)
    return model.eval()


def change(a: Edit, b: Edit, name: str) -> float:
    return float((getattr(a.rendering, name) - getattr(b.rendering, name)).abs().max().detach())


def test_shapes(sources) -> None:
    edit = made()(**sources)
    assert edit.image.shape == (2, 3, 64, 64)
    assert edit.raw.shape == edit.foreground.shape == (2, 3, 32, 32)
    assert edit.image.min() >= 0 and edit.image.max() <= 1


def test_gradients_reach_every_parameter(sources) -> None:
    model = made().train()
    edit = model(**sources, generator=torch.Generator().manual_seed(0))
    loss = edit.image.square().mean() + edit.rendering.residual_l1.mean()
    (loss + edit.behind.square().mean()).backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


def test_the_same_call_gives_the_same_picture(sources) -> None:
    model = made()
    assert torch.equal(model(**sources).image, model(**sources).image)
    noise = [torch.Generator().manual_seed(seed) for seed in (1, 1, 2)]
    one, same, other = (model(**sources, generator=g).image for g in noise)
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_pictures_of_a_batch_do_not_mix(sources) -> None:
    """Whatever stands beside it, a picture is the same to the bit."""

    def twice(value):
        """The first sample, and it again in place of the second."""
        if isinstance(value, tuple):
            return type(value)(*map(twice, value))
        return torch.cat([value[:1], value[:1]])

    model = made()
    whole = model(**sources).image
    same = model(**{name: twice(value) for name, value in sources.items()}).image
    assert torch.equal(same[0], whole[0])
    assert not torch.allclose(same[1], whole[1], atol=1e-2)


def test_twice_the_light_is_twice_the_shading(sources) -> None:
    model = made()
    one = model(**sources).rendering
    two = model(**{**sources, "lightmaps": 2 * sources["lightmaps"]}).rendering
    for name in ("diffuse", "specular"):
        torch.testing.assert_close(getattr(two, name), 2 * getattr(one, name), atol=1e-5, rtol=1e-5)
    for name in ("albedo", "normal", "opacity", "depth"):
        assert torch.equal(getattr(two, name), getattr(one, name))


def test_lights_add_up(sources) -> None:
    model = made()
    other = torch.rand(2, 5, 3, 8, 16, generator=torch.Generator().manual_seed(5))
    both = model(**{**sources, "lightmaps": sources["lightmaps"] + other}).rendering
    parts = [model(**{**sources, "lightmaps": m}).rendering for m in (sources["lightmaps"], other)]
    for name in ("diffuse", "specular", "residual", "colour"):
        added = getattr(parts[0], name) + getattr(parts[1], name)
        torch.testing.assert_close(getattr(both, name), added, atol=1e-5, rtol=1e-5)


def test_each_source_changes_its_own(sources) -> None:
    model = made()
    base = model(**sources)
    other = {
        "e_mot": sources["e_mot"].flip(0),
        "lightmaps": sources["lightmaps"].flip(0),
        "control": control(-0.5),
    }
    edits = {name: model(**{**sources, name: value}) for name, value in other.items()}
    assert change(base, edits["e_mot"], "depth") > 0
    assert change(base, edits["control"], "depth") > 0
    assert change(base, edits["lightmaps"], "depth") == 0
    assert change(base, edits["lightmaps"], "colour") > 0
    for name in ("control", "lightmaps"):
        assert torch.equal(edits[name].planes.shading, base.planes.shading)


def test_no_rotation_leaves_normals_and_moves_points_all_the_same(sources) -> None:
    turned = made()(**sources)
    still = made(dataclasses.replace(SMALLEST, rotation="none"))(**sources)
    for name in ("depth", "opacity", "albedo"):
        assert change(turned, still, name) == 0
    assert change(turned, still, "normal") > 0.01
    assert change(turned, still, "diffuse") > 0


def test_the_surface_field_is_another_deformation(sources) -> None:
    preset = dataclasses.replace(SMALLEST, deformation="surface_field", rotation="surface_field")
    mls, surface = made()(**sources), made(preset, faces=faces())(**sources)
    assert change(mls, surface, "depth") > 0
    mixed = made(dataclasses.replace(SMALLEST, rotation="surface_field"), faces=faces())(**sources)
    assert change(mls, mixed, "depth") == 0
    assert change(mls, mixed, "normal") > 0
    with pytest.raises(ValueError, match="needs faces"):
        made(preset)


def test_the_fall_off_changes_the_deformation(sources) -> None:
    paper = made(dataclasses.replace(SMALLEST, alpha=1.0))(**sources)
    assert change(made()(**sources), paper, "depth") > 0


def test_a_plain_decoder_knows_no_light(sources) -> None:
    model = made(dataclasses.replace(SMALLEST, decoder="plain"))
    other = {**sources, "lightmaps": sources["lightmaps"].flip(0)}
    assert torch.equal(model(**sources).image, model(**other).image)


def test_srgb_composes_what_is_shown(sources) -> None:
    linear, shown = made(), made(dataclasses.replace(SMALLEST, colour="srgb"))
    assert torch.equal(shown(**sources).foreground, shown(**sources).rendering.colour)
    assert not torch.equal(linear(**sources).foreground, linear(**sources).rendering.colour)


def test_no_control_points_are_a_head_at_rest(sources) -> None:
    model = made()
    rest = model(**{**sources, "control": control(0.0)})
    none = model(**{**sources, "control": None})
    assert change(rest, none, "depth") < 1e-3
    assert change(rest, none, "normal") < 1e-3


def test_a_window_is_that_part_of_the_picture(sources) -> None:
    model = made()
    window = Window(row=5, column=12, side=16)
    whole, part = model(**sources), model(**sources, window=window)
    assert part.image.shape == (2, 3, 32, 32)
    for name in ("colour", "albedo", "normal", "opacity", "depth"):
        wanted = window.of(getattr(whole.rendering, name))
        torch.testing.assert_close(getattr(part.rendering, name), wanted, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(part.raw, window.of(whole.raw), atol=1e-4, rtol=1e-4)
    inner = (slice(None), slice(None), slice(8, 24), slice(8, 24))
    torch.testing.assert_close(
        part.image[inner], window.of(whole.image, 2)[inner], atol=1e-4, rtol=1e-4
    )


def test_sources_in_another_frame_are_the_same_light(sources) -> None:
    """Turning the lightmaps' frame and saying so changes nothing but their resampling."""
    model = made()
    from totalediting.light.lightmaps import bake, rotate, texel_directions

    angle = math.radians(90)
    turn = torch.tensor(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    light = 1 + texel_directions(32) @ torch.tensor([[0.5, 0.2, 0.3]]).T
    maps = bake(light.expand(-1, -1, 3).contiguous(), 8).expand(2, -1, -1, -1, -1)
    here = model(**{**sources, "lightmaps": maps})
    there = model(
        **{**sources, "lightmaps": rotate(maps, turn.T), "to_light": turn.expand(2, 3, 3)}
    )
    assert change(here, there, "diffuse") < 0.02 * float(here.rendering.diffuse.detach().max())


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_can_be_built(name: str) -> None:
    with torch.device("meta"):
        model = TotalEditing(PRESETS[name])
    assert sum(p.numel() for p in model.parameters()) > 1e5
