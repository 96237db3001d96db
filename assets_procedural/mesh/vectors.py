"""Small shading-language functions on arrays: unit vectors, steps, angles, rigid motions."""

from __future__ import annotations

from typing import Any

import numpy as np


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) at unit length; zero vectors stay zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


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
