"""The square of a picture in which a face is fitted, as datasets frame theirs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from totalediting.faces.landmarker import Face

FILL = 0.6
"""Height of the head by the side of the square."""
# Of 165 rendered pictures: the longer side of the landmarks' box by the height of the head, and how
# far the head's middle is above the box's, in longer sides.
_SEEN, _RAISED = 0.79, 0.18
_FOREHEAD, _CHIN = 10, 152


def square_around(faces: Sequence[Face]) -> np.ndarray:
    """(3,) left, top and side in pixels of a square in which the head, typically over `faces` of
    one person, is in the middle and fills `FILL`; it may exceed the picture."""
    middles, sizes = [], []
    for face in faces:
        low, high = face.box
        up = face.landmarks[_FOREHEAD, :2] - face.landmarks[_CHIN, :2]
        up /= max(float(np.linalg.norm(up)), 1e-6)
        middles.append((low + high) / 2 + _RAISED * face.size * up)
        sizes.append(face.size)
    side = float(np.median(sizes)) / _SEEN / FILL
    return np.append(np.median(middles, axis=0) - side / 2, side)


def on_grey(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of a stored picture; what is transparent, in front of grey."""
    if picture.shape[2] == 3:
        return picture
    alpha = picture[..., 3:].astype(np.float32) / 255
    return np.rint(picture[..., :3] * alpha + 128 * (1 - alpha)).astype(np.uint8)


# Both eyes' contours (their means do not move with the gaze), nose and corners of the mouth.
_RIGHT_CONTOUR = [33, 160, 158, 133, 153, 144]
_LEFT_CONTOUR = [362, 385, 387, 263, 373, 380]
_NOSE_AND_MOUTH = [4, 61, 291]


def five_points(shares: np.ndarray) -> np.ndarray:
    """(B, 10) `Tracking.face` of landmarks (B, 478, 3) in sides of the square."""
    eyes = [shares[:, contour, :2].mean(1) for contour in (_RIGHT_CONTOUR, _LEFT_CONTOUR)]
    points = np.stack([*eyes, *shares[:, _NOSE_AND_MOUTH, :2].swapaxes(0, 1)], 1)
    return ((points - 0.5) * [1, -1]).reshape(len(points), -1)
