"""Choices for a subject: of named values, by natural frequencies and a job's weights and quotas; of
seeds and of whatever has weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np

Attribute = Literal[
    "sex", "age_group", "ancestry", "hair_style", "hair_colour", "beard", "glasses", "hat"
]  # fmt: skip
ATTRIBUTES: tuple[Attribute, ...] = get_args(Attribute)
"""What has named values. The order matters: `spread_points` and quotas go through it."""
_STEPS = tuple(math.sqrt(n) % 1.0 for n in (2, 3, 5, 7, 11, 13, 17, 19))

Factors = Mapping[Attribute, Mapping[str, float]]
"""Attribute → value → what the natural frequency is multiplied by; 1 where not named."""


class Choices:
    """Draws named values for one subject.

    `factors` multiply the natural frequencies. The attributes in `points` are not left to chance:
    they take the given number in [0, 1) for theirs. The frequencies that each attribute was
    picked from are kept in `frequencies`.
    """

    def __init__(self, factors: Factors, points: Mapping[str, float]) -> None:
        self._factors, self._points = factors, points
        self.frequencies: dict[Attribute, dict[str, float]] = {}

    def pick(
        self, attribute: Attribute, rng: np.random.Generator, natural: Mapping[str, float]
    ) -> str:
        """One of the values of `natural`, whose frequencies need no sum. Draws one number always.

        Where the factors leave none of them, the natural frequencies hold.
        """
        chance = rng.random()
        factors = self._factors.get(attribute, {})
        frequencies = {v: f * factors.get(v, 1.0) for v, f in natural.items()}
        if sum(frequencies.values()) <= 0.0:
            frequencies = dict(natural)
        mass = np.cumsum(list(frequencies.values()))
        place = self._points.get(attribute, chance) * mass[-1]
        index = min(int(np.searchsorted(mass, place, side="right")), len(mass) - 1)
        self.frequencies[attribute] = frequencies
        return list(frequencies)[index]


def chosen(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """A key, by relative weights."""
    names, share = list(weights), np.array(list(weights.values()), float)
    return names[rng.choice(len(names), p=share / share.sum())]


def clipped(value: float) -> float:
    """Clip to [0, 1] and round, so that JSON stays short."""
    return round(min(max(float(value), 0.0), 1.0), 4)


def draw_seed(rng: np.random.Generator) -> int:
    """Draw the seed of a texture or of strands, which is stored with the parameters."""
    return int(rng.integers(2**31))


def spread_points(index: int, rng: np.random.Generator) -> dict[str, float]:
    """A point in [0, 1) for each attribute: over indices 0, 1, 2 … they fill it evenly.

    `rng` shifts them all and must be in the same state for every index: additive recurrences by
    square roots of primes, whose discrepancy falls nearly with one over the number of points.
    """
    shifts = rng.random(len(ATTRIBUTES))
    values = (shifts + (index + 1) * np.array(_STEPS)) % 1.0
    return {name: float(value) for name, value in zip(ATTRIBUTES, values, strict=True)}
