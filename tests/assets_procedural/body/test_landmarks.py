import numpy as np
import pytest

from assets_procedural.body.head import HeadModel
from assets_procedural.body.landmarks import COUNT, FLIP, landmarks, skin_weights
from assets_procedural.body.regions import fields
from assets_procedural.mesh.subdivision import catmull_clark
from assets_procedural.motion.poses import Pose
from assets_procedural.person import Person

INTEROCULAR = (36, 45)


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def identity(model):
    return model.identity(Person())


def posed(identity, **pose) -> np.ndarray:
    return landmarks(identity.pose(Pose(**pose)))


def gap(points: np.ndarray, a: int, b: int) -> float:
    return float(np.linalg.norm(points[a] - points[b]))


def test_neutral_landmarks_are_symmetric(identity):
    points = posed(identity)
    assert points.shape == (COUNT, 3)
    np.testing.assert_allclose(points[FLIP], points * [-1, 1, 1], atol=2e-4)


def test_flip_is_an_involution_that_keeps_the_midline():
    np.testing.assert_array_equal(FLIP[FLIP], np.arange(COUNT))
    assert set(np.flatnonzero(np.arange(COUNT) == FLIP)) == {8, 27, 28, 29, 30, 33, 51, 57, 62, 66}


def test_order_in_a_frontal_picture_is_ibugs(identity):
    """From the front, the picture's x is the world's x and its left the subject's right."""
    x, _, z = posed(identity).T
    for run in (range(17), range(17, 27), range(31, 36), range(48, 55), range(60, 65)):
        assert (np.diff(x[list(run)]) > 0).all(), list(run)
    for run in (range(27, 31), (38, 40), (43, 47), (51, 62, 66, 57, 8), (19, 37, 41, 31, 48)):
        assert (np.diff(z[list(run)]) < 0).all(), list(run)
    assert x[[36, 37, 68, 38, 39, 42, 43, 69, 44, 45]].tolist() == sorted(
        x[[36, 37, 68, 38, 39, 42, 43, 69, 44, 45]]
    )
    assert x[36] < 0 < x[45]


def test_nose_tip_is_the_most_forward_point(identity):
    points = posed(identity)
    assert points[:, 1].argmin() == 30


def test_landmarks_lie_on_the_rendered_skin(model, identity):
    """They are vertices of the skin subdivided once, so no view shows them off the surface."""
    bust = identity.pose(
        Pose(expression={"jawOpen": 0.7, "mouthSmileLeft": 1.0}, head=(0.2, 0, 0.3))
    )
    surface = catmull_clark(model.faces["skin"], len(model.template)).matrix @ bust.vertices
    points = landmarks(bust)[:68]
    nearest = np.linalg.norm(points[:, None] - surface[None], axis=-1).min(axis=1)
    assert nearest.max() < 1e-3
    np.testing.assert_allclose(np.asarray(skin_weights(model).sum(axis=1)), 1, atol=1e-9)


def test_a_blink_brings_the_lids_together(identity):
    opened = posed(identity)
    shut = posed(identity, expression={"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0})
    for upper, lower in ((37, 41), (38, 40), (43, 47), (44, 46)):
        assert gap(shut, upper, lower) < 0.35 * gap(opened, upper, lower)


def test_an_opening_jaw_parts_the_inner_lips_and_lowers_the_chin(identity):
    closed, opened = posed(identity), posed(identity, expression={"jawOpen": 1.0})
    for upper, lower in ((61, 67), (62, 66), (63, 65)):
        assert gap(closed, upper, lower) < 0.004
        assert gap(opened, upper, lower) > 0.015
    assert opened[8, 2] < closed[8, 2] - 0.01
    np.testing.assert_allclose(opened[27:31], closed[27:31], atol=2e-3)


def test_a_smile_widens_the_mouth_and_lifts_its_corners(identity):
    neutral = posed(identity)
    smile = posed(identity, expression={"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0})
    assert gap(smile, 48, 54) > gap(neutral, 48, 54) + 0.004
    assert (smile[[48, 54], 2] > neutral[[48, 54], 2] + 0.003).all()


def test_pupils_follow_the_gaze_and_the_head(identity):
    still = posed(identity)
    left = posed(identity, gaze=(0.4, 0.0))
    assert (left[68:, 0] > still[68:, 0] + 0.003).all()
    up = posed(identity, gaze=(0.0, 0.3))
    assert (up[68:, 2] > still[68:, 2] + 0.002).all()
    np.testing.assert_allclose(still[68, [1, 2]], still[69, [1, 2]], atol=1e-4)


def test_a_turn_of_the_head_is_rigid_above_the_neck(identity):
    still, turned = posed(identity), posed(identity, head=(0.1, 0.1, 0.6))
    face = np.r_[17:68]
    before = np.linalg.norm(still[face, None] - still[None, face], axis=-1)
    after = np.linalg.norm(turned[face, None] - turned[None, face], axis=-1)
    assert np.abs(after - before).max() < 0.003
    assert turned[30, 0] > still[30, 0] + 0.02


def test_lip_landmarks_lie_on_the_painted_vermilion(model):
    lips = skin_weights(model) @ fields(model)["lips"]
    corners = [48, 54]  # on the rim of the paint
    assert (np.delete(lips[48:68], np.subtract(corners, 48)) > 0.3).all()
    assert (lips[:48] < 0.1).all()


@pytest.mark.parametrize("gender", [0.0, 1.0])
@pytest.mark.parametrize("age", [0.4, 1.0])
def test_proportions_stay_human_for_other_people(model, gender, age):
    person = Person(phenotypes={"gender": gender, "age": age, "weight": 0.8})
    points = landmarks(model.identity(person).neutral)
    assert 0.07 < gap(points, *INTEROCULAR) < 0.12
    assert 0.4 < gap(points, 48, 54) / gap(points, *INTEROCULAR) < 0.75
    assert 0.9 < gap(points, 27, 8) / gap(points, *INTEROCULAR) < 1.6
