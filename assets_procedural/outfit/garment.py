"""A garment on an identity: cut from the bust along its outline, draped, folded and hemmed."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel, Identity, vertex_normals
from assets_procedural.body.piece import MeshPiece, skinned
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.vectors import arctan2, smoothstep, unit
from assets_procedural.outfit.cloth import (
    Sheet,
    average_person,
    border_loops,
    cut_from_skin,
    drape,
    ring_strip,
    smooth_ring,
)
from assets_procedural.outfit.fabrics import Fabric, folds
from assets_procedural.outfit.necklines import Outline

# How far sleeves and the waist go on below the bust, metres: out of every default frame.
_REACH = 0.30
# The seam below a band: the step down to the cloth ends this far beyond the band, metres.
_STEP = 0.0009


@dataclass(frozen=True, eq=False)
class _Cut:
    """What does not depend on the identity."""

    sheet: Sheet
    average: np.ndarray  # (N, 3) places on the average person
    weights: np.ndarray  # (N, J) skinning weights
    band: np.ndarray  # (T,) faces of the band along the edge
    edges: list[np.ndarray]  # border loops where the garment ends
    ends: list[np.ndarray]  # border loops where the bust ends: sleeves and the waist


@lru_cache(maxsize=24)
def _cut(model: HeadModel, outline: Outline) -> _Cut:
    average = average_person(model)
    quads = model.faces["skin"]
    near = outline.field(average)[quads].max(axis=1) > -0.03
    sheet = cut_from_skin(model, quads[near], outline.field)
    band = np.zeros(len(sheet.faces), bool)
    if outline.band:
        sheet = sheet.cut(outline.band - 0.0005).cut(outline.band + _STEP)
        band = sheet.field[sheet.faces].mean(axis=1) < outline.band - 0.0005
    loops = [loop for loop in border_loops(sheet.faces) if len(loop) > 8]
    edges = [loop for loop in loops if np.abs(sheet.field[loop]).max() < 1e-6]
    ends = [loop for loop in loops if sheet.field[loop].max() > 1e-3]
    weights = sheet.matrix @ model.weights.astype(float)
    for _ in range(8):
        weights = sheet.smoothing @ weights
    return _Cut(sheet, sheet.matrix @ average, weights, band, edges, ends)


class Patchwork:
    """Vertices of a garment's parts: rest positions, skinning weights and texture coordinates."""

    def __init__(self) -> None:
        self._parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        self._count = 0

    def add(
        self,
        points: np.ndarray,
        weights: np.ndarray,
        uv: np.ndarray,
        seams: np.ndarray | None = None,
    ) -> int:
        """Append N vertices; returns the first one's index. `seams` as in `seam_distances`."""
        start = self._count
        seams = no_seams(points) if seams is None else seams
        self._parts.append((points, weights, uv, seams))
        self._count += len(points)
        return start

    def piece(self, name: str, faces: np.ndarray, parameters: dict) -> MeshPiece:
        """The faces (F, 3|4) over all vertices as a piece of clothing."""
        rest, weights, uv, seams = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        used, local = np.unique(faces, return_inverse=True)
        local = local.reshape(faces.shape).astype(np.int32)
        return MeshPiece(
            name, Part.CLOTHING, local, "cloth", skinned(rest[used], weights[used]), parameters,
            uv[used][local], {"seams": seams[used]},
        )  # fmt: skip


