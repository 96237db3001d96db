import numpy as np
import pytest
import torch
from synthetic_faces import a_tracking

from assets_procedural.motion.poses import ARKIT_NAMES
from totalediting.editing.motion import moved_off, rest_of, taken_over, with_expression
from totalediting.editing.sources import head_in_camera
from totalediting.editing.warping.bust import bust_of, view_of
from totalediting.geometry.tracking import Tracking

SMILE, BROWS, BLINK, OTHER = (
    ARKIT_NAMES.index(name)
    for name in ("mouthSmileLeft", "browDownLeft", "eyeBlinkLeft", "eyeBlinkRight")
)


@pytest.fixture(scope="module")
def tracking() -> Tracking:
    drawn = a_tracking(np.random.default_rng(3), 1)
    still = {name: 0 * getattr(drawn, name) for name in ("head", "gaze", "expression")}
    return drawn._replace(**still)


def showing(tracking, **values):
    expression = torch.zeros(1, 52)
    for name, value in values.items():
        expression[0, ARKIT_NAMES.index(name)] = value
    return tracking._replace(expression=expression)


def test_the_drivers_turn_against_the_camera_is_taken_over(tracking):
    driver = a_tracking(np.random.default_rng(4), 1)
    found = taken_over(tracking, driver)
    turns = []
    for one in (found, driver):
        bust = bust_of(one._replace(identity=0 * one.identity, expression=0 * one.expression))
        still = bust_of(
            one._replace(
                identity=0 * one.identity, expression=0 * one.expression, head=0 * one.head
            )
        )
        skull = bust.vertices[:, 2].argsort()[-200:]
        axes = view_of(one).frame[:3, :3]
        left, right = ((b.vertices[skull] - b.vertices[skull].mean(0)) for b in (bust, still))
        turns.append(np.linalg.lstsq(right, left @ axes, rcond=None)[0])
    assert np.abs(turns[0] - turns[1]).max() < 0.05
    assert (found.expression == driver.expression).all()


def test_a_clip_moves_a_person_off_its_own_look(tracking):
    drawn = a_tracking(np.random.default_rng(5), 3)
    frames = [Tracking(*(field[k : k + 1] for field in drawn)) for k in range(3)]
    frowning = [
        showing(one, browDownLeft=0.4, mouthSmileLeft=0.1 * k) for k, one in enumerate(frames)
    ]
    rest = rest_of(frowning)
    smiling = showing(tracking, mouthSmileLeft=0.5)
    found = moved_off(smiling, frowning[2], rest).expression[0]
    assert found[BROWS] == 0 and np.isclose(found[SMILE], 0.6)
    # At rest it looks as it did, wherever the driver's camera stood.
    driver = frowning[1]._replace(gaze=rest.gaze)
    at_rest = rest._replace(head=head_in_camera(driver))
    same = moved_off(smiling, driver, at_rest)
    assert np.allclose(same.expression, smiling.expression)
    assert np.allclose(same.gaze, smiling.gaze)
    assert np.abs(head_in_camera(same) - head_in_camera(smiling)).max() < 1e-5


def test_of_a_photograph_faint_frowns_are_not_taken_over(tracking):
    driver = showing(tracking, browDownLeft=0.08, mouthSmileLeft=0.9)
    found = moved_off(tracking, driver, None).expression[0]
    assert found[BROWS] < 0.01 and found[SMILE] > 0.8
    assert taken_over(tracking, driver).expression[0, BROWS] > 0.05


def test_half_a_wink_closes_both_eyes_and_a_wink_one(tracking):
    driver = showing(tracking, eyeBlinkLeft=0.9, eyeBlinkRight=0.4)
    found = moved_off(tracking, driver, None).expression[0]
    assert np.isclose(found[BLINK], found[OTHER]) and found[BLINK] > 0.6
    wink = moved_off(tracking, showing(tracking, eyeBlinkLeft=1.0), None).expression[0]
    assert wink[BLINK] > 0.9 and wink[OTHER] < 0.1


def test_coefficients_are_added_and_stay_in_bounds(tracking):
    shown = showing(tracking, jawOpen=0.3, mouthPucker=0.5)
    more = with_expression(shown, {"jawOpen": 0.4, "mouthPucker": -1.0})
    jaw, pucker = (ARKIT_NAMES.index(name) for name in ("jawOpen", "mouthPucker"))
    assert more.expression[0, jaw] == pytest.approx(0.7) and more.expression[0, pucker] == 0
    assert with_expression(shown, {"jawOpen": 0.0}) is shown
