"""How faces vary: the spread of each local change, and the directions in which they vary together.

Names are Anny's local change labels; "±name" stands for the pair l-name and r-name.
"""

from __future__ import annotations

SPREAD: dict[str, float] = {
    # skull
    "head-scale-horiz-incr": 0.14,
    "head-scale-depth-incr": 0.18,
    "head-scale-vert-incr": 0.11,
    "head-angle-out": 0.14,
    "head-fat-incr": 0.26,
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
    "±eye-scale-incr": 0.3,
    "±eye-trans-out": 0.26,
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
    "±eye-bag-height-incr": 0.25,
    # cheeks
    "±cheek-bones-incr": 0.35,
    "±cheek-volume-incr": 0.32,
    "±cheek-inner-incr": 0.25,
    "±cheek-trans-up": 0.25,
    # nose
    "nose-scale-vert-incr": 0.3,
    "nose-scale-horiz-incr": 0.28,
    "nose-scale-depth-incr": 0.24,
    "nose-trans-up": 0.25,
    "nose-trans-forward": 0.12,
    "nose-width1-incr": 0.4,
    "nose-width2-incr": 0.4,
    "nose-width3-incr": 0.32,
    "nose-curve-convex": 0.3,
    "nose-hump-incr": 0.36,
    "nose-greek-incr": 0.3,
    "nose-volume-incr": 0.25,
    "nose-compression-uncompress": 0.2,
    "nose-base-up": 0.3,
    "nose-point-up": 0.18,
    "nose-point-width-incr": 0.42,
    "nose-nostrils-width-incr": 0.3,
    "nose-nostrils-angle-up": 0.25,
    "nose-flaring-incr": 0.28,
    "nose-septumangle-incr": 0.25,
    # mouth
    "mouth-scale-horiz-incr": 0.3,
    "mouth-scale-vert-incr": 0.22,
    "mouth-trans-up": 0.22,
    "mouth-trans-forward": 0.18,
    "mouth-upperlip-height-incr": 0.22,
    "mouth-lowerlip-height-incr": 0.26,
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
    "chin-prognathism-incr": 0.16,
    # ears
    "±ear-scale-incr": 0.28,
    "±ear-scale-vert-incr": 0.25,
    "±ear-scale-depth-incr": 0.2,
    "±ear-wing-incr": 0.3,
    "±ear-lobe-incr": 0.35,
    "±ear-rot-forward": 0.2,
    "±ear-flap-incr": 0.15,
    "±ear-shape-round": 0.25,
    "±ear-shape-triangle": 0.2,
    "±ear-trans-up": 0.1,
    # neck
    "measure-neck-circ-incr": 0.2,
    "neck-scale-vert-incr": 0.07,
    "neck-scale-depth-incr": 0.15,
    "neck-double-incr": 0.2,
}
"""Unit of each change: 1 to 4 mm at the most moved vertex; less for lips, which would pass through
each other or bare the teeth. A face's change is this times its deviate."""

OUTLINES: dict[str, float] = {
    "head-oval": 0.2,
    "head-round": 0.3,
    "head-square": 0.4,
    "head-rectangular": 0.34,
    "head-diamond": 0.13,
    "head-triangular": 0.2,
    "head-invertedtriangular": 0.45,
    "chin-triangle": 0.4,
}
"""Outlines of the head, changes from 0 to 1, and how much of one is common: 3 to 6 mm."""

