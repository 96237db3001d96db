"""Joint distribution of people: who there is, and how it shows."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from assets_procedural.face_shape import draw_asymmetry, draw_shape
from assets_procedural.person import (
    Beard,
    Brows,
    Colour,
    Earrings,
    Eyes,
    Glasses,
    Hair,
    Hat,
    Person,
    Skin,
    Top,
)
from assets_procedural.settings import Interval, Settings, interval

HairStyle = Literal[
    "bald",
    "buzz",
    "short",
    "side_part",
    "slick_back",
    "bob",
    "long_straight",
    "long_wavy",
    "afro",
    "curly",
    "ponytail",
    "bun",
]


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

    age: Annotated[Interval, interval(5.0, 95.0, "years")] = (18.0, 85.0)
    """Years; drawn from a flattened age pyramid over this interval."""
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


ADULT = 18.0  # years
_POLES = ("african", "asian", "caucasian")

# Relative frequency of a style: women, men, and a factor by hair texture (straight, wavy, coily).
_STYLES: dict[HairStyle, tuple[float, float, tuple[float, float, float]]] = {
    "bald": (0.03, 0.5, (1.0, 1.0, 1.0)),
    "buzz": (0.15, 1.6, (0.8, 0.8, 1.8)),
    "short": (0.9, 3.0, (1.0, 1.0, 0.6)),
    "side_part": (0.5, 2.0, (1.2, 1.0, 0.1)),
    "slick_back": (0.3, 1.0, (1.0, 0.8, 0.2)),
    "bob": (2.0, 0.12, (1.1, 0.9, 0.3)),
    "long_straight": (2.2, 0.2, (1.3, 0.4, 0.25)),
    "long_wavy": (2.0, 0.25, (0.5, 1.8, 0.3)),
    "afro": (1.0, 0.9, (0.0, 0.02, 2.5)),
    "curly": (1.2, 0.8, (0.05, 0.9, 1.8)),
    "ponytail": (1.3, 0.12, (1.0, 1.0, 0.8)),
    "bun": (0.9, 0.15, (1.0, 1.0, 1.0)),
}
_UNDER_HAT: tuple[HairStyle, ...] = (
    "bald", "buzz", "short", "side_part", "bob", "long_straight", "long_wavy",
)  # fmt: skip

# Linear Rec.709 reflectances of irises, dark to light.
_IRISES: dict[str, Colour] = {
    "dark_brown": (0.045, 0.022, 0.012),
    "brown": (0.115, 0.055, 0.025),
    "amber": (0.22, 0.11, 0.035),
    "hazel": (0.16, 0.12, 0.05),
    "green": (0.13, 0.16, 0.085),
    "grey": (0.2, 0.23, 0.25),
    "blue": (0.13, 0.21, 0.32),
}
_IRIS_WEIGHTS_LIGHT = (0.03, 0.2, 0.07, 0.18, 0.12, 0.12, 0.28)
_IRIS_WEIGHTS_MEDIUM = (0.35, 0.42, 0.06, 0.12, 0.03, 0.01, 0.01)

_GARMENTS = (
    "#f2f0eb", "#d9d4c7", "#b8b2a7", "#8a8d91", "#5b5f66", "#33363b", "#1d1f22", "#1f2a44",
    "#2f4b6e", "#5d7fa3", "#a9c1d9", "#27483b", "#5f7355", "#9aa88a", "#6b2737", "#9c3b3b",
    "#c97b63", "#d9a441", "#b5651d", "#7a5c43", "#5a4a6f", "#9d8ab5", "#d8a7b1", "#2c6e6f",
)  # fmt: skip
_METALS: tuple[Colour, ...] = ((0.8, 0.6, 0.25), (0.75, 0.75, 0.77), (0.72, 0.45, 0.33))
_FRAMES = ("#17171a", "#17171a", "#4a2f1d", "#6e4524", "#1f2a44", "#6b2737", "#7d7f83", "#c9b79c")


def sample_person(rng: np.random.Generator, settings: PeopleSettings) -> Person:
    """Draw one subject: ancestry, sex and age first, everything else given them."""
    age = _draw_age(rng, settings.age)
    male = bool(rng.random() < settings.male)
    ancestry = _draw_ancestry(rng, settings)
    skin = _draw_skin(rng, age, male, ancestry)
    hat_wanted = rng.random() < settings.hat
    hair = _draw_hair(rng, age, male, ancestry, skin.melanin, settings, hat_wanted)
    hat = _draw_hat(rng) if hat_wanted and hair.style in _UNDER_HAT else None
    top = _draw_top(rng)
    return Person(
        age_years=round(age, 2),
        phenotypes=_draw_phenotypes(rng, age, male, ancestry),
        shape=draw_shape(rng, ancestry, settings.shape),
        asymmetry=draw_asymmetry(rng, settings.asymmetry),
        skin=skin,
        eyes=_draw_eyes(rng, age, ancestry, skin.melanin, hair),
        hair=hair,
        brows=_draw_brows(rng, age, male),
        beard=_draw_beard(rng, age, male, ancestry, settings.beard),
        top=top,
        glasses=_draw_glasses(rng, age, settings),
        earrings=_draw_earrings(rng, age, male, settings.earrings),
        hat=hat,
    )


def phenotype_age(years: float) -> float:
    """Years to Anny's age in [0, 1]: 1 year 0, 11 years 1/3, 25 years 2/3, 90 years 1."""
    return float(np.interp(years, [1.0, 11.0, 25.0, 90.0], [0.0, 1 / 3, 2 / 3, 1.0]))


