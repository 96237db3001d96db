"""The hairline: where the scalp begins, and its recession with age.

Points and regions are in template space (see `roots`).
"""

from __future__ import annotations

import numpy as np

from assets_procedural.mesh.vectors import arctan2, smoothstep
from assets_procedural.person import Person

SKULL_CENTRE = np.array([0.0, -0.05, 0.745])
"""(3,) metres, template space: hairline and combing are measured about it."""

# The hairline: azimuth from the front (degrees) to elevation about the skull's centre (degrees).
_HAIRLINE = np.array(
    [
        (0, 32.5), (12, 32.5), (24, 34), (34, 35), (44, 32), (52, 25), (58, 16), (63, 7),
        (67, -6), (70, -24), (75, -30), (79, -22), (84, -6), (92, -4), (102, -5), (109, -12),
        (115, -32), (124, -45), (150, -53), (180, -55),
    ],
    float,
)  # fmt: skip


def recession(person: Person) -> float:
    """How far the front hairline has receded, in [0, 1]: in older men, each to his own degree."""
    male = 1 - person.phenotypes.get("gender", 0.5)
    chance = np.random.default_rng(person.hair.seed).random()
    aged = smoothstep(28, 75, np.asarray(person.age_years))
    return float(np.clip(male * 1.4 - 0.4, 0, 1) * aged * (0.15 + 0.85 * chance**1.5))


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
    far = recession(person)
    line += far * (34 * np.exp(-(((lag - 36) / 17) ** 2)) + 14 * np.exp(-((lag / 24) ** 2)))
    for wave in (5, 9, 16, 27):
        amplitude, phase = style.normal(0, 2.2 / np.sqrt(wave)), style.random() * 2 * np.pi
        line += amplitude * np.sin(np.radians(azimuth) * wave + phase)
    return elevation - line
