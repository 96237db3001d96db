"""Tops: cut from the bust along a neckline, draped over it, and hemmed.

Necklines and armholes are level sets over the rest shape of the average person, in metres, so every
style fits every identity. `field > 0` is cloth.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from assets_procedural.body.head import Bust, HeadModel, Identity, vertex_normals
from assets_procedural.body.piece import MeshPiece
from assets_procedural.conventions.parts import Part
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
from assets_procedural.person import Person

# Skin farther than this inside the garment (metres) can never be seen.
_HIDDEN_MARGIN = 0.022


@dataclass(frozen=True)
class _Style:
    """How a top is cut, in metres.

    `front` and `back` are the heights where the neckline crosses the midline of the average person
    and `vee` the point of a V-neck (0: none); `gap` is the slack over the skin, `band` the width of
    the collar band and `thickness` its rise off the cloth.
    """

    front: float
    back: float
    gap: float
    band: float
    thickness: float
    material: str = "cloth"
    vee: float = 0.0
    sleeveless: bool = False


STYLES = {
    "tee": _Style(0.494, 0.551, 0.006, 0.020, 0.0012),
    "vneck": _Style(0.500, 0.550, 0.006, 0.016, 0.0012, vee=0.437),
    "tank": _Style(0.468, 0.512, 0.004, 0.009, 0.0008, sleeveless=True),
    "crew_sweater": _Style(0.503, 0.557, 0.010, 0.024, 0.0026, material="knit"),
}


def wardrobe(person: Person, identity: Identity) -> list[MeshPiece]:
    """The top that a person wears: its body and its collar band.

    Materials "cloth" or "knit"; `parameters` hold colour and accent (linear Rec.709), pattern,
    weave and roughness. `uv` are metres along the cloth: u across and v upwards, or along and
    across the band.

    Raises:
        KeyError: an unknown style.
    """
    style = STYLES[person.top.style]
    pattern = _pattern(identity.model, person.top.style)
    garment = _Garment(pattern, style, person, identity)
    colours = {"colour": person.top.colour, "accent": person.top.accent}
    weave = "knit" if style.material == "knit" else "jersey"
    body = {"pattern": person.top.pattern, "weave": weave, "roughness": 0.9, **colours}
    band = {"pattern": "plain", "weave": "rib", "roughness": 0.9, **colours}
    if person.top.pattern == "ringer":
        band["colour"] = person.top.accent
    return [
        garment.piece("top", garment.body_faces, style.material, body, garment.uv),
        garment.piece("collar", garment.band_faces, "knit", band, garment.band_uv),
    ]


def covered_skin(person: Person, identity: Identity) -> np.ndarray:
    """(F,) mask over `model.faces["skin"]`: quads wholly under the top, safe to leave out."""
    model = identity.model
    field = _field(average_person(model), person.top.style)
    return (field[model.faces["skin"]] > _HIDDEN_MARGIN).all(axis=1)


def _field(p: np.ndarray, name: str) -> np.ndarray:
    """Signed distance (N,) into the garment over positions (N, 3) on the average person."""
    style = STYLES[name]
    x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    # A saddle through the pit of the neck (y -.080) and the nape (y .032) that climbs to the sides,
    # where the shoulder seams meet the neck.
    slope = (style.back - style.front) / 0.112
    climb = 2.9
    edge = style.back + slope * (y - 0.032) + climb * np.minimum(x, 0.12) ** 2
    field = (edge - z) / np.sqrt(1 + slope**2 + (2 * climb * np.minimum(x, 0.12)) ** 2)
    if style.vee:
        top, half = style.front + 0.030, 0.068
        rise = top - style.vee
        wedge = (x * rise - (z - style.vee) * half) / np.hypot(rise, half)
        field = np.where(y < -0.02, _soft_min(field, wedge, 0.006), field)
    if style.sleeveless:
        field = _soft_max(field, x - 0.078, 0.03)
        hole = 0.128 + 0.25 * np.clip(0.43 - z, 0, 0.1) - x
        field = _soft_min(field, hole, 0.004)
    return np.where(z > 0.57, -0.05, field)  # never the head, however wide the ears


def _soft_min(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    h = np.clip(0.5 + 0.5 * (b - a) / width, 0, 1)
    return b + (a - b) * h - width * h * (1 - h)


def _soft_max(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    return -_soft_min(-a, -b, width)


@dataclass(frozen=True, eq=False)
class _Pattern:
    """The cut of one style: what does not depend on the identity."""

    sheet: Sheet
    band: np.ndarray  # (T,) faces of the collar band
    necklines: list[np.ndarray]  # border loops where the garment ends
    ends: list[np.ndarray]  # border loops where the bust ends: sleeves and the waist


@lru_cache(maxsize=8)
def _pattern(model: HeadModel, name: str) -> _Pattern:
    style = STYLES[name]
    average = average_person(model)
    quads = model.faces["skin"]
    near = _field(average, name)[quads].max(axis=1) > -0.03
    sheet = cut_from_skin(model, quads[near], partial(_field, name=name))
    sheet = sheet.cut(style.band - 0.0005).cut(style.band + 0.0009)
    band = sheet.field[sheet.faces].mean(axis=1) < style.band - 0.0005
    loops = [loop for loop in border_loops(sheet.faces) if len(loop) > 8]
    necklines = [loop for loop in loops if np.abs(sheet.field[loop]).max() < 1e-6]
    ends = [loop for loop in loops if sheet.field[loop].max() > 1e-3]
    return _Pattern(sheet, band, necklines, ends)


class _Garment:
    """A pattern fitted to an identity: rest positions, skinning weights, faces."""

    def __init__(self, pattern: _Pattern, style: _Style, person: Person, identity: Identity):
        sheet = pattern.sheet
        model = identity.model
        self._points: list[np.ndarray] = []
        self._weights: list[np.ndarray] = []
        self._texture: list[np.ndarray] = []
        self._count = 0
        skin = sheet.matrix @ identity.rest
        average = sheet.matrix @ average_person(model)
        field = sheet.field
        inside = np.clip(field / 0.05, 0, 1)
        least = 0.0022 + (0.6 * style.gap) * inside
        gap = 0.003 + style.gap * inside
        cloth = drape(sheet, skin, gap, least, 36)
        normals = vertex_normals(cloth, sheet.faces)
        # The band lies on the cloth, with a seam as a small step below it.
        raised = np.clip((style.band + 0.0009 - field) / 0.0014, 0, 1)
        lift = style.thickness * raised
        lift += _folds(average, field, np.random.default_rng(person.top.seed), style.gap)
        cloth = cloth + lift[:, None] * normals

        weights = sheet.matrix @ model.weights.astype(float)
        for _ in range(20):
            weights = sheet.smoothing @ weights
        self._add(cloth, weights, _unrolled(average))
        body = [sheet.faces[~pattern.band]]
        band = [sheet.faces[pattern.band]]
        for loop in pattern.necklines:
            band.append(self._hem(loop, cloth, normals, style, weights))
        for loop in pattern.ends:
            body.append(self._close(loop, cloth, weights))
        self.body_faces = np.concatenate(body).astype(np.int32)
        self.band_faces = np.concatenate(band).astype(np.int32)
        self.rest = np.concatenate(self._points)
        self.weights = np.concatenate(self._weights)
        self.uv = np.concatenate(self._texture)
        self.band_uv = self._around(pattern, np.concatenate([field, np.zeros(self._count)]))

    def piece(
        self, name: str, faces: np.ndarray, material: str, parameters: dict, uv: np.ndarray
    ) -> MeshPiece:
        used, local = np.unique(faces, return_inverse=True)
        local = local.reshape(-1, 3).astype(np.int32)
        rest, weights = self.rest[used], self.weights[used]

        def place(bust: Bust) -> np.ndarray:
            motion = bust.blend_bones(weights)
            return np.einsum("nij,nj->ni", motion[..., :3], rest) + motion[..., 3]

        return MeshPiece(name, Part.CLOTHING, local, material, place, parameters, uv[used][local])

    def _add(self, points: np.ndarray, weights: np.ndarray, uv: np.ndarray) -> int:
        start = self._count
        self._points.append(points)
        self._weights.append(weights)
        self._texture.append(uv)
        self._count += len(points)
        return start

    def _hem(
        self,
        loop: np.ndarray,
        cloth: np.ndarray,
        normals: np.ndarray,
        style: _Style,
        weights: np.ndarray,
    ) -> np.ndarray:
        """Turn the cloth in at its edge: a rounded rim and a lining that ends out of sight."""
        edge, normal = cloth[loop], smooth_ring(normals[loop], 6)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        tangent = np.roll(edge, -1, axis=0) - np.roll(edge, 1, axis=0)
        tangent = smooth_ring(tangent / np.linalg.norm(tangent, axis=1, keepdims=True), 6)
        # Faces lie to the left of their border, so this points out of the cloth.
        out = np.cross(tangent, normal)
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        thick = style.thickness + 0.0006
        profile = ((0.5, -0.25), (0.35, -0.8), (-0.5, -1.15), (-3.0, -1.3), (-7.0, -1.5))
        rings = [loop]
        for along, above in profile:
            ring = edge + thick * (along * out + above * normal)
            start = self._add(ring, weights[loop], self._texture[0][loop])
            rings.append(start + np.arange(len(loop)))
        return np.concatenate([ring_strip(a, b) for a, b in itertools.pairwise(rings)])

    def _close(self, loop: np.ndarray, cloth: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Extend a sleeve or the waist beyond the end of the bust, and close it there."""
        edge = cloth[loop]
        middle = edge.mean(axis=0)
        sideways = np.abs(middle[0]) > 0.5 * np.ptp(cloth[:, 0]) * 0.5
        if sideways:
            axis = np.array([np.sign(middle[0]) * 0.68, 0.0, -0.73])
            reach = 0.10
        else:
            axis, reach = np.array([0.0, 0.0, -1.0]), 0.12
        farthest = ((edge - middle) @ axis).max()
        target = edge + (farthest + reach - (edge - middle) @ axis)[:, None] * axis
        target = (
            middle
            + (farthest + reach) * axis
            + 0.94 * (target - middle - (farthest + reach) * axis)
        )
        target = smooth_ring(target, 30)
        rings = [loop]
        for share in (0.15, 0.4, 0.7, 1.0):
            ring = edge + share * (target - edge)
            start = self._add(ring, weights[loop], self._texture[0][loop] + [0, -share * reach])
            rings.append(start + np.arange(len(loop)))
        cap = self._add(target.mean(axis=0)[None], weights[loop].mean(axis=0)[None],
                        self._texture[0][loop].mean(axis=0)[None])  # fmt: skip
        last = rings[-1]
        fan = np.stack([np.roll(last, -1), last, np.full(len(last), cap)], axis=1)
        strips = [ring_strip(a, b) for a, b in itertools.pairwise(rings)]
        return np.concatenate([*strips, fan])

    def _around(self, pattern: _Pattern, field: np.ndarray) -> np.ndarray:
        """Texture of the band: metres around the neck and across the band."""
        centre = self.rest[pattern.necklines[0]].mean(axis=0)
        offset = self.rest - centre
        angle = arctan2(offset[:, 0], -offset[:, 1])
        radius = np.hypot(offset[pattern.necklines[0], 0], offset[pattern.necklines[0], 1]).mean()
        return np.stack([(angle + np.pi) * radius, field[: len(angle)] + 0.1], axis=1)


