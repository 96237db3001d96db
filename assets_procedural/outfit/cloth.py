"""Cutting cloth from a mesh along level sets and letting it drape: geometry shared by garments.

A pattern is cut once from the head model's topology. Its vertices are fixed blends of the model's
vertices (a sparse matrix), so the same cut fits every identity, without a seam out of place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse

from assets_procedural.body.head import HeadModel, vertex_normals
from assets_procedural.mesh.subdivision import catmull_clark
from assets_procedural.person import Person

# An edge cut closer to its end than this share moves that end onto the cut, to avoid slivers.
_SNAP = 0.3


@dataclass(frozen=True, eq=False)
class Sheet:
    """A triangle mesh as blends of source vertices: `matrix` (N, V), `faces` (T, 3), `field` (N,).

    `field` is the signed distance inside the garment from its edge, in metres.
    """

    matrix: sparse.csr_matrix
    faces: np.ndarray
    field: np.ndarray

    def cut(self, level: float) -> Sheet:
        """The same surface with an edge loop along `field == level`."""
        value = self.field - level
        edges = _edges(self.faces)
        a, b = edges.T
        crossing = value[a] * value[b] < 0
        a, b = a[crossing], b[crossing]
        t = value[a] / (value[a] - value[b])
        count = len(value)

        # Snap vertices next to the cut; each takes its nearest cut point.
        near = np.full(count, _SNAP)
        partner = np.full(count, -1)
        for end, other, share in ((a, b, t), (b, a, 1 - t)):
            order = np.argsort(-share)
            closer = share[order] < near[end[order]]
            chosen = order[closer]
            near[end[chosen]] = share[chosen]
            partner[end[chosen]] = other[chosen]
        snapped = np.flatnonzero(partner >= 0)
        weight = np.where(partner >= 0, near, 0.0)
        target = np.where(partner >= 0, partner, np.arange(count))
        move = sparse.csr_matrix(
            (
                np.concatenate([1 - weight, weight]),
                (np.tile(np.arange(count), 2), np.concatenate([np.arange(count), target])),
            ),
            (count, count),
        )
        value = value.copy()
        value[snapped] = 0.0
        field = self.field.copy()
        field[snapped] = level

        # Split the edges that still cross.
        a, b = edges.T
        crossing = value[a] * value[b] < 0
        cut_edges = edges[crossing]
        a, b = cut_edges.T
        t = value[a] / (value[a] - value[b])
        split = sparse.csr_matrix(
            (
                np.concatenate([1 - t, t]),
                (np.tile(np.arange(len(a)), 2), np.concatenate([a, b])),
            ),
            (len(a), count),
        )
        # New points blend the original corners, not the snapped ones, so that they lie on the cut.
        matrix = sparse.vstack([move, split @ move]).tocsr() @ self.matrix
        faces = _split_faces(self.faces, cut_edges, count)
        return Sheet(matrix, faces, np.concatenate([field, np.full(len(a), level)]))

    @cached_property
    def smoothing(self) -> sparse.csr_matrix:
        """One step of `smoothing` over the sheet's vertices."""
        return smoothing(self.faces, len(self.field))

    def keep(self, wanted: np.ndarray) -> Sheet:
        """Keep only the faces of the mask (T,) and the vertices they use."""
        used, local = np.unique(self.faces[wanted], return_inverse=True)
        return Sheet(self.matrix[used], local.reshape(-1, 3).astype(np.int32), self.field[used])


def sheet_from_quads(matrix: sparse.csr_matrix, quads: np.ndarray, field: np.ndarray) -> Sheet:
    """Triangulate (F, 4) quads over the rows of `matrix`, dropping unused rows."""
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Sheet(matrix.tocsr(), faces.astype(np.int32), field).keep(np.ones(len(faces), bool))


@lru_cache(maxsize=2)
def average_person(model: HeadModel) -> np.ndarray:
    """(V, 3) the rest shape on which patterns are drawn."""
    return model.identity(Person()).rest


def cut_from_skin(
    model: HeadModel, quads: np.ndarray, field: Callable[[np.ndarray], np.ndarray]
) -> Sheet:
    """The part of the skin (quads (F, 4), subdivided twice) where `field` is above 0.

    `field` maps positions (N, 3) on the average person to signed distances (N,) in metres.
    """
    average = average_person(model)
    first = catmull_clark(quads, len(average))
    second = catmull_clark(first.faces, len(first.matrix @ average))
    matrix = sparse.csr_matrix(second.matrix @ first.matrix)
    sheet = sheet_from_quads(matrix, second.faces, field(matrix @ average)).cut(0.0)
    return sheet.keep(sheet.field[sheet.faces].max(axis=1) > 1e-9)


