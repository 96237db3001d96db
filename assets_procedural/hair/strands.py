"""Shaping strands in numpy: guides to children, locks, curls and strays, radii.

Symbols: N strands, G guides, K points a strand. Metres.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.mesh.vectors import across, smoothstep, unit


def strand_lengths(strands: np.ndarray) -> np.ndarray:
    """Metres (N,) from root to tip along strands (N, K, 3)."""
    return np.linalg.norm(np.diff(strands, axis=1), axis=2).sum(axis=1)


def resample(strands: np.ndarray, stop: np.ndarray, count: int) -> np.ndarray:
    """Strands (N, K, 3) cut at the fraction `stop` (N,) of their length → (N, count, 3)."""
    last = strands.shape[1] - 1
    place = stop[:, None] * np.linspace(0, last, count)
    low = np.clip(place.astype(int), 0, last - 1)
    share = (place - low)[..., None]
    row = np.arange(len(strands))[:, None]
    return strands[row, low] * (1 - share) + strands[row, low + 1] * share


def spread(
    guides: np.ndarray,
    guide_side: np.ndarray,
    roots: np.ndarray,
    side: np.ndarray,
    neighbours: int = 3,
    focus: float = 2.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Which guides each child mixes: (ids (N, neighbours), weights (N, neighbours)).

    `guides` (G, 3) and `roots` (N, 3) are root positions; a child only mixes guides of its own
    `side`, so that nothing bridges a parting. A guide's weight falls with its distance to the
    power of `focus`: high powers keep the guides apart, as locks.
    """
    ids = np.zeros((len(roots), neighbours), int)
    weights = np.full((len(roots), neighbours), 1 / neighbours)
    for value in np.unique(side):
        mine = np.flatnonzero(side == value)
        pool = np.flatnonzero(guide_side == value)
        if len(pool) == 0:
            pool = np.arange(len(guides))
        k = min(neighbours, len(pool))
        distance, index = KDTree(guides[pool]).query(roots[mine], k=k)
        distance, index = distance.reshape(len(mine), k), index.reshape(len(mine), k)
        weight = 1 / (distance + 1e-4) ** focus
        ids[mine[:, None], np.arange(k)] = pool[index]
        weights[mine] = 0
        weights[mine[:, None], np.arange(k)] = weight / weight.sum(axis=1, keepdims=True)
    return ids, weights


def mix(values: np.ndarray, ids: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Mix guide values (G, ...) to children (N, ...)."""
    result = np.zeros((len(ids), *values.shape[1:]), values.dtype)
    shape = (-1,) + (1,) * (values.ndim - 1)
    for column in range(ids.shape[1]):
        result += weights[:, column].astype(values.dtype).reshape(shape) * values[ids[:, column]]
    return result


def locks(roots: np.ndarray, side: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    """The leading strand (N,) of every strand's lock, locks holding about `size` strands."""
    count = max(int(len(roots) / size), 1)
    centres = rng.permutation(len(roots))[:count]
    ids, _ = spread(roots[centres], side[centres], roots, side, neighbours=1)
    return centres[ids[:, 0]]


def clump(strands: np.ndarray, leader: np.ndarray, strength: np.ndarray | float) -> np.ndarray:
    """Pull strands (N, K, 3) towards their lock's leader, more so towards the tips.

    A strand moves by a third of its length at most, so that short hair does not bare the skin.
    """
    along = np.linspace(0, 1, strands.shape[1])
    profile = 1 - np.exp(-4 * along)
    pull = np.broadcast_to(np.asarray(strength), (len(strands),))[:, None] * profile
    offset = (strands[leader] - strands) * np.minimum(pull, 0.96)[..., None]
    reach = strand_lengths(strands)
    moved = np.linalg.norm(offset[:, -1], axis=1)
    return strands + offset * np.minimum(1, 0.33 * reach / np.maximum(moved, 1e-9))[:, None, None]


def sideways(strands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit fields (N, K, 3) across the strands, stable along each strand."""
    tangent = unit(np.gradient(strands, axis=1))
    reference = unit(np.cross(unit(strands[:, -1] - strands[:, 0]), [0.3, 0.9, 0.2]))[:, None]
    beside = across(reference, tangent)
    return beside, np.cross(tangent, beside)


def wander(
    strands: np.ndarray, amplitude: np.ndarray | float, rng: np.random.Generator
) -> np.ndarray:
    """Add a smooth random drift to strands (N, K, 3); `amplitude` metres at the tips."""
    count, points = strands.shape[:2]
    along = np.linspace(0, 1, points)
    beside, other = sideways(strands)
    drift = np.zeros((2, count, points))
    for order in (1, 2, 3):
        wave = rng.normal(size=(2, count, 1)) / order
        phase = rng.random((2, count, 1)) * 2 * np.pi
        drift += wave * (np.sin(np.pi * order * along + phase) - np.sin(phase))
    scale = np.broadcast_to(np.asarray(amplitude), (count,))[:, None] * along
    return strands + (drift[0] * scale)[..., None] * beside + (drift[1] * scale)[..., None] * other


def coil(
    strands: np.ndarray,
    amplitude: np.ndarray,
    turns: np.ndarray,
    phase: np.ndarray,
    flat: float = 0.0,
) -> np.ndarray:
    """Wind strands (N, K, 3) into helices; `flat` 1 makes plane waves of them.

    `amplitude` (N,) metres, `turns` (N,) per strand, `phase` (N,) radians; the coil grows to its
    full width over the first quarter of the strand.
    """
    along = np.linspace(0, 1, strands.shape[1])
    beside, other = sideways(strands)
    angle = 2 * np.pi * turns[:, None] * along + phase[:, None]
    width = amplitude[:, None] * smoothstep(0, 0.25, along)
    first = (np.cos(angle) - np.cos(phase)[:, None] * (1 - along)) * width
    second = (np.sin(angle) - np.sin(phase)[:, None] * (1 - along)) * width * (1 - flat)
    return strands + first[..., None] * beside + second[..., None] * other


def tapered(
    count: int, points: int, root: float, tip: float, rng: np.random.Generator
) -> np.ndarray:
    """Radii (count, points) in metres from `root` to `tip`, hairs differing by a fifth."""
    along = np.linspace(0, 1, points)
    profile = tip + (root - tip) * (1 - along**2.5)
    return (profile * rng.uniform(0.8, 1.2, (count, 1))).astype(np.float32)


def tousled(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A smooth random vector field (R, 3) with features of 2 to 6 cm."""
    field = np.zeros(points.shape)
    for _ in range(10):
        turn = rng.normal(size=3)
        turn *= 2 * np.pi / rng.uniform(0.02, 0.06) / np.linalg.norm(turn)
        field += np.sin(points @ turn + rng.random() * 6.28)[:, None] * rng.normal(size=3)
    return field / np.sqrt(5)
