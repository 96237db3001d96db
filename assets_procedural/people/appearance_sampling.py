"""Skin, hair, eyes, brows and beard of a subject, given age, sex and ancestry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from assets_procedural.hair.beard_styles import BEARDS
from assets_procedural.hair.styles import STYLES
from assets_procedural.people.ancestry import Heritage
from assets_procedural.people.choices import Choices, chosen, clipped, draw_seed
from assets_procedural.person import ADULT, Beard, Brows, Colour, Eyes, Hair, Makeup, Skin

if TYPE_CHECKING:
    HairStyle = str
else:  # the names are those of the catalogue
    HairStyle = Literal[tuple(STYLES)]

HAIR_COLOURS = ("black", "brown", "blond", "red", "grey")

# Linear Rec.709 reflectances of irises, dark to light.
_IRISES: dict[str, Colour] = {
    "dark_brown": (0.038, 0.02, 0.012),
    "brown": (0.085, 0.043, 0.021),
    "amber": (0.16, 0.085, 0.033),
    "hazel": (0.16, 0.12, 0.05),
    "green": (0.13, 0.16, 0.085),
    "grey": (0.17, 0.19, 0.2),
    "blue": (0.14, 0.19, 0.25),
}
_HAIR_MELANIN = {
    "black": (0.86, 0.98), "brown": (0.5, 0.84), "blond": (0.08, 0.4), "red": (0.35, 0.58)
}  # fmt: skip
_IRIS_WEIGHTS_LIGHT = (0.03, 0.2, 0.07, 0.18, 0.12, 0.12, 0.28)
_IRIS_WEIGHTS_MEDIUM = (0.35, 0.42, 0.06, 0.12, 0.03, 0.01, 0.01)
# Linear Rec.709 colours of dyed fibres.
_DYES: dict[str, Colour] = {
    "blonde": (0.56, 0.40, 0.20),
    "platinum": (0.62, 0.55, 0.43),
    "copper": (0.36, 0.10, 0.025),
    "red": (0.36, 0.02, 0.025),
    "pink": (0.58, 0.19, 0.30),
    "purple": (0.16, 0.04, 0.26),
    "blue": (0.03, 0.09, 0.34),
    "green": (0.05, 0.22, 0.12),
}
_BLEACHED_DYES, _VIVID_DYES = tuple(_DYES)[:3], tuple(_DYES)[3:]
# Linear Rec.709: reds, pinks, browns and nudes; shadows of the lids.
_LIPSTICKS: tuple[Colour, ...] = (
    (0.36, 0.022, 0.035), (0.27, 0.02, 0.045), (0.45, 0.09, 0.12), (0.50, 0.16, 0.16),
    (0.30, 0.085, 0.065), (0.16, 0.018, 0.03), (0.42, 0.15, 0.11),
)  # fmt: skip
_LID_SHADOWS: tuple[Colour, ...] = (
    (0.13, 0.075, 0.055), (0.06, 0.045, 0.045), (0.22, 0.11, 0.09), (0.10, 0.06, 0.09),
    (0.07, 0.085, 0.11),
)  # fmt: skip
# How common each family of brows is: women, men.
_BROW_STYLES: dict[str, tuple[float, float]] = {
    "natural": (3.0, 4.0),
    "flat": (1.2, 1.8),
    "straight": (1.2, 1.6),
    "arched": (2.2, 0.5),
    "rounded": (1.4, 0.5),
    "bushy": (0.5, 2.2),
    "sparse": (0.9, 1.0),
    "thin": (1.4, 0.15),
}


def draw_skin(rng: np.random.Generator, age: float, male: bool, heritage: Heritage) -> Skin:
    """Pigments by ancestry, lines by age."""
    melanin = heritage.melanin(rng)
    melanin = float(np.clip(melanin + rng.normal(0.0, 0.02), 0.02, 0.97))
    fair = float(np.clip(1.0 - melanin / 0.3, 0.0, 1.0))
    freckled = rng.random() < 0.08 + 0.3 * fair
    lines = np.clip((age - 22.0) / 58.0, 0.0, 1.0) ** 1.15 * (1.0 - 0.25 * melanin)
    youth = np.exp(-(((age - 16.0) / 6.0) ** 2))
    return Skin(
        melanin=clipped(melanin),
        haemoglobin=clipped(rng.normal(0.5 - 0.2 * melanin, 0.15)),
        freckles=clipped(rng.beta(1.5, 2.5) * (0.3 + 0.7 * fair) if freckled else 0.0),
        moles=int(rng.poisson(1.5 + 3.0 * np.clip(age / 60.0, 0.0, 1.0))),
        blemishes=clipped(rng.beta(1.3, 5.0) + 0.35 * youth * rng.random()),
        wrinkles=clipped(lines * rng.uniform(0.75, 1.15) + 0.03),
        oiliness=clipped(rng.beta(2.5, 3.0) * (1.1 if male else 0.95) * (1.15 - age / 200.0)),
        seed=draw_seed(rng),
    )


def draw_makeup(rng: np.random.Generator, age: float, male: bool) -> Makeup:
    """Over half of all women wear some, from a little blush to enough for an evening; men none."""
    wanted = rng.random() < 0.55 and not male and age >= ADULT - 2.0
    fullness = rng.beta(1.2, 1.4)
    lips, lids = (int(rng.integers(len(c))) for c in (_LIPSTICKS, _LID_SHADOWS))
    share = rng.random(4)
    if not wanted:
        return Makeup()
    return Makeup(
        lipstick=clipped((0.35 + 0.6 * fullness) * (share[0] < 0.75)),
        lip_colour=_LIPSTICKS[lips],
        eyeshadow=clipped(0.75 * fullness * (share[1] < 0.6)),
        lid_colour=_LID_SHADOWS[lids],
        blush=clipped(0.2 + 0.6 * fullness * share[2]),
        liner=clipped((0.3 + 0.7 * fullness) * (share[3] < 0.55)),
    )


def draw_hair(
    rng: np.random.Generator,
    age: float,
    male: bool,
    heritage: Heritage,
    skin_melanin: float,
    allowed: tuple[HairStyle, ...],
    under_hat: bool,
    choices: Choices,
) -> Hair:
    """Texture and colour by ancestry, grey and thinning by age, style by all of them and sex."""
    curl = clipped(heritage.curl(rng))
    style = _draw_style(rng, age, male, curl, allowed, under_hat, choices)
    dyed = rng.random() < float(np.interp(age, [14.0, 25.0], [0.0, 0.12 if male else 0.45]))
    dye, regrowth_mm = _draw_dye(rng, age, dyed)
    # Ends bleached on purpose: balayage.
    tips = rng.uniform(0.3, 0.8) if dyed and not male and rng.random() < 0.25 else 0.0
    # Greying starts later where hair is dark.
    onset = rng.normal(51.0 - 4.0 * heritage.mean("fair"), 8.0)
    grey = 1.0 / (1.0 + np.exp(-(age - onset - 8.0) / 5.5))
    grey = 0.0 if dyed and age < 75.0 else grey
    fair = heritage.mean("fair") * float(np.clip(1.0 - (skin_melanin - 0.1) / 0.25, 0.0, 1.0))
    bleached = 0.15 if dyed else 0.0
    natural = {
        "black": (1.0 - fair) * 0.78 + fair * 0.1,
        "brown": (1.0 - fair) * 0.2 + fair * 0.6,
        # Children are blond who will be brown.
        "blond": fair * float(np.interp(age, [3.0, 16.0], [0.45, 0.24])) + bleached,
        "red": fair * 0.06 + bleached * 0.4 + 0.002,
    }
    pigmented = sum(natural.values())
    natural = {name: share * (1.0 - grey) / pigmented for name, share in natural.items()}
    colour = choices.pick("hair_colour", rng, {**natural, "grey": grey if grey > 0.03 else 0.0})
    base = "black" if rng.random() < 1.0 - fair else "brown"
    low, high = _HAIR_MELANIN[base if colour == "grey" else colour]
    melanin = rng.uniform(low, high)
    redness = rng.uniform(0.7, 1.0) if colour == "red" else rng.beta(2.0, 6.0)
    white = rng.beta(4.0, 1.5)
    white = 0.45 + 0.55 * white if colour == "grey" else min(0.5 * grey, 0.35)
    thinning = np.clip((age - 35.0) / 60.0, 0.0, 1.0) * (0.55 if male else 0.3)
    receding, bare = _draw_loss(rng, age, male)
    side = float(rng.choice([-1.0, 1.0]))
    # One in seven near the middle; the others are spread over the side.
    aside = float(np.interp(rng.random(), [0.0, 0.14, 0.15, 1.0], [0.0, 0.1, 0.3, 1.0]))
    return Hair(
        style=style,
        colour=colour,
        melanin=clipped(melanin),
        redness=clipped(redness),
        grey=clipped(white if white > 0.03 else 0.0),
        length=clipped(rng.beta(2.0, 2.0)),
        parting=round(side * aside, 4),
        curl=curl,
        density=clipped(rng.normal(0.82, 0.1) - thinning * rng.random()),
        receding=clipped(max(receding, STYLES[style].receding)),
        thinning=clipped(max(bare, STYLES[style].thinning)),
        dye=dye,
        regrowth_mm=regrowth_mm,
        tips=clipped(tips),
        seed=draw_seed(rng),
    )


def _draw_loss(rng: np.random.Generator, age: float, male: bool) -> tuple[float, float]:
    """How far a man's hairline has receded and how bare his crown is, by age and luck; women 0."""
    degree, crown = rng.random(2)
    if not male:
        return 0.0, 0.0
    aged = float(np.clip((age - 26.0) / 50.0, 0.0, 1.0))
    receding = aged * (0.15 + 0.85 * degree**1.5)
    bare = aged * degree * (1.4 * crown - 0.7)
    return receding, max(0.0, bare)


