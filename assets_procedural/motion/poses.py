"""Expressions, gaze and head pose: distributions and smooth tracks."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from assets_procedural.motion.expressions import (
    VISEMES,
    Actions,
    blend,
    draw_expression,
    mouth_only,
    resolve,
    without_mouth,
)
from assets_procedural.settings import Interval, Parameters, Settings, interval

ARKIT_NAMES: tuple[str, ...] = (
    "browDownLeft",
    "browDownRight",
    "browInnerUp",
    "browOuterUpLeft",
    "browOuterUpRight",
    "cheekPuff",
    "cheekSquintLeft",
    "cheekSquintRight",
    "eyeBlinkLeft",
    "eyeBlinkRight",
    "eyeLookDownLeft",
    "eyeLookDownRight",
    "eyeLookInLeft",
    "eyeLookInRight",
    "eyeLookOutLeft",
    "eyeLookOutRight",
    "eyeLookUpLeft",
    "eyeLookUpRight",
    "eyeSquintLeft",
    "eyeSquintRight",
    "eyeWideLeft",
    "eyeWideRight",
    "jawForward",
    "jawLeft",
    "jawOpen",
    "jawRight",
    "mouthClose",
    "mouthDimpleLeft",
    "mouthDimpleRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthFunnel",
    "mouthLeft",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "mouthPressLeft",
    "mouthPressRight",
    "mouthPucker",
    "mouthRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "noseSneerLeft",
    "noseSneerRight",
    "tongueOut",
)


class Pose(Parameters):
    """One moment of a subject.

    `expression`: ARKit name to [0, 1], absent names are 0. `gaze`: (yaw, pitch) of both eyes in the
    head, radians, positive towards the subject's left and up. `head`: (pitch, roll, yaw) of the
    head against the trunk, radians: pitch down, roll towards the subject's left shoulder as Anny
    defines it (+y), yaw to the subject's left.
    """

    expression: dict[str, float] = Field(default_factory=dict)
    gaze: tuple[float, float] = (0.0, 0.0)
    head: tuple[float, float, float] = (0.0, 0.0, 0.0)


# Gaze angle (radians) at which an eyelid shape of ARKit's eyeLook family is fully on.
_LID_FULL_TURN = np.radians(25.0)


def lid_following(pose: Pose) -> dict[str, float]:
    """The pose's expression with ARKit's eyeLook values that its gaze implies for the lids."""
    yaw, pitch = pose.gaze
    level = {
        "eyeLookOutLeft": yaw,
        "eyeLookInRight": yaw,
        "eyeLookInLeft": -yaw,
        "eyeLookOutRight": -yaw,
        "eyeLookUpLeft": pitch,
        "eyeLookUpRight": pitch,
        "eyeLookDownLeft": -pitch,
        "eyeLookDownRight": -pitch,
    }
    implied = {k: min(v / _LID_FULL_TURN, 1.0) for k, v in level.items() if v > 0}
    return {**pose.expression, **implied}


class PoseSettings(Settings):
    """Distribution of expressions, gaze and head poses; degrees, intervals (low, high)."""

    expression: float = Field(default=0.7, ge=0.0, le=1.0)
    """Typical strength against the full archetypes; 0 keeps every face neutral."""
    neutral: float = Field(default=0.15, ge=0.0, le=1.0)
    """Probability of a relaxed face (it still blinks and looks around)."""
    talking: float = Field(default=0.25, ge=0.0, le=1.0)
    """Probability of a mouth caught speaking."""
    closed_eyes: float = Field(default=0.03, ge=0.0, le=1.0)
    """Probability of a single pose caught in a blink."""
    gaze_yaw: Annotated[Interval, interval(-35.0, 35.0, "degrees")] = (-25.0, 25.0)
    """Gaze in the head, positive towards the subject's left."""
    gaze_pitch: Annotated[Interval, interval(-30.0, 30.0, "degrees")] = (-18.0, 14.0)
    """Gaze in the head, positive up."""
    head_yaw: Annotated[Interval, interval(-80.0, 80.0, "degrees")] = (-30.0, 30.0)
    """Head against trunk, positive towards the subject's left."""
    head_pitch: Annotated[Interval, interval(-45.0, 45.0, "degrees")] = (-15.0, 15.0)
    """Head against trunk, positive down."""
    head_roll: Annotated[Interval, interval(-45.0, 45.0, "degrees")] = (-10.0, 10.0)
    """Head against trunk, sideways."""
    frames_per_second: float = Field(default=2.5, gt=0.0, le=240.0)
    """Time step of a track (video subsets)."""


_PAIRED = tuple(n.removesuffix("Left") for n in ARKIT_NAMES if n.endswith("Left"))
_BLINK = [ARKIT_NAMES.index("eyeBlinkLeft"), ARKIT_NAMES.index("eyeBlinkRight")]
_WIDE = [ARKIT_NAMES.index("eyeWideLeft"), ARKIT_NAMES.index("eyeWideRight")]


