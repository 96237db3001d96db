"""Hats with a brim all around: rings carried from the head's outline up the crown and outwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from assets_procedural.body.piece import MeshPiece, rigid
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import shell, tube_faces
from assets_procedural.mesh.vectors import arctan2, smoothstep, unit
from assets_procedural.outfit.cloth import smooth_ring
from assets_procedural.outfit.fabrics import cloth_look
from assets_procedural.outfit.garment import no_seams
from assets_procedural.person import Hat

_AROUND = 96
# Between scalp and hat, for hair and lining, metres.
_CLEARANCE = 0.006


@dataclass(frozen=True)
class _Brimmed:
    """`crown` is (share of the outline, height) from the edge to the middle, `brim` (outwards,
    height) from the edge, metres; `pinch` dents the crown, `wavy` the brim."""

    crown: tuple[tuple[float, float], ...]
    brim: tuple[tuple[float, float], ...]
    weave: str
    ribbon: bool = False
    pinch: float = 0.0
    wavy: float = 0.0


BRIMMED = {
    "bucket": _Brimmed(
        ((1.0, 0), (0.97, 0.025), (0.93, 0.050), (0.86, 0.067), (0.74, 0.077), (0.45, 0.083),
         (0, 0.085)),
        ((0, 0), (0.012, -0.008), (0.030, -0.026), (0.046, -0.043)), "twill", wavy=0.0015,
    ),
    "fedora": _Brimmed(
        ((1.0, 0), (0.99, 0.035), (0.95, 0.075), (0.86, 0.102), (0.70, 0.108), (0.4, 0.097),
         (0, 0.091)),
        ((0, 0), (0.015, -0.001), (0.04, 0.001), (0.058, 0.007)), "fleece", True, 0.022, 0.0,
    ),
    "sun_hat": _Brimmed(
        ((1.0, 0), (0.99, 0.03), (0.95, 0.062), (0.82, 0.086), (0.55, 0.097), (0, 0.100)),
        ((0, 0), (0.03, -0.004), (0.07, -0.014), (0.105, -0.026)), "cable", True, 0.0, 0.006,
    ),
}  # fmt: skip
"""Brimmed hats by name."""


def brimmed(wearing: Hat, scalp: np.ndarray, edge: np.ndarray) -> list[MeshPiece]:
    """A hat over the scalp (N, 3) whose edge lies on the loop (M, 3), both at rest."""
    shape = BRIMMED[wearing.style]
    rng = np.random.default_rng(wearing.seed)
    angles = np.arange(_AROUND) * 2 * np.pi / _AROUND - np.pi
    middle = edge.mean(axis=0)
    turn = arctan2(edge[:, 0] - middle[0], -(edge[:, 1] - middle[1]))
    order = np.argsort(turn)
    ring = np.stack(
        [np.interp(angles, turn[order], edge[order, k], period=2 * np.pi) for k in range(3)], axis=1
    )
    ring = smooth_ring(ring, 12)  # a stiff edge is an even oval
    out = unit((ring - middle) * [1, 1, 0])
    spare = np.einsum("ni,ni->n", ring - middle, out)
    # As wide as the widest part of the head above the edge asks for.
    wide = _widest(scalp, middle, angles)
    ring = ring + (np.maximum(wide - spare, 0) + _CLEARANCE)[:, None] * out

    share, height = np.array(shape.crown).T
    tall = max(1.0, float(scalp[:, 2].max() + 0.008 - middle[2]) / height[-1])
    steps = np.linspace(0, 1, 30)
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(share) * 0.09, np.diff(height)))])
    share = PchipInterpolator(length / length[-1], share)(steps)
    height = PchipInterpolator(length / length[-1], height)(steps) * tall
    share[-1] = 0.012
    level = (share * smoothstep(0.0, 0.8, steps))[:, None] * (middle[2] - ring[:, 2]) * 0.4
    crown = middle + share[:, None, None] * (ring - middle)
    crown[..., 2] = ring[:, 2] * share[:, None] + middle[2] * (1 - share[:, None])
    crown[..., 2] += height[:, None] + level
    if shape.pinch:
        front = np.exp(-(((np.abs(angles) - 0.55) / 0.32) ** 2))
        dent = shape.pinch * front * smoothstep(0.35, 0.75, steps)[:, None]
        crown -= (dent * smoothstep(1.0, 0.85, steps)[:, None])[..., None] * out
    over, fall = np.array(shape.brim).T
    along = np.linspace(0, 1, 14)
    over = PchipInterpolator(np.linspace(0, 1, len(over)), over)(along)[:, None]
    fall = PchipInterpolator(np.linspace(0, 1, len(fall)), fall)(along)[:, None]
    wave = np.zeros(_AROUND)
    for k in range(2, 6):
        wave += rng.normal(0, 1) * np.sin(k * angles + rng.uniform(0, 6))
    # Brims dip in front and behind.
    dip = -0.10 * np.cos(2 * angles) * over if wearing.style != "bucket" else 0.0
    brim = np.broadcast_to(ring, (14, *ring.shape)).copy()
    brim += over[..., None] * out
    brim[..., 2] += fall + dip + shape.wavy * wave * along[:, None]

    look = cloth_look(wearing, shape.weave, 0.9)
    radius = float(np.linalg.norm(ring - middle, axis=1).mean())
    index = np.arange(crown[..., 0].size).reshape(len(steps), _AROUND)
    around = np.broadcast_to(angles * radius, index.shape)
    uv = np.stack([around, np.broadcast_to(height[:, None], index.shape)], axis=-1).reshape(-1, 2)
    points, faces = shell(np.swapaxes(brim, 0, 1), 0.0022, closed=True)
    wide_uv = np.stack(np.broadcast_arrays(angles[:, None] * radius, along * 0.06), axis=-1)
    wide_uv = np.tile(wide_uv.reshape(-1, 2), (2, 1))
    parts = [
        ("hat", crown.reshape(-1, 3), tube_faces(index), uv, look),
        ("hat_brim", points, faces, wide_uv, look),
    ]
    if shape.ribbon:
        band = crown[1:9] + 0.0012 * out
        points, faces = shell(np.swapaxes(band, 0, 1), 0.0008, closed=True)
        trim = {**look, "colour": wearing.accent, "weave": "satin", "pattern": "plain"}
        parts.append(("hat_ribbon", points, faces, points[:, [0, 2]], trim))
    return [
        MeshPiece(
            name,
            Part.HEADWEAR,
            faces,
            "cloth",
            rigid("head", points),
            parameters,
            uv[faces],
            {"seams": no_seams(points)},
        )
        for name, points, faces, uv, parameters in parts
    ]


def _widest(scalp: np.ndarray, middle: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(N,) how far the scalp reaches from `middle` in each horizontal direction."""
    offset = scalp - middle
    turn = arctan2(offset[:, 0], -offset[:, 1])
    column = np.round((turn - angles[0]) / (angles[1] - angles[0])).astype(int) % len(angles)
    wide = np.zeros(len(angles))
    np.maximum.at(wide, column, np.hypot(offset[:, 0], offset[:, 1]))
    return wide
