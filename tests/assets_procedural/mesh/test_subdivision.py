"""Catmull-Clark: the known values on a cube, and what every refinement keeps."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.mesh.subdivision import catmull_clark

CORNERS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)


def grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet of (n - 1)² unit quads: points (n², 3) and faces."""
    index = np.arange(n * n).reshape(n, n)
    faces = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
    y, x = np.divmod(np.arange(n * n), n)
    return np.stack([x, y, 0 * x], axis=1).astype(float), faces.reshape(-1, 4)


def test_a_cube_moves_its_corners_edges_and_faces_as_published():
    once = catmull_clark(CUBE, 8)
    points = once.matrix @ CORNERS
    assert points.shape == (8 + 12 + 6, 3) and once.faces.shape == (24, 4)
    np.testing.assert_allclose(points[:8], CORNERS * 5 / 9)
    edges = np.sort(np.abs(points[8:20]), axis=1)
    np.testing.assert_allclose(edges, np.broadcast_to([0, 0.75, 0.75], edges.shape), atol=1e-12)
    faces = np.sort(np.abs(points[20:]), axis=1)
    np.testing.assert_allclose(faces, np.broadcast_to([0, 0, 1], faces.shape), atol=1e-12)


@pytest.mark.parametrize("shape", ["cube", "sheet"])
def test_every_new_point_is_a_weighted_mean(shape):
    points, faces = (CORNERS, CUBE) if shape == "cube" else grid(5)
    matrix = catmull_clark(faces, len(points)).matrix
    np.testing.assert_allclose(np.asarray(matrix.sum(axis=1)).ravel(), 1, atol=1e-12)
    assert matrix.data.min() >= 0


def test_children_keep_their_parents_turn_and_place():
    once = catmull_clark(CUBE, 8)
    corner = (once.matrix @ CORNERS)[once.faces]
    normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    parent = CORNERS[CUBE]
    outward = np.cross(parent[:, 2] - parent[:, 0], parent[:, 3] - parent[:, 1])
    assert (np.einsum("fi,fi->f", normal, np.repeat(outward, 4, axis=0)) > 0).all()
    # Face 4 q + k starts at corner k of quad q.
    np.testing.assert_array_equal(once.faces[:, 0], CUBE.ravel())


def test_an_open_border_is_a_cubic_b_spline_of_its_own():
    points, faces = grid(5)
    rng = np.random.default_rng(1)
    points = points + rng.normal(0, 0.2, points.shape)
    refined = catmull_clark(faces, len(points)).matrix @ points
    # Along the first row: (1, 6, 1) / 8 at vertices, the middle of the edge between them.
    for k in (1, 2, 3):
        expected = (points[k - 1] + 6 * points[k] + points[k + 1]) / 8
        np.testing.assert_allclose(refined[k], expected)
    for k in range(4):
        middle = (points[k] + points[k + 1]) / 2
        assert np.linalg.norm(refined - middle, axis=1).min() < 1e-12
    # What lies inside has no say in it.
    moved = points.copy()
    moved[12] += 1
    border = np.r_[0:5, 5, 9, 10, 14, 15, 19, 20:25]
    again = catmull_clark(faces, len(points)).matrix @ moved
    np.testing.assert_array_equal(again[border], refined[border])


def test_a_flat_sheet_stays_flat_and_unused_vertices_stay_put():
    points, faces = grid(4)
    points = np.concatenate([points, [[7.0, 8.0, 9.0]]])
    refined = catmull_clark(faces, len(points)).matrix @ points
    np.testing.assert_array_equal(refined[16], [7, 8, 9])
    assert not np.delete(refined, 16, axis=0)[:, 2].any()
    np.testing.assert_allclose(refined[5], points[5])  # an inner vertex of a regular grid


def test_corner_values_are_bilinear_in_the_parent_quad():
    _, faces = grid(3)
    once = catmull_clark(faces, 9)
    uv = np.array([[(0, 0), (1, 0), (1, 1), (0, 1)]], float).repeat(len(faces), axis=0)
    children = once.corner_values(uv)
    assert children.shape == (4 * len(faces), 4, 2)
    np.testing.assert_array_equal(children[0], [(0, 0), (0.5, 0), (0.5, 0.5), (0, 0.5)])
    # A vertex that two children share has one value in both.
    shared: dict[int, np.ndarray] = {}
    for face, values in zip(once.faces[:4], children[:4], strict=True):
        for vertex, value in zip(face.tolist(), values, strict=True):
            np.testing.assert_array_equal(shared.setdefault(vertex, value), value)
