"""Skin reflectance: pigments to colour, zone by zone, at every vertex of the head model.

Mottling and pores are drawn by the skin shader from the strengths given here; creases and marks by
`assets_procedural.skin_detail`. Colours are linear Rec.709.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.body.hairline import bare_crown, hairline_distance
from assets_procedural.body.head import HeadModel
from assets_procedural.body.regions import fields
from assets_procedural.mesh.vectors import smoothstep
from assets_procedural.person import ADULT, Person

# Absorbance (-ln reflectance) of bloodless unpigmented skin and of a full measure of each pigment,
# fitted by eye to photographs from Fitzpatrick type I (melanin 0) to VI (melanin 1); the spectral
# slope follows Donner & Jensen 2006: melanin absorbs blue most, haemoglobin green. Faces
# then have hue angles of 45 to 65 degrees in CIELAB, as spectrophotometers find on all ancestries.
BASE = -np.log(np.array([0.80, 0.625, 0.475]))
MELANIN = np.array([2.02, 2.42, 2.74])
HAEMOGLOBIN = np.array([0.10, 0.50, 0.42])
# Perceived pigmentation is not linear in absorbance: equal steps of `melanin` look equal.
_MELANIN_GAMMA = 1.5
# Pigmented skin hides its blood: without this, dark skin turns orange.
_VEILING = 0.55
_ROUGE = (0.40, 0.12, 0.11)


@dataclass(frozen=True)
class SkinFields:
    """Per-vertex inputs of the skin shader: `colour` (V, 3) linear, the others (V,) in [0, 1].

    `sebum` is the weight of the oily coat, `pores` scales relief and specks, `mottling` patches
    of blood, `stubble` shaven hair.
    """

    colour: np.ndarray
    roughness: np.ndarray
    sebum: np.ndarray
    lips: np.ndarray
    pores: np.ndarray
    mottling: np.ndarray
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

    blood = 0.20 + 0.56 * skin.haemoglobin
    haemoglobin = blood * (
        1
        + 0.5 * flush[0] * zone["cheeks"]
        + 0.55 * flush[1] * zone["nose"]
        + 0.9 * flush[2] * zone["ears"]
        + 0.45 * flush[3] * zone["chin"]
        + 0.45 * zone["eyelids"]
        - 0.3 * zone["forehead"]
        - 0.35 * zone["neck"]
    )
    melanin = skin.melanin * (1 - 0.06 * zone["cheeks"] + 0.08 * zone["neck"]) + 0.05 * (
        (1.2 * zone["under_eye"] + 0.6 * zone["eyelids"]) * (0.5 + 0.8 * age)
    )
    colour = reflectance(melanin, haemoglobin)
    # Thin skin under the eyes: veins behind it take the red.
    tired = zone["under_eye"] * (0.35 + 0.5 * age) * rng.uniform(0.4, 1.3)
    colour *= 1 - tired[:, None] * np.array([0.16, 0.12, 0.06])

    lip_melanin = 0.14 + 0.93 * skin.melanin
    # The red is darkest where it meets the skin.
    edge = 0.25 * np.clip(4 * zone["lips"] * (1 - zone["lips"]), 0, 1)
    lips = reflectance(lip_melanin + 0.5 * edge, 1.2 + 0.9 * skin.haemoglobin + edge)
    lips = lips * np.array([0.98, 0.86, 0.92])
    colour += (zone["lips"][:, None] * 0.8) * (lips - colour)
    mucosa = np.array([0.16, 0.035, 0.03])
    colour += zone["mouth_interior"][:, None] * (mucosa - colour)

    # Shaven hair: blue-grey through pale skin, stronger under dark hair, grey hair hardly shows.
    grown = person.beard.style != "none"
    dark = (0.35 + 0.65 * person.hair.melanin) * (1 - 0.7 * person.hair.grey)
    own = 0.2 + 0.8 * np.random.default_rng([skin.seed, 4]).beta(2.0, 2.5)
    shaven = (0.4 + 0.6 * person.beard.density) if grown else own * dark
    shadow = male * shaven * zone["beard"] * (person.age_years > ADULT - 2)
    colour *= 1 - 0.38 * shadow[:, None] * np.array([1.0, 0.93, 0.8])

    # Hair stubble within the skin: without it, partings and short cuts show a bare scalp.
    inside = np.clip(hairline_distance(model.template, person) / 7, 0, 1) * zone["scalp"]
    inside = inside * (1 - 0.9 * bare_crown(model.template, person))
    cover = inside * (0.25 if person.hair.style == "bald" else 0.8) * (1 - 0.6 * person.hair.grey)
    colour *= 1 - (cover * (0.35 + 0.45 * person.hair.melanin))[:, None]

    roughness = 0.44 - 0.12 * skin.oiliness * zone["t_zone"] - 0.04 * skin.oiliness
    roughness = roughness + 0.05 * zone["cheeks"] * (1 - skin.oiliness)
    roughness = roughness + zone["lips"] * (0.34 - roughness)
    roughness = roughness + 0.15 * inside
    roughness = roughness + zone["mouth_interior"] * (0.2 - roughness)
    # The same sheen shows more on dark skin, which scatters less.
    sebum = (0.16 + 0.26 * skin.oiliness) * (1 + 0.5 * skin.melanin)
    sebum = sebum * (0.55 + 0.9 * zone["t_zone"] - 0.25 * zone["neck"])
    sebum = np.maximum(sebum, 0.3 * zone["lips"]) * (1 - 0.7 * inside)
    for paint, strength in _painted(person, zone, model):
        colour += strength[:, None] * (paint - colour)
    powder = max(person.makeup.blush, 0.5 * person.makeup.lipstick)
    sebum = sebum * (1 - 0.4 * powder * (1 - zone["lips"]))

    inner = np.clip(zone["cheeks"] * smoothstep(0.058, 0.036, np.abs(model.template[:, 0])), 0, 1)
    pores = 0.48 + 0.52 * np.maximum.reduce([0.5 * zone["t_zone"], zone["nose"], inner])
    pores *= (1 - 0.75 * zone["eyelids"]) * (1 - 0.6 * zone["lips"]) * (0.68 + 0.45 * age)
    pores *= 1 - 0.2 * powder - 0.2 * zone["neck"]
    # The face, which is out in all weathers, is the most uneven, and more so with the years.
    mottling = 0.6 + 0.25 * age + 0.15 * (zone["cheeks"] + zone["nose"] + zone["chin"])
    mottling = mottling * (0.45 + person.skin.blemishes) - 0.25 * powder
    mottling = mottling - 0.45 * np.maximum(zone["neck"], zone["scalp"]) - 0.6 * zone["lips"]
    return SkinFields(
        colour=np.clip(colour, 0.005, 0.9),
        roughness=np.clip(roughness, 0.15, 0.8),
        sebum=np.clip(sebum, 0, 1),
        lips=np.clip(zone["lips"], 0, 1),
        pores=np.clip(pores, 0, 1),
        mottling=np.clip(mottling, 0, 1),
        stubble=np.clip(shadow, 0, 1),
    )


def _painted(
    person: Person, zone: dict[str, np.ndarray], model: HeadModel
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Colours (3,) of what is painted on, with how much of each vertex it covers (V,)."""
    makeup = person.makeup
    # Paints are chosen to go with the skin: what is deep on pale skin is bright on dark.
    deep = 1 - 0.6 * person.skin.melanin
    x, _, z = np.abs(model.template.T)
    lid = zone["eyelids"] * smoothstep(0.7255, 0.7325, z) * smoothstep(0.744, 0.735, z)
    apple = smoothstep(
        1, 0.2, np.hypot((x - 0.049) / 0.022, (z - 0.7 - 0.35 * (x - 0.049)) / 0.015)
    )
    apple *= 1 - np.clip(zone["ears"] + zone["neck"], 0, 1)
    return [
        (deep * np.array(makeup.lip_colour), 0.8 * makeup.lipstick * zone["lips"]),
        (deep * np.array(makeup.lid_colour), 0.5 * makeup.eyeshadow * lid),
        (deep * np.array(_ROUGE), 0.25 * makeup.blush * apple),
    ]
