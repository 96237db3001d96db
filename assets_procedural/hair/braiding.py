"""What tied and worked hair becomes: tails, braids, buns and puffs; locs, twists and braids.

Symbols: N strands, G guides, K points a strand. Metres, the rest frame of `head`.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.body.hairline import SKULL_CENTRE
from assets_procedural.body.roots import HeadFrame
from assets_procedural.hair.draping import Surface
from assets_procedural.hair.strands import sideways, spread
from assets_procedural.hair.styles import Style
from assets_procedural.mesh.vectors import smoothstep, unit, way_along
from assets_procedural.person import Person

_CLEAR = 0.02


def tails(
    style: Style,
    person: Person,
    frame: HeadFrame,
    surface: Surface,
    count: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What hair becomes behind its ties.

    Returns `count` strands (count, K, 3), the axis (T, K, 3) of each of the T tails, by which it
    drapes, and the tail (count,) of each strand.
    """
    number = np.arange(count) % len(style.ties)
    strands = np.zeros((count, style.points, 3))
    axes = []
    for index, tie in enumerate(style.ties):
        mine = np.flatnonzero(number == index)
        at = frame.to_rest(np.asarray(tie, float))
        out = unit(at - frame.to_rest(SKULL_CENTRE))
        if style.tail in ("ponytail", "braid"):
            axis = _hanging(style, person, at, out, surface)
            shape = _braided if style.tail == "braid" else _tail
            strands[mine] = shape(axis, len(mine), person, rng)
        else:
            shape = _bun if style.tail == "bun" else _puff
            middle, strands[mine] = shape(at, out, len(mine), style.points, person, rng)
            axis = np.broadcast_to(middle, (style.points, 3))
        axes.append(axis)
    return strands, np.stack(axes), number


def _hanging(
    style: Style, person: Person, tie: np.ndarray, out: np.ndarray, surface: Surface
) -> np.ndarray:
    """The axis (K, 3) of a tail: thrown off the skull, then down, off neck and shoulders."""
    length = 0.15 + 0.22 * person.hair.length
    along = np.linspace(0, 1, style.points) * length
    thrown = 0.022 if style.tail == "ponytail" else 0.015
    away = out * (thrown * (1 - np.exp(-along / 0.03)))[:, None]
    fall = np.maximum(along - 0.03 * (1 - np.exp(-along / 0.03)), 0)
    axis = tie + away - fall[:, None] * np.array([0, 0, 1.0])
    if abs(tie[0]) > 0.03:  # beside the neck, and forward over the shoulder
        axis[:, 1] -= 0.075 * smoothstep(0.02, 0.11, fall)
    for _ in range(3):
        axis[1:] = surface.push_out(axis[1:], _CLEAR)
    return axis


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two unit fields (K, 3) across an axis (K, 3), and the way (K,) along it."""
    across, other = sideways(axis[None])
    return across[0], other[0], way_along(axis)


def _tail(axis: np.ndarray, count: int, person: Person, rng: np.random.Generator) -> np.ndarray:
    across, other, _ = _across(axis)
    along = np.linspace(0, 1, len(axis))
    angle, reach = rng.random(count) * 2 * np.pi, np.sqrt(rng.random(count))
    fluff = 0.7 + 1.0 * person.hair.curl
    width = 0.007 + 0.016 * fluff * np.sin(np.pi * np.clip(along * 0.9 + 0.03, 0, 1)) ** 0.8
    x, y = np.cos(angle) * reach, np.sin(angle) * reach
    return axis + width[:, None] * (x[:, None, None] * across + y[:, None, None] * other)


def _braided(axis: np.ndarray, count: int, person: Person, rng: np.random.Generator) -> np.ndarray:
    across, other, way = _across(axis)
    along = np.linspace(0, 1, len(axis))
    radius = 0.012 * (1 - 0.5 * along**1.5)
    # The end is a loose tassel behind its band.
    tassel = smoothstep(0.88, 0.95, along)
    x, y = _plaited(count, way / 0.042, "braid", rng)
    x, y = x * radius * (1 - 0.5 * tassel), y * radius * (1 - 0.5 * tassel)
    return axis + x[..., None] * across + y[..., None] * other


def _plaited(
    count: int, turns: np.ndarray, plait: str, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Where fibres (count, K) run in a rope of radius 1 that has turned `turns` (…, K) times."""
    angle, reach = rng.random((count, 1)) * 2 * np.pi, np.sqrt(rng.random((count, 1)))
    if plait == "braid":
        phase = 2 * np.pi * (turns + rng.integers(0, 3, (count, 1)) / 3)
        x, y, thick = 0.62 * np.sin(phase), 0.34 * np.sin(2 * phase), 0.42
    elif plait == "twist":
        phase = 2 * np.pi * (turns + rng.integers(0, 2, (count, 1)) / 2)
        x, y, thick = 0.5 * np.cos(phase), 0.5 * np.sin(phase), 0.52
    else:
        x, y, thick = 0.0, 0.0, 1.0
        angle, reach = angle + 1.5 * turns * rng.normal(size=(count, 1)), 0.6 + 0.4 * reach
    return x + thick * reach * np.cos(angle), y + thick * reach * np.sin(angle)