def border_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Closed loops of border vertices of (T, 3) triangles, in the direction of their faces."""
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    stride = np.int64(faces.max()) + 1
    keys = directed[:, 0] * stride + directed[:, 1]
    open_ = ~np.isin(directed[:, 1] * stride + directed[:, 0], keys)
    following = dict(directed[open_].tolist())
    loops = []
    while following:
        start, current = following.popitem()
        loop = [start]
        while current != start and current in following:
            loop.append(current)
            current = following.pop(current)
        loops.append(np.array(loop))
    return loops


def smoothing(faces: np.ndarray, count: int) -> sparse.csr_matrix:
    """One step of umbrella smoothing (N, N); border vertices move along their border only."""
    edges = _edges(faces)
    border = np.zeros(count, bool)
    loops = border_loops(faces)
    for loop in loops:
        border[loop] = True
    a, b = edges.T
    inner = ~border
    rows = np.concatenate([a[inner[a]], b[inner[b]]])
    columns = np.concatenate([b[inner[a]], a[inner[b]]])
    for loop in loops:
        rows = np.concatenate([rows, loop, loop])
        columns = np.concatenate([columns, np.roll(loop, 1), np.roll(loop, -1)])
    adjacency = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), (count, count))
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    share = np.where(degree > 0, 0.5, 0.0)
    step = sparse.diags(1 - share) + sparse.diags(share / np.maximum(degree, 1)) @ adjacency
    return sparse.csr_matrix(step)


def drape(
    sheet: Sheet, skin: np.ndarray, gap: np.ndarray, least: np.ndarray, steps: int
) -> np.ndarray:
    """Cloth vertices (N, 3) of a sheet over the skin points (N, 3) that they cover.

    Starts `gap` (N,) metres above the skin, relaxes for `steps`, and never comes closer than
    `least` (N,) metres along the smoothed normals.
    """
    faces, step = sheet.faces, sheet.smoothing
    normals = vertex_normals(skin, faces)
    for _ in range(6):
        normals = step @ normals
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    cloth = skin + gap[:, None] * normals
    for round_steps in (steps, max(steps // 4, 2), 3, 1):
        for _ in range(round_steps):
            cloth = step @ cloth
        height = np.einsum("ni,ni->n", cloth - skin, normals)
        cloth = cloth + np.maximum(least - height, 0)[:, None] * normals
    return cloth


def smooth_ring(ring: np.ndarray, steps: int) -> np.ndarray:
    """Smooth a closed row of points (N, ..., 3) by its neighbours' mean, `steps` times."""
    for _ in range(steps):
        ring = 0.5 * ring + 0.25 * (np.roll(ring, 1, axis=0) + np.roll(ring, -1, axis=0))
    return ring


def ring_strip(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Triangles (2 N, 3) between two rings of N indices.

    `first` is a border in the direction of its faces.
    """
    a, b = np.roll(first, -1), np.roll(second, -1)
    return np.concatenate([np.stack([a, first, second], 1), np.stack([a, second, b], 1)])


def _edges(faces: np.ndarray) -> np.ndarray:
    """(E, 2) ascending pairs, in order."""
    pairs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    stride = np.int64(faces.max()) + 1
    keys = np.unique(pairs.min(axis=1) * stride + pairs.max(axis=1))
    return np.stack([keys // stride, keys % stride], axis=1)


def _split_faces(faces: np.ndarray, edges: np.ndarray, count: int) -> np.ndarray:
    """Split the triangles (T, 3) that have cut edges into two or three.

    `edges` (E, 2), ascending pairs in order, are cut at the vertices `count` + 0 … E - 1.
    """
    stride = np.int64(count)
    keys = edges[:, 0] * stride + edges[:, 1]

    def middle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        key = np.minimum(a, b) * stride + np.maximum(a, b)
        place = np.searchsorted(keys, key).clip(0, max(len(keys) - 1, 0))
        return np.where(keys[place] == key, count + place, -1) if len(keys) else key * 0 - 1

    i, j, k = faces.T.astype(np.int64)
    cut = np.stack([middle(i, j), middle(j, k), middle(k, i)], axis=1)
    known = cut >= 0
    number = known.sum(axis=1)
    result = [faces[number == 0]]
    one = np.flatnonzero(number == 1)
    turn = np.argmax(known[one], axis=1)
    p, q, r = (faces[one, (turn + n) % 3] for n in range(3))
    m = cut[one, turn]
    result += [np.stack([p, m, r], 1), np.stack([m, q, r], 1)]
    # The two cut edges share one corner p.
    two = np.flatnonzero(number == 2)
    turn = np.argmax(known[two] & np.roll(known[two], 1, axis=1), axis=1)
    p, q, r = (faces[two, (turn + n) % 3] for n in range(3))
    m, n = cut[two, turn], cut[two, (turn - 1) % 3]
    result += [np.stack([p, m, n], 1), np.stack([m, q, r], 1), np.stack([m, r, n], 1)]
    return np.concatenate(result).astype(np.int32)
