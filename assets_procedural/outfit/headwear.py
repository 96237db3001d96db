"""Hats: a beanie and a baseball cap, cut from the scalp and draped over it.

As in `tops`, the cut is a level set over the average person at rest; `field > 0` is hat.
"""

from __future__ import annotations

import itertools
from functools import lru_cache, partial

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel, Identity, vertex_normals
from assets_procedural.body.piece import MeshPiece, rigid
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import ellipsoid
from assets_procedural.mesh.vectors import arctan2
from assets_procedural.outfit.cloth import (
    Sheet,
    average_person,
    border_loops,
    cut_from_skin,
    drape,
    ring_strip,
    smooth_ring,
)
from assets_procedural.person import Hat

# Height of the hat's edge (m, average person) over depth y: forehead, above the ears, nape.
_EDGES = {
    "beanie": ((-0.150, 0.752), (-0.100, 0.731), (-0.045, 0.713), (0.0, 0.700), (0.08, 0.692)),
    "cap": ((-0.150, 0.757), (-0.100, 0.741), (-0.045, 0.727), (0.0, 0.716), (0.08, 0.708)),
}
_BRIM = 0.042
_VISOR_LENGTH = 0.066


def hat(wearing: Hat, identity: Identity) -> list[MeshPiece]:
    """The hat: material "knit" for a beanie, "cloth" for a cap; Part.HEADWEAR.

    `uv` are metres around the head and upwards from the edge.

    Raises:
        KeyError: an unknown style.
    """
    sheet = _pattern(identity.model, wearing.style)
    skin = sheet.matrix @ identity.rest
    field = sheet.field
    knitted = wearing.style == "beanie"
    # Room for hair, and slack at the crown.
    inside = np.clip(field / 0.03, 0, 1)
    crown = np.clip((field - 0.05) / 0.05, 0, 1)
    least = 0.0035 + 0.003 * inside
    gap = 0.005 + (0.004 + 0.012 * crown) * inside if knitted else 0.005 + 0.009 * inside
    points = drape(sheet, skin, gap, least, 40 if knitted else 60)
    normals = vertex_normals(points, sheet.faces)
    if knitted:
        # The brim is folded up: a second layer that ends in a soft step.
        fold = np.clip((_BRIM + 0.002 - field) / 0.004, 0, 1)
        round_edge = 0.5 + 0.5 * np.sin(np.clip(field / _BRIM, 0, 1) * np.pi) ** 0.5
        points = points + (0.0045 * fold * round_edge)[:, None] * normals
    loop = max(border_loops(sheet.faces), key=len)
    points, faces = _hemmed(points, sheet.faces, loop, normals, 0.004 if knitted else 0.0015)
    field = np.concatenate([field, np.zeros(len(points) - len(field))])
    parameters = {
        "colour": wearing.colour,
        "accent": wearing.accent,
        "pattern": "plain",
        "weave": "rib" if knitted else "twill",
        "roughness": 0.9,
    }
    material = "knit" if knitted else "cloth"
    uv = _around(points, field)[faces]
    pieces = [
        MeshPiece("hat", Part.HEADWEAR, faces, material, rigid("head", points), parameters, uv)
    ]
    if not knitted:
        top = points[np.argmax(field)]
        button, button_faces = ellipsoid(top, np.diag([0.006, 0.006, 0.003]))
        visor, visor_faces = _visor(points[loop])
        for name, part, quads in (
            ("hat_button", button, button_faces),
            ("hat_visor", visor, visor_faces),
        ):
            uv = (part[:, :2] - part[:, :2].min(axis=0))[quads]
            pieces.append(
                MeshPiece(name, Part.HEADWEAR, quads, material, rigid("head", part), parameters, uv)
            )
    return pieces


def above_rim(points: np.ndarray, wearing: Hat, identity: Identity) -> np.ndarray:
    """(N,) metres by which the skin nearest to points (N, 3), rest space, lies above the rim.

    Positive where the hat sits, negative below it.
    """
    model = identity.model
    skin = model.groups["skin"]
    _, nearest = KDTree(identity.rest[skin]).query(points)
    return _field(average_person(model)[skin], wearing.style)[nearest] + 0.003


