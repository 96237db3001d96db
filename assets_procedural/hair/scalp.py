"""How dense hair grows on the scalp, and the parting.

Points and regions are in template space (see `roots`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets_procedural.body.hairline import bare_crown, hairline_distance
from assets_procedural.body.roots import Roots
from assets_procedural.hair.combing import WHORL, row_offset
from assets_procedural.hair.strands import tousled
from assets_procedural.hair.styles import Style
from assets_procedural.mesh.vectors import smoothstep
from assets_procedural.person import Person


def with_style_loss(person: Person, style: Style) -> Person:
    """The person with at least the hair loss that the style shows."""
    hair = person.hair
    least = {
        "receding": max(hair.receding, style.receding),
        "thinning": max(hair.thinning, style.thinning),
    }
    return person.model_copy(update={"hair": hair.model_copy(update=least)})


def scalp_density(person: Person, style: Style, ears: np.ndarray) -> Callable:
    """Relative density in [0, 1] of scalp hair, as `sample_roots` wants it.

    Over a centimetre and a half of ragged hairline it grows from single baby hairs to dense.
    """
    seed = np.random.default_rng([person.hair.seed, 23]).integers(2**31)

    def density(points: np.ndarray, roots: Roots) -> np.ndarray:
        ragged = tousled(points * 3.0, np.random.default_rng(seed))[:, 0]
        # The hairline is soft over the face, and sharper around the ears and at the nape.
        front = smoothstep(0.0, -0.07, points[:, 1])
        inside = (hairline_distance(points, person) + 1.6 * ragged) * (2.2 - 1.2 * front)
        grown = 0.05 * smoothstep(-7, -3, inside) + 0.95 * smoothstep(-4.5, 5, inside)
        grown = grown * smoothstep(0.7, 0.35, roots.of(ears))
        if style.volume > 0:
            # Long hair covers what lies below it, short hair its own skin only.
            least = 0.6 if style.length[1] < 0.06 else 0.2
            risk = _bare_risk(points, inside, style, person)
            grown = grown * (least + (1 - least) * risk)
        if style.rows:
            place, _ = row_offset(points, style.rows)
            grown = grown * smoothstep(0.5, 0.34, np.abs(place))
        return grown * (1 - bare_crown(points, person))

    return density


def _bare_risk(points: np.ndarray, inside: np.ndarray, style: Style, person: Person) -> np.ndarray:
    """Where hair grows away and none falls back to cover the skin, (R,) in [0, 1].

    At a parting, the whorl and the front hairline hair must grow denser for the same cover.
    """
    parting = near_parting(points, person) ** 2 * style.parted
    whorl = np.exp(-(((points - WHORL) / 0.022) ** 2).sum(axis=1)) * (not style.ties)
    line = smoothstep(14, 3, inside) * 0.9
    return np.maximum(np.maximum(parting, whorl), line)


def near_parting(points: np.ndarray, person: Person) -> np.ndarray:
    """1 on the parting to 0 a centimetre and a half away from it, (R,)."""
    return np.exp(-((part_gap(points, person) / 0.009) ** 2)) * (points[:, 2] > 0.78)


def part_gap(points: np.ndarray, person: Person) -> np.ndarray:
    """Distance (R,) in metres from the parting, which ends behind the crown."""
    gap = np.abs(points[:, 0] - _part_line(person, points[:, 1]))
    return gap + 0.1 * smoothstep(0.01, 0.06, points[:, 1])


def _part_line(person: Person, y: np.ndarray) -> np.ndarray:
    """Template x of the parting at template y; behind the crown it returns to the middle."""
    return person.hair.parting * 0.046 * smoothstep(0.04, -0.02, y)


def parted_aside(person: Person, least: float) -> Person:
    """The person with a parting at least so far off the middle, as of `Hair.parting`."""
    parting = person.hair.parting
    if abs(parting) >= least:
        return person
    parting = -least if parting < 0 else least
    return person.model_copy(update={"hair": person.hair.model_copy(update={"parting": parting})})


def parting_sides(points: np.ndarray, person: Person, rng: np.random.Generator) -> np.ndarray:
    """Side (-1, 1) of the parting; hairs close to it cross over, so that it is no drawn line."""
    gap = points[:, 0] - _part_line(person, points[:, 1])
    line = np.random.default_rng([person.hair.seed, 29])
    gap = gap + 0.0014 * tousled(points * 2.0, line)[:, 0] + rng.normal(0, 0.0018, len(points))
    return np.where(gap > 0, 1, -1)
