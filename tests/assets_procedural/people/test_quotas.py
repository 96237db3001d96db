"""Quotas and weights: people come out as asked, from the first on, and naturally otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.hair.beard_styles import BEARD_STYLES
from assets_procedural.people.choices import ATTRIBUTES, spread_points
from assets_procedural.people.people_settings import VALUES, PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.people.quotas import QuotaError, attributes, factors, quota_points
from assets_procedural.person import Person

QUOTAS = {
    "sex": {"male": 0.3},
    "age_group": {"old": 0.5, "young": 0.1},
    "ancestry": {"south_asian": 0.4},
    "hair_style": {"bob": 0.25},
    "hair_colour": {"red": 0.2},
    "beard": {"full": 0.1},
    "glasses": {"none": 0.5, "sunglasses": 0.1},
    "hat": {"worn": 0.15},
}


def draw(settings: PeopleSettings, count: int) -> list[Person]:
    return [
        sample_person(
            np.random.default_rng([2, index]),
            settings,
            quota_points(settings, index, np.random.default_rng(5)),
        )
        for index in range(count)
    ]


@pytest.fixture(scope="module")
def crowd() -> list[Person]:
    return draw(PeopleSettings(quotas=QUOTAS), 2000)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("attribute", QUOTAS)
def test_two_thousand_people_reach_every_quota(crowd: list[Person], attribute: str) -> None:
    values = [attributes(person)[attribute] for person in crowd]
    for value, share in QUOTAS[attribute].items():
        # Three deviations of independent draws, which these keep well within.
        slack = 3 * np.sqrt(share * (1 - share) / len(values))
        if attribute != "hat":  # some styles do not fit under one
            assert np.mean([v == value for v in values]) == pytest.approx(share, abs=slack)


@pytest.mark.parametrize("count", [50, 200])
def test_so_do_the_first_ones(crowd: list[Person], count: int) -> None:
    values = [attributes(person) for person in crowd[:count]]
    for attribute in ("sex", "age_group", "ancestry"):
        for value, share in QUOTAS[attribute].items():
            found = np.mean([v[attribute] == value for v in values])
            assert found == pytest.approx(share, abs=1.5 / count + 0.01)


def test_quotas_are_met_by_those_who_can(crowd: list[Person]) -> None:
    assert all(p.sex == "male" for p in crowd if p.beard.style != "none")
    bobs = [p for p in crowd if p.hair.style == "bob"]
    assert np.mean([p.sex == "female" for p in bobs]) > 0.9


def test_weights_multiply_what_is_natural() -> None:
    settings = PeopleSettings(weights={"hair_style": {"afro": 0.0}, "sex": {"male": 3.0}})
    found = [attributes(sample_person(np.random.default_rng(k), settings)) for k in range(600)]
    assert np.mean([f["sex"] == "male" for f in found]) == pytest.approx(0.75, abs=0.06)
    assert all(f["hair_style"] != "afro" for f in found)


def test_every_value_of_a_person_is_one_that_jobs_may_name(crowd: list[Person]) -> None:
    assert tuple(VALUES) == ATTRIBUTES
    assert VALUES["beard"] == BEARD_STYLES
    for person in crowd[:200]:
        found = attributes(person)
        assert tuple(found) == ATTRIBUTES
        assert all(value in VALUES[name] for name, value in found.items())


def test_impossible_quotas_are_told() -> None:
    with pytest.raises(QuotaError, match=r"people.quotas.beard.full = 0.8: at most 0\.\d\d of"):
        factors(PeopleSettings(quotas={"beard": {"full": 0.8}}))


def test_points_of_any_prefix_are_even() -> None:
    points = [spread_points(k, np.random.default_rng(1)) for k in range(100)]
    for name in ATTRIBUTES:
        counts, _ = np.histogram([p[name] for p in points], 10, (0, 1))
        assert counts.min() >= 8 and counts.max() <= 12
