"""Faces of a picture: Google's face landmarker, run by LiteRT without MediaPipe.

Three networks in one file (`face_landmarker.task`, Apache-2.0): BlazeFace finds faces in the
picture at 128 x 128 (Bazarevsky et al. 2019), the face mesh reads 478 landmarks, irises included,
from each face laid straight at 256 x 256 (Kartynnik et al. 2019; Grishchenko et al. 2020), and a
third one gives 52 blendshapes from 146 of these. How they are joined is that of MediaPipe's
`FaceLandmarker`: its anchors, weighted suppression, and squares 1.5 times as large as the face.

Pixel coordinates: x right, y down, the centre of the upper left pixel at (0.5, 0.5). Left and right
are the subject's. Needs the package `ai-edge-litert` (extra `edit`).
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image
from torch.nn import functional

from assets_procedural.motion.poses import ARKIT_NAMES
from totalediting.faces.litert import interpreter_of, run
from totalediting.pretrained.fetch import NetworkError, describe, fetch

LANDMARKS = 478
RIGHT_IRIS, LEFT_IRIS = range(468, 473), range(473, 478)
"""Centre, then four points around it."""
RIGHT_EYE, LEFT_EYE = 33, 263
"""Outer corners, whose line is level in a face laid straight."""
_DETECTOR_SIDE, _MESH_SIDE = 128, 256
_ANCHOR_GRIDS = ((16, 2), (8, 6))  # cells along a side, anchors of each
_FOUND = 0.5  # scores of a detection and of a face's presence, MediaPipe's own
_SAME = 0.3  # share of two boxes' union from which they are one face
_COARSE = 4  # pixels of the picture for one that a network sees, beyond which it is reduced
_MARGIN = 1.5  # sides of the square that a network sees, in sides of the face's box
# Of the landmarks, those that the blendshapes are read from, in the network's order.
_BLENDSHAPE_LANDMARKS = np.array(
    [
        *(0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63),
        *(65, 66, 67, 70, 78, 80, 81, 82, 84, 87, 88, 91, 93, 95, 103, 105, 107, 109, 127, 132),
        *(133, 136, 144, 145, 146, 148, 149, 150, 152, 153, 154, 155, 157, 158, 159, 160, 161),
        *(162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251, 263),
        *(267, 269, 270, 276, 282, 283, 284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310),
        *(311, 312, 314, 317, 318, 321, 323, 324, 332, 334, 336, 338, 356, 361, 362, 365, 373),
        *(374, 375, 377, 378, 379, 380, 381, 382, 384, 385, 386, 387, 388, 389, 390, 397, 398),
        *(400, 402, 405, 409, 415, 454, 466, *range(468, 478)),
    ]
)
assert len(_BLENDSHAPE_LANDMARKS) == 146


@dataclass(frozen=True, eq=False)
class Face:
    """A face found in a picture."""

    landmarks: np.ndarray
    """(478, 3) pixels; depth z in pixels too, smaller towards the camera."""
    blendshapes: np.ndarray
    """(52,) in [0, 1], in the order of `ARKIT_NAMES`; tongueOut, which is not read, is 0."""
    confidence: float
    """Probability that there is a face."""

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Upper left and lower right corner (2,) of the landmarks' box."""
        return self.landmarks[:, :2].min(0), self.landmarks[:, :2].max(0)

    @property
    def size(self) -> float:
        """Longer side of the box, pixels."""
        low, high = self.box
        return float((high - low).max())


