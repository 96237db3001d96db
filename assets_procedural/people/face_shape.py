"""Individual shape of head and face: which local changes vary, how much, and ancestry's share.

Names are Anny's local change labels; "±name" stands for the pair l-name and r-name.
"""

from __future__ import annotations

import numpy as np

SPREAD: dict[str, float] = {
    # skull
    "head-scale-horiz-incr": 0.14,
    "head-scale-depth-incr": 0.18,
    "head-scale-vert-incr": 0.13,
    "head-angle-out": 0.14,
    "head-fat-incr": 0.28,
    "head-back-scale-depth-incr": 0.16,
    "head-age-incr": 0.25,
    "forehead-trans-forward": 0.16,
    "forehead-scale-vert-incr": 0.14,
    "forehead-temple-incr": 0.3,
    "forehead-nubian-incr": 0.05,
    # brows
    "eyebrows-trans-up": 0.3,
    "eyebrows-angle-up": 0.28,
    "eyebrows-trans-forward": 0.2,
    # eyes
    "±eye-scale-incr": 0.32,
    "±eye-trans-out": 0.3,
    "±eye-trans-up": 0.25,
    "±eye-corner1-up": 0.4,
    "±eye-corner2-up": 0.4,
    "±eye-height1-incr": 0.25,
    "±eye-height2-incr": 0.3,
    "±eye-height3-incr": 0.25,
    "±eye-push1-out": 0.25,
    "±eye-push2-out": 0.25,
    "±eye-eyefold-up": 0.35,
    "±eye-eyefold-angle-up": 0.35,
    "±eye-epicanthus-out": 0.2,
    "±eye-bag-incr": 0.25,
    "±eye-bag-out": 0.2,
    # cheeks
    "±cheek-bones-incr": 0.35,
    "±cheek-volume-incr": 0.32,
    "±cheek-inner-incr": 0.25,
    "±cheek-trans-up": 0.25,
    # nose
    "nose-scale-vert-incr": 0.32,
    "nose-scale-horiz-incr": 0.32,
    "nose-scale-depth-incr": 0.26,
    "nose-trans-up": 0.25,
    "nose-width1-incr": 0.4,
    "nose-width2-incr": 0.4,
    "nose-width3-incr": 0.35,
    "nose-curve-convex": 0.3,
    "nose-hump-incr": 0.38,
    "nose-greek-incr": 0.3,
    "nose-volume-incr": 0.25,
    "nose-compression-uncompress": 0.2,
    "nose-base-up": 0.3,
    "nose-point-up": 0.18,
    "nose-point-width-incr": 0.45,
    "nose-nostrils-width-incr": 0.3,
    "nose-nostrils-angle-up": 0.25,
    "nose-flaring-incr": 0.28,
    "nose-septumangle-incr": 0.25,
    # mouth
    "mouth-scale-horiz-incr": 0.32,
    "mouth-scale-vert-incr": 0.22,
    "mouth-trans-up": 0.22,
    "mouth-trans-forward": 0.18,
    "mouth-upperlip-height-incr": 0.22,
    "mouth-lowerlip-height-incr": 0.28,
    "mouth-upperlip-volume-incr": 0.22,
    "mouth-lowerlip-volume-incr": 0.22,
    "mouth-upperlip-width-incr": 0.22,
    "mouth-lowerlip-width-incr": 0.2,
    "mouth-cupidsbow-incr": 0.25,
    "mouth-cupidsbow-width-incr": 0.35,
    "mouth-philtrum-volume-incr": 0.35,
    "mouth-angles-up": 0.22,
    "mouth-laugh-lines-out": 0.3,
    "mouth-dimples-out": 0.2,
    # jaw and chin
    "chin-height-incr": 0.2,
    "chin-width-incr": 0.28,
    "chin-prominent-incr": 0.22,
    "chin-bones-incr": 0.24,
    "chin-cleft-incr": 0.22,
    "chin-jaw-drop-incr": 0.3,
    "chin-prognathism-incr": 0.18,
    # ears
    "±ear-scale-incr": 0.28,
    "±ear-scale-vert-incr": 0.25,
    "±ear-wing-incr": 0.3,
    "±ear-lobe-incr": 0.35,
    "±ear-rot-forward": 0.2,
    "±ear-flap-incr": 0.15,
    "±ear-shape-round": 0.25,
    "±ear-trans-up": 0.1,
    # neck
    "measure-neck-circ-incr": 0.2,
    "neck-scale-vert-incr": 0.07,
    "neck-scale-depth-incr": 0.15,
    "neck-double-incr": 0.2,
}
"""Standard deviation of each change: 1 to 4 mm at the most moved vertex, as faces vary; less for
lips, which would pass through each other or bare the teeth."""

