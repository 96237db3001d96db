"""What the warp's steps calculate with."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter
from torch.nn import functional


def smooth(values: Any, low: float, high: float) -> Any:
    """0 below `low`, 1 above `high`, smoothly between."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)


def unit(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) of length 1; 0 stays 0."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def pixels(side: int) -> np.ndarray:
    """(S, S, 2) centres of pixels, x right and y down."""
    ticks = np.arange(side) + 0.5
    return np.stack(np.meshgrid(ticks, ticks), -1)


def blurred(values: np.ndarray, width: float) -> np.ndarray:
    """(H, W, C) under a Gaussian of deviation `width` in pixels; wide ones on a coarser grid."""
    coarse = max(1, int(width / 3))
    planes = [Image.fromarray(values[..., k].astype(np.float32)) for k in range(values.shape[-1])]
    small = [np.asarray(plane.reduce(coarse)) for plane in planes]
    soft = [gaussian_filter(plane, width / coarse, mode="nearest") for plane in small]
    if coarse == 1:
        return np.stack(soft, -1)
    # The last blocks may reach over the edge.
    high, wide = (size / coarse for size in values.shape[:2])
    size = (values.shape[1], values.shape[0])
    large = [
        Image.fromarray(plane).resize(size, Image.Resampling.BICUBIC, box=(0, 0, wide, high))
        for plane in soft
    ]
    return np.stack([np.asarray(plane) for plane in large], -1)


def sampled(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(S, S, C) in [0, 1] of a picture (S, S, C) at places (S, S, 2), bicubic; its border goes
    on."""
    grid = torch.from_numpy(2 * places / len(picture) - 1)[None].float()
    planes = torch.from_numpy(picture).permute(2, 0, 1)[None].float()
    found = functional.grid_sample(
        planes, grid, mode="bicubic", padding_mode="border", align_corners=False
    )
    return found[0].permute(1, 2, 0).double().numpy().clip(0, 1)
