"""Where eyes look: into the lens, with the head, to the front, or anywhere.

A gaze is (yaw, pitch) of the eyes in the head, radians, positive to the subject's left and up; a
head is (pitch, roll, yaw) as `Pose` has them; attention is (yaw, pitch) against the trunk.
"""

from __future__ import annotations

import numpy as np

# The middle of the eyes from the head's centre (m), over people.
_EYES = np.array([0.0, -0.067, 0.002])


def aim(lens: np.ndarray, head: np.ndarray) -> np.ndarray:
    """The gaze (2,) that meets a lens (3,), metres from the head's centre in the trunk's frame."""
    x, y, z = lens @ _turn(head) - _EYES
    return np.array([np.arctan2(x, -y), np.arctan2(z, np.hypot(x, y))])


def _turn(head: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) of a head: pitch about x, then roll about y, then yaw about z.

    By hand: a plan needs it and does without scipy.
    """
    (cp, cr, cy), (sp, sr, sy) = np.cos(head), np.sin(head)
    pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    roll = np.array([[cr, 0, sr], [0, 1, 0], [-sr, 0, cr]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return yaw @ roll @ pitch


def turn_towards(
    lens: np.ndarray, head: np.ndarray, bounds: np.ndarray, ranges: np.ndarray
) -> np.ndarray:
    """The head (3,), turned as little as brings the lens well within the eyes' `bounds`.

    It stays within `ranges` (3, 2), the low and high of pitch, roll and yaw.
    """
    middle, half = bounds.mean(axis=1), 0.7 * (bounds[:, 1] - bounds[:, 0]) / 2
    gaze = aim(lens, head)
    yaw, pitch = gaze - np.clip(gaze, middle - half, middle + half)
    return np.clip(head + np.array([-pitch, 0.0, yaw]), ranges[:, 0], ranges[:, 1])


def reaches(gaze: np.ndarray, bounds: np.ndarray) -> bool:
    """Whether a gaze lies within (2, 2) bounds (low, high) of yaw and pitch."""
    return bool(((bounds[:, 0] <= gaze) & (gaze <= bounds[:, 1])).all())


def draw_attention(rng: np.random.Generator, head: np.ndarray) -> np.ndarray:
    """Gaze (yaw, pitch) against the trunk: towards the front, with the head's turn, or anywhere."""
    kind = rng.random()
    along = np.array([head[2], -head[0]])
    if kind < 0.5:
        return rng.normal(0.0, np.radians(6.0), 2)
    if kind < 0.85:
        return along * rng.uniform(0.9, 1.4) + rng.normal(0.0, np.radians(4.0), 2)
    return along + rng.normal(0.0, 1.0, 2) * np.radians([14.0, 8.0])


def gaze_in_head(attention: np.ndarray, head: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """The gaze (2,) that looks at `attention`, as far as (2, 2) `bounds` let the eyes turn."""
    wanted = attention - np.array([head[2], -head[0]])
    # A soft stop: gazes do not pile up on the bounds.
    middle, half = bounds.mean(axis=1), 0.5 * (bounds[:, 1] - bounds[:, 0])
    reach = np.maximum(half, 1e-9)
    return middle + reach * np.tanh((wanted - middle) / reach) * (half > 0.0)