ANCESTRY_MEAN: dict[str, dict[str, float]] = {
    "african": {
        "nose-scale-horiz-incr": 0.2,
        "nose-flaring-incr": 0.15,
        "nose-greek-incr": -0.2,
        "mouth-upperlip-volume-incr": 0.12,
        "mouth-lowerlip-volume-incr": 0.12,
        "mouth-trans-forward": 0.12,
    },
    "asian": {
        "±eye-epicanthus-out": -0.3,
        "±eye-eyefold-up": -0.25,
        "±eye-corner1-up": 0.2,
        "nose-greek-incr": -0.25,
        "±cheek-bones-incr": 0.25,
        "head-scale-depth-incr": -0.12,
        # The pole's own lips do not quite meet: fuller ones close them.
        "mouth-upperlip-volume-incr": 0.35,
        "mouth-lowerlip-volume-incr": 0.45,
    },
    "caucasian": {
        "nose-greek-incr": 0.15,
        "nose-scale-depth-incr": 0.1,
        "forehead-temple-incr": -0.1,
    },
}
"""Mean of the changes for an unmixed ancestry, on top of the phenotype's own shape."""

ASYMMETRY: tuple[str, ...] = (
    "brown-1", "brown-2", "cheek-1", "cheek-2", "ear-1", "ear-2", "ear-3", "ear-4", "eye-1",
    "eye-2", "eye-3", "eye-4", "eye-5", "eye-6", "eye-7", "eye-8", "jaw-1", "jaw-2", "jaw-3",
    "mouth-1", "mouth-2", "nose-1", "nose-2", "nose-3", "nose-4", "temple-1", "temple-2", "top-1",
    "top-2",
)  # fmt: skip
"""MakeHuman's targets asym-<name>-l and asym-<name>-r."""

_ASYMMETRY_SPREAD = {"top": 0.08, "jaw": 0.16, "ear": 0.2, "brown": 0.18, "cheek": 0.18}
_LIMIT = 2.3  # standard deviations


def draw_shape(
    rng: np.random.Generator, ancestry: dict[str, float], strength: float
) -> dict[str, float]:
    """Local changes in [-1, 1] for a head of the given ancestry shares (sum 1).

    `strength` scales the individual deviation, not the ancestry's mean.
    """
    shape: dict[str, float] = {}
    deviates = np.clip(rng.standard_normal(len(SPREAD)), -_LIMIT, _LIMIT)
    unequal = rng.normal(0.0, 0.12, len(SPREAD))
    for (name, spread), deviate, side in zip(SPREAD.items(), deviates, unequal, strict=True):
        mean = sum(share * ANCESTRY_MEAN[pole].get(name, 0.0) for pole, share in ancestry.items())
        value = mean + strength * spread * deviate
        if name.startswith("±"):
            shape["l-" + name[1:]] = _bounded(value + strength * spread * side)
            shape["r-" + name[1:]] = _bounded(value - strength * spread * side)
        else:
            shape[name] = _bounded(value)
    return shape


def draw_asymmetry(rng: np.random.Generator, strength: float) -> dict[str, float]:
    """Asymmetry targets in [0, 1]; of each left-right pair one at most is active."""
    out: dict[str, float] = {}
    for name, deviate in zip(ASYMMETRY, rng.standard_normal(len(ASYMMETRY)), strict=True):
        spread = _ASYMMETRY_SPREAD.get(name.partition("-")[0], 0.22)
        value = _bounded(strength * spread * abs(float(np.clip(deviate, -_LIMIT, _LIMIT))))
        if value > 0.0:
            out[f"asym-{name}-{'l' if deviate > 0 else 'r'}"] = value
    return out


def _bounded(value: float) -> float:
    return round(float(np.clip(value, -1.0, 1.0)), 4)
