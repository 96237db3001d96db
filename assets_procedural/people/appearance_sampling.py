"""Skin, hair, eyes, brows and beard of a subject, given age, sex and ancestry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from assets_procedural.hair.styles import STYLES
from assets_procedural.person import ADULT, Beard, Brows, Colour, Eyes, Hair, Skin

if TYPE_CHECKING:
    HairStyle = str
else:  # the names are those of the catalogue
    HairStyle = Literal[tuple(STYLES)]

Ancestry = dict[str, float]
"""Shares of "african", "asian" and "caucasian", sum 1."""

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
_IRIS_WEIGHTS_LIGHT = (0.03, 0.2, 0.07, 0.18, 0.12, 0.12, 0.28)
_IRIS_WEIGHTS_MEDIUM = (0.35, 0.42, 0.06, 0.12, 0.03, 0.01, 0.01)


def clipped(value: float) -> float:
    """Clip to [0, 1] and round, so that JSON stays short."""
    return round(float(np.clip(value, 0.0, 1.0)), 4)


def draw_seed(rng: np.random.Generator) -> int:
    """Draw the seed of a texture or of strands, which is stored with the parameters."""
    return int(rng.integers(2**31))


def draw_skin(rng: np.random.Generator, age: float, male: bool, ancestry: Ancestry) -> Skin:
    """Pigments by ancestry, lines by age; ancestry poles are themselves diverse."""
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
        melanin=clipped(melanin),
        haemoglobin=clipped(rng.normal(0.5 - 0.2 * melanin, 0.15)),
        freckles=clipped(rng.beta(1.5, 2.5) * (0.3 + 0.7 * fair) if freckled else 0.0),
        moles=int(rng.poisson(1.5 + 3.0 * np.clip(age / 60.0, 0.0, 1.0))),
        blemishes=clipped(rng.beta(1.3, 5.0) + 0.35 * youth * rng.random()),
        wrinkles=clipped(lines * rng.uniform(0.75, 1.15) + 0.03),
        oiliness=clipped(rng.beta(2.5, 3.0) * (1.1 if male else 0.95) * (1.15 - age / 200.0)),
        seed=draw_seed(rng),
    )


def draw_hair(
    rng: np.random.Generator,
    age: float,
    male: bool,
    ancestry: Ancestry,
    skin_melanin: float,
    allowed: tuple[HairStyle, ...],
    under_hat: bool,
) -> Hair:
    """Texture and colour by ancestry, grey and thinning by age, style by all of them and sex."""
    # Coily hair follows African ancestry, straight hair Asian; the rest is straight to wavy.
    texture = ancestry["african"] * rng.normal(0.85, 0.1) + ancestry["caucasian"] * rng.beta(1.6, 3)
    texture += ancestry["asian"] * rng.beta(1.2, 12.0)
    curl = clipped(texture)
    style = _draw_style(rng, age, male, curl, allowed, under_hat)
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
        melanin=clipped(melanin),
        redness=clipped(redness),
        grey=clipped(grey),
        length=clipped(rng.beta(2.0, 2.0)),
        parting=round(float(parting), 4),
        curl=curl,
        density=clipped(rng.normal(0.82, 0.1) - thinning * rng.random()),
        seed=draw_seed(rng),
    )


def _draw_style(
    rng: np.random.Generator,
    age: float,
    male: bool,
    curl: float,
    allowed: tuple[HairStyle, ...],
    under_hat: bool,
) -> str:
    if under_hat:
        allowed = tuple(style for style in allowed if STYLES[style].under_hat) or allowed
    weights = [STYLES[style].popularity.weight(age, male, curl) for style in allowed]
    total = sum(weights)
    if total <= 0.0:  # only styles that do not go with this hair are allowed: the setting wins
        return str(rng.choice(allowed))
    return str(rng.choice(allowed, p=np.array(weights) / total))


def draw_eyes(
    rng: np.random.Generator, age: float, ancestry: Ancestry, melanin: float, hair: Hair
) -> Eyes:
    """Iris colour by ancestry, skin and hair; the rest by age."""
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
        limbus=clipped(rng.normal(0.65 - 0.3 * np.clip((age - 40.0) / 50.0, 0.0, 1.0), 0.12)),
        # The pupil narrows with age.
        pupil_mm=round(float(np.clip(rng.normal(4.2 - 0.015 * age, 0.6), 2.0, 6.0)), 3),
        redness=clipped(rng.beta(1.6, 6.0) + 0.1 * np.clip((age - 50.0) / 40.0, 0.0, 1.0)),
        seed=draw_seed(rng),
    )


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


def draw_brows(rng: np.random.Generator, age: float, male: bool) -> Brows:
    """A family by sex, then an outline of one's own; thicker for men, thinner with age."""
    weights = np.array([pair[male] for pair in _BROW_STYLES.values()])
    thin = np.clip((age - 50.0) / 40.0, 0.0, 1.0)

    def spread(scale: float) -> float:
        return round(float(np.clip(rng.normal(0.0, scale), -2.4 * scale, 2.4 * scale)), 4)

    return Brows(
        style=tuple(_BROW_STYLES)[rng.choice(len(weights), p=weights / weights.sum())],
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
    ancestry: Ancestry,
    probability: float,
) -> Beard:
    """Facial hair for the share `probability` of adult men, none for everyone else."""
    wanted = rng.random() < probability
    thin = 0.6 * ancestry["asian"] + 0.15 * ancestry["african"]
    young = np.clip((age - ADULT) / 8.0, 0.25, 1.0)
    weights = np.array([0.42, 0.1 + 0.1 * thin, 0.18, 0.3 * (1.0 - 0.8 * thin) * young])
    style = str(rng.choice(["stubble", "moustache", "goatee", "full"], p=weights / weights.sum()))
    low, high = {"stubble": (0.5, 2.0), "moustache": (3.0, 9.0)}.get(style, (4.0, 24.0))
    length = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    density = rng.normal(0.72 - 0.3 * thin, 0.12) * (0.6 + 0.4 * young)
    seed = draw_seed(rng)
    if not (male and age >= ADULT and wanted):
        return Beard(seed=seed)
    return Beard(style=style, length_mm=round(length, 3), density=clipped(density), seed=seed)