def _unit(value: float) -> float:
    return round(float(np.clip(value, 0.0, 1.0)), 4)


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))


def _linear(colour: str) -> Colour:
    """'#rrggbb' (sRGB) to linear Rec.709."""
    values = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    red, green, blue = (
        round(v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4, 4) for v in values
    )
    return red, green, blue


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
        "gender": _unit(dimorphism if male else 1.0 - dimorphism),
        "age": round(phenotype_age(age), 4),
        "muscle": _unit(np.clip(rng.normal(0.55 if male else 0.45, 0.13), 0.15, 0.9)),
        "weight": _unit(np.clip(rng.normal(0.5 + heavier, 0.15), 0.15, 0.95)),
        "height": _unit(np.clip(rng.normal(0.5, 0.13), 0.15, 0.85)),
        "proportions": _unit(rng.beta(2.5, 2.5)),
        "cupsize": _unit(rng.beta(3.0, 4.0)),
        "firmness": _unit(rng.beta(3.0, 3.0)),
        **ancestry,
    }


def _draw_skin(
    rng: np.random.Generator, age: float, male: bool, ancestry: dict[str, float]
) -> Skin:
    # Each pole is itself diverse: its melanin is drawn, and a mixture averages the draws.
    pale = rng.random()
    pole_melanin = {
        "african": rng.normal(0.72, 0.13),
        "asian": rng.normal(0.27, 0.07) if rng.random() < 0.7 else rng.normal(0.42, 0.08),
        "caucasian": rng.normal(0.1, 0.05)
        if pale < 0.62
        else (rng.normal(0.25, 0.06) if pale < 0.88 else rng.normal(0.45, 0.08)),
    }
    melanin = sum(share * float(pole_melanin[pole]) for pole, share in ancestry.items())
    melanin = float(np.clip(melanin + rng.normal(0.0, 0.02), 0.02, 0.97))
    fair = float(np.clip(1.0 - melanin / 0.3, 0.0, 1.0))
    freckled = rng.random() < 0.08 + 0.3 * fair
    lines = np.clip((age - 22.0) / 58.0, 0.0, 1.0) ** 1.15 * (1.0 - 0.25 * melanin)
    youth = np.exp(-(((age - 16.0) / 6.0) ** 2))
    return Skin(
        melanin=_unit(melanin),
        haemoglobin=_unit(rng.normal(0.5 - 0.2 * melanin, 0.15)),
        freckles=_unit(rng.beta(1.5, 2.5) * (0.3 + 0.7 * fair) if freckled else 0.0),
        moles=int(rng.poisson(1.5 + 3.0 * np.clip(age / 60.0, 0.0, 1.0))),
        blemishes=_unit(rng.beta(1.3, 5.0) + 0.35 * youth * rng.random()),
        wrinkles=_unit(lines * rng.uniform(0.75, 1.15) + 0.03),
        oiliness=_unit(rng.beta(2.5, 3.0) * (1.1 if male else 0.95) * (1.15 - age / 200.0)),
        seed=_seed(rng),
    )


