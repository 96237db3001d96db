"""The ways hair is combed: directions of growth over the skull, in template space (see `roots`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.body.hairline import SKULL_CENTRE
from assets_procedural.mesh.vectors import arctan2, smoothstep, unit

WHORL = np.array([0.008, 0.012, 0.849])


@dataclass(frozen=True)
class Guides:
    """What a combing function sees: template-space points and what is fixed per guide, all (G, …).

    `point` now, `root` the origin, `side` -1 or 1 of the parting.
    """

    point: np.ndarray
    root: np.ndarray
    side: np.ndarray


Combing = Callable[[Guides], np.ndarray]


def combed_from_whorl(guides: Guides) -> np.ndarray:
    """Natural growth: away from the whorl, forward on the top, down elsewhere."""
    away = guides.point - WHORL
    away[:, 2] = np.minimum(away[:, 2], 0)
    return unit(away)


def combed_from_parting(guides: Guides) -> np.ndarray:
    """To either side of the parting and a little back; behind the crown from the whorl."""
    front = smoothstep(0.035, -0.04, guides.root[:, 1])[:, None]
    # Below the temples it falls: outwards it would leave the head.
    front = front * smoothstep(0.75, 0.80, guides.root[:, 2])[:, None]
    back = 0.55 + 0.4 * smoothstep(-0.09, -0.14, guides.root[:, 1])
    apart = np.stack([guides.side, back, np.full(len(back), -0.15)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(guides))


def combed_loosely(guides: Guides) -> np.ndarray:
    """Away from the middle without a parting, a little back at the front."""
    front = smoothstep(0.035, -0.04, guides.root[:, 1])[:, None]
    back = 0.1 + 0.5 * smoothstep(-0.09, -0.14, guides.root[:, 1])
    x = np.tanh(guides.root[:, 0] / 0.025) + 0.25 * guides.side
    apart = np.stack([x, back, np.full(len(back), -0.1)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(guides))


def combed_back(guides: Guides) -> np.ndarray:
    """Straight back over the top, back and down along the sides."""
    low = smoothstep(0.80, 0.70, guides.root[:, 2])
    x = 0.25 * np.sign(guides.root[:, 0]) * (1 - low)
    return unit(np.stack([x, np.ones(len(x)), -0.15 - 0.6 * low], axis=1))


def combed_across(guides: Guides) -> np.ndarray:
    """The top swept over from a side parting and back, the sides down and back."""
    top = smoothstep(0.77, 0.80, guides.root[:, 2])[:, None]
    over = np.stack([guides.side, np.full(len(top), 0.55), np.zeros(len(top))], axis=1)
    down = np.stack([np.zeros(len(top)), np.full(len(top), 0.45), -np.ones(len(top))], axis=1)
    return unit(top * unit(over) + (1 - top) * unit(down))


def combed_forward(guides: Guides) -> np.ndarray:
    """The front third down over the forehead as a fringe, the rest as from a parting."""
    fringe = smoothstep(0.062, 0.05, np.abs(guides.root[:, 0]))
    fringe = fringe * smoothstep(-0.035, -0.06, guides.root[:, 1])
    x = 1.5 * guides.root[:, 0]
    forward = np.stack([x, np.full(len(x), -1.0), np.full(len(x), -0.3)], axis=1)
    return unit(fringe[:, None] * forward + (1 - fringe[:, None]) * combed_from_whorl(guides))


def combed_under(guides: Guides) -> np.ndarray:
    """To all sides from the crown, forward on the whole front: a bowl."""
    forward = smoothstep(0.04, -0.02, guides.root[:, 1])[:, None]
    spread = np.stack([7.0 * guides.root[:, 0], np.full(len(guides.root), -1.0)], axis=1)
    ahead = np.column_stack([spread, np.full(len(spread), -0.35)])
    return unit(forward * unit(ahead) + (1 - forward) * combed_from_whorl(guides))


# Cornrows run to a point below the nape, in rows of equal angle about this axis through the skull.
_NAPE = np.array([0.0, 0.075, 0.665])
_ROW_AXIS = unit(_NAPE - SKULL_CENTRE - np.array([0.0, 0.0, 0.01]))


def row_offset(points: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Where points (R, 3) lie across their row of `rows` over the head, and the way across.

    Returns (R,) in [-0.5, 0.5], 0 at the middle of a row, and unit vectors (R, 3).
    """
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, _ROW_AXIS)
    offset = points - SKULL_CENTRE
    angle = arctan2(offset @ right, offset @ up)
    place = angle * rows / np.pi
    turn = np.cos(angle)[:, None] * right - np.sin(angle)[:, None] * up
    return place - np.round(place), turn


def combed_in_rows(rows: int) -> Combing:
    """Back to the nape along `rows` rows, every hair into the middle of its own."""

    def combing(guides: Guides) -> np.ndarray:
        place, across = row_offset(guides.point, rows)
        return unit(unit(_NAPE - guides.point) - 2.6 * place[:, None] * across)

    return combing


def upright(guides: Guides) -> np.ndarray:
    """Straight off the skull."""
    return unit(guides.root - SKULL_CENTRE - np.array([0, 0, -0.02]))
