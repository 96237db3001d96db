"""Quotas of a population: the factors on natural frequencies that make people come out as asked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from assets_procedural.people.choices import ATTRIBUTES, Attribute, Choices, Factors, spread_points
from assets_procedural.people.kinds import draw_kind
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.person import Person

PEOPLE = 1024
"""How many people the factors are fitted on."""
_TOLERANCE = 0.02


class QuotaError(ValueError):
    """A quota that these people cannot reach: the `field` of the job, its `value`, the `remedy`."""

    def __init__(self, field: str, value: str, remedy: str) -> None:
        self.field, self.value, self.remedy = field, value, remedy
        super().__init__(f"{field} = {value}: {remedy}")


def factors(settings: PeopleSettings) -> Factors:
    """The factors for `Choices`: a job's weights, and for each quota what makes it come true.

    Beards are for men and grey hair is for the old: a quota of such a value is met by more of those
    who can have it, never by others. Takes seconds where there are quotas, and is then kept.

    Raises:
        QuotaError: too few of these people can have the value.
    """
    return _fitted(settings.model_dump_json())


@lru_cache(maxsize=8)
def _fitted(stored: str) -> Factors:
    settings = PeopleSettings.model_validate_json(stored)
    found: dict[Attribute, dict[str, float]] = {
        name: dict(table) for name, table in settings.weights.items()
    }
    asked: list[Attribute] = [name for name in ATTRIBUTES if settings.quotas.get(name)]
    for attribute in asked:
        seen: list[dict[str, float]] = []
        for index in range(PEOPLE):
            points = quota_points(settings, index, np.random.default_rng(0))
            choices = Choices(found, points)
            draw_kind(np.random.default_rng([0, index]), settings, choices)
            seen.append(choices.frequencies[attribute])
        fitted = _fit(attribute, seen, settings.quotas[attribute])
        table = found.setdefault(attribute, {})
        for value, factor in fitted.items():
            table[value] = table.get(value, 1.0) * factor
    return found


def _fit(
    attribute: Attribute, seen: list[dict[str, float]], quotas: dict[str, float]
) -> dict[str, float]:
    """Value to factor: iterative proportional fitting of the mean shares over people `seen`."""
    names = list(dict.fromkeys([*quotas, *(name for one in seen for name in one)]))
    weights = np.array([[one.get(name, 0.0) for name in names] for one in seen])
    weights /= weights.sum(axis=1, keepdims=True)
    shares = np.array([quotas.get(name, np.nan) for name in names])
    named = np.isfinite(shares)
    scale = np.ones(len(names))
    if quotas and np.nansum(shares) > 1.0 - 1e-6:
        scale[~named] = 0.0
    reached = np.zeros(len(names))
    for _ in range(300):
        share = weights * scale
        total = share.sum(axis=1, keepdims=True)
        reached = np.divide(share, total, out=weights.copy(), where=total > 0).mean(axis=0)
        ratio = np.divide(shares, reached, out=np.zeros_like(reached), where=reached > 1e-9)
        scale[named] = np.clip(scale[named] * ratio[named], 0.0, 1e9)
    worst = int(np.nanargmax(np.abs(reached - shares)))
    if abs(reached[worst] - shares[worst]) > _TOLERANCE:
        at = "at most" if reached[worst] < shares[worst] else "at least"
        raise QuotaError(
            f"people.quotas.{attribute}.{names[worst]}",
            f"{shares[worst]:g}",
            f"{at} {reached[worst]:.2f} of these people can have it; change the share, or who the "
            "people are",
        )
    return {name: float(scale[k]) for k, name in enumerate(names) if named[k] or scale[k] != 1.0}


def quota_points(
    settings: PeopleSettings, index: int, rng: np.random.Generator
) -> dict[str, float]:
    """`spread_points` of the attributes that have quotas."""
    points = spread_points(index, rng)
    return {name: points[name] for name in ATTRIBUTES if settings.quotas.get(name)}


def attributes(person: Person) -> dict[Attribute, str]:
    """A person's value of every attribute in `choices.ATTRIBUTES`."""
    glasses = person.glasses
    return {
        "sex": person.sex,
        "age_group": person.age_group,
        "ancestry": person.ancestry,
        "hair_style": person.hair.style,
        "hair_colour": person.hair.colour,
        "beard": person.beard.style,
        "glasses": "none" if glasses is None else "sunglasses" if glasses.tint > 0.5 else "clear",
        "hat": "none" if person.hat is None else "worn",
    }
