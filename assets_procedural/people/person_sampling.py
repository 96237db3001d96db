"""The joint distribution of people: demographics first, appearance given them."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from assets_procedural.hair.styles import STYLES
from assets_procedural.people.appearance_sampling import (
    HairStyle,
    clipped,
    draw_beard,
    draw_brows,
    draw_eyes,
    draw_hair,
    draw_skin,
)
from assets_procedural.people.face_shape import draw_asymmetry, draw_shape
from assets_procedural.people.outfit_sampling import (
    draw_clothes,
    draw_earrings,
    draw_glasses,
    draw_hat,
)
from assets_procedural.person import Person
from assets_procedural.settings import Interval, Settings, interval


class AncestryWeights(Settings):
    """Relative frequencies of the three poles that Anny's head space spans."""

    african: float = Field(default=1.0, ge=0.0)
    asian: float = Field(default=1.0, ge=0.0)
    caucasian: float = Field(default=1.0, ge=0.0)

    @model_validator(mode="after")
    def _some(self) -> AncestryWeights:
        if self.african + self.asian + self.caucasian <= 0.0:
            raise ValueError("at least one of african, asian, caucasian must be above 0")
        return self


class PeopleSettings(Settings):
    """Distribution of people. Probabilities in [0, 1], intervals (low, high)."""

    age: Annotated[Interval, interval(16.0, 95.0, "years")] = (18.0, 85.0)
    """Years; drawn from a flattened age pyramid over this interval. The head has no shapes of
    children."""
    male: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of men."""
    ancestry: AncestryWeights = AncestryWeights()
    """Relative weights of the ancestries."""
    mixed: float = Field(default=0.25, ge=0.0, le=1.0)
    """Share of people of clearly mixed ancestry."""
    shape: float = Field(default=1.0, ge=0.0, le=1.5)
    """Strength of individual head and face shape; 0 gives average faces, 1 is natural."""
    asymmetry: float = Field(default=1.0, ge=0.0, le=2.0)
    """Strength of facial asymmetry; 0 is symmetric, 1 natural."""
    glasses: float = Field(default=0.2, ge=0.0, le=1.0)
    """Probability of glasses for a young adult; older people get them more often."""
    sunglasses: float = Field(default=0.05, ge=0.0, le=1.0)
    """Share of glasses that are strongly tinted."""
    hat: float = Field(default=0.06, ge=0.0, le=1.0)
    """Probability of a hat."""
    earrings: float = Field(default=0.35, ge=0.0, le=1.0)
    """Probability of earrings for a woman; men get a seventh of it, children a third."""
    beard: float = Field(default=0.5, ge=0.0, le=1.0)
    """Probability of visible facial hair, stubble included, for an adult man."""
    hair_styles: Literal["all"] | tuple[HairStyle, ...] = "all"
    """Scalp hair styles that may occur: "all" or a list of names."""

    @model_validator(mode="after")
    def _hair(self) -> PeopleSettings:
        if self.hair_styles != "all":
            if not self.hair_styles:
                raise ValueError('hair_styles is empty; list at least one style or say "all"')
            if len(set(self.hair_styles)) != len(self.hair_styles):
                raise ValueError("hair_styles names a style twice")
        return self


_POLES = ("african", "asian", "caucasian")


def sample_person(rng: np.random.Generator, settings: PeopleSettings) -> Person:
    """Draw one subject: ancestry, sex and age first, everything else given them."""
    age = _draw_age(rng, settings.age)
    male = bool(rng.random() < settings.male)
    ancestry = _draw_ancestry(rng, settings)
    skin = draw_skin(rng, age, male, ancestry)
    allowed = tuple(STYLES) if settings.hair_styles == "all" else settings.hair_styles
    hat_wanted = rng.random() < settings.hat
    hair = draw_hair(rng, age, male, ancestry, skin.melanin, allowed, hat_wanted)
    hat = draw_hat(rng, age, male, STYLES[hair.style].under_hat) if hat_wanted else None
    return Person(
        age_years=round(age, 2),
        phenotypes=_draw_phenotypes(rng, age, male, ancestry),
        shape=draw_shape(rng, ancestry, settings.shape),
        asymmetry=draw_asymmetry(rng, settings.asymmetry),
        skin=skin,
        eyes=draw_eyes(rng, age, ancestry, skin.melanin, hair),
        hair=hair,
        brows=draw_brows(rng, age, male),
        beard=draw_beard(rng, age, male, ancestry, settings.beard),
        **draw_clothes(rng, age, male, hat, hair.style),
        glasses=draw_glasses(rng, age, male, settings.glasses, settings.sunglasses),
        earrings=draw_earrings(rng, age, male, settings.earrings, hat),
        hat=hat,
    )


def phenotype_age(years: float) -> float:
    """Years to Anny's age in [0, 1]: 1 year 0, 11 years 1/3, 25 years 2/3, 90 years 1."""
    return float(np.interp(years, [1.0, 11.0, 25.0, 90.0], [0.0, 1 / 3, 2 / 3, 1.0]))


def _draw_age(rng: np.random.Generator, interval_years: Interval) -> float:
    """A flat pyramid up to 50 years that thins out towards old age."""
    low, high = interval_years
    years = np.linspace(low, high, 257)
    density = np.interp(years, [50.0, 85.0, 95.0], [1.0, 0.45, 0.3])
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return float(np.interp(rng.random() * mass[-1], mass, years))


def _draw_ancestry(rng: np.random.Generator, settings: PeopleSettings) -> dict[str, float]:
    """Shares of the three poles, sum 1; unmixed people keep a little of the others."""
    weights = np.array([getattr(settings.ancestry, pole) for pole in _POLES])
    weights /= weights.sum()
    main = rng.choice(3, p=weights)
    if rng.random() < settings.mixed:
        concentration = 1.2 * (0.4 + 1.8 * weights) * (weights > 0.0)
        concentration[main] += 1.0
    else:
        concentration = 0.25 * (weights > 0.0)
        concentration[main] = 8.0
    shares = rng.standard_gamma(concentration)
    shares /= shares.sum()
    return {pole: round(float(share), 4) for pole, share in zip(_POLES, shares, strict=True)}


def _draw_phenotypes(
    rng: np.random.Generator, age: float, male: bool, ancestry: dict[str, float]
) -> dict[str, float]:
    # Anny: gender 0 is male, 1 female; most people are near an end, few at it.
    dimorphism = 0.4 * rng.beta(1.4, 2.6)
    heavier = 0.05 * np.clip((age - 25.0) / 30.0, 0.0, 1.0)
    return {
        "gender": clipped(dimorphism if male else 1.0 - dimorphism),
        "age": round(phenotype_age(age), 4),
        "muscle": clipped(np.clip(rng.normal(0.55 if male else 0.45, 0.13), 0.15, 0.9)),
        "weight": clipped(np.clip(rng.normal(0.5 + heavier, 0.15), 0.15, 0.95)),
        "height": clipped(np.clip(rng.normal(0.5, 0.13), 0.15, 0.85)),
        "proportions": clipped(rng.beta(2.5, 2.5)),
        **ancestry,
    }
