"""What stands on a garment's edge: shirt and polo collars, stands, rolls, hoods.

A collar is a cross-section carried along the edge from the throat around the nape and back. In it
`out` points away from the neck and `up` along it, in millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import MeshPiece
from assets_procedural.mesh.sweep import joined, rounded, shell, sweep
from assets_procedural.mesh.vectors import smoothstep, unit, way_along
from assets_procedural.outfit.cloth import smooth_ring
from assets_procedural.outfit.garment import Garment, Patchwork, bone_weights, clear_of

_STATIONS = 73
_ACROSS = 15


@dataclass(frozen=True)
class _Collar:
    """Cross-sections at the throat and at the nape (mm outwards and upwards from the edge), and the
    cloth's `thickness` in metres; `spread` is how far the fall's ends turn aside for its depth,
    `wrinkle` how unevenly it lies, in steps of half a millimetre."""

    throat: tuple[tuple[float, float], ...]
    nape: tuple[tuple[float, float], ...]
    thickness: float
    spread: float = 0.0
    wrinkle: float = 0.0


COLLARS: dict[str, _Collar] = {
    "shirt": _Collar(
        ((0, -4), (0.5, 14), (2, 25), (6, 28), (9, 22), (13, -2), (16, -34)),
        ((0, -4), (-1, 14), (-1, 30), (4, 36), (9, 32), (13, 12), (16, -9)),
        0.0013, 0.55,
    ),
    "soft": _Collar(
        ((0, -4), (1, 8), (3, 16), (7, 18), (10, 12), (13, -6), (15, -26)),
        ((0, -4), (0, 10), (1, 22), (6, 26), (11, 21), (14, 6), (16, -8)),
        0.0018, 0.5, 0.6,
    ),
    "stand": _Collar(
        ((0, -4), (1, 6), (1, 16), (1, 24)), ((0, -4), (0, 8), (-1, 20), (-2, 30)), 0.0024,
    ),
    "tall": _Collar(
        ((1, -4), (3, 8), (6, 22), (9, 40)), ((1, -4), (1, 14), (1, 30), (2, 46)), 0.0026, 0.2, 1.2,
    ),
    "roll": _Collar(
        ((0.5, -3), (1, 0), (3.5, 2), (6, -1), (7, -14), (8, -26), (8.5, -36)),
        ((0.5, -3), (1, 0), (3.5, 2), (6.5, -1), (8, -16), (9, -32), (9.5, -44)),
        0.0022, 0.0, 1.5,
    ),
    "hood": _Collar(
        ((1, -6), (4, 2), (9, 9), (14, 8), (17, 0), (18, -9), (17, -16)),
        ((1, -6), (3, 26), (16, 44), (42, 40), (62, 16), (66, -24), (56, -70)),
        0.0035, 0.1, 2.6,
    ),
}  # fmt: skip
"""Collars by name."""


def collar(garment: Garment, identity: Identity, parameters: dict, seed: int) -> list[MeshPiece]:
    """The collar that the garment's outline names, as one piece of "cloth".

    Raises:
        KeyError: an unknown collar.
    """
    name = garment.outline.collar
    shape = COLLARS[name]
    rng = np.random.default_rng(seed)
    base, out, up, share = _track(garment, identity, closed=name == "roll")
    along = np.linspace(0, 1, _ACROSS)
    rear = smoothstep(1.0, 0.15, share)[:, None, None]
    section = 1e-3 * (rear * _spaced(shape.nape, along) + (1 - rear) * _spaced(shape.throat, along))
    # Slack: the section breathes along the edge.
    turn = np.pi * np.linspace(-1, 1, len(base))
    wave = np.zeros(len(base))
    for k in range(2, 9):
        wave += rng.normal(0, 1) * np.sin(k * turn + rng.uniform(0, 6))
    section = section + (0.5e-3 * shape.wrinkle * wave)[:, None, None] * along[:, None]
    grid = base[:, None] + section[..., :1] * out[:, None] + section[..., 1:] * up[:, None]
    # The ends of the fall point down and aside.
    tangent = unit(np.gradient(base, axis=0))
    fall = np.maximum(section[:, :, 1].max(axis=1, keepdims=True) - section[..., 1], 0)
    fall *= np.arange(_ACROSS) > section[..., 1].argmax(axis=1)[:, None]
    end = smoothstep(0.62, 1.0, share) * -np.sign(np.linspace(-1, 1, len(base)))
    grid += (shape.spread * end[:, None] * fall)[..., None] * tangent[:, None]

    skin = identity.model.groups["skin"]
    skin = skin[identity.model.template[skin, 2] < 0.68]
    points = grid.reshape(-1, 3)
    points = clear_of(points, identity.rest[skin], identity.neutral.normals[skin], 0.002)
    grid = points.reshape(grid.shape)
    if name != "roll":
        falls = np.arange(_ACROSS) >= _ACROSS // 2
        lower = grid[:, falls].reshape(-1, 3)
        margin = 0.0015 + shape.thickness
        lower = clear_of(lower, garment.cloth, garment.normals, margin)
        grid[:, falls] = lower.reshape(len(base), -1, 3)
    grid = _relaxed(grid, name == "roll")
    points, faces = shell(grid, shape.thickness, closed=name == "roll")
    length = way_along(base)
    width = np.linalg.norm(np.diff(grid, axis=1), axis=2).mean(axis=0).cumsum()
    u, v = np.meshgrid(length, np.concatenate([[0], width]), indexing="ij")
    uv = np.tile(np.stack([u, v], axis=-1).reshape(-1, 2), (2, 1))
    patches = Patchwork()
    weights = bone_weights(identity, base)
    patches.add(points, np.tile(np.repeat(weights, _ACROSS, axis=0), (2, 1)), uv)
    pieces = [patches.piece("collar", faces, parameters)]
    if name == "hood":
        pieces.append(_cords(garment, grid, weights, parameters))
    return pieces


def _track(
    garment: Garment, identity: Identity, closed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The edge from the left of the throat around the nape to the right, or the whole loop.

    Points (N, 3), out (N, 3), up (N, 3), and the share of the way from nape (0) to throat (1).
    """
    loop = garment.edge
    on_saddle = np.abs(garment.outline.around(garment.average[loop])) < 0.004
    points = garment.cloth[loop]
    joints = identity.joints
    axis = unit(joints[3] - joints[0])
    centre = points[on_saddle].mean(axis=0)
    offset = points - centre
    angle = np.arctan2(offset[:, 0].copy(), offset[:, 1].copy())  # 0 at the nape
    keep = np.ones(len(loop), bool) if closed else on_saddle
    order = np.flatnonzero(keep)[np.argsort(angle[keep])]
    track, turn = points[order], angle[order]
    if closed:
        track = np.concatenate([track[-1:], track, track[:1]])
        turn = np.concatenate([turn[-1:] - 2 * np.pi, turn, turn[:1] + 2 * np.pi])
        stations = np.linspace(-np.pi, np.pi, _STATIONS, endpoint=False)
    else:
        # A buttoned collar meets at the throat.
        low, high = turn[0], turn[-1]
        stations = np.linspace(low, high, _STATIONS)
    base = np.stack([np.interp(stations, turn, track[:, k]) for k in range(3)], axis=1)
    kernel = np.array([0.25, 0.5, 0.25])
    for _ in range(6):
        inner = np.stack([np.convolve(base[:, k], kernel, "valid") for k in range(3)], axis=1)
        base[1:-1] = inner
    out = base - centre
    out = unit(out - (out @ axis)[:, None] * axis)
    # At the nape the collar follows the neck, at the throat it stands more upright.
    front = smoothstep(0.4, 1.0, np.abs(stations) / np.pi)[:, None]
    up = unit((1 - front) * axis + front * unit(axis + [0, 0.5, 0.5]))
    up = unit(up - np.einsum("ni,ni->n", up, out)[:, None] * out)
    return base, out, up, np.abs(stations) / np.abs(stations).max()


