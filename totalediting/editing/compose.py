"""The whole picture again: an edited square put back, relit as a whole, before a background.

Outside the square every pixel is the photograph's own, at its own resolution. Bands of rows are
done one by one, so that large pictures take little memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from PIL import Image

from assets_procedural.conventions.colour import display, undisplay
from totalediting.editing.subject import Subject
from totalediting.editing.warping.numbers import blurred
from totalediting.editing.warping.portrait import filled_in

_BAND = 4_000_000  # pixels at once
_RIM = 0.06  # of the square's side, over which it gives way to the picture around
_MIXED, _SURE = 0.5, 0.9  # of the matte: colours are the background's too; the person's own
_HOLE = 8.0  # times the matte of the photograph, where the background is filled in
_SOFT = 256  # pixels of the longer side, in which light goes on around the square
_NOTHING = 1 / 512  # of the matte


@dataclass(frozen=True, eq=False)
class Edit:
    """What becomes of a subject's square."""

    person: np.ndarray | None
    """(S, S, 3) in [0, 1], its colours going on beyond the outline; None: as photographed."""
    matte: np.ndarray
    """(S, S)."""
    ratio: np.ndarray | None
    """(S, S, 3) of the lights; None: the light it was taken in."""


def composed(subject: Subject, edit: Edit, background: np.ndarray | None = None) -> np.ndarray:
    """(H, W, 3) uint8, the edit before a background (h, w, 3) in [0, 1] of the picture's shape.

    None is the photograph's own, filled in where the person was.
    """
    ratio = None if edit.ratio is None else _whole_ratio(subject, edit.ratio)
    return np.concatenate([_shown(rows, edit, ratio, background) for rows in _bands(subject)])


def alpha_of(subject: Subject, edit: Edit) -> np.ndarray:
    """(H, W) uint8: where the person is."""
    mattes = [rows.mixed(subject.matte, edit.matte) for rows in _bands(subject)]
    return np.rint(255 * np.concatenate(mattes)[..., 0].clip(0, 1)).astype(np.uint8)


class _Rows:
    """Some rows of a whole picture, R of them, and what lies there."""

    def __init__(self, subject: Subject, top: int, bottom: int) -> None:
        self.subject, self.top, self.bottom = subject, top, bottom
        self.height, self.width = subject.picture.shape[:2]
        left, upper, edge = subject.square
        self.x, self.y = _pixels_in(subject.square, self.width, top, bottom)
        x, y = np.arange(*self.x) + 0.5 - left, np.arange(*self.y) + 0.5 - upper
        rim = np.minimum.outer(np.minimum(y, edge - y), np.minimum(x, edge - x)) / edge
        self.share = self._laid(np.clip(rim / _RIM, 0, 1)[..., None])
        """(R, W, 1): 1 in the square, 0 off it."""

    @property
    def picture(self) -> np.ndarray:
        """(R, W, 3) in [0, 1]."""
        return self.subject.picture[self.top : self.bottom].astype(np.float32) / 255

    def whole(self, values: np.ndarray) -> np.ndarray:
        """(R, W, C) of (h, w[, C]), which is all of the picture."""
        scale = len(values) / self.height
        box = (0, self.top * scale, values.shape[1], self.bottom * scale)
        return _resized(values, (self.width, self.bottom - self.top), box)

    def within(self, values: np.ndarray) -> np.ndarray:
        """(R, W, C) of (S, S[, C]), which is the square; 0 off it."""
        (x0, x1), (y0, y1) = self.x, self.y
        if x1 <= x0 or y1 <= y0:
            return np.zeros((self.bottom - self.top, self.width, 1), np.float32)
        return self._laid(_part_of_square(values, self.subject.square, self.x, self.y))

    def mixed(self, whole: np.ndarray, within: np.ndarray) -> np.ndarray:
        """(R, W, C): one in the square, the other around it."""
        around = self.whole(whole)
        return around + self.share * (self.within(within) - around)

    def _laid(self, values: np.ndarray) -> np.ndarray:
        laid = np.zeros((self.bottom - self.top, self.width, values.shape[-1]), np.float32)
        laid[self.y[0] - self.top : self.y[1] - self.top, slice(*self.x)] = values
        return laid