WHOLE_FACE: dict[str, dict[str, float]] = {
    "long": {
        "head-scale-vert-incr": 1.0, "forehead-scale-vert-incr": 0.6, "nose-scale-vert-incr": 0.9,
        "chin-height-incr": 1.0, "mouth-trans-up": -0.6, "head-scale-horiz-incr": -1.0,
        "head-angle-out": -0.6, "chin-width-incr": -0.5, "±cheek-bones-incr": -0.4,
        "neck-scale-vert-incr": 0.5,
    },
    "broad": {
        "head-scale-horiz-incr": 1.0, "±cheek-bones-incr": 0.9, "head-angle-out": 0.7,
        "chin-width-incr": 0.6, "nose-scale-horiz-incr": 0.6, "mouth-scale-horiz-incr": 0.8,
        "±eye-trans-out": 0.8, "forehead-temple-incr": 0.6, "nose-width1-incr": 0.5,
    },
    "coarse": {
        "nose-volume-incr": 0.9, "nose-point-width-incr": 0.9, "nose-width2-incr": 0.6,
        "nose-scale-depth-incr": 0.6, "mouth-lowerlip-volume-incr": 0.5, "chin-bones-incr": 0.7,
        "chin-prominent-incr": 0.5, "eyebrows-trans-forward": 0.9, "±ear-scale-incr": 0.8,
        "±ear-lobe-incr": 0.5, "mouth-scale-horiz-incr": 0.5, "±eye-scale-incr": -0.6,
        "measure-neck-circ-incr": 0.5, "mouth-laugh-lines-out": 0.6,
    },
    "heavy": {
        "head-fat-incr": 1.2, "±cheek-volume-incr": 1.0, "±cheek-inner-incr": 0.8,
        "neck-double-incr": 1.0, "measure-neck-circ-incr": 0.9, "chin-jaw-drop-incr": 0.6,
        "forehead-temple-incr": 0.6, "±eye-bag-out": 0.4, "±eye-height2-incr": -0.3,
        "±cheek-bones-incr": -0.5, "nose-scale-horiz-incr": 0.3,
    },
    "robust": {
        "eyebrows-trans-forward": 1.0, "eyebrows-trans-up": -0.9, "chin-width-incr": 1.0,
        "chin-prominent-incr": 0.8, "chin-bones-incr": 0.8, "head-angle-out": 0.7,
        "forehead-trans-forward": -0.7, "mouth-upperlip-volume-incr": -0.5,
        "measure-neck-circ-incr": 0.6, "±eye-push1-out": -0.6, "chin-height-incr": 0.5,
    },
    "childlike": {
        "±eye-scale-incr": 1.0, "nose-scale-vert-incr": -0.9, "nose-point-up": 0.8,
        "chin-height-incr": -0.8, "chin-prominent-incr": -0.6, "±cheek-volume-incr": 0.8,
        "forehead-scale-vert-incr": 0.9, "forehead-trans-forward": 0.6, "nose-hump-incr": -0.7,
        "mouth-scale-horiz-incr": -0.6, "nose-scale-depth-incr": -0.6, "±eye-height2-incr": 0.5,
        "chin-width-incr": -0.6,
    },
    "convex": {
        "nose-hump-incr": 1.1, "nose-curve-convex": 0.9, "nose-scale-depth-incr": 0.8,
        "forehead-trans-forward": -0.9, "chin-prominent-incr": -0.9, "mouth-trans-forward": 0.5,
        "chin-prognathism-incr": -0.6, "nose-point-up": -0.7, "nose-greek-incr": 0.5,
    },
    "drooping": {
        "±eye-corner2-up": -1.0, "mouth-angles-up": -0.8, "eyebrows-angle-up": -0.8,
        "±eye-eyefold-up": -0.7, "±eye-bag-incr": 0.6, "±cheek-trans-up": -0.8,
        "nose-base-up": -0.6, "chin-jaw-drop-incr": 0.5,
    },
    "low set": {
        "±eye-trans-up": -0.8, "eyebrows-trans-up": -0.7, "nose-trans-up": -0.8,
        "mouth-trans-up": -0.8, "forehead-scale-vert-incr": 0.8, "±ear-trans-up": -0.6,
        "chin-height-incr": -0.8,
    },
}  # fmt: skip
"""Directions over the whole face: what one standard deviation adds to the deviates of changes."""

