"""Ancestries: what people of each look like on average, and how much they differ.

Groups are broad regions of the world, each a place between the three poles that Anny's head space
spans, with features, pigments and hair of its own. People of mixed ancestry lie between groups.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

AncestryGroup = Literal[
    "african", "east_african", "european", "middle_eastern", "south_asian", "east_asian",
    "southeast_asian", "latin_american", "pacific_islander",
]  # fmt: skip
POLES = ("african", "asian", "caucasian")
"""Anny's phenotypes of ancestry, in the order of `Group.poles`."""


@dataclass(frozen=True)
class Group:
    """An ancestry. `poles` are its mean shares of `POLES`, `shape` the means of local changes on
    top of them; `melanin` means and deviations of skin tones with their weights; `curl` mean and
    deviation of the hair's; `fair` the share of natural hair and eyes that may be other than dark;
    `body_hair` the strength of beards and brows."""

    poles: tuple[float, float, float]
    melanin: tuple[tuple[float, float, float], ...]
    curl: tuple[float, float]
    fair: float = 0.0
    body_hair: float = 1.0
    shape: Mapping[str, float] = field(default_factory=dict)


GROUPS: dict[str, Group] = {
    "african": Group(
        (1.0, 0.0, 0.0), ((0.78, 0.1, 0.75), (0.6, 0.09, 0.25)), (0.9, 0.07), body_hair=0.85,
        shape={
            "nose-scale-horiz-incr": 0.22, "nose-flaring-incr": 0.25, "nose-greek-incr": -0.25,
            "nose-width1-incr": 0.2, "mouth-upperlip-volume-incr": 0.2,
            "mouth-lowerlip-volume-incr": 0.22, "mouth-lowerlip-height-incr": 0.1,
            "mouth-trans-forward": 0.16, "chin-prognathism-incr": -0.05,
            "forehead-nubian-incr": 0.04, "±ear-scale-incr": -0.15,
        },
    ),
    "east_african": Group(
        (0.66, 0.0, 0.34), ((0.68, 0.1, 1.0),), (0.78, 0.1), body_hair=0.8,
        shape={
            "nose-scale-horiz-incr": -0.12, "nose-width3-incr": -0.2, "nose-greek-incr": 0.1,
            "nose-scale-vert-incr": 0.15, "head-scale-horiz-incr": -0.1,
            "forehead-scale-vert-incr": 0.1, "±eye-scale-incr": 0.15, "±cheek-volume-incr": -0.2,
            "chin-width-incr": -0.15, "±cheek-bones-incr": 0.15,
        },
    ),
    "european": Group(
        (0.0, 0.0, 1.0), ((0.07, 0.035, 0.7), (0.15, 0.05, 0.3)), (0.3, 0.17), fair=1.0,
        shape={
            "nose-greek-incr": 0.18, "nose-scale-depth-incr": 0.12, "forehead-temple-incr": -0.1,
            "nose-width3-incr": -0.1, "±eye-push1-out": -0.08,
        },
    ),
    "middle_eastern": Group(
        (0.04, 0.04, 0.92), ((0.24, 0.07, 1.0),), (0.42, 0.17), fair=0.12, body_hair=1.25,
        shape={
            "nose-hump-incr": 0.3, "nose-curve-convex": 0.2, "nose-scale-vert-incr": 0.2,
            "nose-scale-depth-incr": 0.2, "nose-point-up": -0.15, "nose-greek-incr": 0.15,
            "eyebrows-trans-up": -0.2, "±eye-scale-incr": 0.1, "±eye-push1-out": -0.12,
            "±eye-bag-incr": 0.15, "mouth-lowerlip-volume-incr": 0.1, "nose-volume-incr": 0.1,
        },
    ),
    "south_asian": Group(
        (0.12, 0.16, 0.72), ((0.5, 0.11, 0.65), (0.34, 0.08, 0.35)), (0.26, 0.15), fair=0.03,
        body_hair=1.2,
        shape={
            "±eye-scale-incr": 0.25, "±eye-height2-incr": 0.15, "±eye-bag-incr": 0.25,
            "nose-volume-incr": 0.15, "nose-width3-incr": 0.12, "nose-point-up": -0.1,
            "mouth-lowerlip-volume-incr": 0.15, "mouth-upperlip-volume-incr": 0.08,
            "head-scale-horiz-incr": -0.06, "±eye-epicanthus-out": 0.15, "eyebrows-trans-up": -0.15,
            "±cheek-volume-incr": 0.08,
        },
    ),
    "east_asian": Group(
        (0.0, 1.0, 0.0), ((0.17, 0.05, 0.75), (0.28, 0.06, 0.25)), (0.06, 0.05), body_hair=0.5,
        shape={
            "±eye-epicanthus-out": -0.45, "±eye-eyefold-up": -0.4, "±eye-eyefold-angle-up": -0.25,
            "±eye-corner2-up": 0.2, "±eye-push1-out": 0.12, "nose-greek-incr": -0.3,
            "nose-scale-depth-incr": -0.1, "±cheek-bones-incr": 0.3, "head-scale-depth-incr": -0.12,
            # The pole's own lips do not quite meet: fuller ones close them.
            "mouth-upperlip-volume-incr": 0.3, "mouth-lowerlip-volume-incr": 0.38,
        },
    ),
    "southeast_asian": Group(
        (0.12, 0.8, 0.08), ((0.36, 0.07, 0.7), (0.5, 0.07, 0.3)), (0.14, 0.1), body_hair=0.5,
        shape={
            "±eye-epicanthus-out": -0.2, "±eye-eyefold-up": -0.1, "±eye-scale-incr": 0.12,
            "nose-greek-incr": -0.3, "nose-scale-horiz-incr": 0.1, "nose-flaring-incr": 0.25,
            "nose-width3-incr": 0.15, "±cheek-bones-incr": 0.25, "chin-width-incr": 0.1,
            "mouth-upperlip-volume-incr": 0.36, "mouth-lowerlip-volume-incr": 0.46,
            "mouth-scale-horiz-incr": 0.1,
        },
    ),
    "latin_american": Group(
        (0.1, 0.34, 0.56), ((0.3, 0.08, 0.7), (0.44, 0.08, 0.3)), (0.22, 0.14), fair=0.08,
        body_hair=0.75,
        shape={
            "±cheek-bones-incr": 0.25, "nose-volume-incr": 0.15, "nose-width3-incr": 0.12,
            "nose-hump-incr": 0.08, "±eye-epicanthus-out": -0.08, "±eye-eyefold-up": -0.1,
            "head-scale-horiz-incr": 0.04, "mouth-lowerlip-volume-incr": 0.15,
            "mouth-upperlip-volume-incr": 0.1,
        },
    ),
    "pacific_islander": Group(
        (0.34, 0.5, 0.16), ((0.44, 0.08, 0.7), (0.62, 0.08, 0.3)), (0.5, 0.2), body_hair=0.8,
        shape={
            "nose-scale-horiz-incr": 0.2, "nose-flaring-incr": 0.2, "nose-volume-incr": 0.2,
            "chin-width-incr": 0.2, "head-fat-incr": 0.1, "measure-neck-circ-incr": 0.2,
            "eyebrows-trans-forward": 0.12, "mouth-scale-horiz-incr": 0.15,
            "mouth-upperlip-volume-incr": 0.2, "mouth-lowerlip-volume-incr": 0.26,
            "±cheek-bones-incr": 0.2,
        },
    ),
}  # fmt: skip
assert set(GROUPS) == set(get_args(AncestryGroup))

