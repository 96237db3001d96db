"""The matte of people in photographs: Google's selfie segmentation, run by LiteRT."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from totalediting.faces.litert import interpreter_of, run
from totalediting.pretrained.fetch import describe, fetch

_SIDE = 256


class Matting:
    """The network, on one CPU thread; `description` names it for reports."""

    def __init__(self, path: Path | str | None = None) -> None:
        """Fetches the network on first use, or reads the local `.tflite` file `path`.

        Raises:
            InputError: the package `ai-edge-litert` is not installed.
            NetworkError: the network cannot be had.
        """
        self.description = describe("selfie", path)
        self._network = interpreter_of(fetch("selfie", path).read_bytes())

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """(S, S) in [0, 1], where people are in a square picture (S, S, 3) uint8."""
        side = len(picture)
        small = Image.fromarray(picture).resize((_SIDE, _SIDE), Image.Resampling.BOX)
        matte = run(self._network, np.asarray(small, np.float32) / 255)[1, _SIDE, _SIDE, 1]
        large = Image.fromarray(matte[0, ..., 0]).resize((side, side), Image.Resampling.BICUBIC)
        # A pixel of the network is several of the picture.
        return gaussian_filter(np.asarray(large, np.float64), side / _SIDE / 2).clip(0, 1)
