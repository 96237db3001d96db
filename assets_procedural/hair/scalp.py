"""How dense hair grows on the scalp, and the parting.

Points and regions are in template space (see `roots`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets_procedural.body.hairline import SKULL_CENTRE, hairline_distance
from assets_procedural.body.roots import Roots
from assets_procedural.hair.styles import WHORL, Style
from assets_procedural.mesh.vectors import arctan2, smoothstep
from assets_procedural.person import Person


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
            # What pattern baldness leaves: a horseshoe of hair, and fuzz on top.
            top = smoothstep(0.786, 0.818, points[:, 2] - 0.15 * np.maximum(points[:, 1], 0))
            grown = grown * (1 - style.crown * 0.97 * top)
        return grown

    return density


def _bare_risk(points: np.ndarray, inside: np.ndarray, style: Style, person: Person) -> np.ndarray:
    """Where hair grows away and none falls back to cover the skin, (R,) in [0, 1].

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
    """Side (-1, 1) of the parting; hairs close to it cross over, so no bare line shows."""
    gap = points[:, 0] - _part_line(person, points[:, 1])
    gap = gap + rng.normal(0, 0.002, len(points))
    return np.where(gap > 0, 1, -1)
