"""How far pixels are from what is covered."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt


def distance(covered: np.ndarray) -> np.ndarray:
    """(H, W) pixels to the nearest that is `covered` (H, W); 0 there."""
    return np.asarray(distance_transform_edt(~covered))


def nearest(covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column (H, W) of the nearest pixel that is `covered`."""
    found = np.asarray(
        distance_transform_edt(~covered, return_distances=False, return_indices=True)
    )
    return found[0], found[1]
