"""Axes and angles of cameras about a head, and a first guess of them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def camera_axes(angles: np.ndarray) -> np.ndarray:
    """(B, 3, 3) columns right, up and away of cameras' yaw, pitch, roll (B, 3)."""
    # The camera at rest looks along +Y: right is X, up is Z, away is -Y.
    still = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    yaw, pitch, roll = angles.T
    turned = Rotation.from_euler("ZXY", np.stack([yaw, -pitch, -roll], 1)).as_matrix()
    return turned @ still


def camera_angles(axes: np.ndarray) -> np.ndarray:
    """(3,) yaw, pitch, roll of a camera with these axes (3, 3)."""
    right, _, away = axes.T
    yaw, pitch = np.arctan2(away[0], -away[1]), np.arcsin(np.clip(away[2], -1, 1))
    level = np.array([np.cos(yaw), np.sin(yaw), 0])
    return np.array([yaw, pitch, np.arctan2(right @ np.cross(away, level), right @ level)])


def similarity(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Rotation (3, 3), scale and shift (3,) from points (N, 3) to those seen (Umeyama 1991)."""
    middle, centre = points.mean(0), seen.mean(0)
    left, sizes, right = np.linalg.svd((seen - centre).T @ (points - middle))
    sign = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
    rotation = (left * sign) @ right
    scale = float((sizes * sign).sum() / ((points - middle) ** 2).sum())
    return rotation, scale, centre - scale * rotation @ middle