def _spaced(section: tuple[tuple[float, float], ...], along: np.ndarray) -> np.ndarray:
    """A cross-section (K, 2) at equal steps of its own length."""
    knots = np.array(section, float)
    steps = way_along(knots)
    return PchipInterpolator(steps / steps[-1], knots)(along)


def _relaxed(grid: np.ndarray, closed: bool) -> np.ndarray:
    """Smooth what collisions left, along the edge only."""
    if closed:
        return smooth_ring(grid, 3)
    for _ in range(3):
        grid = grid.copy()
        grid[1:-1] = 0.5 * grid[1:-1] + 0.25 * (grid[2:] + grid[:-2])
    return grid


def _cords(garment: Garment, grid: np.ndarray, weights: np.ndarray, parameters: dict) -> MeshPiece:
    """The two drawstrings of a hood, hanging over the chest."""
    parts, own = [], []
    for end, side in ((3, -1.0), (-4, 1.0)):
        start = grid[end, _ACROSS // 2]
        fall = np.linspace(0, 0.15, 24)
        path = start + np.stack([0.08 * side * fall * np.sign(start[0]) * side, 0 * fall, -fall], 1)
        path = clear_of(path, garment.cloth, garment.normals, 0.003)
        path[2:] = clear_of(path[2:], garment.cloth, garment.normals, 0.003)
        points, faces = sweep(path, np.array([1.0, 0, 0]), rounded(0.0042, 0.0036, 2.2, 10), False)
        parts.append((points, faces))
        own.append(np.repeat(weights[end][None], len(points), axis=0))
    points, faces = joined(parts)
    patches = Patchwork()
    patches.add(points, np.concatenate(own), points[:, [0, 2]])
    return patches.piece("cords", faces, {**parameters, "weave": "jersey", "pattern": "plain"})
