"""Headwear: what is cut from the scalp and draped over it (beanies, cap, turban, bandana), and
where every hat ends.

As in `necklines`, the cut is a level set over the average person at rest; `field > 0` is hat.
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
from assets_procedural.outfit.brimmed_hats import BRIMMED, brimmed
from assets_procedural.outfit.cloth import (
    Sheet,
    average_person,
    border_loops,
    cut_from_skin,
    drape,
    ring_strip,
    smooth_ring,
)
from assets_procedural.outfit.fabrics import cloth_look
from assets_procedural.outfit.garment import no_seams
from assets_procedural.outfit.scarves import headscarf
from assets_procedural.person import Hat

_CAP = ((-0.150, 0.757), (-0.100, 0.741), (-0.045, 0.727), (0.0, 0.716), (0.08, 0.708))
_BEANIE = ((-0.150, 0.752), (-0.100, 0.731), (-0.045, 0.713), (0.0, 0.700), (0.08, 0.692))
EDGES = {
    "beanie": _BEANIE,
    "bobble": _BEANIE,
    "cap": _CAP,
    "bucket": ((-0.150, 0.757), (-0.100, 0.744), (-0.045, 0.733), (0.0, 0.722), (0.08, 0.712)),
    "fedora": ((-0.150, 0.762), (-0.100, 0.748), (-0.045, 0.737), (0.0, 0.728), (0.08, 0.718)),
    "sun_hat": ((-0.150, 0.762), (-0.100, 0.747), (-0.045, 0.736), (0.0, 0.727), (0.08, 0.717)),
    "turban": ((-0.150, 0.768), (-0.100, 0.742), (-0.045, 0.716), (0.0, 0.700), (0.08, 0.688)),
    "bandana": ((-0.150, 0.764), (-0.100, 0.745), (-0.045, 0.728), (0.0, 0.712), (0.08, 0.700)),
}
"""Style → depth y and height of the hat's edge on the average person, metres: from the forehead
over the ears to the nape. Headscarves have none."""
_WEAVES = {
    "beanie": "rib",
    "bobble": "knit",
    "cap": "twill",
    "turban": "jersey",
    "bandana": "poplin",
}
_BRIM = 0.042
_VISOR_LENGTH = 0.066


def hat(wearing: Hat, identity: Identity) -> list[MeshPiece]:
    """The hat or headscarf: material "cloth", Part.HEADWEAR.

    `uv` are metres around the head and upwards from the edge.

    Raises:
        KeyError: an unknown style.
    """
    if wearing.style == "headscarf":
        return headscarf(wearing, identity)
    if wearing.style in BRIMMED:
        sheet = _pattern(identity.model, wearing.style)
        loop = max(border_loops(sheet.faces), key=len)
        skin = sheet.matrix @ identity.rest
        return brimmed(wearing, skin, skin[loop])
    return _draped(wearing, identity)


def hides_hair(wearing: Hat | None) -> bool:
    """Whether no hair of the head shows under it."""
    return wearing is not None and wearing.style == "headscarf"


def _draped(wearing: Hat, identity: Identity) -> list[MeshPiece]:
    style = wearing.style
    sheet = _pattern(identity.model, style)
    skin = sheet.matrix @ identity.rest
    field = sheet.field
    knitted = style in ("beanie", "bobble")
    # Room for hair, and slack at the crown.
    inside = np.clip(field / 0.03, 0, 1)
    crown = np.clip((field - 0.05) / 0.05, 0, 1)
    least = 0.0035 + 0.003 * inside
    gap = 0.005 + 0.009 * inside
    if knitted:
        gap = 0.005 + (0.004 + 0.012 * crown) * inside
    elif style == "bandana":
        least, gap = 0.0040 + 0.0015 * inside, 0.0055 + 0.002 * inside
    points = drape(sheet, skin, gap, least, 40 if knitted else 60)
    normals = vertex_normals(points, sheet.faces)
    place = sheet.matrix @ average_person(identity.model)
    rng = np.random.default_rng(wearing.seed)
    thick = 0.0015
    if knitted:
        # The brim is folded up: a second layer that ends in a soft step.
        fold = np.clip((_BRIM + 0.002 - field) / 0.004, 0, 1)
        round_edge = 0.5 + 0.5 * np.sin(np.clip(field / _BRIM, 0, 1) * np.pi) ** 0.5
        lift, thick = 0.0045 * fold * round_edge, 0.004
        around = arctan2(place[:, 0], -(place[:, 1] + 0.05))
        slack = np.sin(3 * around + rng.uniform(0, 6)) * np.sin(field * 45 + rng.uniform(0, 6))
        lift = lift + 0.0035 * np.clip((field - 0.045) / 0.03, 0, 1) * slack
    elif style == "turban":
        lift, thick = _wound(place, field, rng), 0.003
    elif style == "cap":
        lift = _panels(place, field)
    else:
        ripple = np.sin(place @ rng.normal(0, 90, 3)) * np.sin(place @ rng.normal(0, 70, 3))
        lift = 0.0012 * inside * ripple
    points = points + lift[:, None] * normals
    normals = vertex_normals(points, sheet.faces)
    loop = max(border_loops(sheet.faces), key=len)
    points, faces = _hemmed(points, sheet.faces, loop, normals, thick)
    field = np.concatenate([field, np.zeros(len(points) - len(field))])
    parameters = cloth_look(wearing, _WEAVES[style], 0.9)
    parts = [("hat", points, faces, _around(points, field))]
    top = points[np.argmax(field)]
    if style == "cap":
        for name, (part, quads) in (
            ("hat_button", ellipsoid(top, np.diag([0.006, 0.006, 0.003]))),
            ("hat_visor", _visor(points[loop])),
        ):
            parts.append((name, part, quads, part[:, :2] - part[:, :2].min(axis=0)))
    elif style == "bobble":
        ball, quads = ellipsoid(top + [0, 0, 0.024], np.diag([0.029, 0.029, 0.027]))
        parts.append(("hat_bobble", ball, quads, ball[:, :2]))
    elif style == "bandana":
        knot = points[loop][np.argmax(points[loop][:, 1])] + [0, 0.006, 0.008]
        ball, quads = ellipsoid(knot, np.diag([0.016, 0.009, 0.012]))
        parts.append(("hat_knot", ball, quads, ball[:, :2]))
    return [
        MeshPiece(
            name,
            Part.HEADWEAR,
            quads,
            "cloth",
            rigid("head", part),
            {**parameters, "weave": "pile"} if name == "hat_bobble" else parameters,
            uv[quads],
            {"seams": no_seams(part)},
        )
        for name, part, quads, uv in parts
    ]


def _wound(place: np.ndarray, field: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Heights (N,) of cloth wound around the head that crosses over the forehead, metres."""
    x, y, z = place.T
    front = np.clip(-(y + 0.03) / 0.08, 0, 1)
    over = np.where(x * rng.choice([-1.0, 1.0]) > 0, 1.0, -1.0)
    climb = z + (0.75 * np.abs(x) - 0.055) * front - 0.25 * y
    ridge = np.abs(np.sin(np.pi * climb / 0.019 + 0.35 * over * front))
    roll = np.clip(field / 0.010, 0, 1) ** 0.5 * np.clip((0.125 - field) / 0.05, 0.15, 1)
    return roll * (0.008 + 0.0075 * ridge**0.7)


