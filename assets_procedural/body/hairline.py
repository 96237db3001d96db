"""The hairline: where the scalp begins, and its recession.

Points and regions are in template space (see `roots`).
"""

from __future__ import annotations

import numpy as np

from assets_procedural.mesh.vectors import arctan2, smoothstep
from assets_procedural.person import Person

_CROWN = np.array([0.004, 0.020, 0.846])
SKULL_CENTRE = np.array([0.0, -0.05, 0.745])
"""(3,) metres, template space: hairline and combing are measured about it."""

# The hairline: azimuth from the front (degrees) to elevation about the skull's centre (degrees).
_HAIRLINE = np.array(
    [
        (0, 29), (12, 29), (24, 30.5), (34, 31.5), (42, 28.5), (47, 23), (51, 16), (54, 9),
        (57, 4), (62, -2), (67, -9), (70, -24), (75, -30), (79, -22), (84, -6), (92, -4),
        (102, -5), (109, -12), (115, -32), (124, -45), (150, -53), (180, -55),
    ],
    float,
)  # fmt: skip


def hairline_distance(points: np.ndarray, person: Person) -> np.ndarray:
    """Degrees (R,) by which template points lie inside the hairline; negative outside."""
    offset = points - SKULL_CENTRE
    azimuth = np.degrees(arctan2(offset[:, 0], -offset[:, 1]))
    elevation = np.degrees(arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])))
    male = 1 - person.phenotypes.get("gender", 0.5)
    style = np.random.default_rng([person.hair.seed, 17])
    lag = np.abs(azimuth)
    line = np.interp(lag, _HAIRLINE[:, 0], _HAIRLINE[:, 1])
    line += (male - 0.5) * 5 * np.exp(-(((lag - 40) / 12) ** 2))
    line += style.normal(0, 1.5) * np.exp(-((lag / 45) ** 2))
    # A widow's peak or a round middle.
    line -= style.normal(0.3, 1.0) * np.exp(-((lag / 9) ** 2))
    far = person.hair.receding
    line += far * (34 * np.exp(-(((lag - 36) / 17) ** 2)) + 14 * np.exp(-((lag / 24) ** 2)))
    for wave in (5, 9, 16, 27, 43, 61):
        amplitude, phase = style.normal(0, 2.4 / np.sqrt(wave)), style.random() * 2 * np.pi
        line += amplitude * np.sin(np.radians(azimuth) * wave + phase)
    return elevation - line


def bare_crown(points: np.ndarray, person: Person) -> np.ndarray:
    """The share (R,) of hair that template points have lost to baldness of the crown.

    A bare spot on the crown that grows with `Hair.thinning` until only a horseshoe is left.
    """
    lost = person.hair.thinning
    if lost == 0:
        return np.zeros(len(points))
    away = np.linalg.norm((points - _CROWN) * [1.0, 1.0, 1.4], axis=1)
    size = 0.020 + 0.085 * lost
    spot = smoothstep(size + 0.022, size - 0.014, away)
    top = smoothstep(0.782, 0.812, points[:, 2] - 0.15 * np.maximum(points[:, 1], 0))
    return 0.97 * np.maximum(min(1.0, 1.6 * lost) * spot, smoothstep(0.6, 1.0, lost) * top)
