"""An editor whose faces are known: neither networks nor LiteRT are needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from synthetic_faces import a_tracking

from totalediting.data import frames
from totalediting.editing.editor import Editor
from totalediting.faces.table import FitTable, joined
from totalediting.geometry.tracking import Tracking

NOBODY, TWO, TINY = 0, 200, 201
"""Of the first pixel's red: no face, two, one of few pixels; else the number of a tracking."""


class KnownTracker:
    """Finds in a picture the face that its first pixel numbers, in its middle."""

    def __init__(self) -> None:
        drawn = a_tracking(np.random.default_rng(3), 3)
        still = torch.zeros(3, 1)
        self.tracking = drawn._replace(
            head=drawn.head * torch.tensor([[0.0], [2.0], [3.0]]),
            camera_yaw_pitch_roll=0 * drawn.camera_yaw_pitch_roll,
            expression=drawn.expression * torch.tensor([[0.0], [1.0], [1.0]]),
            gaze=drawn.gaze * still,
        )
        self.looked = 0

    def pictures(self, pictures: Iterator[tuple[str, int, np.ndarray]], whole: bool) -> FitTable:
        del whole
        tables = [self._row(*one) for one in pictures]
        return joined([table for table in tables if table is not None])

    def video(self, source: str, path: Path, done: Callable[[int], None]) -> FitTable:
        tables = []
        for number, (_, picture) in enumerate(frames.play_video(path, frames.index_video(path))):
            tables.append(self._row(source, number, picture))
            done(number + 1)
        return joined([table for table in tables if table is not None])

    def _row(self, source: str, frame: int, picture: np.ndarray) -> FitTable | None:
        self.looked += 1
        number = int(picture[0, 0, 0])
        if number < 8:  # as videos and JPEG have it
            return None
        height, width = picture.shape[:2]
        side = 20.0 if number == TINY else 0.7 * min(height, width)
        square = np.array([[(width - side) / 2, (height - side) / 2, side]])
        which = number % 3
        return FitTable(
            [source],
            np.array([frame]),
            np.array([2 if number == TWO else 1]),
            np.zeros(1),
            np.ones(1),
            np.zeros(1),
            square,
            Tracking(*(field[which : which + 1] for field in self.tracking)),
            np.zeros((1, 52)),
        )


def matting(picture: np.ndarray) -> np.ndarray:
    """(S, S): what is redder than it is blue."""
    return np.clip((picture[..., 0].astype(float) - picture[..., 2]) / 40, 0, 1)


def an_editor() -> Editor:
    """With both of these."""
    return Editor(KnownTracker(), matting)  # pyright: ignore[reportArgumentType]


def a_portrait(number: int = 9, width: int = 160, height: int = 120) -> np.ndarray:
    """(H, W, 3) uint8 of a brown disc on a patterned blue wall; tracking `number` % 3."""
    y, x = np.mgrid[:height, :width]
    wall = 60 + 40 * ((x // 8 + y // 8) % 2)
    picture = np.stack([wall // 4, wall // 2, wall + 80], -1)
    away = np.hypot(x - width / 2, y - height / 2)
    skin = np.stack([190 - 40 * (x > width / 2), 140 - 30 * (x > width / 2), 110 + 0 * x], -1)
    picture[away < 0.35 * height] = skin[away < 0.35 * height]
    picture[0, 0] = number
    return picture.astype(np.uint8)


def save(path: Path, picture: np.ndarray) -> Path:
    """A picture's file."""
    Image.fromarray(picture).save(path)
    return path