def _bands(subject: Subject) -> Iterator[_Rows]:
    height, width = subject.picture.shape[:2]
    step = max(1, _BAND // width)
    for top in range(0, height, step):
        yield _Rows(subject, top, min(top + step, height))


def _shown(
    rows: _Rows, edit: Edit, ratio: np.ndarray | None, background: np.ndarray | None
) -> np.ndarray:
    """(R, W, 3) uint8."""
    subject, picture = rows.subject, rows.picture
    portrait = subject.portrait
    matte = rows.mixed(subject.matte, edit.matte).clip(0, 1)
    behind = person = picture
    if background is not None:
        # At the outline the person's colours are mixed with those of what was behind.
        own = rows.mixed(subject.matte, portrait.matte)
        own = ((own - _MIXED) / (_SURE - _MIXED)).clip(0, 1)
        person = own * picture + (1 - own) * rows.mixed(subject.person, portrait.person)
        behind = rows.whole(background)
    if edit.person is not None:
        person = person + rows.share * (rows.within(edit.person) - person)
        if background is None:
            hole = rows.share * (_HOLE * rows.within(portrait.matte)).clip(0, 1)
            behind = picture + hole * (rows.within(portrait.background) - picture)
    if ratio is not None and edit.ratio is not None:
        on = matte[..., 0] > _NOTHING
        lit = undisplay(person[on].clip(0, 1)) * rows.mixed(ratio, edit.ratio)[on]
        person = person.copy()
        person[on] = display(lit)
    shown = matte * person + (1 - matte) * behind
    return np.rint(255 * shown.clip(0, 1)).astype(np.uint8)


def _whole_ratio(subject: Subject, ratio: np.ndarray) -> np.ndarray:
    """(h, w, 3) the ratio (S, S, 3) of the square, going on softly around it; coarse."""
    high, wide = subject.picture.shape[:2]
    scale = min(1.0, _SOFT / max(high, wide))
    height, width = max(1, round(high * scale)), max(1, round(wide * scale))
    square = subject.square * (width / wide)
    x, y = _pixels_in(square, width, 0, height)
    known, laid = np.zeros((height, width), bool), np.ones((height, width, 3))
    if x[1] <= x[0] or y[1] <= y[0]:
        return laid
    inside = slice(*y), slice(*x)
    laid[inside] = _part_of_square(ratio, square, x, y)
    known[inside] = True
    return blurred(filled_in(laid, known), square[2] / 16)


def _pixels_in(
    square: np.ndarray, width: int, top: int, bottom: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Columns and rows, each from and to, of pixels that lie in a square (3,) as wholes, within
    rows from `top` to `bottom`."""
    left, upper, edge = square
    columns = max(int(np.ceil(left)), 0), min(int(left + edge), width)
    return columns, (max(int(np.ceil(upper)), top), max(min(int(upper + edge), bottom), top))


def _part_of_square(
    values: np.ndarray, square: np.ndarray, x: tuple[int, int], y: tuple[int, int]
) -> np.ndarray:
    """The columns `x` and rows `y` of a picture, out of (S, S[, C]), which is a square of it."""
    scale = len(values) / square[2]
    left, right = (float((column - square[0]) * scale) for column in x)
    top, bottom = (float((row - square[1]) * scale) for row in y)
    return _resized(values, (x[1] - x[0], y[1] - y[0]), (left, top, right, bottom))


def _resized(
    values: np.ndarray, size: tuple[int, int], box: tuple[float, float, float, float]
) -> np.ndarray:
    """(H, W, C) float32 of a box of (h, w[, C]), to a width and height."""
    planes = values[..., None] if values.ndim == 2 else values
    high, wide = planes.shape[:2]
    box = (max(box[0], 0.0), max(box[1], 0.0), min(box[2], wide), min(box[3], high))
    images = [Image.fromarray(planes[..., k].astype(np.float32)) for k in range(planes.shape[-1])]
    done = [np.asarray(one.resize(size, Image.Resampling.BICUBIC, box=box)) for one in images]
    return np.stack(done, -1)
