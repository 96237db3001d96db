"""Teeth and gums of one jaw, shaped along a dental arch.

Frame of a tooth, in millimetres: x along the arch, y outwards to the lips, z from the gum (0) to
the biting edge. `labial` y = 0 is the arch curve, on which the outer face of every crown lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from assets_procedural.mesh.sweep import tube_faces
from assets_procedural.mesh.vectors import way_along

RINGS = 11
AROUND = 20
# Rings of a crown: share of its height from the gum.
_HEIGHTS = np.array([-0.25, 0.0, 0.15, 0.32, 0.5, 0.66, 0.8, 0.9, 0.965, 1.0, 1.0])
_GUM_STEPS = 168
_GUM_PROFILE = 14


@dataclass(frozen=True)
class Crown:
    """Mean dimensions of a crown (mm; Wheeler's Dental Anatomy, rounded) and its type."""

    kind: str
    width: float
    height: float
    depth: float


UPPER = (
    Crown("incisor", 8.5, 10.5, 6.5),
    Crown("incisor", 6.6, 9.0, 6.0),
    Crown("canine", 7.6, 10.0, 7.5),
    Crown("premolar", 7.0, 8.5, 8.5),
    Crown("premolar", 6.8, 8.5, 8.5),
    Crown("molar", 10.0, 7.5, 10.5),
    Crown("molar", 9.2, 7.0, 10.0),
)
LOWER = (
    Crown("incisor", 5.3, 9.0, 5.6),
    Crown("incisor", 5.9, 9.3, 6.0),
    Crown("canine", 6.9, 10.5, 7.2),
    Crown("premolar", 7.0, 8.5, 7.6),
    Crown("premolar", 7.1, 8.0, 8.0),
    Crown("molar", 11.0, 7.5, 10.2),
    Crown("molar", 10.2, 7.0, 10.0),
)


@dataclass(frozen=True)
class Jaw:
    """Vertices in millimetres in the frame of the arch: x to the subject's left, y outwards at the
    midline, z to the biting edge, all crowns' necks near z = 0. `tones` (V, 3) multiply the shade
    of the teeth."""

    teeth: np.ndarray
    tones: np.ndarray
    teeth_faces: np.ndarray
    gums: np.ndarray
    gums_faces: np.ndarray


def jaw(crowns: tuple[Crown, ...], arch: np.ndarray, rng: np.random.Generator) -> Jaw:
    """Build a jaw on half an arch (K, 2): (x, y) from the midline backwards, in millimetres.

    `rng` draws the small irregularities of a natural dentition.
    """
    curve = _Arch(arch)
    total = sum(c.width for c in crowns)
    scale = (curve.length - 1.0) / total
    points, faces, tones = [], [], []
    crown_faces = tube_faces(np.arange(RINGS * AROUND).reshape(RINGS, AROUND))
    seats: list[tuple[float, float, float]] = []
    for side in (1.0, -1.0):
        along = 0.0
        for crown in crowns:
            width = crown.width * scale
            s = side * (along + width / 2)
            along += width
            local = _crown(crown, width * 1.01, rng)
            turn, lean = rng.normal(0, 0.035), rng.normal(0, 0.02)
            x, y, z = local.T
            x, y = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
            x = x + lean * z
            y = y + rng.normal(0, 0.12)
            z = z + rng.normal(0, 0.12)
            faces.append(crown_faces + RINGS * AROUND * len(points))
            tones.append(_tones(crown, along, rng))
            points.append(curve.place(np.full(len(x), s), x, y, z))
            seats.append((s, width / 2, crown.depth))
    gums, gums_faces = _gums(curve, seats)
    return Jaw(
        np.concatenate(points), np.concatenate(tones), np.concatenate(faces), gums, gums_faces
    )


class _Arch:
    """A smooth mirrored curve by arc length: s = 0 at the midline, positive to the left."""

    def __init__(self, half: np.ndarray):
        mirrored = np.concatenate([half[:0:-1] * [-1, 1], half])
        chord = way_along(mirrored)
        dense = CubicSpline(chord, mirrored)(np.linspace(0, chord[-1], 801))
        arc = way_along(dense)
        self.length = float(arc[-1] / 2)
        self._curve = CubicSpline(arc - self.length, dense)
        self._tangent = self._curve.derivative()

    def place(self, s: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Points offset from arc length `s` by x along, y outwards and z up: (N, 3)."""
        tangent = self._tangent(s)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        outward = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        flat = self._curve(s) + x[:, None] * tangent + y[:, None] * outward
        return np.column_stack([flat, z])


def _tones(crown: Crown, along: float, rng: np.random.Generator) -> np.ndarray:
    """(RINGS * AROUND, 3): dentine shows at the neck, enamel alone is grey at the edge.

    Canines are yellower than incisors; what lies farther back, `along` mm, is darker.
    """
    rise = _HEIGHTS[:, None]
    neck = np.clip(1 - rise / 0.45, 0, 1)
    edge = np.clip((rise - 0.75) / 0.25, 0, 1) * (crown.kind == "incisor")
    tone = 1 - neck * [0.04, 0.11, 0.24] - edge * [0.15, 0.11, 0.05]
    if crown.kind == "canine":
        tone = tone * [0.97, 0.93, 0.85]
    back = 1 - 0.35 * np.clip((along - 16) / 25, 0, 1)
    tone = tone * back * (1 + rng.normal(0, 0.025)) * (1 + rng.normal(0, 0.012, 3))
    return np.repeat(tone, AROUND, axis=0)


def _crown(crown: Crown, width: float, rng: np.random.Generator) -> np.ndarray:
    """(RINGS * AROUND, 3) rings from below the gum to the biting edge, closed at the top."""
    v = _HEIGHTS[:, None]
    rise = np.clip(v, 0, 1)
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    cos, sin = np.cos(angle), np.sin(angle)
    height = crown.height * (1 + rng.normal(0, 0.025))
    # Crowns are widest where they touch their neighbours, near the edge, and narrow at the neck.
    half_width = width / 2 * (0.74 + 0.26 * np.sin(np.clip(rise / 0.7, 0, 1) * np.pi / 2))
    if crown.kind in ("incisor", "canine"):
        power = 2.4
        half_depth = crown.depth / 2 * (1 - rise) ** 0.85 + 0.55
        rounding = np.array([1, 1, 1, 1, 1, 1, 0.99, 0.96, 0.89, 0.74, 0.0])[:, None]
        half_width = half_width * rounding
        half_depth = half_depth * np.array([1, 1, 1, 1, 1, 1, 1, 0.95, 0.8, 0.5, 0.0])[:, None]
        bite = np.zeros_like(angle)[None]
        if crown.kind == "canine":
            point = np.clip((rise - 0.6) / 0.4, 0, 1)
            half_width = half_width * (1 - 0.55 * point**1.5)
        else:
            # The corner away from the midline is rounder; worn edges are slightly wavy.
            bite = -0.5 * np.abs(cos)[None] ** 3 * (rise > 0.85)
    else:
        power = 3.0
        half_depth = crown.depth / 2 * (0.86 + 0.14 * np.sin(rise * np.pi))
        taper = np.array([1, 1, 1, 1, 1, 0.98, 0.94, 0.86, 0.72, 0.5, 0.0])[:, None]
        half_width, half_depth = half_width * (0.5 + 0.5 * taper), half_depth * taper
        half_width = half_width * np.array([1] * (RINGS - 1) + [0.0])[:, None]
        cusps = 2 if crown.kind == "premolar" else 4
        wave = np.cos(2 * angle + np.pi) if cusps == 2 else np.cos(4 * angle + np.pi)
        bite = 0.45 * wave[None] * np.clip((rise - 0.75) / 0.2, 0, 1)
        bite = (
            bite * np.array([1] * (RINGS - 2) + [0.6, 0.0])[:, None]
            - 0.9 * (np.arange(RINGS) == RINGS - 1)[:, None]
        )
    x = half_width * np.sign(cos) * np.abs(cos) ** (2 / power)
    y = half_depth * np.sign(sin) * np.abs(sin) ** (2 / power)
    # The outer face bulges a little in its lower third and leans back towards the edge.
    labial = 0.25 - 1.1 * (rise - 0.35) ** 2
    z = height * v + bite
    return np.stack(np.broadcast_arrays(x, y - half_depth + labial, z), axis=-1).reshape(-1, 3)


def _gums(curve: _Arch, seats: list[tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """A closed band around the necks whose margin rises to a papilla between neighbours."""
    order = sorted(seats)
    centre = np.array([s for s, _, _ in order])
    half = np.array([h for _, h, _ in order])
    depth = np.array([d for _, _, d in order])
    reach = centre[-1] + half[-1] + 1.5
    s = np.linspace(-reach, reach, _GUM_STEPS)
    nearest = np.argmin(np.abs(s[:, None] - centre) - half, axis=1)
    offset = np.clip(np.abs(s - centre[nearest]) / half[nearest], 0, 1)[:, None]
    thick = np.interp(s, centre, depth)[:, None]
    margin = 0.4 + 2.6 * offset**3
    # Papillae sit back between the crowns; over the roots the gum bulges.
    outer = 0.25 - 0.9 * offset**3
    root = 0.45 * (1 - offset**2)
    # Outside from the fold of the lip down to the margin, then inside up again.
    share = np.linspace(0, 1, 7)[None]
    outside_z = -12 + (margin + 12) * share
    outside_y = outer + (0.55 + root) * np.sin(np.clip((1 - share) * 2.2, 0, 1) * np.pi / 2)
    outside_y = outside_y - 3.0 * np.clip(0.4 - share, 0, 1) * 2
    inside_y = -thick - 0.4 + outer * 0 - 1.5 * (1 - share)
    y = np.concatenate([outside_y, inside_y[:, ::-1] + 0 * outside_y], axis=1)
    z = np.concatenate([outside_z, outside_z[:, ::-1]], axis=1)
    ends = np.clip((reach - np.abs(s)) / 1.5, 0.02, 1)[:, None]
    y = -thick / 2 + (y + thick / 2) * ends
    flat = np.broadcast_to(s[:, None], y.shape).ravel()
    points = curve.place(flat, np.zeros_like(flat), y.ravel(), z.ravel())
    index = np.arange(_GUM_STEPS * _GUM_PROFILE).reshape(_GUM_STEPS, _GUM_PROFILE)
    return points, tube_faces(index)
