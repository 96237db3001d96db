"""Where hair grows on the scalp: the hairline, its recession with age, and the parting.

Points and regions are in template space (see `roots`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets_procedural.hair_styles import SKULL_CENTRE, WHORL, Style
from assets_procedural.person import Person
from assets_procedural.roots import Roots
from assets_procedural.vectors import arctan2, smoothstep

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
    """How far the front hairline has moved up, in [0, 1]: older men, each to his own degree."""
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


def scalp_density(person: Person, style: Style, ears: np.ndarray, soft: float) -> Callable:
    def density(points: np.ndarray, roots: Roots) -> np.ndarray:
        inside = hairline_distance(points, person)
        offset = points - SKULL_CENTRE
        front = np.exp(-((np.degrees(arctan2(offset[:, 0], -offset[:, 1])) / 60) ** 2))
        width = soft * (0.7 + 0.6 * front)
        grown = smoothstep(-width, width, inside) * smoothstep(0.7, 0.35, roots.of(ears))
        if style.volume > 0:
            grown = grown * (0.25 + 0.75 * _bare_risk(points, inside, style, person))
        if style.crown > 0:
            # What pattern baldness leaves: a wreath, and down on the top.
            top = smoothstep(0.786, 0.818, points[:, 2] - 0.15 * np.maximum(points[:, 1], 0))
            grown = grown * (1 - style.crown * 0.97 * top)
        return grown

    return density


def _bare_risk(points: np.ndarray, inside: np.ndarray, style: Style, person: Person) -> np.ndarray:
    """Where hair only leaves and none arrives to cover the skin, (R,) in [0, 1].

    At a parting, the whorl and the front hairline hair must grow denser for the same cover.
    """
    parting = near_parting(points, person) * style.parted
    whorl = np.exp(-(((points - WHORL) / 0.022) ** 2).sum(axis=1)) * (style.tie is None)
    line = smoothstep(9, 2, inside) * 0.45
    return np.maximum(np.maximum(parting, whorl), line)


def near_parting(points: np.ndarray, person: Person) -> np.ndarray:
    """1 on the parting to 0 a centimetre and a half away from it, (R,)."""
    gap = (points[:, 0] - _part_line(person, points[:, 1])) / 0.009
    front = smoothstep(0.05, 0.0, points[:, 1]) * (points[:, 2] > 0.78)
    return np.exp(-(gap**2)) * front


def _part_line(person: Person, y: np.ndarray) -> np.ndarray:
    """Template x of the parting at template y; behind the crown it returns to the middle."""
    return person.hair.parting * 0.046 * smoothstep(0.04, -0.02, y)


def parting_sides(points: np.ndarray, person: Person, rng: np.random.Generator) -> np.ndarray:
    """Side (-1, 1) of the parting; hairs close to it cross over, so that it shows no bare line."""
    gap = points[:, 0] - _part_line(person, points[:, 1])
    gap = gap + rng.normal(0, 0.002, len(points))
    return np.where(gap > 0, 1, -1)
