"""The catalogue of hair styles: who wears each, its dimensions, and how it is combed.

Directions and regions live in template space (see `roots`), lengths in metres. A new style is one
entry of `STYLES`: jobs accept its name, people are drawn who wear it, and `scalp_hair` grows it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.body.hairline import SKULL_CENTRE
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.person import ADULT

WHORL = np.array([0.008, 0.012, 0.849])


@dataclass(frozen=True)
class Guides:
    """What a combing function sees: template-space points and what is fixed per guide, all (G, …).

    `point` now, `root` the origin, `side` -1 or 1 of the parting, `travelled` metres so far.
    """

    point: np.ndarray
    root: np.ndarray
    side: np.ndarray
    travelled: np.ndarray


Combing = Callable[[Guides], np.ndarray]


def combed_from_whorl(guides: Guides) -> np.ndarray:
    """Natural growth: away from the whorl, forward on the top, down elsewhere."""
    away = guides.point - WHORL
    away[:, 2] = np.minimum(away[:, 2], 0)
    return unit(away)


def combed_from_parting(guides: Guides) -> np.ndarray:
    """To either side of the parting and a little back; behind the crown from the whorl."""
    front = smoothstep(0.035, -0.04, guides.root[:, 1])[:, None]
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


def gathered(point: tuple[float, float, float]) -> Combing:
    """Everything drawn over the skull to one point."""

    def combing(guides: Guides) -> np.ndarray:
        return unit(np.asarray(point) - guides.point)

    return combing


def upright(guides: Guides) -> np.ndarray:
    """Straight off the skull."""
    return unit(guides.root - SKULL_CENTRE - np.array([0, 0, -0.02]))


ByAge = Callable[[float, bool], float]
"""A factor by age in years and by whether the person is male."""


def always(age: float, male: bool) -> float:
    """As popular at every age."""
    return 1.0


def over_years(young: tuple[float, float], old: tuple[float, float]) -> ByAge:
    """A factor that runs from one (age in years, factor) to another and is constant beyond."""

    def by_age(age: float, male: bool) -> float:
        return float(np.interp(age, [young[0], old[0]], [young[1], old[1]]))

    return by_age


def _balding(age: float, male: bool) -> float:
    factor = 0.15 + 4.5 * np.clip((age - 28.0) / 40.0, 0.0, 1.0) if male else 1.0
    return factor * (age >= ADULT)


@dataclass(frozen=True)
class Popularity:
    """How often a style is worn, relative to others.

    A product of factors: `women` or `men`, one of `by_texture` (straight, wavy, coily), `by_age`.
    """

    women: float
    men: float
    by_texture: tuple[float, float, float] = (1.0, 1.0, 1.0)
    by_age: ByAge = always

    def weight(self, age: float, male: bool, curl: float) -> float:
        """Relative frequency among people of an age (years) and sex; `curl` as of `Hair`."""
        texture = [np.interp(curl, [0.0, 0.35, 0.7], row) for row in np.eye(3)]
        worn = self.men if male else self.women
        return worn * float(np.dot(self.by_texture, texture)) * self.by_age(age, male)


@dataclass(frozen=True)
class Style:
    """One hair style. Lengths in metres; shares and strengths in [0, 1].

    `popularity` weighs the style in sampling; `under_hat` says that a hat fits over it. `count` is
    the number of strands of the densest hair, 0 on a bald head.

    `length` is the range that `Hair.length` spans on the top, `sides` the share of it on the sides
    and at the nape; `cut` instead trims everything at a height of template space, from and to;
    `fringe` trims what falls over the forehead. `lift` turns the root off the skin, `reach` is how
    far combing holds against gravity, `volume` the height of the outermost layer and `layers` the
    share of it of the innermost. `tousle` bends the combing by a random field. `wave` is
    (amplitude, length of a turn), widened by `Hair.curl`. `lock` is (strands, strength). `tie` is
    where tied hair leaves the skull, `tail` what it becomes: "ponytail" or "bun". `rope` > 0 is
    the radius of locs.
    """

    popularity: Popularity
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
    under_hat: bool = False


_RARER_WITH_AGE = over_years((45, 1.0), (75, 0.3))
_FAVOURED_WITH_AGE = over_years((45, 1.0), (75, 2.0))
_HIGH_TIE = (0.0, 0.050, 0.80)
_TOP_TIE = (0.0, 0.035, 0.852)
STYLES: dict[str, Style] = {
    "bald": Style(
        Popularity(0.03, 0.5, by_age=_balding), combed_from_whorl, (0, 0), count=0, under_hat=True,
    ),
    "buzz": Style(
        Popularity(0.12, 1.4, (0.8, 0.8, 1.8)),
        combed_from_whorl, (0.005, 0.011), count=60000, points=4, radius=8.5e-5, lift=0.4,
        reach=1, gravity=0, volume=0, lock=(1, 0), stray=0.0006, flyaway=0, roughness=0.4,
        under_hat=True,
    ),
    "receding": Style(
        Popularity(0.0, 1.0, (1.0, 1.0, 0.7), over_years((24, 0.0), (50, 1.8))),
        combed_from_whorl, (0.014, 0.032), sides=0.8, count=30000, points=6, lift=0.35, reach=0.2,
        gravity=0.2, volume=0.007, tousle=0.25, lock=(30, 0.35), stray=0.003, crown=1.0,
        under_hat=True,
    ),
    "short": Style(
        Popularity(0.5, 2.2, (1.0, 1.0, 0.6), _FAVOURED_WITH_AGE),
        combed_from_whorl, (0.028, 0.052), sides=0.5, count=44000, points=7, lift=0.55, reach=0.2,
        gravity=0.12, volume=0.014, tousle=0.4, lock=(45, 0.6), stray=0.003, under_hat=True,
    ),
    "crop": Style(
        Popularity(0.3, 1.6, (1.0, 1.0, 0.8)),
        combed_forward, (0.032, 0.048), sides=0.3, fringe=0.776, count=48000, points=7, lift=0.5,
        reach=0.2, gravity=0.15, volume=0.016, tousle=0.3, lock=(60, 0.65), stray=0.003,
        under_hat=True,
    ),
    "side_part": Style(
        Popularity(0.4, 2.0, (1.2, 1.0, 0.1)),
        combed_across, (0.065, 0.09), sides=0.32, count=42000, points=9, lift=0.4, reach=0.15,
        gravity=0.2, volume=0.016, tousle=0.2, lock=(80, 0.5), stray=0.004, parted=True,
        under_hat=True,
    ),
    "slick_back": Style(
        Popularity(0.3, 1.0, (1.0, 0.8, 0.2)),
        combed_back, (0.09, 0.14), sides=0.6, count=36000, points=9, lift=0.45, reach=0.3,
        gravity=0.12, volume=0.014, tousle=0.15, lock=(70, 0.55), stray=0.003, flyaway=0.02,
        roughness=0.25,
    ),
    "pixie": Style(
        Popularity(0.9, 0.1, (1.0, 1.0, 0.6), _FAVOURED_WITH_AGE),
        combed_across, (0.07, 0.10), sides=0.55, count=42000, points=9, lift=0.4, reach=0.06,
        gravity=0.6, volume=0.016, tousle=0.4, lock=(50, 0.5), stray=0.004, parted=True,
        under_hat=True,
    ),
    "bob": Style(
        Popularity(1.6, 0.12, (1.1, 0.9, 0.3), _FAVOURED_WITH_AGE),
        combed_from_parting, (0.34, 0.34), cut=(0.64, 0.60), count=34000, points=12, volume=0.022,
        lift=0.45, lock=(90, 0.35), stray=0.006, parted=True, under_hat=True,
    ),
    "fringe_bob": Style(
        Popularity(1.0, 0.05, (1.2, 0.8, 0.2)),
        combed_forward, (0.34, 0.34), cut=(0.665, 0.615), fringe=0.754, count=36000, points=12,
        volume=0.018, lift=0.4, lock=(110, 0.5), stray=0.004, under_hat=True,
    ),
    "long_straight": Style(
        Popularity(2.2, 0.2, (1.3, 0.4, 0.25), _RARER_WITH_AGE),
        combed_from_parting, (0.46, 0.5), cut=(0.56, 0.45), count=32000, points=14, parted=True,
        volume=0.022, lift=0.45, lock=(110, 0.5), stray=0.006, under_hat=True,
    ),
    "long_wavy": Style(
        Popularity(2.0, 0.25, (0.5, 1.8, 0.3), _RARER_WITH_AGE),
        combed_from_parting, (0.46, 0.5), cut=(0.56, 0.46), count=30000, points=18, parted=True,
        volume=0.028, lift=0.5, tousle=0.2, wave=(0.014, 0.09), flat=0.4, lock=(200, 1.4),
        stray=0.006, under_hat=True,
    ),
    "curly": Style(
        Popularity(1.2, 0.8, (0.05, 0.9, 1.6)),
        combed_loosely, (0.14, 0.26), count=24000, points=22, radius=6.5e-5, volume=0.040,
        lift=0.7, reach=0.06, gravity=0.5, tousle=0.6, wave=(0.0105, 0.048), flat=0.0,
        lock=(130, 2.2), stray=0.003, flyaway=0.06, sides=0.85,
    ),
    "afro": Style(
        Popularity(1.0, 0.7, (0.0, 0.02, 2.2)),
        upright, (0.05, 0.11), count=44000, points=14, radius=5e-5, lift=1.0, reach=9,
        gravity=0.0, stiffness=0.9, volume=0, tousle=0.35, wave=(0.003, 0.011), flat=0.0,
        lock=(60, 0.35), stray=0.010, sides=0.9, flyaway=0.06, roughness=0.4,
    ),
    "coils": Style(
        Popularity(0.7, 0.9, (0.0, 0.02, 2.2)),
        upright, (0.014, 0.03), count=54000, points=10, radius=5.5e-5, lift=1.0, reach=9,
        gravity=0.0, stiffness=0.9, volume=0, tousle=0.4, wave=(0.0025, 0.010), flat=0.0,
        lock=(60, 0.5), stray=0.004, sides=0.6, roughness=0.4,
    ),
    "locs": Style(
        Popularity(0.6, 0.6, (0.0, 0.03, 1.8)),
        combed_from_parting, (0.2, 0.36), count=32000, points=12, parted=True, volume=0.024,
        lift=0.4, tousle=0.3, stray=0.001, rope=0.0042, sides=0.9, lock=(1, 0), flyaway=0.05,
        roughness=0.4, under_hat=True,
    ),
    "ponytail": Style(
        Popularity(1.3, 0.12, (1.0, 1.0, 0.8), _RARER_WITH_AGE),
        gathered(_HIGH_TIE), (0.3, 0.3), count=34000, points=12, lift=0.3, reach=9, gravity=0.0,
        volume=0.010, lock=(70, 0.4), stray=0.004, tie=_HIGH_TIE, tail="ponytail",
    ),
    "bun": Style(
        Popularity(0.9, 0.15),
        gathered(_TOP_TIE), (0.3, 0.3), count=34000, points=12, lift=0.3, reach=9, gravity=0.0,
        volume=0.010, lock=(70, 0.4), stray=0.004, tie=_TOP_TIE, tail="bun",
    ),
}  # fmt: skip