def _draw_dye(rng: np.random.Generator, age: float, dyed: bool) -> tuple[Colour | None, float]:
    """A colour that hair does not grow in, and millimetres of regrowth below it; mostly none."""
    vivid = rng.random() < 0.35
    name = str(rng.choice(_VIVID_DYES if vivid else _BLEACHED_DYES))
    regrowth = float(rng.choice([0.0, rng.uniform(5.0, 60.0)], p=[0.4, 0.6]))
    chance = (0.16 if dyed else 0.015) * float(np.interp(age, [30.0, 65.0], [1.0, 0.25]))
    if rng.random() > chance:
        return None, 0.0
    return _DYES[name], round(regrowth, 1)


def _draw_style(
    rng: np.random.Generator,
    age: float,
    male: bool,
    curl: float,
    allowed: tuple[HairStyle, ...],
    under_hat: bool,
    choices: Choices,
) -> str:
    if under_hat:
        allowed = tuple(style for style in allowed if STYLES[style].under_hat) or allowed
    natural = {style: STYLES[style].popularity.weight(age, male, curl) for style in allowed}
    if sum(natural.values()) <= 0.0:  # only styles that do not go with this hair: the setting wins
        natural = dict.fromkeys(allowed, 1.0)
    return choices.pick("hair_style", rng, natural)


