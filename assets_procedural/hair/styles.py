"""The catalogue of hair styles: numbers, and one function for where the hair is combed.

Directions and regions live in template space (see `roots`), lengths in metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.body.hairline import SKULL_CENTRE
from assets_procedural.mesh.vectors import smoothstep, unit

WHORL = np.array([0.008, 0.012, 0.849])


@dataclass(frozen=True)
class Field:
    """What a combing function sees: template-space points and what is fixed per guide, all (G, …).

    `point` now, `root` the origin, `side` -1 or 1 of the parting, `travelled` metres so far.
    """

    point: np.ndarray
    root: np.ndarray
    side: np.ndarray
    travelled: np.ndarray


Combing = Callable[[Field], np.ndarray]


def combed_from_whorl(field: Field) -> np.ndarray:
    """Natural growth: away from the whorl, forward on the top, down elsewhere."""
    away = field.point - WHORL
    away[:, 2] = np.minimum(away[:, 2], 0)
    return unit(away)


def combed_from_parting(field: Field) -> np.ndarray:
    """To either side of the parting and a little back; behind the crown from the whorl."""
    front = smoothstep(0.035, -0.04, field.root[:, 1])[:, None]
    back = 0.55 + 0.4 * smoothstep(-0.09, -0.14, field.root[:, 1])
    apart = np.stack([field.side, back, np.full(len(back), -0.15)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(field))


def combed_loosely(field: Field) -> np.ndarray:
    """Away from the middle without a parting, a little back at the front."""
    front = smoothstep(0.035, -0.04, field.root[:, 1])[:, None]
    back = 0.1 + 0.5 * smoothstep(-0.09, -0.14, field.root[:, 1])
    x = np.tanh(field.root[:, 0] / 0.025) + 0.25 * field.side
    apart = np.stack([x, back, np.full(len(back), -0.1)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(field))


def combed_back(field: Field) -> np.ndarray:
    """Straight back over the top, back and down along the sides."""
    low = smoothstep(0.80, 0.70, field.root[:, 2])
    x = 0.25 * np.sign(field.root[:, 0]) * (1 - low)
    return unit(np.stack([x, np.ones(len(x)), -0.15 - 0.6 * low], axis=1))


def combed_across(field: Field) -> np.ndarray:
    """The top swept over from a side parting and back, the sides down and back."""
    top = smoothstep(0.77, 0.80, field.root[:, 2])[:, None]
    over = np.stack([field.side, np.full(len(top), 0.55), np.zeros(len(top))], axis=1)
    down = np.stack([np.zeros(len(top)), np.full(len(top), 0.45), -np.ones(len(top))], axis=1)
    return unit(top * unit(over) + (1 - top) * unit(down))


def combed_forward(field: Field) -> np.ndarray:
    """The front third down over the forehead as a fringe, the rest as from a parting."""
    fringe = smoothstep(0.062, 0.05, np.abs(field.root[:, 0]))
    fringe = fringe * smoothstep(-0.035, -0.06, field.root[:, 1])
    x = 1.5 * field.root[:, 0]
    forward = np.stack([x, np.full(len(x), -1.0), np.full(len(x), -0.3)], axis=1)
    return unit(fringe[:, None] * forward + (1 - fringe[:, None]) * combed_from_whorl(field))


def gathered(point: tuple[float, float, float]) -> Combing:
    """Everything drawn over the skull to one point."""

    def combing(field: Field) -> np.ndarray:
        return unit(np.asarray(point) - field.point)

    return combing


def upright(field: Field) -> np.ndarray:
    """Straight off the skull."""
    return unit(field.root - SKULL_CENTRE - np.array([0, 0, -0.02]))


@dataclass(frozen=True)
class Style:
    """One hair style. Lengths in metres; shares and strengths in [0, 1].

    `length` is the range that `Hair.length` spans on the top, `sides` the share of it on the sides
    and at the nape; `cut` instead trims everything at a height of template space, from and to;
    `fringe` trims what falls over the forehead. `lift` turns the root off the skin, `reach` is how
    far combing holds against gravity, `volume` the height of the outermost layer and `layers` the
    share of it of the innermost. `tousle` bends the combing by a random field. `wave` is
    (amplitude, length of a turn), widened by `Hair.curl`. `lock` is (strands, strength). `tie` is
    where tied hair leaves the skull, `tail` what it becomes: "ponytail" or "bun". `rope` > 0 is
    the radius of locs.
    """

    combing: Combing
    length: tuple[float, float]
    sides: float = 1.0
    cut: tuple[float, float] | None = None
    fringe: float | None = None
    count: int = 30000
    points: int = 10
    radius: float = 5.5e-5
    lift: float = 0.3
    reach: float = 0.05
    stiffness: float = 0.6
    gravity: float = 0.5
    volume: float = 0.012
    layers: float = 0.15
    tousle: float = 0.0
    wave: tuple[float, float] = (0.0, 0.05)
    flat: float = 0.3
    lock: tuple[float, float] = (40.0, 0.35)
    stray: float = 0.004
    flyaway: float = 0.03
    parted: bool = False
    crown: float = 0.0
    tie: tuple[float, float, float] | None = None
    tail: str = ""
    rope: float = 0.0
    roughness: float = 0.3


_HIGH_TIE = (0.0, 0.050, 0.80)
_TOP_TIE = (0.0, 0.035, 0.852)
STYLES: dict[str, Style | None] = {
    "bald": None,
    "buzz": Style(
        combed_from_whorl, (0.005, 0.011), count=60000, points=4, radius=8.5e-5, lift=0.4,
        reach=1, gravity=0, volume=0, lock=(1, 0), stray=0.0006, flyaway=0, roughness=0.4,
    ),
    "receding": Style(
        combed_from_whorl, (0.014, 0.032), sides=0.8, count=30000, points=6, lift=0.35, reach=0.2,
        gravity=0.2, volume=0.007, tousle=0.25, lock=(30, 0.35), stray=0.003, crown=1.0,
    ),
    "short": Style(
        combed_from_whorl, (0.028, 0.052), sides=0.5, count=44000, points=7, lift=0.55, reach=0.2,
        gravity=0.12, volume=0.014, tousle=0.4, lock=(45, 0.6), stray=0.003,
    ),
    "crop": Style(
        combed_forward, (0.032, 0.048), sides=0.3, fringe=0.776, count=48000, points=7, lift=0.5,
        reach=0.2, gravity=0.15, volume=0.016, tousle=0.3, lock=(60, 0.65), stray=0.003,
    ),
    "side_part": Style(
        combed_across, (0.065, 0.09), sides=0.32, count=42000, points=9, lift=0.4, reach=0.15,
        gravity=0.2, volume=0.016, tousle=0.2, lock=(80, 0.5), stray=0.004, parted=True,
    ),
    "slick_back": Style(
        combed_back, (0.09, 0.14), sides=0.6, count=36000, points=9, lift=0.45, reach=0.3,
        gravity=0.12, volume=0.014, tousle=0.15, lock=(70, 0.55), stray=0.003, flyaway=0.02,
        roughness=0.25,
    ),
    "pixie": Style(
        combed_across, (0.07, 0.10), sides=0.55, count=42000, points=9, lift=0.4, reach=0.06,
        gravity=0.6, volume=0.016, tousle=0.4, lock=(50, 0.5), stray=0.004, parted=True,
    ),
    "bob": Style(
        combed_from_parting, (0.34, 0.34), cut=(0.64, 0.60), count=34000, points=12, volume=0.022,
        lift=0.45, lock=(90, 0.35), stray=0.006, parted=True,
    ),
    "fringe_bob": Style(
        combed_forward, (0.34, 0.34), cut=(0.665, 0.615), fringe=0.754, count=36000, points=12,
        volume=0.018, lift=0.4, lock=(110, 0.5), stray=0.004,
    ),
    "long_straight": Style(
        combed_from_parting, (0.46, 0.5), cut=(0.56, 0.45), count=32000, points=14, parted=True,
        volume=0.022, lift=0.45, lock=(110, 0.5), stray=0.006,
    ),
    "long_wavy": Style(
        combed_from_parting, (0.46, 0.5), cut=(0.56, 0.46), count=30000, points=18, parted=True,
        volume=0.028, lift=0.5, tousle=0.2, wave=(0.014, 0.09), flat=0.4, lock=(200, 1.4),
        stray=0.006,
    ),
    "curly": Style(
        combed_loosely, (0.14, 0.26), count=24000, points=22, radius=6.5e-5, volume=0.040,
        lift=0.7, reach=0.06, gravity=0.5, tousle=0.6, wave=(0.0105, 0.048), flat=0.0,
        lock=(130, 2.2), stray=0.003, flyaway=0.06, sides=0.85,
    ),
    "afro": Style(
        upright, (0.05, 0.11), count=44000, points=14, radius=5e-5, lift=1.0, reach=9,
        gravity=0.0, stiffness=0.9, volume=0, tousle=0.35, wave=(0.003, 0.011), flat=0.0,
        lock=(60, 0.35), stray=0.010, sides=0.9, flyaway=0.06, roughness=0.4,
    ),
    "coils": Style(
        upright, (0.014, 0.03), count=54000, points=10, radius=5.5e-5, lift=1.0, reach=9,
        gravity=0.0, stiffness=0.9, volume=0, tousle=0.4, wave=(0.0025, 0.010), flat=0.0,
        lock=(60, 0.5), stray=0.004, sides=0.6, roughness=0.4,
    ),
    "locs": Style(
        combed_from_parting, (0.2, 0.36), count=32000, points=12, parted=True, volume=0.024,
        lift=0.4, tousle=0.3, stray=0.001, rope=0.0042, sides=0.9, lock=(1, 0), flyaway=0.05,
        roughness=0.4,
    ),
    "ponytail": Style(
        gathered(_HIGH_TIE), (0.3, 0.3), count=34000, points=12, lift=0.3, reach=9, gravity=0.0,
        volume=0.010, lock=(70, 0.4), stray=0.004, tie=_HIGH_TIE, tail="ponytail",
    ),
    "bun": Style(
        gathered(_TOP_TIE), (0.3, 0.3), count=34000, points=12, lift=0.3, reach=9, gravity=0.0,
        volume=0.010, lock=(70, 0.4), stray=0.004, tie=_TOP_TIE, tail="bun",
    ),
}  # fmt: skip
