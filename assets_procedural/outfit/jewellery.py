"""Earrings and necklaces."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy import sparse

from assets_procedural.body.head import Bust, HeadModel, Identity
from assets_procedural.body.piece import MeshPiece
from assets_procedural.body.regions import mirror
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import ellipsoid, joined, rounded, sweep, tube_faces
from assets_procedural.mesh.vectors import unit
from assets_procedural.outfit.cloth import (
    average_person,
    border_loops,
    cut_from_skin,
    smooth_ring,
)
from assets_procedural.outfit.necklines import Outline
from assets_procedural.person import Earrings, Necklace

# Outer side of the left ear lobe, in the numbering of MakeHuman's base mesh.
_LOBE = (12041, 12019)
# Stations along a necklace; length of a chain's link and radius of a string's pearl, metres.
_STATIONS = 360
_LINK, _PEARL = 0.0060, 0.0036


def earrings(wearing: Earrings, identity: Identity) -> list[MeshPiece]:
    """A pair of "metal" hoops, studs or drops (Part.FACEWEAR); hoops and drops hang by gravity.

    Raises:
        KeyError: an unknown shape.
    """
    pieces = []
    for name, side in (("left", 1.0), ("right", -1.0)):
        points, faces = _EARRINGS[wearing.shape](wearing.size_mm * 0.5e-3, side)
        place = _hanging(points, _lobe(identity, side), wearing.shape != "stud")
        look = {"colour": wearing.colour, "roughness": 0.16}
        pieces.append(MeshPiece(f"earring_{name}", Part.FACEWEAR, faces, "metal", place, look))
    return pieces


def _hoop(radius: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    angle = np.arange(64) * 2 * np.pi / 64
    # In its own frame: x out of the ear, y backwards, z up; the hole at the origin.
    ring = np.stack([0 * angle, radius * np.sin(angle), radius * np.cos(angle)], axis=1)
    wire = float(np.clip(0.05 * radius, 0.6e-3, 1.1e-3))
    points, faces = sweep(ring, ring.copy(), rounded(2 * wire, 2 * wire, 2, 12), closed=True)
    points = points - [0, 0, radius - 1.2e-3]
    turn = side * np.radians(38.0)
    cos, sin = np.cos(turn), np.sin(turn)
    return points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]), faces


def _stud(radius: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    out = np.array([side * 0.6 * radius, 0, 0])
    return ellipsoid(out * 0.5, np.diag([side * 0.7, side, 1.0]) * radius)


def _drop(radius: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """A hook, and a bead that hangs from it."""
    length, bead = 2 * radius, min(0.55 * radius, 5.5e-3)
    out = 1.5e-3 * side
    wire = np.stack([np.full(12, out), np.zeros(12), np.linspace(1e-3, -length + bead, 12)], axis=1)
    parts = [
        sweep(wire, np.array([1.0, 0, 0]), rounded(1.1e-3, 1.1e-3, 2, 8), closed=False),
        ellipsoid(np.array([out, 0, -length]), np.diag([side * 0.8, side, 1.35]) * bead),
        ellipsoid(np.array([out, 0, 0]), np.diag([side, side, 1.0]) * 1.8e-3),
    ]
    return joined(parts)


_EARRINGS: dict[str, Callable[[float, float], tuple[np.ndarray, np.ndarray]]] = {
    "hoop": _hoop,
    "stud": _stud,
    "drop": _drop,
}


def _lobe(identity: Identity, side: float) -> np.ndarray:
    """Indices of the lobe's outer vertices on one side."""
    index = identity.model.from_base(_LOBE)
    return index if side > 0 else mirror(identity.model)[index]


def _hanging(points: np.ndarray, lobe: np.ndarray, swings: bool) -> Callable[[Bust], np.ndarray]:
    def place(bust: Bust) -> np.ndarray:
        rotation = bust.bones["head"][:3, :3]
        if swings:
            back = rotation[:, 1] - rotation[2, 1] * np.array([0, 0, 1.0])
            back /= np.linalg.norm(back)
            up = np.array([0, 0, 1.0])
            rotation = np.stack([np.cross(back, up), back, up], axis=1)
        return bust.vertices[lobe].mean(axis=0) + points @ rotation.T

    return place


