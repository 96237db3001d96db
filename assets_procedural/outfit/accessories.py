"""What a person wears besides a top: glasses, jewellery, hat, headphones, scarf."""

from __future__ import annotations

import numpy as np

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import MeshPiece, rigid
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import ellipsoid, joined, rounded, sweep
from assets_procedural.mesh.vectors import arctan2, unit
from assets_procedural.outfit.glasses import glasses
from assets_procedural.outfit.headwear import hat
from assets_procedural.outfit.jewellery import earrings, necklace
from assets_procedural.outfit.scarves import scarf
from assets_procedural.person import Headphones, Person

# Room for hair under the band of headphones, metres.
_BAND_CLEARANCE = 0.010


def accessories(person: Person, identity: Identity) -> list[MeshPiece]:
    """The glasses, jewellery, hat, headphones and scarf that the person wears, if any.

    Raises:
        KeyError: an unknown shape or style.
    """
    pieces: list[MeshPiece] = []
    if person.glasses:
        pieces += glasses(person.glasses, identity)
    if person.earrings:
        pieces += earrings(person.earrings, identity)
    if person.necklace:
        pieces += necklace(person.necklace, identity)
    if person.hat:
        pieces += hat(person.hat, identity)
    if person.headphones:
        pieces += _headphones(person.headphones, identity)
    if person.scarf:
        pieces += scarf(person.scarf, identity)
    return pieces


def _headphones(wearing: Headphones, identity: Identity) -> list[MeshPiece]:
    """Cups over the ears, cushions towards the head, a band over the crown (Part.HEADWEAR)."""
    model, rest = identity.model, identity.rest
    skin = model.groups["skin"]
    ears = skin[model.masks["ears"][skin] > 0.5]
    hard, soft = [], []
    tops = []
    for side in (1.0, -1.0):
        ear = rest[ears[rest[ears, 0] * side > 0]]
        centre = np.array([np.quantile(ear[:, 0] * side, 0.85) * side, *ear[:, 1:].mean(axis=0)])
        centre = centre + [side * 0.006, -0.003, 0.002]
        hard.append(ellipsoid(centre + [side * 0.008, 0, 0],
                              np.diag([side * 0.015, side * 0.034, 0.041])))  # fmt: skip
        angle = np.arange(40) * 2 * np.pi / 40
        ring = np.stack([0 * angle, 0.027 * np.sin(angle), 0.034 * np.cos(angle)], axis=1)
        path = ring + centre + [side * -0.005, 0, 0]
        soft.append(sweep(path, np.array([side, 0, 0]), rounded(0.024, 0.017, 2.4, 14), True))
        tops.append(centre + [side * 0.013, 0, 0.030])
    middle = (tops[0] + tops[1]) / 2
    head = rest[skin[np.abs(rest[skin, 1] - middle[1]) < 0.022]]
    head = head[head[:, 2] > middle[2]]
    offset = head - middle
    turn = arctan2(offset[:, 0], offset[:, 2])
    reach = np.hypot(offset[:, 0], offset[:, 2])
    stations = np.linspace(-np.pi / 2, np.pi / 2, 61)
    near = np.abs(turn[None] - stations[:, None]) < 0.16
    radius = np.where(near, reach[None], 0).max(axis=1) + _BAND_CLEARANCE
    ends = np.abs(stations) > np.radians(70)
    radius[ends] = np.linalg.norm(tops[0] - middle)
    for _ in range(14):
        radius[1:-1] = 0.5 * radius[1:-1] + 0.25 * (radius[2:] + radius[:-2])
    path = middle + radius[:, None] * np.stack(
        [np.sin(stations), 0 * stations, np.cos(stations)], axis=1
    )
    out = unit(path - middle)
    width = np.interp(np.abs(stations), [0, 1.1, 1.5], [0.034, 0.026, 0.014])[:, None, None]
    thick = rounded(0.009, 0.0, 3.0)
    hard.append(sweep(path, out, thick + width * rounded(0.0, 1.0, 3.0), closed=False))
    pieces = []
    for name, parts, look in (
        ("headphones", hard, {"colour": wearing.colour, "roughness": 0.35}),
        ("headphones_cushions", soft, {"colour": wearing.accent, "roughness": 0.6}),
    ):
        points, faces = joined(parts)
        pieces.append(MeshPiece(name, Part.HEADWEAR, faces, "plastic", rigid("head", points), look))
    return pieces
