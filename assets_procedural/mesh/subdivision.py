"""Catmull-Clark subdivision as one sparse matrix, so that it can be applied to any vertex array.

The renderer, the labels and the tests share this mesh: every vertex that Cycles renders is known in
numpy.

Symbols: V, F, E vertices, quads and edges of the control mesh; V' = V + E + F refined vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True, eq=False)
class Subdivision:
    """One level: `matrix` (V', V), `faces` (4 F, 4), of which quad q gives 4 q … 4 q + 3.

    Face 4 q + k starts at corner k of quad q, so per-quad data repeats four times.
    """

    matrix: sparse.csr_matrix
    faces: np.ndarray

    def corner_values(self, values: np.ndarray) -> np.ndarray:
        """Per-corner data (F, 4, C) of the control quads → (4 F, 4, C), bilinear in each quad."""
        centre = values.mean(axis=1, keepdims=True)
        following = (values + np.roll(values, -1, axis=1)) / 2
        preceding = np.roll(following, 1, axis=1)
        children = np.stack(
            [values, following, np.broadcast_to(centre, values.shape), preceding], axis=2
        )
        return children.reshape(-1, 4, values.shape[-1])


def catmull_clark(faces: np.ndarray, vertices: int) -> Subdivision:
    """One Catmull-Clark level for (F, 4) quads over `vertices` vertices (Catmull & Clark 1978).

    Boundary edges use the cubic B-spline rule, so open borders keep their own curve. Vertices that
    no face uses stay where they are.
    """
    quads = len(faces)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    unique, edge_of = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    edge_of = edge_of.reshape(quads, 4)
    count = len(unique)

    face_points = _average(faces, vertices)
    uses = np.bincount(edge_of.ravel(), minlength=count)
    interior = uses == 2
    around = sparse.csr_matrix(
        (np.ones(quads * 4), (edge_of.ravel(), np.repeat(np.arange(quads), 4))), (count, quads)
    )
    ends = _average(unique, vertices)
    inside = sparse.diags(interior.astype(float))
    edge_points = (
        0.5 * inside @ ends
        + 0.5 * inside @ (sparse.diags(1 / uses) @ around @ face_points)
        + sparse.diags((~interior).astype(float)) @ ends
    )

    # Interior vertices: (average of face points + 2 average of edge midpoints + (n - 3) v) / n.
    corner = faces.ravel()
    valence = np.bincount(corner, minlength=vertices)
    face_sum = sparse.csr_matrix(
        (np.ones(quads * 4), (corner, np.repeat(np.arange(quads), 4))), (vertices, quads)
    )
    edge_sum = sparse.csr_matrix(
        (np.ones(count * 2), (unique.ravel(), np.repeat(np.arange(count), 2))), (vertices, count)
    )
    border_edges = unique[~interior]
    on_border = np.zeros(vertices, bool)
    on_border[border_edges] = True
    used = valence > 0
    smooth = used & ~on_border
    n = np.maximum(valence, 1)
    points = (
        sparse.diags(smooth / n**2) @ face_sum @ face_points
        + sparse.diags(smooth * 2 / n**2) @ edge_sum @ ends
        + sparse.diags(np.where(smooth, (n - 3) / n, 0))
    )
    border_sum = sparse.csr_matrix(
        (
            np.ones(border_edges.size),
            (border_edges.ravel(), np.repeat(np.arange(len(border_edges)), 2)),
        ),
        (vertices, len(border_edges)),
    )
    degree = np.asarray(border_sum.sum(axis=1)).ravel()
    curve = on_border & (degree == 2)
    points = (
        points
        + sparse.diags(curve * 0.25) @ border_sum @ _average(border_edges, vertices)
        + sparse.diags(np.where(curve, 0.5, np.where(used & ~smooth | ~used, 1.0, 0.0)))
    )

    e, f = vertices + edge_of, vertices + count + np.arange(quads)
    children = [np.stack([faces[:, k], e[:, k], f, e[:, (k + 3) % 4]], axis=1) for k in range(4)]
    refined = np.stack(children, axis=1).reshape(-1, 4).astype(np.int32)
    matrix = sparse.csr_matrix(sparse.vstack([points, edge_points, face_points]))
    return Subdivision(matrix, refined)


def _average(index: np.ndarray, vertices: int) -> sparse.csr_matrix:
    rows, width = index.shape
    values = np.full(rows * width, 1 / width)
    return sparse.csr_matrix(
        (values, (np.repeat(np.arange(rows), width), index.ravel())), (rows, vertices)
    )