class Garment:
    """One layer: `cloth` (N, 3) at rest and its `normals`, over the places `average` (N, 3).

    `under` is the height of other clothes beneath, in metres; `calm` maps `average` to the share
    (N,) of the folds that may show.
    """

    def __init__(
        self,
        identity: Identity,
        outline: Outline,
        fabric: Fabric,
        rng: np.random.Generator,
        under: float = 0.0,
        calm: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        cut = _cut(identity.model, outline)
        sheet = cut.sheet
        self.outline, self.fabric = outline, fabric
        self.average, self.weights, self.faces = cut.average, cut.weights, sheet.faces
        skin = sheet.matrix @ identity.rest
        inside = np.clip(sheet.field / 0.05, 0, 1)
        least = 0.0022 + under + 0.6 * fabric.slack * inside
        gap = 0.003 + under + fabric.slack * inside
        cloth = drape(sheet, skin, gap, least, 36)
        normals = vertex_normals(cloth, sheet.faces)
        # The band lies on the cloth, with a seam as a small step below it.
        raised = np.clip((outline.band + _STEP - sheet.field) / 0.0014, 0, 1) * bool(outline.band)
        start = smoothstep(0.012 + outline.band, 0.07, sheet.field)
        height = fabric.folds * start * folds(cut.average, fabric.crisp, rng)
        if calm is not None:
            height = height * calm(cut.average)
        lift = fabric.thickness * raised + height
        self.cloth = cloth + lift[:, None] * normals
        self.normals = vertex_normals(self.cloth, sheet.faces)
        self._cut, self._field = cut, sheet.field

    @property
    def edge(self) -> np.ndarray:
        """Vertices of the loop around the neck."""
        return max(self._cut.edges, key=len)

    def body(self, parameters: dict, band: dict) -> list[MeshPiece]:
        """The cloth, with sleeves that go on below the bust, and the band along its edge."""
        cut, patches, around = self._cut, Patchwork(), self._around()
        uv = _unrolled(self.average)
        patches.add(self.cloth, self.weights, uv, seam_distances(self.average))
        faces = [self.faces[~cut.band], *(self._extend(patches, loop, uv) for loop in cut.ends)]
        if not self.outline.band:
            faces += [self._hem(patches, loop, uv) for loop in cut.edges]
            return [patches.piece("top", np.concatenate(faces), parameters)]
        edging = Patchwork()
        edging.add(self.cloth, self.weights, around)
        rim = [self.faces[cut.band], *(self._hem(edging, loop, around) for loop in cut.edges)]
        return [
            patches.piece("top", np.concatenate(faces), parameters),
            edging.piece("band", np.concatenate(rim), band),
        ]

    def panel(
        self, distance: np.ndarray, lift: float, roll: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A second layer where `distance` (N,) is above 0: points, weights, average and faces.

        It lies `lift` metres (and `roll` (N,) more) on the cloth; its rim is closed.
        """
        count = len(self.cloth)
        unity = sparse.csr_matrix(sparse.identity(count))
        sheet = Sheet(unity, self.faces, distance).cut(0.0)
        sheet = sheet.keep(sheet.field[sheet.faces].max(axis=1) > 1e-9)
        normals = unit(sheet.matrix @ self.normals)
        base = sheet.matrix @ self.cloth
        rise = sheet.matrix @ np.broadcast_to(roll, count) + lift
        top = base + rise[:, None] * normals
        points, faces, source = [top], [sheet.faces], [np.arange(len(top))]
        total = len(top)
        for loop in border_loops(sheet.faces):
            if len(loop) < 4:
                continue
            rings = [loop]
            for share in (0.75, -0.2):
                points.append(base[loop] + (share * rise[loop])[:, None] * normals[loop])
                source.append(loop)
                rings.append(total + np.arange(len(loop)))
                total += len(loop)
            faces += [ring_strip(a, b) for a, b in itertools.pairwise(rings)]
        origin = np.concatenate(source)
        return (
            np.concatenate(points),
            (sheet.matrix @ self.weights)[origin],
            (sheet.matrix @ self.average)[origin],
            np.concatenate(faces).astype(np.int32),
        )

    def _hem(self, patches: Patchwork, loop: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Turn the cloth in at its edge: a rounded rim and a lining that ends out of sight."""
        edge, normal = self.cloth[loop], unit(smooth_ring(self.normals[loop], 6))
        tangent = smooth_ring(unit(np.roll(edge, -1, axis=0) - np.roll(edge, 1, axis=0)), 6)
        # Faces lie to the left of their border, so this points out of the cloth.
        out = unit(np.cross(tangent, normal))
        thick = self.fabric.thickness + 0.0006
        profile = ((0.5, -0.25), (0.35, -0.8), (-0.5, -1.15), (-3.0, -1.3), (-7.0, -1.5))
        rings = [loop]
        for along, above in profile:
            ring = edge + thick * (along * out + above * normal)
            start = patches.add(ring, self.weights[loop], uv[loop])
            rings.append(start + np.arange(len(loop)))
        return np.concatenate([ring_strip(a, b) for a, b in itertools.pairwise(rings)])

    def _extend(self, patches: Patchwork, loop: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Go on below the end of the bust, along the hanging arm or the waist, and close there."""
        edge = self.cloth[loop]
        middle = edge.mean(axis=0)
        side = np.sign(middle[0]) * (abs(middle[0]) > 0.25 * np.ptp(self.cloth[:, 0]))
        weights = self.weights[loop]
        rings, centre, count = [loop], middle, 9
        flat = smooth_ring(edge - middle, 2)
        for k in range(1, count + 1):
            share = k / count
            # The arm turns from its raised rest towards hanging straight down.
            axis = unit(
                np.array([0.62 * side * (1 - 0.8 * share), -0.06 * abs(side) * share, -0.78])
            )
            centre = centre + axis * _REACH / count
            level = flat - (flat @ axis)[:, None] * axis * min(1.0, 2 * share)
            size = 1 + 0.02 * np.sin(9 * k + np.arange(len(loop)) * 4 * np.pi / len(loop))
            ring = centre + level * (size * (1 - 0.1 * share))[:, None]
            texture = uv[loop] - [0, share * _REACH]
            start = patches.add(smooth_ring(ring, 4), weights, texture)
            rings.append(start + np.arange(len(loop)))
        cap = patches.add(centre[None], weights.mean(axis=0)[None], uv[loop].mean(axis=0)[None])
        last = rings[-1]
        fan = np.stack([np.roll(last, -1), last, np.full(len(last), cap)], axis=1)
        return np.concatenate([*(ring_strip(a, b) for a, b in itertools.pairwise(rings)), fan])

    def _around(self) -> np.ndarray:
        """Texture of the band: metres around the neck and across the band."""
        ring = self.cloth[self.edge]
        offset = self.cloth - ring.mean(axis=0)
        radius = np.hypot(*(ring - ring.mean(axis=0))[:, :2].T).mean()
        angle = arctan2(offset[:, 0], -offset[:, 1])
        return np.stack([(angle + np.pi) * radius, self._field + 0.1], axis=1)


def seam_distances(average: np.ndarray) -> np.ndarray:
    """(N, 3) signed distances in metres to the armhole, the shoulder seam and the front's middle.

    To the shoulder seam in depth, to the others across the body. Away from the shoulders and from
    the front theirs are 1. `average` (N, 3) are places on the average person.
    """
    x, y, z = np.abs(average[:, 0]), average[:, 1], average[:, 2]
    armhole = x - (
        0.158 + 0.25 * np.clip(0.46 - z, 0, 0.1) ** 1.2 + 0.02 * smoothstep(0.02, -0.05, y)
    )
    shoulder = np.where((z > 0.47) & (x < 0.168), y + 0.004, 1.0)
    front = np.where((y < -0.03) & (z < 0.53), average[:, 0], 1.0)
    return np.stack([armhole, shoulder, front], axis=1)


def no_seams(points: np.ndarray) -> np.ndarray:
    """`seam_distances` of N points on cloth without a seam."""
    return np.ones((len(points), 3))


def bone_weights(identity: Identity, points: np.ndarray) -> np.ndarray:
    """(N, J) skinning weights of points (N, 3) at rest: a soft mean of the skin close by."""
    skin = identity.model.groups["skin"]
    distance, near = KDTree(identity.rest[skin]).query(points, k=12)
    share = 1 / (distance + 0.01) ** 2
    weights = identity.model.weights[skin[near]] * share[..., None]
    return weights.sum(axis=1) / share.sum(axis=1)[:, None]


def clear_of(
    points: np.ndarray, surface: np.ndarray, normals: np.ndarray, margin: float
) -> np.ndarray:
    """Points (N, 3) moved to at least `margin` metres above the nearest part of a surface."""
    _, near = KDTree(surface).query(points, k=4)
    offset = np.einsum("nkj,nkj->nk", points[:, None] - surface[near], normals[near]).mean(axis=1)
    lack = np.clip(margin - offset, 0, 0.02)
    return points + lack[:, None] * unit(normals[near].mean(axis=1))


def _unrolled(average: np.ndarray) -> np.ndarray:
    """Metre-like texture coordinates: across the body, and around it from front to back."""
    angle = arctan2(average[:, 2] - 0.38, -(average[:, 1] + 0.02))
    return np.stack([average[:, 0] + 0.5, 0.13 * angle + 0.5], axis=1)
