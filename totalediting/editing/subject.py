"""A photograph whose person is edited: the square that is worked on, and the picture around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from PIL import Image

from assets_procedural.conventions.colour import undisplay
from totalediting.editing.sources import Found, Photograph
from totalediting.editing.warping import relight
from totalediting.editing.warping.bust import View, bust_of, view_of
from totalediting.editing.warping.portrait import BACKGROUND, PERSON, Portrait, filled_in
from totalediting.geometry.tracking import Tracking

WIDER = 1.3
"""Sides of the worked square, in those of the fitted one."""
_SIDES = (384, 1024)  # pixels that are worked on
_COARSE = 768  # pixels of the longer side, in which what is around the square is worked out

Matting = Callable[[np.ndarray], np.ndarray]
"""From a square picture (S, S, 3) uint8 to where people are (S, S)."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A photograph with the square that is worked on."""

    picture: np.ndarray
    """(H, W, 3) uint8, whole."""
    square: np.ndarray
    """(3,) left, top and side, pixels of the picture."""
    tracking: Tracking
    portrait: Portrait
    """Of the square."""
    matte: np.ndarray
    """(h, w) of the whole picture, coarse."""
    notes: tuple[str, ...] = ()
    """What the user should know, in lines."""

    @cached_property
    def coarse(self) -> np.ndarray:
        """(h, w, 3) in [0, 1]: the picture, as coarse as its matte."""
        height, width = self.matte.shape
        image = Image.fromarray(self.picture).resize((width, height), Image.Resampling.BOX)
        return np.asarray(image) / 255

    @cached_property
    def person(self) -> np.ndarray:
        """(h, w, 3) colours of the person alone, going on beyond the outline."""
        return filled_in(self.coarse, self.matte > PERSON)

    @cached_property
    def background(self) -> np.ndarray:
        """(h, w, 3) the picture without the person; there, what is around."""
        return filled_in(self.coarse, self.matte < BACKGROUND)

    @cached_property
    def light(self) -> relight.Levelled:
        """The light that it was taken in."""
        portrait = self.portrait
        light = relight.light_of(portrait, undisplay(portrait.picture))
        return relight.Levelled(light, self.face_normals)

    @cached_property
    def face_normals(self) -> np.ndarray:
        """(N, 3) of the bust that is seen."""
        return self.portrait.normals[self.portrait.raster.covered]

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) of the camera in model space."""
        return self.portrait.view.frame[:3, :3]


def subject_of(photograph: Photograph, found: Found, matting: Matting) -> Subject:
    """Of a photograph and its face."""
    picture, fitted = photograph.picture, found.square
    square = np.append(fitted[:2] - (WIDER - 1) / 2 * fitted[2], WIDER * fitted[2])
    side = int(np.clip(round(square[2]), *_SIDES))
    view = view_of(found.tracking)
    cut = cut_out(picture, square, side)
    if photograph.matte is None:
        matte, whole = matting(cut), _whole_matte(picture, matting)
    else:
        known = np.repeat(np.rint(255 * photograph.matte[..., None]).astype(np.uint8), 3, -1)
        matte = cut_out(known, square, side)[..., 0] / 255
        size = _coarse_size(picture)
        whole = np.asarray(Image.fromarray(known).resize(size, Image.Resampling.BOX))[..., 0] / 255
    portrait = Portrait(
        cut / 255, matte, bust_of(found.tracking), View(view.frame, view.focal / WIDER)
    )
    return Subject(picture, square, found.tracking, portrait, whole, tuple(found.notes))


def cut_out(picture: np.ndarray, square: np.ndarray, side: int) -> np.ndarray:
    """(side, side, 3) uint8: a square of a picture, whose border goes on beyond it."""
    left, top, edge = square
    height, width = picture.shape[:2]
    x0, y0 = int(np.floor(left)) - 2, int(np.floor(top)) - 2
    x1, y1 = int(np.ceil(left + edge)) + 2, int(np.ceil(top + edge)) + 2
    within = picture[
        min(max(y0, 0), height - 1) : max(min(y1, height), 1),
        min(max(x0, 0), width - 1) : max(min(x1, width), 1),
    ]
    beyond = ((max(-y0, 0), max(y1 - height, 0)), (max(-x0, 0), max(x1 - width, 0)), (0, 0))
    part = np.pad(within, beyond, "edge")
    box = (left - x0, top - y0, left - x0 + edge, top - y0 + edge)
    image = Image.fromarray(part).resize((side, side), Image.Resampling.BICUBIC, box=box)
    return np.asarray(image)


def _coarse_size(picture: np.ndarray) -> tuple[int, int]:
    """Width and height."""
    height, width = picture.shape[:2]
    share = min(1.0, _COARSE / max(height, width))
    return max(1, round(width * share)), max(1, round(height * share))


def _whole_matte(picture: np.ndarray, matting: Matting) -> np.ndarray:
    """(h, w) of a whole picture, which the network sees in the middle of a square."""
    width, height = _coarse_size(picture)
    small = Image.fromarray(picture).resize((width, height), Image.Resampling.BOX)
    side = max(width, height)
    left, top = (side - width) // 2, (side - height) // 2
    margin = ((top, side - height - top), (left, side - width - left), (0, 0))
    seen = matting(np.pad(np.asarray(small), margin, "edge"))
    return seen[top : top + height, left : left + width]