FAMILIES: dict[str, tuple[str, ...]] = {
    "asian": ("east_asian", "southeast_asian"),
    "caucasian": ("european", "middle_eastern", "south_asian"),
}
"""Names that stand for several groups at once, in equal parts."""


@dataclass(frozen=True)
class Heritage:
    """A subject's ancestry: `group`, the main one, and `mix`, group to share, of sum 1."""

    group: str
    mix: dict[str, float]
    poles: dict[str, float]
    """Shares of `POLES`, sum 1."""

    def mean(self, attribute: str) -> float:
        """A figure of `Group`, averaged over the mix."""
        return sum(share * getattr(GROUPS[name], attribute) for name, share in self.mix.items())

    def shape(self) -> dict[str, float]:
        """Mean local changes on top of the poles."""
        total: dict[str, float] = {}
        for name, share in self.mix.items():
            for label, value in GROUPS[name].shape.items():
                total[label] = total.get(label, 0.0) + share * value
        return total

    def melanin(self, rng: np.random.Generator) -> float:
        """Draw a skin tone: each group's own are diverse, and a mixture averages the draws."""
        total = 0.0
        for name, share in self.mix.items():
            tones = np.array(GROUPS[name].melanin)
            mean, deviation, _ = tones[rng.choice(len(tones), p=tones[:, 2] / tones[:, 2].sum())]
            total += share * rng.normal(mean, deviation)
        return float(total)

    def curl(self, rng: np.random.Generator) -> float:
        """Draw how curly the hair is, 0 straight to 1 coily."""
        mean = sum(share * GROUPS[name].curl[0] for name, share in self.mix.items())
        deviation = sum(share * GROUPS[name].curl[1] for name, share in self.mix.items())
        return float(rng.normal(mean, deviation))


def draw_heritage(
    rng: np.random.Generator, group: str, weights: Mapping[str, float], mixed: float
) -> Heritage:
    """Draw the ancestry of somebody of a main `group`; the share `mixed` has a second one too.

    `weights` are the frequencies of the second one: a group of weight 0 does not occur.
    """
    others = [name for name, weight in weights.items() if weight > 0.0 and name != group]
    is_mixed = rng.random() < mixed
    pick, part = rng.random(), 0.18 + 0.32 * rng.beta(1.5, 1.0)
    mix = {group: 1.0}
    if is_mixed and others:
        mass = np.cumsum([weights[name] for name in others])
        second = others[int(np.searchsorted(mass, pick * mass[-1], side="right"))]
        mix = {group: round(1.0 - part, 4), second: round(part, 4)}
    shares = np.zeros(3)
    noise = rng.standard_gamma(1.0, (2, 3))
    for (name, share), own in zip(mix.items(), noise, strict=False):
        poles = np.array(GROUPS[name].poles)
        # People of a group that lies between poles differ in how near they are to each.
        drawn = poles * (0.6 + 0.4 * own)
        shares += share * drawn / drawn.sum()
    shares /= shares.sum()
    poles = {pole: round(float(share), 4) for pole, share in zip(POLES, shares, strict=True)}
    return Heritage(group, mix, poles)