def _field(p: np.ndarray, style: str) -> np.ndarray:
    depth, height = np.array(_EDGES[style]).T
    slope = 0.3
    return (p[:, 2] - np.interp(p[:, 1], depth, height)) / np.hypot(1, slope)


@lru_cache(maxsize=4)
def _pattern(model: HeadModel, style: str) -> Sheet:
    average = average_person(model)
    quads = model.faces["skin"]
    # The ears stay outside, also where they reach above the edge.
    ears = model.masks["ears"][quads].max(axis=1) > 0.5
    near = (_field(average, style)[quads].max(axis=1) > -0.02) & ~ears
    sheet = cut_from_skin(model, quads[near], partial(_field, style=style))
    if style == "beanie":
        sheet = sheet.cut(_BRIM - 0.002).cut(_BRIM + 0.002)
    return sheet


def _hemmed(
    points: np.ndarray, faces: np.ndarray, loop: np.ndarray, normals: np.ndarray, thick: float
) -> tuple[np.ndarray, np.ndarray]:
    """Turn the edge in: a rounded rim and a lining that goes up inside."""
    edge = points[loop]
    normal = smooth_ring(normals[loop], 8)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    rings, added = [loop], [points]
    start = len(points)
    for down, inward in ((0.3, 0.25), (0.2, 0.7), (-0.5, 1.0), (-3.0, 1.2)):
        added.append(edge - thick * (inward * normal + np.array([0, 0, down])))
        rings.append(start + np.arange(len(loop)))
        start += len(loop)
    strips = [ring_strip(a, b) for a, b in itertools.pairwise(rings)]
    return np.concatenate(added), np.concatenate([faces, *strips]).astype(np.int32)


def _visor(edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curved peak that starts along the front of the cap's edge loop (N, 3)."""
    middle = edge.mean(axis=0)
    angle = arctan2(edge[:, 0] - middle[0], -(edge[:, 1] - middle[1]))
    order = np.argsort(angle)
    reach = np.radians(62.0)
    sweep = np.linspace(-reach, reach, 41)
    root = np.stack([np.interp(sweep, angle[order], edge[order, k]) for k in range(3)], axis=1)
    share = np.linspace(-0.06, 1, 14)
    length = _VISOR_LENGTH * np.clip(1 - np.abs(sweep / reach) ** 2.6, 0, 1) ** 0.75
    # Forward and a little down, more so at the sides: a bent bill.
    level = root[20, 2] + 0.004
    across = sweep / reach
    surfaces = []
    for lower in (False, True):
        grid = np.repeat(root[None], len(share), axis=0)
        s = share[:, None]
        grid[..., 0] += 0.10 * s * length * across
        grid[..., 1] -= s * length
        droop = 0.30 * s * length + 0.010 * across**2 * np.clip(s, 0, 1)
        lift = (level - root[:, 2]) * 0.35 * np.clip(s, 0, 1)
        grid[..., 2] += 0.003 - droop + lift
        thick = 0.0026 * np.clip(np.minimum(1 - s, 1) * 8, 0.15, 1)
        grid[..., 2] -= thick if lower else 0.0
        surfaces.append(grid)
    count = len(sweep)
    index = np.arange(len(share) * count).reshape(len(share), count)
    top = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1)
    top = top.reshape(-1, 4)
    below = top[:, ::-1] + index.size
    rim = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1]])
    wall = np.stack([rim[:-1], rim[:-1] + index.size, rim[1:] + index.size, rim[1:]], axis=1)
    points = np.concatenate([s.reshape(-1, 3) for s in surfaces])
    return points, np.concatenate([top, below, wall]).astype(np.int32)


def _around(points: np.ndarray, field: np.ndarray) -> np.ndarray:
    middle = points.mean(axis=0)
    angle = arctan2(points[:, 0] - middle[0], -(points[:, 1] - middle[1]))
    return np.stack([(angle + np.pi) * 0.09, field + 0.05], axis=1)
