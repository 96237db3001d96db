"""The people of a job in numbers: which share has each value, as asked and as drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from assets_procedural.people.choices import ATTRIBUTES
from assets_procedural.people.people_settings import VALUES
from assets_procedural.people.quotas import attributes
from assets_procedural.person import Person
from synthgen.planning.plan import Plan

# Figures of a person that are shown as a histogram: name, where it is, lowest, highest.
_FIGURES: tuple[tuple[str, Callable[[Person], float], float, float], ...] = (
    ("age_years", lambda person: person.age_years, 0.0, 100.0),
    ("skin_melanin", lambda person: person.skin.melanin, 0.0, 1.0),
    ("hair_curl", lambda person: person.hair.curl, 0.0, 1.0),
    ("weight", lambda person: person.phenotypes["weight"], 0.0, 1.0),
)
_BINS = 10


@dataclass(frozen=True)
class Marginal:
    """How one attribute is distributed: a value's share as drawn, and as its quota asks, if any."""

    attribute: str
    drawn: dict[str, float]
    asked: dict[str, float]


@dataclass(frozen=True)
class Population:
    """`people` of `subset`, counted."""

    subset: str
    people: int
    marginals: tuple[Marginal, ...]


def population(plan: Plan, people: int, subset: str | None = None) -> Population:
    """Count the first `people` of a subset, by default of the first one.

    More are drawn than the subset has subjects, if so many are asked for: they show what its people
    tend to.
    """
    subset = subset or next(iter(plan.job.subsets))
    drawn = [plan.person(subset, index) for index in range(people)]
    values = [attributes(person) for person in drawn]
    marginals = []
    for name in ATTRIBUTES:
        counts = Counter(value[name] for value in values)
        asked = plan.job.people.quotas.get(name, {})
        shown = [v for v in VALUES[name] if counts[v] or v in asked]
        shares = {value: counts[value] / people for value in shown}
        marginals.append(Marginal(name, shares, dict(asked)))
    for name, figure, low, high in _FIGURES:
        found = [figure(person) for person in drawn]
        counts, edges = np.histogram(found, _BINS, (low, high))
        digits = 0 if high > 10 else 1
        shares = {
            f"{a:.{digits}f} to {b:.{digits}f}": float(n) / people
            for (a, b), n in zip(pairwise(edges), counts, strict=True)
        }
        marginals.append(Marginal(name, shares, {}))
    return Population(subset, people, tuple(marginals))


def as_json(population: Population) -> dict[str, Any]:
    """Plain data of a population."""
    return {
        "subset": population.subset,
        "people": population.people,
        "marginals": {
            m.attribute: {"drawn": m.drawn, "asked": m.asked} for m in population.marginals
        },
    }
