"""Pinhole cameras: resolving against a head, projection, axis conventions.

World: metres, Z up, the head looks along -Y, its left is +X. `camera_to_world` is 4x4 with OpenGL
axes (x right, y up, the camera looks along -z), as nerfstudio. Image: pixels, x right, y down,
(0, 0) is the upper left corner of the upper left pixel, whose centre is (0.5, 0.5).
`intrinsics` is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels. Depth is planar, along the viewing
axis, positive in front. P = number of points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from assets_procedural.settings import Parameters

SENSOR_MM = 36.0
"""Width and height of the square sensor that focal lengths refer to."""
LANDMARK_MARGIN = 0.25
"""Landmarks stay inside the frame enlarged by this share of it on every side."""


class CameraSample(Parameters):
    """Where a camera stands relative to a head that is not known yet. Angles in radians.

    `yaw`: 0 in front, positive towards the subject's left. `pitch`: positive looks from above.
    `roll`: of the camera about its viewing axis, positive counter-clockwise as the photographer
    sees it. `fill`: head height / frame height. `shift`: where the head's centre appears, as a
    share of the frame from its middle, (right, up).
    """

    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    focal_mm: float = 85.0
    fill: float = 0.5
    shift: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Camera:
    """A resolved camera: `camera_to_world` (4, 4), `intrinsics` (3, 3), size in pixels."""

    camera_to_world: np.ndarray
    intrinsics: np.ndarray
    width: int
    height: int

    @property
    def position(self) -> np.ndarray:
        """(3,) metres, world."""
        return self.camera_to_world[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """(3,) unit viewing direction, world."""
        return -self.camera_to_world[:3, 2]

    @property
    def focal_mm(self) -> float:
        """Focal length on a sensor `SENSOR_MM` wide."""
        return float(self.intrinsics[0, 0]) / self.width * SENSOR_MM

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (..., 3) to pixels (..., 2) and depths (...) in metres.

        Points at or behind the camera get a depth <= 0 and meaningless, but finite, pixels.
        """
        _check(points, 3, "points")
        local = (points - self.position) @ self.camera_to_world[:3, :3]
        depth = -local[..., 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        fx, fy = self.intrinsics[0, 0], self.intrinsics[1, 1]
        cx, cy = self.intrinsics[0, 2], self.intrinsics[1, 2]
        pixels = np.stack([cx + fx * local[..., 0] / safe, cy - fy * local[..., 1] / safe], axis=-1)
        return pixels, depth

    def unproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) and planar depths (...) in metres to world points (..., 3)."""
        _check(pixels, 2, "pixels")
        fx, fy = self.intrinsics[0, 0], self.intrinsics[1, 1]
        cx, cy = self.intrinsics[0, 2], self.intrinsics[1, 2]
        depth = np.asarray(depth, dtype=np.float64)
        local = np.stack(
            [
                (pixels[..., 0] - cx) / fx * depth,
                (cy - pixels[..., 1]) / fy * depth,
                -depth,
            ],
            axis=-1,
        )
        return local @ self.camera_to_world[:3, :3].T + self.position

    def pixel_centres(self) -> np.ndarray:
        """(height, width, 2) pixel coordinates of all pixel centres."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([x, y], axis=-1)


def resolve(
    sample: CameraSample, head_centre: np.ndarray, head_height: float, resolution: int
) -> Camera:
    """Put a sampled camera in front of a head.

    `head_centre` (3,) and `head_height` are in metres. The distance is such that the head's height
    at its centre's depth fills `sample.fill` of the frame. `shift` moves the camera sideways, so
    the principal point stays in the middle of the picture.
    """
    head_centre = np.asarray(head_centre, dtype=np.float64)
    _check(head_centre, 3, "head_centre")
    if head_height <= 0.0:
        raise ValueError(f"head_height must be positive, got {head_height}")
    away = np.array(
        [
            math.sin(sample.yaw) * math.cos(sample.pitch),
            -math.cos(sample.yaw) * math.cos(sample.pitch),
            math.sin(sample.pitch),
        ]
    )
    right = np.array([math.cos(sample.yaw), math.sin(sample.yaw), 0.0])
    up = np.cross(away, right)
    cos, sin = math.cos(sample.roll), math.sin(sample.roll)
    right, up = cos * right + sin * up, cos * up - sin * right
    frame = head_height / sample.fill
    distance = sample.focal_mm / SENSOR_MM * frame
    position = (
        head_centre
        + distance * away
        - sample.shift[0] * frame * right
        - sample.shift[1] * frame * up
    )
    camera_to_world = np.eye(4)
    camera_to_world[:3] = np.stack([right, up, away, position], axis=1)
    focal = sample.focal_mm / SENSOR_MM * resolution
    middle = resolution / 2.0
    intrinsics = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    return Camera(camera_to_world, intrinsics, resolution, resolution)


def nerfstudio_frame(camera: Camera) -> dict[str, object]:
    """The camera's entries of a frame in nerfstudio's `transforms.json`."""
    k = camera.intrinsics
    return {
        "fl_x": float(k[0, 0]),
        "fl_y": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        "w": camera.width,
        "h": camera.height,
        "transform_matrix": camera.camera_to_world.tolist(),
    }


def _check(array: np.ndarray, last: int, name: str) -> None:
    if np.shape(array)[-1:] != (last,):
        raise ValueError(f"{name} must be (..., {last}), got {np.shape(array)}")
