"""Lightmaps of a dataset's panoramas: each is baked once per machine, then turned for every sample.

A panorama's maps are baked in its own frame at `ROWS` rows, and kept in memory and in the cache
folder under the sha256 of the panorama's file. `lightmaps.bake` into another frame goes by the same
`ROWS`, so that turning what is kept gives the very maps that baking for the sample would give.
Frames and scales are those of `totalediting.light.lightmaps`; h = rows of the maps asked for.
"""

from __future__ import annotations

import contextlib
import math
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from assets_procedural.conventions import panorama_reading
from assets_procedural.conventions.files import cache_folder, replacing, sha256
from totalediting.light import lightmaps

ROWS = 128
"""Rows of the maps that are kept: twice what the sharpest lobe needs, 2 MB a panorama."""
_FORMAT = 1  # of the files in the cache folder; to be raised when `bake` changes its numbers


def environment_lightmaps(
    path: Path, height: int, angle: float, exposure: float, frame: Tensor | None = None
) -> Tensor:
    """Normalised lightmaps (5, 3, height, 2 height) of a panorama as a shot was lit by it, float32.

    `angle` (radians) is the environment's rotation about +Z, `exposure` the linear factor of the
    picture: what is shaded with these maps needs only the display transform. `frame` (3, 3) takes
    directions of the frame wanted to the world's, as `camera_to_world[:3, :3]`; without it the
    maps are in world axes.

    Raises:
        PanoramaError: the file is missing or no panorama.
    """
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = torch.tensor([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    if frame is not None:
        rotation = rotation @ frame.to(rotation)
    return lightmaps.rotate(baked(Path(path)), rotation, height) * exposure


@lru_cache(maxsize=64)
def baked(path: Path) -> Tensor:
    """The lightmaps (5, 3, ROWS, 2 ROWS) of a panorama in its own frame; not to be changed.

    Raises:
        PanoramaError: the file is missing or no panorama.
    """
    if not path.is_file():
        raise panorama_reading.PanoramaError(f"{path}: no such panorama; restore it")
    kept = cache_folder() / "lightmaps" / f"{_digest(path)}-{ROWS}-v{_FORMAT}.npy"
    # A file that is missing, foreign or damaged is made again.
    with contextlib.suppress(OSError, ValueError):
        maps = np.load(kept, allow_pickle=False)
        if maps.shape == (len(lightmaps.LOBES), 3, ROWS, 2 * ROWS) and maps.dtype == np.float32:
            return torch.from_numpy(maps)
    maps = lightmaps.bake(torch.from_numpy(panorama_reading.load(path)), ROWS)
    # Without a disk for it, memory has to do.
    with contextlib.suppress(OSError), replacing(kept) as file:
        np.save(file, maps.numpy())
    return maps


_digest = cache(sha256)