def _draw_hair(
    rng: np.random.Generator,
    age: float,
    male: bool,
    ancestry: dict[str, float],
    skin_melanin: float,
    settings: PeopleSettings,
    under_hat: bool,
) -> Hair:
    # Coily hair follows African ancestry, straight hair Asian; the rest is straight to wavy.
    texture = ancestry["african"] * rng.normal(0.85, 0.1) + ancestry["caucasian"] * rng.beta(1.6, 3)
    texture += ancestry["asian"] * rng.beta(1.2, 12.0)
    curl = _unit(texture)
    style = _draw_style(rng, age, male, curl, settings, under_hat)
    dark = 1.0 - ancestry["caucasian"] * float(np.clip(1.0 - (skin_melanin - 0.1) / 0.25, 0.0, 1.0))
    natural = float(
        rng.choice([0.9, 0.72, 0.55, 0.4, 0.22, 0.1], p=[0.12, 0.3, 0.25, 0.15, 0.13, 0.05])
    )
    melanin = dark * rng.uniform(0.86, 1.0) + (1.0 - dark) * natural + rng.normal(0.0, 0.03)
    redness = rng.beta(2.0, 6.0)
    if rng.random() < 0.07 * (1.0 - dark):
        melanin, redness = rng.uniform(0.35, 0.55), rng.uniform(0.7, 1.0)
    dyed = rng.random() < (0.12 if male else 0.45)
    if dyed and rng.random() < 0.3:
        melanin, redness = melanin * rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.7)
    onset = rng.normal(47.0 + 4.0 * (1.0 - ancestry["caucasian"]), 8.0)
    grey = 1.0 / (1.0 + np.exp(-(age - onset - 8.0) / 5.5))
    grey = 0.0 if grey < 0.03 or (dyed and age < 75.0) else grey
    thinning = np.clip((age - 35.0) / 60.0, 0.0, 1.0) * (0.55 if male else 0.3)
    side = float(rng.choice([-1.0, 1.0]))
    parting = 0.0 if rng.random() < 0.3 else side * rng.uniform(0.3, 1.0)
    return Hair(
        style=style,
        melanin=_unit(melanin),
        redness=_unit(redness),
        grey=_unit(grey),
        length=_unit(rng.beta(2.0, 2.0)),
        parting=round(float(parting), 4),
        curl=curl,
        density=_unit(rng.normal(0.82, 0.1) - thinning * rng.random()),
        seed=_seed(rng),
    )


def _draw_style(
    rng: np.random.Generator,
    age: float,
    male: bool,
    curl: float,
    settings: PeopleSettings,
    under_hat: bool,
) -> str:
    allowed = get_args(HairStyle) if settings.hair_styles == "all" else settings.hair_styles
    if under_hat:
        allowed = tuple(style for style in allowed if style in _UNDER_HAT) or allowed
    texture = np.array([np.interp(curl, [0.0, 0.35, 0.7], row) for row in np.eye(3)])
    weights = []
    for style in allowed:
        women, men, by_texture = _STYLES[style]
        weight = (men if male else women) * float(np.dot(by_texture, texture))
        if style == "bald":
            weight *= 0.15 + 4.5 * np.clip((age - 28.0) / 40.0, 0.0, 1.0) if male else 1.0
            weight *= age >= ADULT
        if style in ("long_straight", "long_wavy", "ponytail"):
            weight *= float(np.interp(age, [45.0, 75.0], [1.0, 0.3]))
        if style in ("short", "bob"):
            weight *= float(np.interp(age, [45.0, 75.0], [1.0, 2.0]))
        weights.append(weight)
    total = sum(weights)
    if total <= 0.0:  # only styles that do not go with this hair are allowed: the setting wins
        return str(rng.choice(allowed))
    return str(rng.choice(allowed, p=np.array(weights) / total))


def _draw_eyes(
    rng: np.random.Generator, age: float, ancestry: dict[str, float], melanin: float, hair: Hair
) -> Eyes:
    fair = ancestry["caucasian"] * float(np.clip(1.0 - (melanin - 0.12) / 0.2, 0.0, 1.0))
    fair *= float(np.clip(1.6 - hair.melanin, 0.5, 1.0))
    dark = np.array([0.78, 0.2, 0.01, 0.01, 0.0, 0.0, 0.0])
    medium = max(0.0, ancestry["caucasian"] - fair)
    weights = (1.0 - fair - medium) * dark
    weights = (
        weights + fair * np.array(_IRIS_WEIGHTS_LIGHT) + medium * np.array(_IRIS_WEIGHTS_MEDIUM)
    )
    name = tuple(_IRISES)[rng.choice(len(_IRISES), p=weights / weights.sum())]
    tone = np.exp(rng.normal(0.0, 0.2)) * np.exp(rng.normal(0.0, 0.08, 3))
    red, green, blue = (
        round(float(c), 4) for c in np.clip(np.array(_IRISES[name]) * tone, 0.008, 0.5)
    )
    return Eyes(
        iris=(red, green, blue),
        limbus=_unit(rng.normal(0.65 - 0.3 * np.clip((age - 40.0) / 50.0, 0.0, 1.0), 0.12)),
        # The pupil narrows with age.
        pupil_mm=round(float(np.clip(rng.normal(4.2 - 0.015 * age, 0.6), 2.0, 6.0)), 3),
        redness=_unit(rng.beta(1.6, 6.0) + 0.1 * np.clip((age - 50.0) / 40.0, 0.0, 1.0)),
        seed=_seed(rng),
    )