class _Square(NamedTuple):
    """A square of the picture, turned: its centre (2,), side, and angle, clockwise in radians."""

    centre: np.ndarray
    side: float
    angle: float

    @property
    def axes(self) -> np.ndarray:
        """(2, 2) columns: the square's right and down in the picture."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return np.array([[cos, -sin], [sin, cos]])


class Landmarker:
    """The three networks, on one CPU thread; `description` names them for reports."""

    def __init__(self, path: Path | str | None = None) -> None:
        """Fetches the networks on first use, or reads the local `.task` file `path`.

        Raises:
            InputError: the package `ai-edge-litert` is not installed.
            NetworkError: the networks cannot be had, or the file holds others.
        """
        self.description = describe("face_landmarker", path)
        file = fetch("face_landmarker", path)
        names = ("face_detector", "face_landmarks_detector", "face_blendshapes")
        try:
            with zipfile.ZipFile(file) as bundle:
                contents = [bundle.read(f"{name}.tflite") for name in names]
        except (zipfile.BadZipFile, KeyError) as error:
            raise NetworkError(f"{file}: not Google's face landmarker: {error}") from None
        self._detector, self._mesh, self._blendshapes = map(interpreter_of, contents)
        self._anchors = np.array(
            [
                ((x + 0.5) / cells, (y + 0.5) / cells)
                for cells, count in _ANCHOR_GRIDS
                for y, x in product(range(cells), range(cells))
                for _ in range(count)
            ]
        )

    def find(self, picture: np.ndarray) -> list[Face]:
        """All faces of a picture (H, W, 3) uint8, the largest first.

        Faces below an eighth of the picture are looked for where there is no larger one.

        Raises:
            ValueError: another shape or type.
        """
        _check(picture)
        for squares in _searched(picture.shape[1], picture.shape[0]):
            starts = [start for square in squares for start in self._detect(picture, square)]
            faces = [self._read(picture, start) for start in starts]
            if kept := _distinct([face for face in faces if face is not None]):
                return kept
        return []

    def follow(self, picture: np.ndarray, last: Face) -> Face | None:
        """The face that was at `last` a moment ago; None where there is none any more.

        Raises:
            ValueError: another shape or type.
        """
        _check(picture)
        return self._read(picture, _around(last))

    def _detect(self, picture: np.ndarray, square: _Square) -> list[_Square]:
        """Squares around the faces that the detector finds in a part of the picture."""
        seen = _laid(picture, square, _DETECTOR_SIDE, "zeros")
        outputs = run(self._detector, 2.0 * seen - 1.0)
        boxes, logits = outputs[1, 896, 16][0], outputs[1, 896, 1][0]
        scores = 1.0 / (1.0 + np.exp(-logits[:, 0].astype(np.float64).clip(-100, 100)))
        kept = np.flatnonzero(scores > _FOUND)
        points = boxes[kept].reshape(-1, 8, 2) / _DETECTOR_SIDE
        points[:, [0, *range(2, 8)]] += self._anchors[kept, None]  # not the box's extent
        found = []
        for centre, extent, right_eye, left_eye in _suppressed(points, scores[kept])[:, :4]:
            angle = float(np.arctan2(*(left_eye - right_eye)[::-1]))
            middle = (centre - 0.5) * square.side + square.centre
            found.append(_Square(middle, _MARGIN * square.side * float(extent.max()), angle))
        return found

    def _read(self, picture: np.ndarray, square: _Square) -> Face | None:
        """The face in a square; None where the network says that there is none."""
        outputs = run(self._mesh, _laid(picture, square, _MESH_SIDE, "border"))
        presence = 1.0 / (1.0 + np.exp(-float(outputs[1, 1, 1, 1].item())))
        if not presence > _FOUND:
            return None
        points = (
            outputs[1, 1, 1, LANDMARKS * 3].reshape(LANDMARKS, 3).astype(np.float64) / _MESH_SIDE
        )
        flat = (points[:, :2] - 0.5) @ square.axes.T * square.side + square.centre
        scores = run(self._blendshapes, flat[_BLENDSHAPE_LANDMARKS])[52,]
        # MediaPipe's names are `_neutral`, then ARKit's in our order, which ends with tongueOut.
        blendshapes = np.zeros(len(ARKIT_NAMES), np.float32)
        blendshapes[:51] = scores[1:]
        landmarks = np.concatenate([flat, points[:, 2:] * square.side], 1)
        return Face(landmarks.astype(np.float32), blendshapes, presence)


def _check(picture: np.ndarray) -> None:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise ValueError(f"a picture is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")


def _searched(width: int, height: int) -> list[list[_Square]]:
    """Squares to look for faces in, in rounds: all of the picture, then halves of it, likewise."""
    longer = max(width, height)
    rounds = []
    for share in (1, 2, 4):
        side = longer / share
        centres = [
            [size / 2] if size <= side else np.linspace(side / 2, size - side / 2, 2 * share - 1)
            for size in (width, height)
        ]
        rounds.append([_Square(np.array(c), side, 0.0) for c in product(*centres)])
    return rounds


def _laid(picture: np.ndarray, square: _Square, side: int, beyond: str) -> np.ndarray:
    """(side, side, 3) in [0, 1]: a square of the picture, bilinear; `beyond` it, as torch pads.

    As in MediaPipe, a pixel of it is the picture's where its upper left corner lies, half a pixel
    off.
    A square many times larger than `side` is taken from the picture made smaller first.
    """
    reach = square.side * (abs(np.cos(square.angle)) + abs(np.sin(square.angle))) / 2 + 2
    low = np.clip(np.floor(square.centre - reach), 0, None).astype(int)
    low = np.minimum(low, [picture.shape[1] - 1, picture.shape[0] - 1])
    high = np.maximum(np.ceil(square.centre + reach).astype(int), low + 1)
    part = picture[low[1] : high[1], low[0] : high[0]]
    factor = max(1, int(square.side / side / _COARSE))
    part = np.array(Image.fromarray(part).reduce(factor))
    ticks = np.arange(side) / side - 0.5
    own = np.stack(np.meshgrid(ticks, ticks), -1)
    places = (own @ square.axes.T * square.side + square.centre + 0.5 - low) / factor
    grid = 2 * places / [part.shape[1], part.shape[0]] - 1
    pixels = torch.from_numpy(part).permute(2, 0, 1)[None].float()
    laid = functional.grid_sample(
        pixels, torch.from_numpy(grid)[None].float(), padding_mode=beyond, align_corners=False
    )
    return laid[0].permute(1, 2, 0).numpy() / 255.0


def _around(face: Face) -> _Square:
    """The square that the mesh reads a face from again: level with its eyes, around its box."""
    points = face.landmarks[:, :2].astype(np.float64)
    angle = float(np.arctan2(*(points[LEFT_EYE] - points[RIGHT_EYE])[::-1]))
    axes = _Square(np.zeros(2), 0.0, angle).axes
    own = points @ axes
    low, high = own.min(0), own.max(0)
    return _Square(axes @ (low + high) / 2, _MARGIN * float((high - low).max()), angle)


def _suppressed(points: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """(F, 8, 2) detections, those of one face averaged by their scores.

    `points` (N, 8, 2): a box's centre and extent, then points of the face.
    """
    order = np.argsort(-scores, kind="stable")
    points, scores = points[order], scores[order]
    low, high = points[:, 0] - points[:, 1] / 2, points[:, 0] + points[:, 1] / 2
    left = np.ones(len(points), bool)
    found = []
    while left.any():
        best = int(np.argmax(left))
        same = left & (_overlap(low[best], high[best], low, high) > _SAME)
        same[best] = True
        found.append(np.average(points[same], axis=0, weights=scores[same]))
        left &= ~same
    return np.array(found).reshape(-1, 8, 2)


def _distinct(faces: list[Face]) -> list[Face]:
    """Faces in the order of their size, each once."""
    kept: list[Face] = []
    for face in sorted(faces, key=lambda face: -face.size):
        boxes = [np.stack(other.box) for other in kept]
        lows, highs = (np.array([box[k] for box in boxes]).reshape(-1, 2) for k in (0, 1))
        if not (_overlap(*face.box, lows, highs) > _SAME).any():
            kept.append(face)
    return kept


def _overlap(low: np.ndarray, high: np.ndarray, lows: np.ndarray, highs: np.ndarray) -> np.ndarray:
    """(N,) area that a box (2,), (2,) shares with each of N boxes, by that of their union."""
    shared = np.clip(np.minimum(high, highs) - np.maximum(low, lows), 0, None).prod(-1)
    return shared / ((high - low).prod() + (highs - lows).prod(-1) - shared)