def necklace(wearing: Necklace, identity: Identity) -> list[MeshPiece]:
    """A chain, a chain with a pendant, or a string of beads on the skin (Part.FACEWEAR, "metal").

    Raises:
        KeyError: an unknown style.
    """
    if wearing.style not in ("chain", "pendant", "beads"):
        raise KeyError(wearing.style)
    track = _track(identity.model, round(wearing.drop, 1))
    angle = np.arange(10) * 2 * np.pi / 10
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rest = track @ identity.rest
    length = np.linalg.norm(np.roll(rest, -1, axis=0) - rest, axis=1).sum()
    beads = wearing.style == "beads"
    phase = np.arange(_STATIONS) / _STATIONS * (length / (2 * _PEARL if beads else _LINK))
    phase = phase * np.round(phase[-1]) / max(phase[-1], 1e-9)
    if beads:
        radius = _PEARL * np.sqrt(np.maximum(1 - (2 * (phase % 1) - 1) ** 2, 0.02))
    else:
        radius = 0.0009 * (0.75 + 0.45 * np.abs(np.sin(np.pi * phase)))
    index = np.arange(_STATIONS * 10).reshape(-1, 10)
    faces = tube_faces(np.concatenate([index, index[:1]]))
    front = int(np.argmin(rest[:, 1]))
    pendant = wearing.style == "pendant"
    drop, drop_faces = ellipsoid(np.zeros(3), np.diag([0.0055, 0.0018, 0.0085]))
    if pendant:
        faces = np.concatenate([faces, drop_faces + _STATIONS * 10])

    def place(bust: Bust) -> np.ndarray:
        path = track @ bust.vertices
        out = unit(track @ bust.normals)
        path = smooth_ring(path, 8)  # a chain spans the hollows
        path = path + (radius.mean() + 0.0010) * out
        tangent = unit(np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0))
        side = unit(np.cross(tangent, out))
        out = np.cross(side, tangent)
        rings = circle[:, 0, None] * out[:, None] + circle[:, 1, None] * side[:, None]
        points = (path[:, None] + radius[:, None, None] * rings).reshape(-1, 3)
        if pendant:
            axes = np.stack([tangent[front], out[front], np.cross(tangent[front], out[front])])
            down = np.sign(axes[2, 2]) * -axes[2]
            hung = path[front] + 0.010 * down + 0.001 * out[front]
            points = np.concatenate([points, hung + drop @ axes])
        return points

    look = {"colour": wearing.colour, "roughness": 0.3 if beads else 0.2}
    kind = "plastic" if beads else "metal"
    return [MeshPiece("necklace", Part.FACEWEAR, faces, kind, place, look)]


@lru_cache(maxsize=12)
def _track(model: HeadModel, drop: float) -> sparse.csr_matrix:
    """Evenly spaced stations around the neck as blends of the bust's vertices."""
    outline = Outline(0.516 - 0.062 * drop, 0.563 - 0.006 * drop, 3.4 - 0.8 * drop)
    average = average_person(model)
    quads = model.faces["skin"]
    near = np.abs(outline.field(average)[quads]).min(axis=1) < 0.03
    sheet = cut_from_skin(model, quads[near], outline.field)
    loops = [loop for loop in border_loops(sheet.faces) if np.abs(sheet.field[loop]).max() < 1e-6]
    loop = max(loops, key=len)
    points = (sheet.matrix @ average)[loop]
    length = np.concatenate(
        [[0], np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).cumsum()]
    )
    stations = np.arange(_STATIONS) / _STATIONS * length[-1]
    first = np.searchsorted(length, stations, side="right") - 1
    share = (stations - length[first]) / np.maximum(length[first + 1] - length[first], 1e-12)
    rows = np.arange(_STATIONS)
    blend = sparse.csr_matrix(
        (
            np.concatenate([1 - share, share]),
            (np.tile(rows, 2), np.concatenate([first, (first + 1) % len(loop)])),
        ),
        (_STATIONS, len(loop)),
    )
    return sparse.csr_matrix(blend @ sheet.matrix[loop])