def _draw_brows(rng: np.random.Generator, age: float, male: bool) -> Brows:
    return Brows(
        thickness=_unit(rng.normal(0.6 if male else 0.42, 0.15)),
        density=_unit(rng.normal(0.68 - 0.25 * np.clip((age - 50.0) / 40.0, 0.0, 1.0), 0.12)),
        seed=_seed(rng),
    )


def _draw_beard(
    rng: np.random.Generator,
    age: float,
    male: bool,
    ancestry: dict[str, float],
    probability: float,
) -> Beard:
    wanted = rng.random() < probability
    thin = 0.6 * ancestry["asian"] + 0.15 * ancestry["african"]
    young = np.clip((age - ADULT) / 8.0, 0.25, 1.0)
    weights = np.array([0.42, 0.1 + 0.1 * thin, 0.18, 0.3 * (1.0 - 0.8 * thin) * young])
    style = str(rng.choice(["stubble", "moustache", "goatee", "full"], p=weights / weights.sum()))
    low, high = {"stubble": (0.5, 2.0), "moustache": (3.0, 9.0)}.get(style, (4.0, 24.0))
    length = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    density = rng.normal(0.72 - 0.3 * thin, 0.12) * (0.6 + 0.4 * young)
    seed = _seed(rng)
    if not (male and age >= ADULT and wanted):
        return Beard(seed=seed)
    return Beard(style=style, length_mm=round(length, 3), density=_unit(density), seed=seed)


def _draw_top(rng: np.random.Generator) -> Top:
    colour, accent = rng.choice(_GARMENTS, 2, replace=False)
    return Top(
        style=str(rng.choice(["tee", "vneck", "crew_sweater", "tank"], p=[0.45, 0.2, 0.25, 0.1])),
        colour=_linear(str(colour)),
        accent=_linear(str(accent)),
        pattern=str(rng.choice(["plain", "stripes"], p=[0.75, 0.25])),
        seed=_seed(rng),
    )


def _draw_glasses(rng: np.random.Generator, age: float, settings: PeopleSettings) -> Glasses | None:
    # (1 - p)^k keeps 0 at 0 and 1 at 1 while older people wear glasses more often.
    exponent = float(np.interp(age, [5.0, 20.0, 40.0, 65.0], [0.4, 1.0, 1.2, 3.0]))
    worn = rng.random() < 1.0 - (1.0 - settings.glasses) ** exponent
    shape = str(rng.choice(["rectangle", "round", "aviator"], p=[0.5, 0.32, 0.18]))
    metal = bool(rng.random() < {"aviator": 0.85, "round": 0.45, "rectangle": 0.3}[shape])
    frame = _linear(str(rng.choice(_FRAMES)))
    colour = _METALS[rng.integers(len(_METALS))] if metal else frame
    tinted = rng.random() < settings.sunglasses
    tint = rng.uniform(0.7, 0.92) if tinted else rng.uniform(0.0, 0.04)
    return Glasses(shape=shape, colour=colour, metal=metal, tint=_unit(tint)) if worn else None


def _draw_earrings(
    rng: np.random.Generator, age: float, male: bool, probability: float
) -> Earrings | None:
    share = 1.0 if age >= 16.0 else 1.0 / 3.0
    worn = rng.random() < probability * share * (1.0 / 7.0 if male else 1.0)
    stud = bool(rng.random() < (0.7 if male else 0.45))
    size = rng.uniform(3.0, 6.0) if stud else np.exp(rng.uniform(np.log(11.0), np.log(38.0)))
    colour = _METALS[rng.integers(len(_METALS))]
    if not worn:
        return None
    shape = "stud" if stud else "hoop"
    return Earrings(shape=shape, size_mm=round(float(size), 2), colour=colour)


def _draw_hat(rng: np.random.Generator) -> Hat:
    colour, accent = rng.choice(_GARMENTS, 2, replace=False)
    return Hat(
        style=str(rng.choice(["beanie", "cap"])),
        colour=_linear(str(colour)),
        accent=_linear(str(accent)),
        seed=_seed(rng),
    )
