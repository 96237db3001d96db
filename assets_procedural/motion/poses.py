"""Expressions, gaze and head pose of single moments, and the settings of their distributions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from assets_procedural.motion.expressions import (
    EVERYDAY,
    MOODS,
    VISEMES,
    WIDE,
    Actions,
    blend,
    draw_mood,
    draw_rest,
    mouth_only,
    resolve,
    without_mouth,
)
from assets_procedural.motion.gaze import aim, draw_attention, gaze_in_head, reaches, turn_towards
from assets_procedural.settings import Interval, Parameters, Settings, interval

if TYPE_CHECKING:
    Mood = str
else:  # the names are those of the library
    Mood = Literal[tuple(MOODS)]

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
    """Typical strength against the full moods; 0 keeps every face neutral."""
    neutral: float = Field(default=0.15, ge=0.0, le=1.0)
    """Probability of a relaxed face (it still blinks and looks around)."""
    moods: Literal["everyday", "wide"] | dict[Mood, Annotated[float, Field(ge=0.0)]] = "everyday"
    """How often each mood is shown: "everyday" smiles softly and is seldom upset, "wide" moves
    every muscle, a table gives relative weights; moods that it leaves out do not occur."""
    talking: float = Field(default=0.12, ge=0.0, le=1.0)
    """Probability of a mouth caught speaking."""
    closed_eyes: float = Field(default=0.03, ge=0.0, le=1.0)
    """Probability of a single pose caught in a blink."""
    gaze_at_camera: float = Field(default=0.5, ge=0.0, le=1.0)
    """Probability that the eyes look into the lens of the first camera, where the ranges of gaze
    and head let them; in a track, of each fixation."""
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
    tracks: Path | None = None
    """A folder of tables that `totalediting track` wrote: video subsets move as the people in them
    do, within the ranges of gaze and head; expression, moods, talking and neutral are theirs."""

    @field_validator("moods")
    @classmethod
    def _some(cls, moods: str | dict[str, float]) -> str | dict[str, float]:
        if not isinstance(moods, str) and sum(moods.values()) <= 0.0:
            raise ValueError('moods needs at least one weight above 0, or "everyday" or "wide"')
        return moods

    def gaze_bounds(self) -> np.ndarray:
        """((yaw low, high), (pitch low, high)), radians."""
        return np.radians([self.gaze_yaw, self.gaze_pitch])

    def head_ranges(self) -> np.ndarray:
        """(low, high) of pitch, roll and yaw, (3, 2) radians."""
        return np.radians([self.head_pitch, self.head_roll, self.head_yaw])

    def mood_weights(self) -> dict[str, float]:
        """Relative weights of the moods that occur."""
        named = {"everyday": EVERYDAY, "wide": WIDE}
        return named[self.moods] if isinstance(self.moods, str) else dict(self.moods)


_PAIRED = tuple(n.removesuffix("Left") for n in ARKIT_NAMES if n.endswith("Left"))
_BLINK = [ARKIT_NAMES.index("eyeBlinkLeft"), ARKIT_NAMES.index("eyeBlinkRight")]
_WIDE = [ARKIT_NAMES.index("eyeWideLeft"), ARKIT_NAMES.index("eyeWideRight")]


def sample_pose(
    rng: np.random.Generator, settings: PoseSettings, lens: np.ndarray | None = None
) -> Pose:
    """Draw one pose: expression, speech or blink, head turn and a matching gaze.

    `lens` (3,) is where the first camera is, metres from the head's centre in the frame of the
    trunk; without one nobody looks at it.
    """
    bias = draw_bias(rng)
    expression = resolve(draw_actions(rng, settings), ARKIT_NAMES, bias)
    if rng.random() < settings.closed_eyes:
        close_eyes(expression, float(rng.uniform(0.5, 1.0)))
    bounds = settings.gaze_bounds()
    at_lens = rng.random() < settings.gaze_at_camera
    head = draw_head(rng, settings)
    if lens is not None and at_lens:
        head = turn_towards(lens, head, bounds, settings.head_ranges())
        if reaches(gaze := aim(lens, head), bounds):
            return as_pose(expression, gaze, head)
    return as_pose(expression, gaze_in_head(draw_attention(rng, head), head, bounds), head)


def draw_actions(rng: np.random.Generator, settings: PoseSettings) -> Actions:
    """What the face does at a moment: its tension at rest, a mood, perhaps a sound."""
    actions = at_rest(rng, settings)
    if rng.random() >= settings.neutral:
        actions = in_mood(rng, settings, actions)
    if rng.random() < settings.talking:
        viseme = VISEMES[str(rng.choice(list(VISEMES)))]
        # The mood's own mouth stays recognisable.
        actions = blend(
            (1.0, without_mouth(actions)),
            (0.45, mouth_only(actions)),
            (float(rng.uniform(0.5, 1.1)), viseme),
        )
    return actions


def at_rest(rng: np.random.Generator, settings: PoseSettings) -> Actions:
    """Draw what a relaxed face does."""
    return blend((min(1.0, settings.expression), draw_rest(rng)))


def in_mood(rng: np.random.Generator, settings: PoseSettings, rest: Actions) -> Actions:
    """Draw what a face at `rest` does in a mood, which shows at about its full strength."""
    mood = draw_mood(rng, settings.mood_weights())
    strength = float(0.45 + 1.05 * rng.beta(1.8, 1.5))
    return blend((0.5, rest), (settings.expression * strength, mood))


def draw_bias(rng: np.random.Generator) -> dict[str, float]:
    """Left-right imbalance of a subject's movements: a habit and some noise."""
    habit = rng.normal(0.0, 0.07)
    return dict(zip(_PAIRED, habit + rng.normal(0.0, 0.08, len(_PAIRED)), strict=True))


def draw_head(rng: np.random.Generator, settings: PoseSettings) -> np.ndarray:
    """(pitch, roll, yaw) in radians."""
    intervals = (settings.head_pitch, settings.head_roll, settings.head_yaw)
    return np.array([_draw_within(rng, interval) for interval in intervals])


def _draw_within(rng: np.random.Generator, interval_degrees: Interval) -> float:
    """Radians inside an interval; the middle is likelier than the ends."""
    low, high = interval_degrees
    return float(np.radians(low + (high - low) * rng.beta(1.7, 1.7)))


def close_eyes(expression: np.ndarray, lid: float) -> None:
    """Shut the lids of (52,) values at least by `lid`, in place."""
    expression[_BLINK] = np.maximum(expression[_BLINK], lid)
    expression[_WIDE] *= 1.0 - lid


def as_pose(expression: np.ndarray, gaze: np.ndarray, head: np.ndarray) -> Pose:
    """Plain data, rounded so that JSON stays short."""
    values = {
        name: round(float(value), 4)
        for name, value in zip(ARKIT_NAMES, expression, strict=True)
        if value >= 5e-5
    }
    yaw, pitch = (round(float(angle), 5) for angle in gaze)
    down, roll, turn = (round(float(angle), 5) for angle in head)
    return Pose(expression=values, gaze=(yaw, pitch), head=(down, roll, turn))
