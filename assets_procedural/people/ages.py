"""Ages: the groups that jobs name, and how years are drawn."""

from __future__ import annotations

import math

import numpy as np

from assets_procedural.settings import Interval

AGE_GROUPS: dict[str, Interval] = {
    "child": (3.0, 13.0),
    "teenager": (13.0, 18.0),
    "young": (18.0, 35.0),
    "middle": (35.0, 55.0),
    "senior": (55.0, 70.0),
    "old": (70.0, 95.0),
}
"""Name to years, the end excluded but for the last."""


def age_group(years: float) -> str:
    """Name of the group that an age belongs to."""
    return next((n for n, (_, high) in AGE_GROUPS.items() if years < high), "old")


def age_weights(years: Interval) -> dict[str, float]:
    """Natural share of each group within the `years` of a job; all 0 but one for a single age."""
    mass = {name: _mass(*_within(years, name))[1][-1] for name in AGE_GROUPS}
    if sum(mass.values()) <= 0.0:
        return {name: float(name == age_group(years[0])) for name in AGE_GROUPS}
    return {name: float(value) for name, value in mass.items()}


def draw_age(rng: np.random.Generator, group: str, years: Interval) -> float:
    """Years of somebody of a group, within `years`: flat up to 50, thinning out towards 95; whole
    hundredths."""
    grid, mass = _mass(*_within(years, group))
    drawn = float(np.interp(rng.random() * mass[-1], mass, grid)) if mass[-1] > 0.0 else years[0]
    return max(math.floor(100.0 * drawn) / 100.0, float(grid[0]))  # never up into the next group


def phenotype_age(years: float) -> float:
    """Years to Anny's age in [0, 1]: 1 year 0, 11 years 1/3, 25 years 2/3, 90 years 1."""
    return float(np.interp(years, [1.0, 11.0, 25.0, 90.0], [0.0, 1 / 3, 2 / 3, 1.0]))


def _within(years: Interval, group: str) -> Interval:
    low, high = AGE_GROUPS[group]
    low = max(low, years[0])
    return low, max(low, min(high, years[1]))


def _mass(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Ages from low to high, and how many people are younger than each."""
    grid = np.linspace(low, high, 65)
    density = np.interp(grid, [50.0, 85.0, 95.0], [1.0, 0.45, 0.3])
    steps = 0.5 * (density[1:] + density[:-1]) * (high - low) / 64
    return grid, np.concatenate([[0.0], np.cumsum(steps)])
