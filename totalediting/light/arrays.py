"""Lightmaps as numpy arrays, for programs that do not use torch themselves.

Registered as the entry point `totalediting` of the group `synthgen.lightmaps`: the page of
`synthgen browse` shades with what it finds there, so that it shows what a model learns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from totalediting.light.environments import environment_lightmaps
from totalediting.light.lightmaps import bake


def of_file(path: Path, height: int) -> np.ndarray:
    """Lightmaps (5, 3, height, 2 height) float32 of a panorama of a dataset, in its own frame.

    Raises:
        PanoramaError: the file is missing or no panorama.
    """
    return environment_lightmaps(path, height, 0.0, 1.0).numpy()


def of_pixels(pixels: np.ndarray, height: int) -> np.ndarray:
    """Lightmaps (5, 3, height, 2 height) float32 of a panorama (H, 2H, 3), linear, in its frame.

    Raises:
        ValueError: the shape or the values are no panorama's.
    """
    return bake(torch.from_numpy(pixels), height).numpy()
