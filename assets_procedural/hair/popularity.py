"""Who wears a hair style: how often, by sex, age and the texture of the hair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.person import ADULT

ByAge = Callable[[float, bool], float]
"""A factor by age in years and by whether the person is male."""


def always(age: float, male: bool) -> float:
    """As popular at every age."""
    return 1.0


def over_years(young: tuple[float, float], old: tuple[float, float]) -> ByAge:
    """A factor that runs from one (age in years, factor) to another and is constant beyond."""

    def by_age(age: float, male: bool) -> float:
        return float(np.interp(age, [young[0], old[0]], [young[1], old[1]]))

    return by_age


def rising_with_baldness(age: float, male: bool) -> float:
    """More popular with men the older they are; not for children."""
    factor = 0.15 + 4.5 * np.clip((age - 28.0) / 40.0, 0.0, 1.0) if male else 1.0
    return factor * (age >= ADULT)


@dataclass(frozen=True)
class Popularity:
    """How often a style is worn, relative to others.

    A product of factors: `women` or `men`, one of `by_texture` (straight, wavy, coily), `by_age`.
    """

    women: float
    men: float
    by_texture: tuple[float, float, float] = (1.0, 1.0, 1.0)
    by_age: ByAge = always

    def weight(self, age: float, male: bool, curl: float) -> float:
        """Relative frequency among people of an age (years) and sex; `curl` as of `Hair`."""
        texture = [np.interp(curl, [0.0, 0.35, 0.7], row) for row in np.eye(3)]
        worn = self.men if male else self.women
        return worn * float(np.dot(self.by_texture, texture)) * self.by_age(age, male)