def _panels(place: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Heights (N,) of a cap's six panels, which bulge between their seams, metres."""
    around = arctan2(place[:, 0], -(place[:, 1] + 0.045))
    between = np.abs(np.sin(3 * around))
    return 0.0028 * np.minimum(between * 2.2, 1) ** 0.6 * np.clip(field / 0.01, 0.3, 1)


def above_rim(points: np.ndarray, wearing: Hat, identity: Identity) -> np.ndarray:
    """(N,) metres by which the skin nearest to points (N, 3), rest space, lies above the rim.

    Positive where the hat sits, negative below it.
    """
    model = identity.model
    if hides_hair(wearing):
        return np.full(len(points), 0.1)
    skin = model.groups["skin"]
    _, nearest = KDTree(identity.rest[skin]).query(points)
    return _field(average_person(model)[skin], wearing.style)[nearest] + 0.003


def _field(p: np.ndarray, style: str) -> np.ndarray:
    depth, height = np.array(EDGES[style]).T
    slope = 0.3
    return (p[:, 2] - np.interp(p[:, 1], depth, height)) / np.hypot(1, slope)


@lru_cache(maxsize=8)
def _pattern(model: HeadModel, style: str) -> Sheet:
    average = average_person(model)
    quads = model.faces["skin"]
    # The ears stay outside, also where they reach above the edge.
    ears = model.masks["ears"][quads].max(axis=1) > 0.5
    near = (_field(average, style)[quads].max(axis=1) > -0.02) & ~ears
    sheet = cut_from_skin(model, quads[near], partial(_field, style=style))
    if style in ("beanie", "bobble"):
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
