"""Skin: pigments darken and redden, people stay within what skin can look like."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.body.head import HeadModel
from assets_procedural.body.regions import fields
from assets_procedural.body.skin import reflectance, skin_fields
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.person import Hair, Makeup, Person, Skin

AMOUNTS = np.linspace(0, 1, 21)


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


def test_reflectance_is_a_share_of_light():
    melanin, haemoglobin = np.meshgrid(np.linspace(0, 1.3, 14), np.linspace(0, 3, 13))
    colour = reflectance(melanin, haemoglobin)
    assert colour.shape == (13, 14, 3)
    assert colour.min() > 0 and colour.max() < 1


@pytest.mark.parametrize("haemoglobin", [0.0, 0.5, 1.0])
def test_melanin_darkens_every_channel(haemoglobin):
    colour = reflectance(AMOUNTS, np.full(21, haemoglobin))
    assert (np.diff(colour, axis=0) < 0).all()
    # Brown: red is absorbed least, blue most.
    assert (np.diff(colour[-1] / colour[0]) < 0).all()


@pytest.mark.parametrize("melanin", [0.0, 0.4, 0.9])
def test_haemoglobin_reddens(melanin):
    colour = reflectance(np.full(21, melanin), AMOUNTS)
    assert (np.diff(colour[:, 0] / colour[:, 1]) > 0).all()
    assert (colour[0] - colour[-1] > 0).all()
    red, green = (colour[0] / colour[-1])[:2]
    assert green > red


def hue(colour: np.ndarray) -> float:
    """The angle of a linear colour (3,) in CIELAB, degrees."""
    xyz = np.array([[0.434, 0.376, 0.190], [0.213, 0.715, 0.072], [0.018, 0.109, 0.873]]) @ colour
    x, y, z = np.cbrt(xyz)  # relative to white
    return float(np.degrees(np.arctan2(200 * (y - z), 500 * (x - y))))


def test_sampled_people_have_skin_colours(model):
    zone = fields(model)
    face = zone["forehead"] > 0.9
    shades = []
    for seed in range(24):
        person = sample_person(np.random.default_rng(seed), PeopleSettings())
        skin = skin_fields(person, model)
        for name, value in vars(skin).items():
            assert np.isfinite(value).all() and value.min() >= 0 and value.max() <= 1, name
        colour = np.median(skin.colour[face], axis=0)
        # From Fitzpatrick type VI to I: linear red .04 to .8, never green or blue.
        assert 0.03 < colour[0] < 0.8, seed
        assert colour[0] > colour[1] > colour[2] > 0.01, seed
        assert 1.1 < colour[0] / colour[2] < 5, seed
        assert 45 < hue(colour) < 68, seed  # as spectrophotometers find, neither pink nor yellow
        shades.append((person.skin.melanin, colour.mean()))
    melanin, brightness = np.array(shades).T
    assert np.corrcoef(melanin, brightness)[0, 1] < -0.85


def test_lips_and_cheeks_are_redder_than_the_forehead(model):
    zone = fields(model)
    colour = skin_fields(Person(), model).colour
    redness = colour[:, 0] / colour[:, 1]
    forehead = np.median(redness[zone["forehead"] > 0.9])
    assert np.median(redness[zone["cheeks"] > 0.9]) > forehead
    assert np.median(redness[zone["lips"] > 0.9]) > forehead


def test_oil_and_pores_lie_where_skin_is_oily(model):
    zone = fields(model)
    plain = skin_fields(Person(skin=Skin(oiliness=0)), model)
    oily = skin_fields(Person(skin=Skin(oiliness=1)), model)
    assert (oily.roughness <= plain.roughness).all() and (oily.sebum >= plain.sebum).all()
    middle, side = zone["t_zone"] > 0.9, (zone["cheeks"] > 0.5) & (zone["t_zone"] < 0.01)
    assert oily.sebum[middle].mean() > 1.5 * oily.sebum[side].mean()
    assert oily.pores[zone["nose"] > 0.9].mean() > 1.2 * oily.pores[zone["eyelids"] > 0.5].mean()


@pytest.mark.parametrize(
    ("paint", "where"), [("lipstick", "lips"), ("eyeshadow", "eyelids"), ("blush", "cheeks")]
)
def test_makeup_colours_its_place_alone(model, paint, where):
    zone = fields(model)
    bare, made_up = (
        skin_fields(Person(makeup=Makeup.model_validate({paint: strength})), model).colour
        for strength in (0, 1)
    )
    changed = np.abs(made_up - bare).max(axis=1) > 0.01
    assert changed.sum() > 20
    assert zone[where][changed].mean() > 0.3
    assert not changed[(zone["forehead"] > 0.9) | (zone["neck"] > 0.9)].any()


def test_a_shaven_beard_shows_on_men_with_dark_hair(model):
    zone = fields(model)
    shades = [
        skin_fields(
            Person(phenotypes={"gender": gender}, hair=Hair(melanin=melanin)), model
        ).stubble[zone["beard"] > 0.9].mean()
        for gender, melanin in ((0, 1.0), (0, 0.1), (1, 1.0))
    ]  # fmt: skip
    assert shades[0] > 1.5 * shades[1] > 0
    assert shades[2] == 0


def test_dark_hair_shades_the_scalp_and_only_the_scalp(model):
    bald, dark = (
        skin_fields(Person(hair=Hair(style=style, melanin=1.0)), model).colour
        for style in ("bald", "buzz")
    )
    scalp = fields(model)["scalp"]
    assert dark[scalp > 0.9].mean() < bald[scalp > 0.9].mean()
    np.testing.assert_array_equal(dark[scalp == 0], bald[scalp == 0])