def sample_pose(rng: np.random.Generator, settings: PoseSettings) -> Pose:
    """Draw one pose: expression, speech or blink, head turn and a matching gaze."""
    head = _draw_head(rng, settings)
    bias = _draw_bias(rng)
    actions: Actions = {}
    if rng.random() >= settings.neutral:
        actions = blend((settings.expression * _draw_strength(rng), draw_expression(rng)))
    if rng.random() < settings.talking:
        viseme = VISEMES[rng.integers(len(VISEMES))]
        actions = _speaking(actions, viseme, float(rng.uniform(0.5, 1.2)))
    expression = resolve(actions, ARKIT_NAMES, bias)
    if rng.random() < settings.closed_eyes:
        _close_eyes(expression, float(rng.uniform(0.5, 1.0)))
    attention = _draw_attention(rng, head)
    return _pose(expression, _eyes(attention, head, settings), head)


def sample_track(rng: np.random.Generator, frames: int, settings: PoseSettings) -> tuple[Pose, ...]:
    """Draw a smooth motion of `frames` poses, 1 / settings.frames_per_second apart.

    Expression and head ease between key poses, the head sways, the gaze jumps and holds while the
    head moves under it, eyes blink, and one track in `settings.talking` speaks.
    """
    if frames < 1:
        raise ValueError(f"a track has at least 1 frame, not {frames}")
    time = np.arange(frames) / settings.frames_per_second
    bias = _draw_bias(rng)
    expression = _expression_track(rng, time, settings, bias)
    head = _head_track(rng, time, settings)
    # Fixations are piecewise constant: eyes reach them within one frame.
    starts = _event_times(rng, time[-1], 0.35, 1.6)
    targets = np.array([_draw_attention(rng, head[np.searchsorted(time, t) - 1]) for t in starts])
    attention = targets[np.searchsorted(starts, time, side="right") - 1]
    lids = _blink_track(rng, time)
    poses = []
    for k in range(frames):
        _close_eyes(expression[k], lids[k])
        gaze = _eyes(attention[k], head[k], settings)
        poses.append(_pose(expression[k], gaze, head[k]))
    return tuple(poses)


def _draw_strength(rng: np.random.Generator) -> float:
    return float(0.45 + 1.05 * rng.beta(1.8, 1.5))


def _draw_bias(rng: np.random.Generator) -> dict[str, float]:
    """Left-right imbalance of a subject's movements: a habit and some noise."""
    habit = rng.normal(0.0, 0.07)
    return dict(zip(_PAIRED, habit + rng.normal(0.0, 0.08, len(_PAIRED)), strict=True))


def _draw_within(rng: np.random.Generator, interval_degrees: Interval) -> float:
    """Radians inside an interval; the middle is likelier than the ends."""
    low, high = interval_degrees
    return float(np.radians(low + (high - low) * rng.beta(1.7, 1.7)))


def _draw_head(rng: np.random.Generator, settings: PoseSettings) -> np.ndarray:
    """(pitch, roll, yaw) in radians."""
    intervals = (settings.head_pitch, settings.head_roll, settings.head_yaw)
    return np.array([_draw_within(rng, interval) for interval in intervals])


def _draw_attention(rng: np.random.Generator, head: np.ndarray) -> np.ndarray:
    """Gaze (yaw, pitch) against the trunk: towards the front, with the head's turn, or anywhere."""
    kind = rng.random()
    along = np.array([head[2], -head[0]])
    if kind < 0.5:
        return rng.normal(0.0, np.radians(6.0), 2)
    if kind < 0.85:
        return along * rng.uniform(0.9, 1.4) + rng.normal(0.0, np.radians(4.0), 2)
    return along + rng.normal(0.0, 1.0, 2) * np.radians([14.0, 8.0])


def _eyes(attention: np.ndarray, head: np.ndarray, settings: PoseSettings) -> np.ndarray:
    """Gaze in the head (yaw, pitch) that looks at `attention`, as far as the eyes may turn."""
    wanted = attention - np.array([head[2], -head[0]])
    bounds = np.radians([settings.gaze_yaw, settings.gaze_pitch])
    # A soft stop: gazes do not pile up on the bounds.
    middle, half = bounds.mean(axis=1), 0.5 * (bounds[:, 1] - bounds[:, 0])
    reach = np.maximum(half, 1e-9)
    return middle + reach * np.tanh((wanted - middle) / reach) * (half > 0.0)


def _speaking(actions: Actions, viseme: Actions, strength: float) -> Actions:
    """Speech over an expression, whose own mouth stays recognisable."""
    return blend((1.0, without_mouth(actions)), (0.45, mouth_only(actions)), (strength, viseme))


