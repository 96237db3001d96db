"""Primaries and whites of linear colour spaces, and the way from them to Rec.709."""

from __future__ import annotations

import numpy as np

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""CIE xy of red, green, blue and white, as in the attribute `chromaticities`."""
_AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
_AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
_REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
_P3D65 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)
_ADOBE = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290)
SPACES = {
    "lin_rec709_scene": REC709,
    "lin_rec709": REC709,
    "lin_srgb": REC709,
    "lin_ap1_scene": _AP1,
    "acescg": _AP1,
    "lin_ap0_scene": _AP0,
    "aces2065-1": _AP0,
    "lin_rec2020_scene": _REC2020,
    "lin_p3d65_scene": _P3D65,
    "lin_adobergb_scene": _ADOBE,
}
"""Names of linear colour spaces: ids of the Color Interop Forum, and common names of the same."""
SAME = 2e-3
"""Largest difference between xy of the same primaries, as writers round them."""


def to_rec709(primaries: tuple[float, ...]) -> np.ndarray | None:
    """(3, 3) from linear RGB of primaries and white (xy) to Rec.709, by Bradford's adaptation.

    None if they span no colours. Equals `colour.matrix_RGB_to_RGB`, whose import takes a second.
    """
    xy = np.reshape(primaries, (4, 2)).astype(float)
    if not np.isfinite(xy).all() or (np.abs(xy[:, 1]) < 1e-6).any() or xy[3, 1] <= 0:
        return None
    if abs(np.linalg.det(np.c_[xy[:3], np.ones(3)])) < 1e-3:
        return None
    target = np.reshape(REC709, (4, 2))
    cones = [_BRADFORD @ _xyz(white) for white in (xy[3], target[3])]
    if min(cones[0]) <= 0:
        return None
    adapt = np.linalg.solve(_BRADFORD, np.diag(cones[1] / cones[0]) @ _BRADFORD)
    return np.linalg.solve(_rgb_to_xyz(target), adapt @ _rgb_to_xyz(xy))


_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def _rgb_to_xyz(xy: np.ndarray) -> np.ndarray:
    columns = np.stack([_xyz(colour) for colour in xy[:3]], axis=1)
    return columns * np.linalg.solve(columns, _xyz(xy[3]))


def _xyz(xy: np.ndarray) -> np.ndarray:
    """XYZ of a chromaticity at Y = 1."""
    return np.array([xy[0], xy[1], 1 - xy.sum()]) / xy[1]
