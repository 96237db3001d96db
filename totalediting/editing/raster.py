"""Triangles to pixels: which one is seen where, and where in it. Plain numpy, no gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_PAIRS = 2_000_000  # pixels of boxes around triangles at once, which bounds the memory


class Raster(NamedTuple):
    """What is seen in each pixel of (H, W)."""

    triangle: np.ndarray
    """(H, W) number of the triangle, -1 for none."""
    shares: np.ndarray
    """(H, W, 3) of its corners, in space; 0 where there is none."""
    depth: np.ndarray
    """(H, W) along the viewing axis; infinite where there is none."""

    @property
    def covered(self) -> np.ndarray:
        return self.triangle >= 0

    def interpolate(self, values: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(H, W, C) of values (V, C) at the corners of triangles (F, 3); 0 where there is none."""
        corners = values[triangles[self.triangle.clip(0)]]
        return (corners * self.shares[..., None]).sum(-2)


def rasterise(
    places: np.ndarray, depth: np.ndarray, triangles: np.ndarray, height: int, width: int
) -> Raster:
    """Of triangles (F, 3) of points at `places` (V, 2) in pixels, x right and y down, and `depth`
    (V,); both sides are seen, what is at or behind the camera is not."""
    found = np.full(height * width, -1)
    nearest = np.full(height * width, np.inf)
    kept = np.flatnonzero((depth[triangles] > 0).all(1))
    corners = places[triangles[kept]]
    # Pixel centres within the box.
    low = np.ceil(corners.min(1) - 0.5).astype(int).clip(0)
    high = np.floor(corners.max(1) - 0.5).astype(int)
    high = np.minimum(high, [width - 1, height - 1])
    size = (high - low + 1).clip(0)
    count = size.prod(1)
    for part in _parts(count):
        number = np.repeat(part, count[part])
        first = np.cumsum(count[part]) - count[part]
        inside = np.arange(len(number)) - np.repeat(first, count[part])
        x = low[number, 0] + inside % size[number, 0].clip(1)
        y = low[number, 1] + inside // size[number, 0].clip(1)
        shares = _shares(corners[number], np.stack([x, y], 1) + 0.5)
        hit = (shares >= -1e-9).all(1)
        number, shares = number[hit], shares[hit]
        pixel = y[hit] * width + x[hit]
        distance = 1 / (shares / depth[triangles[kept[number]]]).sum(1)
        order = np.argsort(-distance, kind="stable")  # the nearest is written last
        pixel, distance, number = pixel[order], distance[order], number[order]
        closer = distance < nearest[pixel]
        nearest[pixel[closer]] = distance[closer]
        found[pixel[closer]] = kept[number[closer]]
    shares = np.zeros((height * width, 3))
    seen = np.flatnonzero(found >= 0)
    centres = np.stack([seen % width, seen // width], 1) + 0.5
    of = triangles[found[seen]]
    flat = _shares(places[of], centres) / depth[of]
    shares[seen] = flat / flat.sum(1, keepdims=True)
    return Raster(
        found.reshape(height, width),
        shares.reshape(height, width, 3),
        nearest.reshape(height, width),
    )


def _parts(count: np.ndarray) -> list[np.ndarray]:
    """Triangles in groups of at most `_PAIRS` pixels."""
    group = np.cumsum(count) // _PAIRS
    return [np.flatnonzero(group == k) for k in np.unique(group)] if len(count) else []


def _shares(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, 3) barycentric coordinates in the picture of points (N, 2) in triangles (N, 3, 2)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = _cross(b - a, c - a)
    safe = np.where(np.abs(area) < 1e-12, np.nan, area)
    second, third = _cross(points - a, c - a) / safe, _cross(b - a, points - a) / safe
    return np.stack([1 - second - third, second, third], 1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
