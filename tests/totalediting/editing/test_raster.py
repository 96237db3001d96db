import numpy as np

from totalediting.editing.raster import rasterise

SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def test_a_square_covers_its_pixels_and_interpolates():
    places = np.array([[1.0, 1], [7, 1], [7, 5], [1, 5]])
    found = rasterise(places, np.full(4, 2.0), SQUARE, 8, 10)
    covered = np.zeros((8, 10), bool)
    covered[1:5, 1:7] = True
    assert (found.covered == covered).all()
    assert np.allclose(found.depth[covered], 2) and np.isinf(found.depth[~covered]).all()
    x = found.interpolate(places, SQUARE)[..., 0]
    assert np.allclose(x[2, 1:7], np.arange(1, 7) + 0.5)


def test_the_nearer_triangle_is_seen_whatever_their_order():
    places = np.array([[0.0, 0], [9, 0], [0, 9], [0, 0], [9, 0], [0, 9]])
    depth = np.array([2.0, 2, 2, 1, 1, 1])
    for triangles in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        found = rasterise(places, depth, np.array(triangles), 9, 9)
        assert np.allclose(found.depth[found.covered], 1)


def test_shares_are_those_in_space():
    # A point halfway in space lies nearer to the far end in the picture.
    places = np.array([[0.0, 0], [8, 0], [0, 8]])
    found = rasterise(places, np.array([1.0, 3, 1]), np.array([[0, 1, 2]]), 8, 8)
    share = found.shares[0, 5, 1]
    assert np.isclose(share, (5.5 / 8 / 3) / (2.5 / 8 + 5.5 / 8 / 3), atol=0.03)


def test_what_is_behind_the_camera_is_not_seen():
    places = np.array([[0.0, 0], [8, 0], [0, 8]])
    assert not rasterise(places, np.array([1.0, -1, 1]), np.array([[0, 1, 2]]), 8, 8).covered.any()
