"""Skin reflectance: pigments to colour, zone by zone, at every vertex of the head model.

Fine detail (mottling, freckles, pores, wrinkles) is drawn by the skin shader from the strengths
given here; what is here is the part that needs the anatomy. Colours are linear Rec.709.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.body.hairline import bare_crown, hairline_distance
from assets_procedural.body.head import HeadModel
from assets_procedural.body.regions import fields
from assets_procedural.person import Person

# Absorbance (-ln reflectance) of bloodless unpigmented skin and of a full measure of each pigment,
# fitted by eye to photographs from Fitzpatrick type I (melanin 0) to VI (melanin 1); the spectral
# slope follows Donner & Jensen 2006: melanin absorbs blue most, haemoglobin green.
BASE = -np.log(np.array([0.82, 0.61, 0.47]))
MELANIN = np.array([2.00, 2.50, 2.95])
HAEMOGLOBIN = np.array([0.10, 0.50, 0.42])
# Perceived pigmentation is not linear in absorbance: equal steps of `melanin` look equal.
_MELANIN_GAMMA = 1.5
# Pigmented skin hides its blood: without this, dark skin turns orange.
_VEILING = 0.55


@dataclass(frozen=True)
class SkinFields:
    """Per-vertex inputs of the skin shader: `colour` (V, 3) linear, the others (V,) in [0, 1]."""

    colour: np.ndarray
    roughness: np.ndarray
    lips: np.ndarray
    freckles: np.ndarray
    wrinkles: np.ndarray
    pores: np.ndarray
    stubble: np.ndarray


def reflectance(melanin: np.ndarray, haemoglobin: np.ndarray) -> np.ndarray:
    """Linear reflectance (..., 3) of skin by Beer-Lambert from pigment amounts (...)."""
    melanin = np.clip(melanin, 0, 1.3)[..., None]
    pigment = melanin**_MELANIN_GAMMA
    blood = np.clip(haemoglobin, 0, 3)[..., None] * (1 - _VEILING * np.minimum(melanin, 1))
    return np.exp(-(BASE + pigment * MELANIN + blood * HAEMOGLOBIN))


def skin_fields(person: Person, model: HeadModel) -> SkinFields:
    """The subject's skin over the head model's vertices."""
    zone = fields(model)
    skin = person.skin
    rng = np.random.default_rng(skin.seed)
    flush = rng.uniform(0.6, 1.4, 4)
    male = float(np.clip(1 - person.phenotypes.get("gender", 0.5), 0, 1))
    age = np.clip((person.age_years - 20) / 60, 0, 1)

    blood = 0.32 + 0.58 * skin.haemoglobin
    haemoglobin = blood * (
        1
        + 0.5 * flush[0] * zone["cheeks"]
        + 0.45 * flush[1] * zone["nose"]
        + 0.9 * flush[2] * zone["ears"]
        + 0.35 * flush[3] * zone["chin"]
        + 0.45 * zone["eyelids"]
        - 0.2 * zone["forehead"]
        - 0.35 * zone["neck"]
    )
    melanin = skin.melanin * (1 - 0.06 * zone["cheeks"] + 0.08 * zone["neck"]) + 0.05 * (
        (zone["under_eye"] + 0.6 * zone["eyelids"]) * (0.5 + 0.8 * age)
    )
    colour = reflectance(melanin, haemoglobin)

    lip_melanin = 0.1 + 0.75 * skin.melanin
    lips = reflectance(np.full(1, lip_melanin), np.full(1, 1.5 + 0.9 * skin.haemoglobin))
    lips = lips * np.array([0.98, 0.86, 0.92])
    colour += (zone["lips"][:, None] * 0.85) * (lips - colour)
    mucosa = np.array([0.16, 0.035, 0.03])
    colour += zone["mouth_interior"][:, None] * (mucosa - colour)

    has_beard = 1.0 if person.beard.style != "none" else 0.25
    shadow = male * has_beard * zone["beard"] * (0.4 + 0.6 * person.beard.density)
    colour *= 1 - 0.28 * shadow[:, None] * np.array([1.0, 0.92, 0.80])

    # Hair stubble within the skin: without it, partings and short cuts show a bare scalp.
    inside = np.clip(hairline_distance(model.template, person) / 7, 0, 1) * zone["scalp"]
    inside = inside * (1 - 0.9 * bare_crown(model.template, person))
    cover = inside * (0.25 if person.hair.style == "bald" else 0.8) * (1 - 0.6 * person.hair.grey)
    colour *= 1 - (cover * (0.35 + 0.45 * person.hair.melanin))[:, None]

    roughness = 0.52 - 0.16 * skin.oiliness * zone["t_zone"] - 0.04 * skin.oiliness
    roughness = roughness + zone["lips"] * (0.36 - roughness)
    roughness = roughness + 0.15 * inside
    roughness = roughness + zone["mouth_interior"] * (0.2 - roughness)

    wrinkling = skin.wrinkles * (zone["forehead"] + zone["under_eye"] + 0.3 * zone["cheeks"])
    return SkinFields(
        colour=np.clip(colour, 0.005, 0.9),
        roughness=np.clip(roughness, 0.15, 0.8),
        lips=np.clip(zone["lips"], 0, 1),
        freckles=np.clip(
            skin.freckles * (zone["cheeks"] + zone["nose"]) + 0.1 * skin.freckles, 0, 1
        ),
        wrinkles=np.clip(wrinkling, 0, 1),
        pores=np.clip(0.35 + 0.65 * np.maximum(zone["t_zone"], zone["cheeks"]), 0, 1),
        stubble=np.clip(shadow, 0, 1),
    )