PARTS: dict[str, dict[str, dict[str, float]]] = {
    "eyes": {
        "spacing": {"±eye-trans-out": 1.1, "nose-width1-incr": 0.5},
        "size": {"±eye-scale-incr": 1.1, "±eye-height2-incr": 0.4},
        "tilt": {"±eye-corner1-up": -0.7, "±eye-corner2-up": 1.1, "±eye-eyefold-angle-up": 0.5},
        "opening": {
            "±eye-height1-incr": 0.7, "±eye-height2-incr": 1.0, "±eye-height3-incr": 0.7,
            "±eye-eyefold-up": 0.5,
        },
        "almond": {"±eye-height1-incr": 0.9, "±eye-height3-incr": -0.9, "±eye-corner1-up": -0.5},
        "hood": {"±eye-eyefold-up": -1.1, "±eye-eyefold-angle-up": -0.8, "±eye-height3-incr": -0.4},
        "depth": {"±eye-push1-out": 1.0, "±eye-push2-out": 1.0, "eyebrows-trans-forward": -0.5},
        "height": {"±eye-trans-up": 1.0, "eyebrows-trans-up": 0.7},
        "bags": {"±eye-bag-incr": 1.0, "±eye-bag-out": 0.9, "±eye-bag-height-incr": 0.9},
        "inner fold": {"±eye-epicanthus-out": 1.0, "±eye-corner1-up": 0.5},
    },
    "brows": {
        "height": {"eyebrows-trans-up": 1.0, "±eye-eyefold-up": 0.5},
        "slope": {"eyebrows-angle-up": 1.0},
        "ridge": {"eyebrows-trans-forward": 1.0, "forehead-trans-forward": -0.5},
    },
    "nose": {
        "length": {"nose-scale-vert-incr": 1.0, "nose-trans-up": -0.4},
        "bridge width": {"nose-width1-incr": 1.0, "nose-width2-incr": 0.9},
        "wings": {
            "nose-width3-incr": 1.0, "nose-flaring-incr": 0.9, "nose-nostrils-width-incr": 0.8,
            "nose-scale-horiz-incr": 0.7,
        },
        "bridge height": {"nose-greek-incr": 1.1, "nose-scale-depth-incr": 0.5},
        "hump": {"nose-hump-incr": 1.1, "nose-curve-convex": 0.8},
        "tip": {"nose-point-up": 0.9, "nose-base-up": 1.0, "nose-septumangle-incr": 0.8},
        "bulb": {"nose-point-width-incr": 1.1, "nose-volume-incr": 0.7},
        "projection": {"nose-scale-depth-incr": 1.0, "nose-trans-forward": 0.8},
        "nostrils": {"nose-nostrils-angle-up": 1.0, "nose-compression-uncompress": 0.9},
    },
    "mouth": {
        "width": {"mouth-scale-horiz-incr": 1.2},
        "fullness": {
            "mouth-upperlip-volume-incr": 0.9, "mouth-lowerlip-volume-incr": 0.9,
            "mouth-upperlip-height-incr": 0.8, "mouth-lowerlip-height-incr": 0.8,
        },
        "upper lip": {
            "mouth-upperlip-height-incr": 0.8, "mouth-lowerlip-height-incr": -0.7,
            "mouth-upperlip-volume-incr": 0.6, "mouth-lowerlip-volume-incr": -0.5,
        },
        "height": {"mouth-trans-up": 1.1},
        "philtrum": {"mouth-philtrum-volume-incr": 1.0, "mouth-cupidsbow-incr": 0.8},
        "bow": {"mouth-cupidsbow-width-incr": 1.0, "mouth-upperlip-width-incr": 0.8},
        "corners": {"mouth-angles-up": 1.0, "mouth-dimples-out": 0.7},
        "projection": {"mouth-trans-forward": 1.0, "chin-prominent-incr": -0.3},
    },
    "cheeks": {
        "bones": {"±cheek-bones-incr": 1.1, "±cheek-trans-up": 0.6},
        "hollow": {"±cheek-volume-incr": -1.1, "±cheek-inner-incr": -0.9},
        "folds": {"mouth-laugh-lines-out": 1.0, "±cheek-inner-incr": 0.5},
    },
    "jaw": {
        "square": {"chin-width-incr": 1.1, "head-angle-out": 0.6, "chin-bones-incr": 0.6},
        "chin length": {"chin-height-incr": 1.1},
        "chin forward": {"chin-prominent-incr": 1.1, "chin-prognathism-incr": 0.6},
        "cleft": {"chin-cleft-incr": 1.0},
        "jowls": {"chin-jaw-drop-incr": 1.0, "neck-double-incr": 0.5},
        "bones": {"chin-bones-incr": 1.0, "chin-width-incr": -0.6},
    },
    "forehead": {
        "height": {"forehead-scale-vert-incr": 1.1},
        "slope": {"forehead-trans-forward": -1.1, "forehead-nubian-incr": -0.8},
        "temples": {"forehead-temple-incr": 1.1},
    },
    "ears": {
        "size": {"±ear-scale-incr": 1.0, "±ear-scale-vert-incr": 0.7},
        "wings": {"±ear-wing-incr": 1.1, "±ear-flap-incr": 0.5},
        "lobe": {"±ear-lobe-incr": 1.0},
        "outline": {"±ear-shape-round": 1.0, "±ear-shape-triangle": -0.8},
    },
    "skull": {
        "depth": {"head-scale-depth-incr": 1.0, "head-back-scale-depth-incr": 0.6},
        "height": {"head-scale-vert-incr": 0.6},
        "width": {"head-scale-horiz-incr": 0.9},
        "neck": {"measure-neck-circ-incr": 0.9, "neck-scale-depth-incr": 0.8},
    },
}  # fmt: skip
"""Directions of each part of the face, likewise."""

