"""Panoramas as sums of patches and suns, without Blender."""

from __future__ import annotations

import numpy as np
import pytest
from stage_scenes import SUN, write_skies

from assets_procedural.conventions import panorama, panorama_reading
from synthgen.planning.plan import EnvironmentUse
from synthgen.stage.light.patches import PATCHES, basis, find_suns, triangles


def use(name: str, rotation: float) -> EnvironmentUse:
    return EnvironmentUse(id=name, rotation=rotation, exposure=0.0, seed=0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("skies")
    write_skies(place)
    return place


def irradiance(lights, weights: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N, 3) of the sum of a basis' lights, patches as their middles."""
    corners = triangles()
    middle = corners.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    a, b, c = corners.swapaxes(0, 1)
    triple = np.abs(np.einsum("pk,pk->p", a, np.cross(b, c)))
    below = 1 + sum((x * y).sum(-1) for x, y in ((a, b), (b, c), (c, a)))
    area = 2 * np.arctan2(triple, below)
    suns = np.array([sun.irradiance[0] for sun in lights.suns])
    directions = np.concatenate([middle, [sun.direction for sun in lights.suns]])
    power = np.concatenate([lights.strengths * area, suns])
    facing = np.clip(normals @ directions.T, 0, None)
    return (facing * power) @ weights


def test_patches_cover_the_sphere_once():
    inside = [np.linalg.det(each) for each in triangles()]
    assert len(inside) == PATCHES and min(inside) > 0
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    sides = np.cross(triangles(), np.roll(triangles(), -1, axis=1))
    assert ((np.einsum("pck,nk->npc", sides, points) > 0).all(-1).sum(-1) == 1).all()


def test_sums_of_lights_are_the_panoramas_as_they_are_turned(folder):
    uses = [use("soft", 0.7), use("sunny", -1.9)]
    lights = basis(uses, folder)
    assert len(lights.suns) == 1
    assert not lights.weights[0, PATCHES:].any()
    normals = np.random.default_rng(1).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    for each, weights in zip(uses, lights.weights, strict=True):
        whole = panorama_reading.load(folder / f"{each.id}.exr")
        wanted = panorama.irradiance(whole, normals, each.rotation)
        found = irradiance(lights, weights, normals)
        assert np.abs(found - wanted).max() < 0.03 * wanted.max()


def test_a_sun_is_found_where_it_is_as_large_as_it_is(folder):
    suns, rest = find_suns(panorama_reading.load(folder / "sunny.exr"))
    assert len(suns) == 1
    assert np.degrees(np.arccos(suns[0].direction @ SUN)) < 0.7  # half a texel
    assert 0.03 < suns[0].angle < 0.09
    assert rest.max() < 500


def test_every_light_gets_samples_as_it_matters_whatever_its_units(folder):
    """The panoramas differ a hundred times; both are half of what the lights are."""
    lights = basis([use("soft", 0.0), use("sunny", 0.0)], folder)
    assert lights.strengths.max() / lights.strengths.min() < 20
    assert lights.suns[0].irradiance[0] < 5
