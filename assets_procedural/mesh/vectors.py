"""Small shading-language functions on arrays: unit vectors, ways, steps, angles, motions."""

from __future__ import annotations

from typing import Any

import numpy as np


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) at unit length; zero vectors stay zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def across(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Unit vectors along what is at right angles to unit `axes` of vectors, (..., 3) both."""
    return unit(vectors - axes * (vectors * axes).sum(-1, keepdims=True))


def way_along(points: np.ndarray) -> np.ndarray:
    """(N,) length of the way from the first of N points to each, straight between them."""
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def smoothstep(low: Any, high: Any, value: Any) -> Any:
    """Hermite step from 0 at `low` to 1 at `high`, in either order."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def arctan2(y: Any, x: Any) -> np.ndarray:
    """`np.arctan2`, the same to the last bit in every run.

    On strided arguments numpy 1.26 picks one of two routines by where the result lies in memory.
    """
    return np.arctan2(np.asarray(y, order="C"), np.asarray(x, order="C"))


def moved(points: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Points (..., 3) under a rigid motion (3|4, 4)."""
    return points @ motion[:3, :3].T + motion[:3, 3]