AVERAGE: dict[str, float] = {
    "head-scale-horiz-incr": -0.06, "head-fat-incr": -0.08, "forehead-scale-vert-incr": -0.22,
    "head-scale-vert-incr": -0.05, "±eye-scale-incr": 0.5, "±eye-push1-out": 0.1,
    "±eye-height2-incr": 0.1, "±eye-height3-incr": 0.08, "nose-nostrils-width-incr": 0.2,
    "mouth-scale-horiz-incr": 0.15, "mouth-angles-up": 0.2, "measure-neck-circ-incr": -0.12,
}  # fmt: skip
"""Added to every head: what brings Anny's average face to the measures of real ones."""

FEMALE: dict[str, float] = {
    "eyebrows-trans-up": 0.25, "eyebrows-trans-forward": -0.2, "forehead-trans-forward": 0.12,
    "chin-width-incr": -0.2, "chin-bones-incr": -0.2, "chin-prominent-incr": -0.1,
    "head-angle-out": -0.1, "nose-scale-depth-incr": -0.08, "nose-point-up": 0.08,
    "nose-volume-incr": -0.1, "mouth-upperlip-volume-incr": 0.12,
    "mouth-lowerlip-volume-incr": 0.12, "±eye-scale-incr": 0.1, "measure-neck-circ-incr": -0.25,
    "±cheek-bones-incr": 0.1, "±ear-scale-incr": -0.15,
}  # fmt: skip
"""Added to women on top of the phenotype's own, and two thirds of it taken from men, both less
before they have grown up."""

OLD: dict[str, float] = {
    "±ear-scale-vert-incr": 0.3, "±ear-lobe-incr": 0.5, "nose-scale-vert-incr": 0.15,
    "nose-point-up": -0.2, "nose-base-up": -0.2, "nose-volume-incr": 0.2,
    "mouth-upperlip-volume-incr": -0.3, "mouth-lowerlip-volume-incr": -0.3,
    "mouth-upperlip-height-incr": -0.2, "mouth-lowerlip-height-incr": -0.15,
    "mouth-angles-up": -0.2, "mouth-laugh-lines-out": 0.35, "±eye-eyefold-up": -0.4,
    "±eye-eyefold-angle-up": -0.3, "±eye-bag-incr": 0.45, "±eye-bag-out": 0.3,
    "±eye-height2-incr": -0.15, "±cheek-trans-up": -0.4, "±cheek-volume-incr": -0.2,
    "chin-jaw-drop-incr": 0.45, "neck-double-incr": 0.35, "forehead-temple-incr": -0.3,
    "head-age-incr": 0.35,
}  # fmt: skip
"""Added at 85 years, in parts from 40 on: what sags, thins or goes on growing."""

CHILD: dict[str, float] = {
    "mouth-scale-horiz-incr": -0.5, "mouth-upperlip-volume-incr": -0.3,
    "mouth-lowerlip-volume-incr": -0.35, "mouth-upperlip-height-incr": -0.2,
    "mouth-lowerlip-height-incr": -0.25, "nose-nostrils-width-incr": -0.3,
    "nose-scale-horiz-incr": -0.15, "nose-hump-incr": -0.2, "±eye-scale-incr": -0.15,
    "eyebrows-trans-forward": -0.2, "chin-width-incr": -0.15,
}  # fmt: skip
"""Added at 3 years, in parts up to 14."""