def _unrolled(average: np.ndarray) -> np.ndarray:
    """Metre-like texture coordinates: across the body, and around it from front to back."""
    angle = arctan2(average[:, 2] - 0.38, -(average[:, 1] + 0.02))
    return np.stack([average[:, 0] + 0.5, 0.13 * angle + 0.5], axis=1)


def _folds(
    average: np.ndarray, field: np.ndarray, rng: np.random.Generator, gap: float
) -> np.ndarray:
    """Heights (N,) in metres of soft folds that start below the collar."""
    height = np.zeros(len(average))
    for _ in range(7):
        lean = rng.normal(0, 0.5)
        direction = np.array([np.cos(lean), 0.35 * rng.normal(), np.sin(lean)])
        wave = 2 * np.pi / rng.uniform(0.05, 0.13)
        phase = rng.uniform(0, 2 * np.pi) + 0.8 * np.sin(
            average @ rng.normal(0, 14, 3) + rng.uniform(0, 6)
        )
        ridge = 0.5 + 0.5 * np.sin(wave * (average @ direction) + phase)
        patch = 0.5 + 0.5 * np.sin(average @ rng.normal(0, 16, 3) + rng.uniform(0, 6))
        height += ridge**2.5 * patch**2
    start = np.clip((field - 0.03) / 0.07, 0, 1)
    return (0.0006 + 0.25 * gap) * start * height
