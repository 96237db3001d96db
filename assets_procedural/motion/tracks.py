"""Motion over time: moods and heads that ease, eyes that jump and hold, blinks and speech.

Everything is timed in seconds and then looked at `frames_per_second` times a second: slow tracks
catch moments of it, 24 and more show how lids and lips get there.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.mesh.vectors import smoothstep
from assets_procedural.motion.expressions import (
    CONSONANTS,
    MOODS,
    VISEMES,
    VOWELS,
    Actions,
    blend,
    resolve,
)
from assets_procedural.motion.gaze import (
    aim,
    draw_attention,
    gaze_in_head,
    reaches,
    turn_towards,
)
from assets_procedural.motion.poses import (
    ARKIT_NAMES,
    Mood,
    Pose,
    PoseSettings,
    as_pose,
    at_rest,
    close_eyes,
    draw_bias,
    draw_head,
    in_mood,
)

# Seconds: lids shut, stay and open again.
_SHUT, _STAY, _OPEN = 0.08, 0.03, 0.15
_IS_MOUTH = np.array([name.startswith(("mouth", "jaw", "tongue")) for name in ARKIT_NAMES])


def sample_track(
    rng: np.random.Generator,
    frames: int,
    settings: PoseSettings,
    lens: np.ndarray | None = None,
) -> tuple[Pose, ...]:
    """Draw a motion of `frames` poses, 1 / settings.frames_per_second apart.

    Expression and head ease between key poses, the head sways, the gaze jumps and holds while the
    head moves under it, eyes blink, and one track in `settings.talking` speaks. `lens` is as in
    `sample_pose`.

    Raises:
        ValueError: less than one frame.
    """
    if frames < 1:
        raise ValueError(f"a track has at least 1 frame, not {frames}")
    time = np.arange(frames) / settings.frames_per_second
    expression = _expression_track(rng, time, settings, draw_bias(rng))
    head = _head_track(rng, time, settings, lens)
    gaze = _gaze_track(rng, time, settings, head, lens)
    lids = _blink_track(rng, time)
    poses = []
    for k in range(frames):
        close_eyes(expression[k], lids[k])
        poses.append(as_pose(expression[k], gaze[k], head[k]))
    return tuple(poses)


def named_moods(
    rng: np.random.Generator,
    moods: tuple[Mood, ...],
    frames: int,
    settings: PoseSettings,
    lens: np.ndarray | None = None,
) -> tuple[Pose, ...]:
    """`frames` poses that show `moods` in turn, each whole, on one person, whose habits they keep.

    Heads turn as `settings` say; eyes look into the lens (as in `sample_pose`) where they can.
    """
    bias, rest, bounds = draw_bias(rng), at_rest(rng, settings), settings.gaze_bounds()
    poses = []
    for k in range(frames):
        actions = blend((0.5, rest), (1.0, MOODS[moods[k % len(moods)]]))
        head, gaze = draw_head(rng, settings), np.zeros(2)
        if lens is not None:
            head = turn_towards(lens, head, bounds, settings.head_ranges())
            gaze = np.clip(aim(lens, head), bounds[:, 0], bounds[:, 1])
        poses.append(as_pose(resolve(actions, ARKIT_NAMES, bias), gaze, head))
    return tuple(poses)


def _gaze_track(
    rng: np.random.Generator,
    time: np.ndarray,
    settings: PoseSettings,
    head: np.ndarray,
    lens: np.ndarray | None,
) -> np.ndarray:
    """(T, 2) gazes: fixations, between which the eyes jump."""
    bounds = settings.gaze_bounds()
    starts = _event_times(rng, time[-1], 0.3, 1.8)
    at = np.maximum(np.searchsorted(time, starts, side="right") - 1, 0)
    attention = [draw_attention(rng, head[k]) for k in at]
    wish, wanted = rng.random(len(starts)), settings.gaze_at_camera
    at_lens = np.zeros(len(starts), bool)
    if lens is not None:
        able = np.array([reaches(aim(lens, head[k]), bounds) for k in at])
        at_lens = able & (wish * max(able.mean(), wanted) < wanted)
    gaze = np.zeros((len(time), 2))

    def look(fixation: int, turn: np.ndarray) -> np.ndarray:
        if lens is not None and at_lens[fixation]:
            return np.clip(aim(lens, turn), bounds[:, 0], bounds[:, 1])
        return gaze_in_head(attention[fixation], turn, bounds)

    for k, now in enumerate(time):
        which = int(np.searchsorted(starts, now, side="right")) - 1
        there = look(which, head[k])
        before = look(max(which - 1, 0), head[k])
        # A saccade takes 21 ms and 2.2 ms a degree (Carpenter 1988).
        span = 0.021 + 0.0022 * float(np.degrees(np.hypot(*(there - before))))
        t = float(np.clip((now - starts[which]) / span, 0.0, 1.0))
        gaze[k] = before + (there - before) * t**2 * (3.0 - 2.0 * t)
    return gaze


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
    rest = at_rest(rng, settings)
    for _ in starts:
        if rng.random() < settings.neutral:
            actions.append(rest)
        elif actions and rng.random() < 0.3:  # the same expression, stronger or weaker
            actions.append(blend((float(rng.uniform(0.5, 1.2)), actions[-1])))
        else:
            actions.append(in_mood(rng, settings, rest))
    keys = np.array([resolve(a, ARKIT_NAMES, bias) for a in actions])
    expression = _ease(time, starts, keys, 0.8)
    if rng.random() < settings.talking:
        expression[:, _IS_MOUTH] *= 0.45
        expression = np.clip(expression + _speech_track(rng, time, bias), 0.0, 1.0)
    return expression


def _speech_track(rng: np.random.Generator, time: np.ndarray, bias: dict[str, float]) -> np.ndarray:
    """(T, 52): words of two or three syllables, consonant and vowel in turn, with pauses."""
    at = -float(rng.uniform(0.0, 1.0))
    starts, sounds = [at], [resolve({}, ARKIT_NAMES)]
    while at <= time[-1] + 1.0:
        loud = float(rng.uniform(0.5, 1.0))
        for _ in range(int(rng.integers(1, 4))):
            for sound in (str(rng.choice(CONSONANTS)), str(rng.choice(VOWELS))):
                at += float(
                    rng.uniform(0.1, 0.15) if sound in CONSONANTS else rng.uniform(0.13, 0.22)
                )
                starts.append(at)
                sounds.append(resolve(blend((loud, VISEMES[sound])), ARKIT_NAMES, bias))
        if rng.random() < 0.3:
            at += float(rng.uniform(0.15, 0.6))
            starts.append(at)
            sounds.append(resolve({}, ARKIT_NAMES))
    return _ease(time, np.array(starts), np.array(sounds), 1.0)


def _head_track(
    rng: np.random.Generator,
    time: np.ndarray,
    settings: PoseSettings,
    lens: np.ndarray | None,
) -> np.ndarray:
    """(T, 3) pitch, roll, yaw: key turns with ease and a slow sway, inside the intervals.

    As often as eyes look into the lens, the head turns towards it.
    """
    starts = _event_times(rng, time[-1], 0.7, 1.7)
    starts = np.append(starts, starts[-1] + 1.0)
    keys = [draw_head(rng, settings)]
    for _ in starts[1:]:
        keys.append(keys[-1] + rng.uniform(0.35, 0.95) * (draw_head(rng, settings) - keys[-1]))
    ranges = settings.head_ranges()
    facing = rng.random(len(keys)) < settings.gaze_at_camera
    if lens is not None:
        bounds = settings.gaze_bounds()
        keys = [
            turn_towards(lens, key, bounds, ranges) if turned else key
            for key, turned in zip(keys, facing, strict=True)
        ]
    head = _ease(time, starts, np.array(keys), 1.0)
    for _ in range(3):
        hertz, phase = rng.uniform(0.15, 0.6), rng.uniform(0.0, 2.0 * np.pi, 3)
        size = np.radians(rng.uniform(0.2, 0.9, 3))
        head += size * np.sin(2.0 * np.pi * hertz * time[:, None] + phase)
    return np.clip(head, ranges[:, 0], ranges[:, 1])


def _blink_track(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """(T,) lid closure: quick to shut, slower to open, some blinks incomplete."""
    lids = np.zeros(len(time))
    for start in _event_times(rng, time[-1], 1.2, 4.8):
        depth = 1.0 if rng.random() < 0.8 else float(rng.uniform(0.5, 0.9))
        shut = smoothstep(0.0, _SHUT, time - start)
        opened = smoothstep(0.0, _OPEN, time - start - _SHUT - _STAY)
        lids = np.maximum(lids, depth * np.minimum(shut, 1.0 - opened))
    return lids


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
