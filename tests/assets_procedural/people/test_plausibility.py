"""The plausibility limit: the table is the head's, and no face is far beyond real ones."""

from __future__ import annotations

import json

import numpy as np
import pytest

from assets_procedural.body.head import HeadModel
from assets_procedural.people import face_shape, measures
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.people.plausibility import (
    DEVIATION,
    LIMIT,
    RELATIONS,
    keep_plausible,
    within_norm,
)


def test_the_table_is_what_the_head_gives() -> None:
    stored, found = json.loads(measures.FILE.read_text()), measures.table()
    assert stored.keys() == found.keys()
    for name, rows in found.items():
        for side, values in rows.items():
            assert stored[name][side] == pytest.approx(values, abs=0.01), name


def test_wild_faces_are_pulled_back_and_plain_ones_left_alone() -> None:
    rng = np.random.default_rng(0)
    plain = 0.3 * rng.standard_normal(len(face_shape.NAMES))
    np.testing.assert_array_equal(keep_plausible(plain), plain)
    up, down = measures.responses()
    spread = np.array(list(face_shape.SPREAD.values()))[:, None]
    deviation = np.array([DEVIATION[name] for name in measures.MEASURES])
    place = {name: k for k, name in enumerate(measures.MEASURES)}
    for _ in range(200):
        wild = keep_plausible(2.5 * rng.standard_normal(len(face_shape.NAMES)))
        slopes = np.where(wild[:, None] > 0, up, down) * spread / deviation
        found = wild @ slopes
        assert np.abs(found).max() < LIMIT + 0.5
        for a, b, limit in RELATIONS:
            assert abs(found[place[a]] - found[place[b]]) < limit + 0.7


def test_no_direction_is_taken_too_far() -> None:
    rng = np.random.default_rng(1)
    for size in (3, 10):
        norms = [np.linalg.norm(within_norm(rng.standard_normal(size))) for _ in range(2000)]
        full = [np.linalg.norm(rng.standard_normal(size)) for _ in range(2000)]
        assert max(norms) <= np.sqrt(size - 0.5) + 0.9 + 1e-9
        assert 0.02 < np.mean(np.array(full) > max(norms)) < 0.2


def test_changes_vary_together() -> None:
    """A long face has a long nose: correlated directions, not independent draws."""
    settings = PeopleSettings(age=(25, 35), ancestry={"european": 1})
    crowd = [sample_person(np.random.default_rng(k), settings).shape for k in range(400)]

    def correlation(a: str, b: str) -> float:
        return float(np.corrcoef([[p[a] for p in crowd], [p[b] for p in crowd]])[0, 1])

    assert correlation("nose-scale-vert-incr", "head-scale-vert-incr") > 0.1
    assert correlation("head-fat-incr", "neck-double-incr") > 0.3
    assert correlation("nose-hump-incr", "nose-curve-convex") > 0.3
    assert any(p.get("head-oval", 0) > 0 for p in crowd)


@pytest.mark.parametrize("sex", ["male", "female"])
def test_measures_of_faces_are_those_of_people(sex: str) -> None:
    """Means and deviations in millimetres near Farkas', for young Europeans."""
    model = HeadModel.load()
    settings = PeopleSettings(
        age=(20, 40), ancestry={"european": 1}, mixed=0, male=float(sex == "male")
    )
    found = np.array([
        measures.measure(
            measures.face_points(
                model.identity(sample_person(np.random.default_rng(k), settings)).neutral
            )
        )
        for k in range(40)
    ])  # fmt: skip
    mean = dict(zip(measures.MEASURES, found.mean(axis=0), strict=True))
    deviation = dict(zip(measures.MEASURES, found.std(axis=0), strict=True))
    real = {"nose length": 51, "mouth width": 51, "between eyes": 33, "eye width": 31}
    for name, expected in real.items():
        assert mean[name] == pytest.approx(expected, rel=0.12), name
    # Data wants its faces to differ somewhat more than people do.
    for name in ("nose length", "mouth width", "face height", "chin"):
        assert 0.6 * DEVIATION[name] < deviation[name] < 1.6 * DEVIATION[name], name