def draw_eyes(
    rng: np.random.Generator, age: float, heritage: Heritage, melanin: float, hair: Hair
) -> Eyes:
    """Iris colour by ancestry, skin and hair; the rest by age."""
    fair = heritage.mean("fair") * float(np.clip(1.0 - (melanin - 0.12) / 0.2, 0.0, 1.0))
    fair *= float(np.clip(1.6 - hair.melanin, 0.5, 1.0))
    dark = np.array([0.78, 0.2, 0.01, 0.01, 0.0, 0.0, 0.0])
    medium = max(0.0, 0.6 * heritage.poles["caucasian"] - fair)
    weights = (1.0 - fair - medium) * dark
    weights = (
        weights + fair * np.array(_IRIS_WEIGHTS_LIGHT) + medium * np.array(_IRIS_WEIGHTS_MEDIUM)
    )
    name = chosen(rng, dict(zip(_IRISES, weights, strict=True)))
    tone = np.exp(rng.normal(0.0, 0.2)) * np.exp(rng.normal(0.0, 0.08, 3))
    red, green, blue = (
        round(float(c), 4) for c in np.clip(np.array(_IRISES[name]) * tone, 0.008, 0.5)
    )
    return Eyes(
        iris=(red, green, blue),
        limbus=clipped(rng.normal(0.65 - 0.3 * np.clip((age - 40.0) / 50.0, 0.0, 1.0), 0.12)),
        # The pupil narrows with age.
        pupil_mm=round(float(np.clip(rng.normal(4.2 - 0.015 * age, 0.6), 2.0, 6.0)), 3),
        redness=clipped(rng.beta(1.6, 6.0) + 0.1 * np.clip((age - 50.0) / 40.0, 0.0, 1.0)),
        seed=draw_seed(rng),
    )


