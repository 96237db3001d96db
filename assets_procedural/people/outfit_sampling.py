"""Tops, glasses, earrings and hats of a subject."""

from __future__ import annotations

import numpy as np

from assets_procedural.conventions.colour import srgb_decode
from assets_procedural.people.appearance_sampling import clipped, draw_seed
from assets_procedural.person import Colour, Earrings, Glasses, Hat, Top

_GARMENTS = (
    "#f2f0eb", "#d9d4c7", "#b8b2a7", "#8a8d91", "#5b5f66", "#33363b", "#1d1f22", "#1f2a44",
    "#2f4b6e", "#5d7fa3", "#a9c1d9", "#27483b", "#5f7355", "#9aa88a", "#6b2737", "#9c3b3b",
    "#c97b63", "#d9a441", "#b5651d", "#7a5c43", "#5a4a6f", "#9d8ab5", "#d8a7b1", "#2c6e6f",
)  # fmt: skip
_METALS: tuple[Colour, ...] = ((0.8, 0.6, 0.25), (0.75, 0.75, 0.77), (0.72, 0.45, 0.33))
_FRAMES = ("#17171a", "#17171a", "#4a2f1d", "#6e4524", "#1f2a44", "#6b2737", "#7d7f83", "#c9b79c")


def _linear(colour: str) -> Colour:
    """'#rrggbb' (sRGB) to linear Rec.709."""
    encoded = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    red, green, blue = (round(float(value), 4) for value in srgb_decode(encoded))
    return red, green, blue


def draw_top(rng: np.random.Generator) -> Top:
    """Style, colours and pattern of a top."""
    colour, accent = rng.choice(_GARMENTS, 2, replace=False)
    return Top(
        style=str(rng.choice(["tee", "vneck", "crew_sweater", "tank"], p=[0.45, 0.2, 0.25, 0.1])),
        colour=_linear(str(colour)),
        accent=_linear(str(accent)),
        pattern=str(rng.choice(["plain", "stripes", "ringer"], p=[0.65, 0.22, 0.13])),
        seed=draw_seed(rng),
    )


def glasses_share(age: float, probability: float) -> float:
    """Share of people of an age that wear glasses, where `probability` of the young ones do."""
    # (1 - p)^k keeps 0 at 0 and 1 at 1 while older people wear glasses more often.
    exponent = float(np.interp(age, [5.0, 20.0, 40.0, 65.0], [0.4, 1.0, 1.2, 3.0]))
    return 1.0 - (1.0 - probability) ** exponent


def draw_glasses(
    rng: np.random.Generator, age: float, probability: float, sunglasses: float
) -> Glasses | None:
    """Glasses or none; `sunglasses` is the share with tinted lenses."""
    worn = rng.random() < glasses_share(age, probability)
    shape = str(rng.choice(["rectangle", "round", "aviator"], p=[0.5, 0.32, 0.18]))
    metal = bool(rng.random() < {"aviator": 0.85, "round": 0.45, "rectangle": 0.3}[shape])
    frame = _linear(str(rng.choice(_FRAMES)))
    colour = _METALS[rng.integers(len(_METALS))] if metal else frame
    tinted = rng.random() < sunglasses
    tint = rng.uniform(0.7, 0.92) if tinted else rng.uniform(0.0, 0.04)
    return Glasses(shape=shape, colour=colour, metal=metal, tint=clipped(tint)) if worn else None


def draw_earrings(
    rng: np.random.Generator, age: float, male: bool, probability: float
) -> Earrings | None:
    """Earrings or none."""
    share = 1.0 if age >= 16.0 else 1.0 / 3.0
    worn = rng.random() < probability * share * (1.0 / 7.0 if male else 1.0)
    stud = bool(rng.random() < (0.7 if male else 0.45))
    size = rng.uniform(3.0, 6.0) if stud else np.exp(rng.uniform(np.log(11.0), np.log(38.0)))
    colour = _METALS[rng.integers(len(_METALS))]
    if not worn:
        return None
    shape = "stud" if stud else "hoop"
    return Earrings(shape=shape, size_mm=round(float(size), 2), colour=colour)


def draw_hat(rng: np.random.Generator) -> Hat:
    """A hat, for those who wear one."""
    colour, accent = rng.choice(_GARMENTS, 2, replace=False)
    return Hat(
        style=str(rng.choice(["beanie", "cap"])),
        colour=_linear(str(colour)),
        accent=_linear(str(accent)),
        seed=draw_seed(rng),
    )
