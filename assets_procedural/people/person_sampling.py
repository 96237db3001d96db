"""The joint distribution of people: demographics first, appearance given them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from assets_procedural.hair.styles import STYLES
from assets_procedural.people.ages import phenotype_age
from assets_procedural.people.ancestry import Heritage
from assets_procedural.people.appearance_sampling import draw_brows, draw_eyes, draw_makeup
from assets_procedural.people.choices import Choices, clipped
from assets_procedural.people.face_shape import draw_asymmetry, draw_shape
from assets_procedural.people.kinds import Kind, draw_kind
from assets_procedural.people.outfit_sampling import (
    draw_clothes,
    draw_earrings,
    draw_glasses,
    draw_hat,
)
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.quotas import factors
from assets_procedural.person import Person


def sample_person(
    rng: np.random.Generator, settings: PeopleSettings, points: Mapping[str, float] | None = None
) -> Person:
    """Draw one subject: ancestry, sex and age first, everything else given them.

    `points` (`quotas.quota_points`) place the attributes that have quotas; without it they are left
    to chance as the others are, with the same frequencies.

    Raises:
        QuotaError: see `quotas.factors`.
    """
    kind = draw_kind(rng, settings, Choices(factors(settings), points or {}))
    return draw_person(rng, settings, kind)


def draw_person(rng: np.random.Generator, settings: PeopleSettings, kind: Kind) -> Person:
    """A person of a kind."""
    age, male, heritage, skin, hair = kind.age, kind.male, kind.heritage, kind.skin, kind.hair
    hat = draw_hat(rng, age, male, STYLES[hair.style].under_hat) if kind.hat else None
    tinted = float(kind.glasses == "sunglasses")
    return Person(
        sex="male" if male else "female",
        age_group=kind.age_group,
        ancestry=heritage.group,
        ancestry_mix=heritage.mix,
        age_years=age,
        phenotypes=_draw_phenotypes(rng, age, male, heritage),
        shape=draw_shape(rng, heritage, age, male, settings.shape),
        asymmetry=draw_asymmetry(rng, settings.asymmetry),
        skin=skin,
        eyes=draw_eyes(rng, age, heritage, skin.melanin, hair),
        hair=hair,
        brows=draw_brows(rng, age, male),
        beard=kind.beard,
        **draw_clothes(rng, age, male, hat, hair.style),
        glasses=draw_glasses(rng, age, male, float(kind.glasses != "none"), tinted),
        earrings=draw_earrings(rng, age, male, settings.earrings, hat),
        hat=hat,
        makeup=draw_makeup(rng, age, male),
    )


def _draw_phenotypes(
    rng: np.random.Generator, age: float, male: bool, heritage: Heritage
) -> dict[str, float]:
    # Anny: gender 0 is male, 1 female; most people are near an end, few at it, children between.
    dimorphism = 0.4 * rng.beta(1.4, 2.6)
    dimorphism += (0.3 - 0.5 * dimorphism) * float(np.interp(age, [8.0, 17.0], [1.0, 0.0]))
    heavier = 0.05 * np.clip((age - 25.0) / 30.0, 0.0, 1.0)
    return {
        "gender": clipped(dimorphism if male else 1.0 - dimorphism),
        "age": round(phenotype_age(age), 4),
        "muscle": clipped(np.clip(rng.normal(0.55 if male else 0.45, 0.13), 0.15, 0.9)),
        "weight": clipped(np.clip(rng.normal(0.5 + heavier, 0.16), 0.12, 0.97)),
        "height": clipped(np.clip(rng.normal(0.5, 0.13), 0.15, 0.85)),
        "proportions": clipped(rng.beta(2.5, 2.5)),
        **heritage.poles,
    }