def draw_brows(rng: np.random.Generator, age: float, male: bool) -> Brows:
    """A family by sex, then an outline of one's own; thicker for men, thinner with age."""
    styles = {name: pair[male] for name, pair in _BROW_STYLES.items()}
    thin = np.clip((age - 50.0) / 40.0, 0.0, 1.0)

    def spread(scale: float) -> float:
        return round(float(np.clip(rng.normal(0.0, scale), -2.4 * scale, 2.4 * scale)), 4)

    return Brows(
        style=chosen(rng, styles),
        height_mm=spread(1.3),
        slope=spread(0.04),
        arch_mm=spread(1.0),
        taper=spread(0.35),
        start_mm=spread(1.8),
        thickness=clipped(rng.normal(0.58 if male else 0.42, 0.17)),
        density=clipped(rng.normal(0.68 - 0.25 * thin, 0.13)),
        seed=draw_seed(rng),
    )


def draw_beard(
    rng: np.random.Generator,
    age: float,
    male: bool,
    heritage: Heritage,
    probability: float,
    choices: Choices,
) -> Beard:
    """Facial hair for the share `probability` of adult men, none for everyone else."""
    thick = min(heritage.mean("body_hair"), 1.0)
    young = float(np.clip((age - ADULT) / 8.0, 0.25, 1.0))
    can = probability if male and age >= ADULT else 0.0
    # A thin or young growth shows as stubble or a moustache rather than as a whole beard.
    whole = float(np.clip(1.6 * thick - 0.6, 0.2, 1.0)) * young
    styles = {
        "stubble": 0.40,
        "moustache": 0.18 - 0.1 * thick,
        "goatee": 0.14,
        "boxed": 0.16 * whole,
        "full": 0.18 * whole,
        "long": 0.05 * whole,
        "sideburns": 0.03,
    }
    total = sum(styles.values())
    natural = {"none": 1.0 - can, **{name: can * s / total for name, s in styles.items()}}
    style = choices.pick("beard", rng, natural)
    low, high = BEARDS[style].length_mm if style != "none" else (1.0, 1.0)
    length = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    density = rng.normal(0.42 + 0.3 * thick, 0.12) * (0.6 + 0.4 * young)
    seed = draw_seed(rng)
    if style == "none":
        return Beard(seed=seed)
    return Beard(style=style, length_mm=round(length, 3), density=clipped(density), seed=seed)
