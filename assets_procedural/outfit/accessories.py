"""What a person wears on the head: glasses, earrings, a hat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets_procedural.body.head import Bust, Identity
from assets_procedural.body.piece import MeshPiece
from assets_procedural.body.regions import mirror
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import ellipsoid, rounded, sweep
from assets_procedural.outfit.glasses import glasses
from assets_procedural.outfit.headwear import hat
from assets_procedural.person import Earrings, Person

# Outer side of the left ear lobe, in the numbering of MakeHuman's base mesh.
_LOBE = (12041, 12019)


def accessories(person: Person, identity: Identity) -> list[MeshPiece]:
    """The glasses, earrings and hat that the person wears, if any.

    Raises:
        KeyError: an unknown shape or style.
    """
    pieces: list[MeshPiece] = []
    if person.glasses:
        pieces += glasses(person.glasses, identity)
    if person.earrings:
        pieces += _earrings(person.earrings, identity)
    if person.hat:
        pieces += hat(person.hat, identity)
    return pieces


def _earrings(earrings: Earrings, identity: Identity) -> list[MeshPiece]:
    """A pair of "metal" hoops or studs (Part.FACEWEAR) that hang from the lobes by gravity."""
    radius = earrings.size_mm * 0.5e-3
    pieces = []
    for name, side in (("left", 1.0), ("right", -1.0)):
        lobe = _lobe(identity, side)
        if earrings.shape == "hoop":
            angle = np.arange(64) * 2 * np.pi / 64
            # In its own frame: x out of the ear, y backwards, z up; the hole at the origin.
            ring = np.stack([0 * angle, radius * np.sin(angle), radius * np.cos(angle)], axis=1)
            wire = float(np.clip(0.05 * radius, 0.6e-3, 1.1e-3))
            points, faces = sweep(
                ring, ring.copy(), rounded(2 * wire, 2 * wire, 2, 12), closed=True
            )
            points = points - [0, 0, radius - 1.2e-3]
            turn = side * np.radians(38.0)
            swing = np.array(
                [
                    [np.cos(turn), np.sin(turn), 0],
                    [-np.sin(turn), np.cos(turn), 0],
                    [0, 0, 1],
                ]
            )
            points = points @ swing
        elif earrings.shape == "stud":
            out = np.array([side * 0.6 * radius, 0, 0])
            points, faces = ellipsoid(out * 0.5, np.diag([side * 0.7, side, 1.0]) * radius)
        else:
            raise KeyError(earrings.shape)
        pieces.append(
            MeshPiece(
                f"earring_{name}",
                Part.FACEWEAR,
                faces,
                "metal",
                _hanging(points, lobe, earrings.shape == "hoop"),
                {"colour": earrings.colour, "roughness": 0.16},
            )
        )
    return pieces


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
