"""The space that is rendered, and how the canonical planes of features hold it.

Model space and canonical space: metres, Z up, the head looks along -Y, the origin between the ears
at the height of the eyes. Planes are finest where the face is, and coarser away from it by an asinh
along each axis: of 64 texels, one is 4 mm there, 8 mm 10 cm away and 24 mm at the end.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor

BOX_LOW = (-0.3, -0.3, -0.36)
"""Lowest corner of the box, metres: the chest ends below."""
BOX_HIGH = (0.3, 0.3, 0.24)
"""Highest corner; all sides are 0.6 m."""
FOCUS = (0.0, -0.06, -0.03)
"""Where planes are finest, metres: behind the nose. A face has its sides at equal distances."""
REACH = 0.05
"""Metres from there within which planes are about equally fine."""

ORIGIN_LANDMARKS = (0, 16, 28)
"""In front of both ears at the height of the eyes, and the ridge of the nose: no expression moves
them by more than half a millimetre, and their mean lies amid the head."""


def head_centre(landmarks_canonical: np.ndarray) -> np.ndarray:
    """(3,) the origin of model space in the world, from a subject's (70, 3) canonical landmarks."""
    if landmarks_canonical.shape != (70, 3):
        raise ValueError(f"landmarks must be (70, 3), got {landmarks_canonical.shape}")
    return landmarks_canonical[list(ORIGIN_LANDMARKS)].mean(axis=0, dtype=np.float64)


def box(like: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest and highest corner (3,), of the dtype and on the device of a tensor."""
    return like.new_tensor(BOX_LOW), like.new_tensor(BOX_HIGH)


def on_planes(points: Tensor) -> Tensor:
    """Where canonical `points` (..., 3) lie on planes (..., 3): the box spans [-1, 1] each way."""
    focus, low, high = _ends(points)
    return 2.0 * (((points - focus) / REACH).asinh() - low) / (high - low) - 1.0


def off_planes(places: Tensor) -> Tensor:
    """The points (..., 3) of `places` (..., 3): the inverse of `on_planes`."""
    focus, low, high = _ends(places)
    return focus + REACH * (low + (places + 1.0) / 2.0 * (high - low)).sinh()


def _ends(like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The focus, and how far the ends of the box are from it once distances are shrunk."""
    focus, (low, high) = like.new_tensor(FOCUS), box(like)
    return focus, ((low - focus) / REACH).asinh(), ((high - focus) / REACH).asinh()
