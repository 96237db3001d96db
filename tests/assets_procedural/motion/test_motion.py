"""Expressions, single poses and tracks."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from assets_procedural.motion.expressions import (
    EXPRESSIONS,
    VISEMES,
    draw_expression,
    mirrored,
    resolve,
)
from assets_procedural.motion.poses import (
    ARKIT_NAMES,
    Pose,
    PoseSettings,
    sample_pose,
    sample_track,
)

MANY = 400


def poses(settings: PoseSettings, count: int = MANY) -> list[Pose]:
    return [sample_pose(np.random.default_rng(seed), settings) for seed in range(count)]


def vector(pose: Pose) -> np.ndarray:
    return np.array([pose.expression.get(name, 0.0) for name in ARKIT_NAMES])


def test_the_52_names() -> None:
    assert len(ARKIT_NAMES) == len(set(ARKIT_NAMES)) == 52


def test_every_archetype_resolves_into_the_unit_range() -> None:
    assert len(EXPRESSIONS) >= 15
    for actions in (*EXPRESSIONS.values(), *VISEMES):
        values = resolve(actions, ARKIT_NAMES)
        assert values.min() >= 0.0 and values.max() <= 1.0
        assert values.max() >= 0.2
        both = resolve(mirrored(mirrored(actions)), ARKIT_NAMES)
        np.testing.assert_array_equal(values, both)


def test_unknown_action_is_an_error() -> None:
    with pytest.raises(KeyError):
        resolve({"mouthSmirk": 1.0}, ARKIT_NAMES)


def test_no_contradictory_actions() -> None:
    rng = np.random.default_rng(0)
    at = {name: index for index, name in enumerate(ARKIT_NAMES)}
    for _ in range(300):
        values = resolve(draw_expression(rng), ARKIT_NAMES)
        assert min(values[at["mouthLeft"]], values[at["mouthRight"]]) == 0.0
        for side in ("Left", "Right"):
            assert values[at["eyeBlink" + side]] + values[at["eyeWide" + side]] <= 1.0 + 1e-9
            if values[at["jawOpen"]] > 0.34:
                assert values[at["mouthPress" + side]] == 0.0


def test_poses_are_deterministic_and_survive_json() -> None:
    settings = PoseSettings()
    for seed in range(20):
        pose = sample_pose(np.random.default_rng(seed), settings)
        assert pose == sample_pose(np.random.default_rng(seed), settings)
        assert Pose.model_validate_json(pose.model_dump_json()) == pose


def test_poses_stay_inside_the_settings() -> None:
    settings = PoseSettings(head_yaw=(10, 20), head_pitch=(-5, 0), gaze_yaw=(-3, 12))
    for pose in poses(settings):
        pitch, roll, yaw = np.degrees(pose.head)
        assert 10 - 1e-3 <= yaw <= 20 + 1e-3 and -5 - 1e-3 <= pitch <= 1e-3
        assert -10 - 1e-3 <= roll <= 10 + 1e-3
        gaze_yaw, gaze_pitch = np.degrees(pose.gaze)
        assert -3 - 1e-3 <= gaze_yaw <= 12 + 1e-3 and -18 - 1e-3 <= gaze_pitch <= 14 + 1e-3
        assert all(0.0 < value <= 1.0 for value in pose.expression.values())
        assert set(pose.expression) <= set(ARKIT_NAMES)


def test_fixed_settings_give_fixed_poses() -> None:
    still = PoseSettings(
        expression=0, talking=0, closed_eyes=0, gaze_yaw=(0, 0), gaze_pitch=(0, 0),
        head_yaw=(0, 0), head_pitch=(0, 0), head_roll=(0, 0),
    )  # fmt: skip
    for pose in poses(still, 20):
        assert pose == Pose()


def test_gaze_compensates_for_the_turn_of_the_head() -> None:
    sampled = poses(PoseSettings())
    turn = np.array([pose.head[2] for pose in sampled])
    gaze = np.array([pose.gaze[0] for pose in sampled])
    assert np.corrcoef(turn, gaze)[0, 1] < -0.25


def test_expressions_vary_and_are_slightly_asymmetric() -> None:
    values = np.array([vector(pose) for pose in poses(PoseSettings(neutral=0))])
    used = (values > 0.1).mean(axis=0)
    assert (used > 0.005).sum() >= 35
    at = {name: index for index, name in enumerate(ARKIT_NAMES)}
    left, right = values[:, at["mouthSmileLeft"]], values[:, at["mouthSmileRight"]]
    assert np.corrcoef(left, right)[0, 1] > 0.8
    smiling = (left > 0.2) & (right > 0.2)
    assert np.median(np.abs(left - right)[smiling]) > 0.01


def test_strength_scales_expressions() -> None:
    weak, strong = (
        np.mean([vector(p).sum() for p in poses(PoseSettings(expression=s, talking=0), 200)])
        for s in (0.2, 0.9)
    )
    assert strong > 2.5 * weak


def test_closed_eyes() -> None:
    for pose in poses(PoseSettings(closed_eyes=1), 50):
        assert min(pose.expression["eyeBlinkLeft"], pose.expression["eyeBlinkRight"]) >= 0.5


def test_tracks_are_deterministic_and_have_their_length() -> None:
    settings = PoseSettings()
    for frames in (1, 2, 10):
        track = sample_track(np.random.default_rng(4), frames, settings)
        assert len(track) == frames
        assert track == sample_track(np.random.default_rng(4), frames, settings)
    with pytest.raises(ValueError, match="at least 1 frame"):
        sample_track(np.random.default_rng(4), 0, settings)


def test_tracks_are_smooth_and_stay_inside() -> None:
    settings = PoseSettings(frames_per_second=60, talking=0.5)
    blink = [ARKIT_NAMES.index("eyeBlinkLeft"), ARKIT_NAMES.index("eyeBlinkRight")]
    wide = [ARKIT_NAMES.index("eyeWideLeft"), ARKIT_NAMES.index("eyeWideRight")]
    for seed in range(12):
        track = sample_track(np.random.default_rng(seed), 300, settings)
        head = np.degrees([pose.head for pose in track])
        assert np.abs(np.diff(head, axis=0)).max() * 60 < 200  # degrees per second
        assert np.abs(head[:, 2]).max() <= 30.001
        values = np.array([vector(pose) for pose in track])
        step = np.abs(np.diff(np.delete(values, blink + wide, axis=1), axis=0))
        assert step.max() < 0.2
        assert values[:, blink].max() > 0.45  # five seconds without a blink are rare


def test_a_few_frames_show_motion() -> None:
    settings = PoseSettings()
    moved = []
    for seed in range(40):
        track = sample_track(np.random.default_rng(seed), 10, settings)
        values = np.array([vector(pose) for pose in track])
        moved.append(np.abs(values.max(axis=0) - values.min(axis=0)).max())
    assert np.median(moved) > 0.25


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"expression": 1.5}, "less than or equal to 1"),
        ({"talking": -0.1}, "greater than or equal to 0"),
        ({"head_yaw": [30, -30]}, "low <= high"),
        ({"head_yaw": [-120, 0]}, r"within \[-80, 80\] degrees"),
        ({"frames_per_second": 0}, "greater than 0"),
        ({"head": [0, 1]}, "Extra inputs"),
    ],
)
def test_bad_settings(settings: dict, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PoseSettings(**settings)
