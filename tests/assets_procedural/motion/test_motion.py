"""Expressions, single poses and tracks."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from assets_procedural.motion.expressions import (
    EVERYDAY,
    MOODS,
    VISEMES,
    WIDE,
    draw_mood,
    mirrored,
    resolve,
)
from assets_procedural.motion.poses import (
    ARKIT_NAMES,
    Pose,
    PoseSettings,
    sample_pose,
)
from assets_procedural.motion.tracks import sample_track

MANY = 400


def poses(settings: PoseSettings, count: int = MANY) -> list[Pose]:
    return [sample_pose(np.random.default_rng(seed), settings) for seed in range(count)]


def vector(pose: Pose) -> np.ndarray:
    return np.array([pose.expression.get(name, 0.0) for name in ARKIT_NAMES])


def test_the_52_names() -> None:
    assert len(ARKIT_NAMES) == len(set(ARKIT_NAMES)) == 52


def test_every_archetype_resolves_into_the_unit_range() -> None:
    assert len(MOODS) >= 15
    for actions in (*MOODS.values(), *VISEMES.values()):
        values = resolve(actions, ARKIT_NAMES)
        assert values.min() >= 0.0 and values.max() <= 1.0
        assert values.max() >= 0.15 or actions == {}
        both = resolve(mirrored(mirrored(actions)), ARKIT_NAMES)
        np.testing.assert_array_equal(values, both)


def test_unknown_action_is_an_error() -> None:
    with pytest.raises(KeyError):
        resolve({"mouthSmirk": 1.0}, ARKIT_NAMES)


def test_no_contradictory_actions() -> None:
    rng = np.random.default_rng(0)
    at = {name: index for index, name in enumerate(ARKIT_NAMES)}
    for _ in range(300):
        values = resolve(draw_mood(rng, WIDE), ARKIT_NAMES)
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


def looks_upset(pose: Pose) -> bool:
    signs = ("browDownLeft", "mouthFrownLeft", "noseSneerLeft", "browInnerUp")
    return max(pose.expression.get(name, 0.0) for name in signs) > 0.3


def test_everyday_faces_are_seldom_upset_and_wide_ones_often() -> None:
    everyday, wide = (
        np.mean([looks_upset(p) for p in poses(PoseSettings(moods=m))])  # pyright: ignore[reportArgumentType]
        for m in ("everyday", "wide")
    )
    assert everyday <= 0.15 < 0.25 < wide
    smiling = [p.expression.get("mouthSmileLeft", 0.0) > 0.1 for p in poses(PoseSettings())]
    assert np.mean(smiling) > 0.5


def test_most_everyday_faces_are_nearly_even() -> None:
    pairs = ("browDown", "browOuterUp", "mouthSmile", "mouthFrown", "mouthPress", "eyeSquint")
    skew = [
        max(
            abs(p.expression.get(n + "Left", 0.0) - p.expression.get(n + "Right", 0.0))
            for n in pairs
        )
        for p in poses(PoseSettings())
    ]
    assert np.mean(np.array(skew) < 0.12) > 0.85
    speaking = [p.expression.get("jawOpen", 0.0) > 0.1 for p in poses(PoseSettings())]
    assert np.mean(speaking) < 0.15


def test_jobs_choose_moods() -> None:
    for pose in poses(PoseSettings(moods={"yawn": 1.0}, neutral=0, talking=0), 50):
        assert pose.expression["jawOpen"] > 0.15
    assert set(EVERYDAY) <= set(MOODS) and set(WIDE) <= set(MOODS)


def meets(pose: Pose, lens: np.ndarray) -> bool:
    """The optic axis passes within 3 degrees of the lens."""
    yaw, pitch = pose.gaze
    turn = Rotation.from_euler("xyz", pose.head)
    axis = turn.apply(Rotation.from_euler("xyz", [-pitch, 0, yaw]).apply([0, -1, 0]))
    towards = lens - turn.apply([0, -0.067, 0.002])
    return bool(np.degrees(np.arccos(axis @ towards / np.linalg.norm(towards))) < 3)


@pytest.mark.parametrize("yaw", [0, 25, -40])
def test_half_of_all_gazes_meet_the_lens(yaw: float) -> None:
    lens = Rotation.from_euler("xyz", [0.1, 0, np.radians(yaw)]).apply([0, -1.0, 0])
    for wanted in (0.0, 0.5, 1.0):
        settings = PoseSettings(gaze_at_camera=wanted)
        drawn = [sample_pose(np.random.default_rng(s), settings, lens) for s in range(200)]
        share = np.mean([meets(pose, lens) for pose in drawn])
        assert wanted - 0.09 <= share <= wanted + 0.12
        track = sample_track(np.random.default_rng(1), 400, settings, lens)
        shown = np.mean([meets(pose, lens) for pose in track])
        assert shown >= 0.45 * wanted


def test_expressions_vary_and_are_slightly_asymmetric() -> None:
    values = np.array([vector(pose) for pose in poses(PoseSettings(neutral=0, moods="wide"))])
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


def test_lids_shut_faster_than_they_open_and_gazes_hold() -> None:
    settings = PoseSettings(frames_per_second=200, talking=0, moods={"neutral": 1.0})
    lids, held = [], []
    for seed in range(6):
        track = sample_track(np.random.default_rng(seed), 1200, settings)
        lids.append(np.array([p.expression.get("eyeBlinkLeft", 0.0) for p in track]))
        gaze = np.degrees([p.gaze for p in track]) + np.degrees([p.head for p in track])[:, [2, 0]]
        held.append(np.hypot(*np.diff(gaze, axis=0).T) < 0.25)
    speed = np.diff(np.array(lids), axis=1)
    shutting, opening = (speed > 1e-3).sum(), (speed < -1e-3).sum()
    assert 1.5 < opening / shutting < 2.3  # 150 and 80 ms
    assert np.mean(held) > 0.85


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
        ({"moods": {"angry": -1.0}}, "greater than or equal to 0"),
        ({"moods": {"cross": 1.0}}, "Input should be"),
        ({"moods": {}}, "at least one weight"),
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