def _close_eyes(expression: np.ndarray, lid: float) -> None:
    expression[_BLINK] = np.maximum(expression[_BLINK], lid)
    expression[_WIDE] *= 1.0 - lid


def _pose(expression: np.ndarray, gaze: np.ndarray, head: np.ndarray) -> Pose:
    values = {
        name: round(float(value), 4)
        for name, value in zip(ARKIT_NAMES, expression, strict=True)
        if value >= 5e-5
    }
    yaw, pitch = (round(float(angle), 5) for angle in gaze)
    down, roll, turn = (round(float(angle), 5) for angle in head)
    return Pose(expression=values, gaze=(yaw, pitch), head=(down, roll, turn))


def _event_times(
    rng: np.random.Generator, end: float, shortest: float, longest: float
) -> np.ndarray:
    """Ascending times from before 0 to past `end`, seconds, spaced `shortest` to `longest`."""
    times = [-float(rng.uniform(0.0, longest))]
    while times[-1] <= end:
        times.append(times[-1] + float(rng.uniform(shortest, longest)))
    return np.array(times)


def _ease(time: np.ndarray, starts: np.ndarray, keys: np.ndarray, share: float) -> np.ndarray:
    """Key values (K, C) to (T, C): minimum-jerk moves in the first `share` of each span."""
    span = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(starts) - 2)
    progress = (time - starts[span]) / (starts[span + 1] - starts[span])
    t = np.clip(progress / share, 0.0, 1.0)[:, None]
    blending = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    return keys[span] * (1.0 - blending) + keys[span + 1] * blending


def _expression_track(
    rng: np.random.Generator,
    time: np.ndarray,
    settings: PoseSettings,
    bias: dict[str, float],
) -> np.ndarray:
    """(T, 52)"""
    starts = _event_times(rng, time[-1], 0.5, 1.2)
    starts = np.append(starts, starts[-1] + 1.0)
    actions: list[Actions] = []
    for _ in starts:
        if rng.random() < settings.neutral:
            actions.append({})
        elif actions and rng.random() < 0.2:  # the same expression, stronger or weaker
            actions.append(blend((float(rng.uniform(0.4, 1.3)), actions[-1])))
        else:
            strength = settings.expression * _draw_strength(rng)
            actions.append(blend((strength, draw_expression(rng))))
    keys = np.array([resolve(a, ARKIT_NAMES, bias) for a in actions])
    expression = _ease(time, starts, keys, 0.8)
    if rng.random() < settings.talking:
        syllables = _event_times(rng, time[-1], 0.18, 0.36)
        syllables = np.append(syllables, syllables[-1] + 0.25)
        visemes = []
        for _ in syllables:
            viseme = VISEMES[rng.integers(len(VISEMES))]
            visemes.append(blend((float(rng.uniform(0.4, 1.1)), viseme)))
        spoken = np.array([resolve(v, ARKIT_NAMES, bias) for v in visemes])
        mouth = np.array([name.startswith(("mouth", "jaw", "tongue")) for name in ARKIT_NAMES])
        expression[:, mouth] *= 0.45
        expression = np.clip(expression + _ease(time, syllables, spoken, 1.0), 0.0, 1.0)
    return expression


def _head_track(rng: np.random.Generator, time: np.ndarray, settings: PoseSettings) -> np.ndarray:
    """(T, 3) pitch, roll, yaw: key turns with ease and a slow sway, inside the intervals."""
    starts = _event_times(rng, time[-1], 0.7, 1.7)
    starts = np.append(starts, starts[-1] + 1.0)
    keys = [_draw_head(rng, settings)]
    for _ in starts[1:]:
        keys.append(keys[-1] + rng.uniform(0.35, 0.95) * (_draw_head(rng, settings) - keys[-1]))
    head = _ease(time, starts, np.array(keys), 1.0)
    for _ in range(3):
        hertz, phase = rng.uniform(0.15, 0.6), rng.uniform(0.0, 2.0 * np.pi, 3)
        size = np.radians(rng.uniform(0.2, 0.9, 3))
        head += size * np.sin(2.0 * np.pi * hertz * time[:, None] + phase)
    bounds = np.radians([settings.head_pitch, settings.head_roll, settings.head_yaw])
    return np.clip(head, bounds[:, 0], bounds[:, 1])


def _blink_track(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """(T,) lid closure: quick to shut, slower to open, some blinks incomplete."""
    lids = np.zeros(len(time))
    for start in _event_times(rng, time[-1], 1.0, 5.0):
        depth = 1.0 if rng.random() < 0.8 else float(rng.uniform(0.5, 0.9))
        shut = np.clip((time - start) / 0.09, 0.0, 1.0)
        opened = np.clip((time - start - 0.15) / 0.2, 0.0, 1.0)
        lids = np.maximum(lids, depth * np.minimum(shut, 1.0 - opened))
    return lids
