"""Creases follow age and expression and lie where faces fold; marks are a share of light."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.body.head import HeadModel
from assets_procedural.body.landmarks import skin_weights
from assets_procedural.motion.expressions import EXPRESSIONS
from assets_procedural.people.person_sampling import PeopleSettings, sample_person
from assets_procedural.person import Makeup, Person, Skin
from assets_procedural.skin_detail import chart
from assets_procedural.skin_detail.creases import Creases
from assets_procedural.skin_detail.detail import SkinDetail
from assets_procedural.skin_detail.marks import marks


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def smooth(model: HeadModel) -> Creases:
    return Creases(Skin(wrinkles=0.0, seed=3), model)


def depth(height: np.ndarray, at: np.ndarray) -> float:
    """Metres of the deepest place in a window of 24 texels about a template position (3,)."""
    column, row = chart.pixels(at).round().astype(int)
    return -float(height[row - 12 : row + 12, column - 12 : column + 12].min())


def test_the_chart_shows_the_template_where_it_is(model: HeadModel) -> None:
    points = skin_weights(model) @ model.template
    columns, rows = chart.pixels(points[17:68]).round().astype(int).T
    shown = chart.surface(model)[rows, columns]
    assert np.median(np.linalg.norm(shown - points[17:68], axis=1)) < 0.0008


def test_faces_at_the_back_of_the_head_do_not_cross_the_chart(model: HeadModel) -> None:
    back = model.template[model.groups["skin"]]
    back = back[back[:, 1] > 0.02]
    assert (chart.project(back)[:, 1] < -5).all()


@pytest.mark.parametrize(
    ("actions", "place"),
    [
        ({"browOuterUpLeft": 1.0, "browInnerUp": 1.0}, (0.025, 0.768)),
        ({"browDownLeft": 1.0}, (0.0075, 0.746)),
        ({"mouthSmileLeft": 1.0}, (0.0295, 0.6735)),
        ({"mouthFrownLeft": 1.0}, (0.0312, 0.645)),
        ({"cheekSquintLeft": 1.0}, (0.055, 0.7278)),
        ({"noseSneerLeft": 1.0}, (0.0075, 0.722)),
    ],
)
def test_an_action_folds_its_side_at_its_place(
    model: HeadModel, smooth: Creases, actions: dict, place: tuple
) -> None:
    left = chart.lift(model, np.array([place]))[0]
    right = left * [-1, 1, 1]
    rest, moved = smooth.height({}), smooth.height(actions)
    assert depth(moved, left) > depth(rest, left) + 0.0001
    if "browInnerUp" not in actions and place[0] > 0.012:
        assert depth(moved, right) == pytest.approx(depth(rest, right), abs=2e-5)


def test_age_deepens_folds_and_smooth_skin_has_few(model: HeadModel, smooth: Creases) -> None:
    young, old = smooth.height({}), Creases(Skin(wrinkles=1.0, seed=3), model).height({})
    assert (old < -0.0002).sum() > 6 * (young < -0.0002).sum()
    assert 0.0004 < -old.min() < 0.003


def test_every_expression_of_everybody_is_finite_and_absorbs_a_share(model: HeadModel) -> None:
    for seed in range(3):
        detail = SkinDetail(sample_person(np.random.default_rng(seed), PeopleSettings()), model)
        for actions in ({}, *list(EXPRESSIONS.values())[:4]):
            picture = detail.picture(actions)
            assert picture.shape == (chart.HEIGHT, chart.WIDTH, 4) and picture.dtype == np.float32
            assert np.isfinite(picture).all() and np.abs(picture[..., 3]).max() < 0.005
            assert picture[..., :3].min() >= 0 and picture[..., :3].max() < 1
            edge = np.concatenate([picture[[0, -1]].ravel(), picture[:, [0, -1]].ravel()])
            assert not edge.any()


def test_the_same_person_has_the_same_skin(model: HeadModel) -> None:
    person = Person(age_years=60, skin=Skin(freckles=0.5, moles=4, blemishes=0.5, wrinkles=0.5))
    one, other = (SkinDetail(person, model).picture({"jawOpen": 0.4}) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_freckles_moles_spots_and_liner_are_drawn(model: HeadModel) -> None:
    clear = Skin(blemishes=0.0, melanin=0.6)
    bare = marks(Person(age_years=25, skin=clear), model)[0].sum()
    for change in ({"freckles": 0.5}, {"moles": 3}, {"blemishes": 0.8}):
        marked = Person(age_years=25, skin=clear.model_copy(update=change))
        assert marks(marked, model)[0].sum() > bare + 10
    assert marks(Person(age_years=80, skin=clear), model)[0].sum() > bare + 10
    lined = Person(age_years=25, skin=clear, makeup=Makeup(liner=1.0))
    assert marks(lined, model)[0].sum() > bare + 100
