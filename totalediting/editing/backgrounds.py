"""What is seen behind the person."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

from totalediting.data import frames
from totalediting.editing.lights import Panorama
from totalediting.editing.sources import read_photograph
from totalediting.editing.subject import Subject
from totalediting.editing.warping.bust import View
from totalediting.editing.warping.numbers import blurred
from totalediting.errors import InputError

WORDS = ("keep", "blur", "light")
_LARGEST = 4096  # pixels of the longer side of a picture that is put behind
_BLUR = 0.02  # of the longer side, deviation

Background = str | Path | np.ndarray
"""One of `WORDS`, a colour such as "#204080" or "teal", or a picture: file or (H, W, 3) uint8."""


def check(background: Background, lit: bool) -> None:
    """Raises `InputError` for one that cannot be; `lit`: whether there is a light to show."""
    if isinstance(background, np.ndarray) or background in ("keep", "blur"):
        return
    if background == "light":
        if not lit:
            raise InputError("--background: light: there is none; give --lighting, too")
        return
    if _colour(background) is None and Path(background).suffix.lower() not in frames.PICTURES:
        raise InputError(
            f"--background: {background}: give {', '.join(WORDS)}, a colour such as #204080 or "
            "teal, or a picture's file"
        )


def behind(
    background: Background,
    subject: Subject,
    light: Panorama | Subject | None,
    view: View,
) -> np.ndarray | None:
    """(h, w, 3) in [0, 1] in the shape of the subject's picture; None to keep its own.

    `light` is the panorama, or the photograph whose light is taken; `view` the camera of the
    subject's square.

    Raises:
        InputError: a picture that cannot be used.
    """
    height, width = subject.matte.shape
    if isinstance(background, np.ndarray):
        return _covering(background, width, height)
    if background == "keep":
        return None
    if background == "blur":
        return blurred(subject.background, _BLUR * max(height, width))
    if background == "light":
        if isinstance(light, Panorama):
            return _seen(light, subject, view)
        if light is None:
            raise InputError("a background of light takes a light; give one")
        shown = np.rint(255 * light.background).astype(np.uint8)
        return _covering(shown, width, height)
    if (colour := _colour(background)) is not None:
        return np.broadcast_to(np.array(colour) / 255, (height, width, 3))
    picture = read_photograph(Path(background)).picture
    high, wide = subject.picture.shape[:2]
    share = min(1.0, _LARGEST / max(high, wide))
    return _covering(picture, max(1, round(wide * share)), max(1, round(high * share)))


def _colour(background: Background) -> tuple[int, ...] | None:
    try:
        return ImageColor.getrgb(str(background))[:3]
    except ValueError:
        return None


def _covering(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width, 3) in [0, 1]: the middle of a picture (H, W, 3) uint8, as large as fits."""
    high, wide = picture.shape[:2]
    scale = min(wide / width, high / height)
    half = np.array([width, height]) * scale / 2
    low, top = np.array([wide, high]) / 2 - half, np.array([wide, high]) / 2 + half
    box = (max(low[0], 0), max(low[1], 0), min(top[0], wide), min(top[1], high))
    image = Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS, box=box)
    return np.asarray(image) / 255


def _seen(panorama: Panorama, subject: Subject, view: View) -> np.ndarray:
    height, width = subject.matte.shape
    scale = subject.picture.shape[1] / width
    x, y = (np.arange(width) + 0.5) * scale, (np.arange(height) + 0.5) * scale
    pixels = np.stack(np.meshgrid(x, y), -1) - subject.square[:2]
    return panorama.seen(view, pixels / subject.square[2])