def _bun(
    tie: np.ndarray, out: np.ndarray, count: int, points: int, person: Person,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Strands wind in a few thick turns around the axis of the bun, on a bulging torus."""
    size = 0.027 + 0.011 * person.hair.length
    middle = tie + out * size * 0.6
    across = unit(np.cross(out, [1.0, 0.1, 0]))
    other = np.cross(out, across)
    along = np.linspace(0, 1, points)
    # Coils of hair: each strand keeps to one of seven, which lie a little askew.
    coil = rng.integers(0, 7, count)
    centre = rng.uniform(0, 2 * np.pi, 7)[coil] + rng.normal(0, 0.28, count)
    turn = rng.random(count)[:, None] * 2 * np.pi + along * rng.uniform(1.2, 2.2, (count, 1))
    level = centre[:, None] + along * 0.9 + 0.4 * np.sin(turn + coil[:, None])
    tube = size * 0.5 * np.sqrt(rng.uniform(0.6, 1, (count, 1)))
    tube = tube * (1 + 0.10 * np.cos(7 * level + coil[:, None]))
    ring = size * 0.5 + tube * np.cos(level)
    strands = middle + out * (tube * np.sin(level) * 0.95)[..., None]
    strands = strands + ring[..., None] * (
        np.cos(turn)[..., None] * across + np.sin(turn)[..., None] * other
    )
    return middle, strands


def _puff(
    tie: np.ndarray, out: np.ndarray, count: int, points: int, person: Person,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """A ball of coily hair that bursts from its tie."""
    size = 0.055 + 0.04 * person.hair.length
    ray = unit(rng.normal(size=(count, 3)) + 0.9 * out)
    along = np.linspace(0, 1, points)[:, None]
    reach = size * rng.uniform(0.8, 1.05, (count, 1, 1)) * (0.6 + 0.4 * (ray @ out)[:, None, None])
    strands = tie + out * 0.01 + ray[:, None] * along * reach
    return tie + out * size * 0.6, strands


def roped(
    style: Style, strands: np.ndarray, side: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Strands as the fibres of ropes around some of them, and the number (N,) of their rope."""
    centres = rng.permutation(len(strands))[: style.ropes]
    ids, _ = spread(strands[centres, 0], side[centres], strands[:, 0], side, neighbours=1)
    rope = ids[:, 0]
    core = strands[centres]
    across, other = sideways(core)
    way = np.cumsum(np.linalg.norm(np.diff(core, axis=1, prepend=core[:, :1]), axis=2), axis=1)
    pitch = {"loc": 0.05, "twist": 0.022, "braid": 0.020}[style.plait]
    x, y = _plaited(len(strands), (way / pitch)[rope], style.plait, rng)
    along = np.linspace(0, 1, strands.shape[1])
    size = style.rope * rng.uniform(0.8, 1.15, len(centres))[rope, None] * (1 - 0.3 * along**3)
    fibre = core[rope] + (x * size)[..., None] * across[rope] + (y * size)[..., None] * other[rope]
    blend = smoothstep(0, 0.014, way[rope])[..., None]
    return strands * (1 - blend) + fibre * blend, rope
