"""Shading inputs of strands: pigment, its tone from lock to lock, grey hairs and dye."""

from __future__ import annotations

from typing import Any

import numpy as np

from assets_procedural.person import Hair


def colouring(
    melanin: float,
    redness: float,
    grey: np.ndarray | float,
    count: int,
    rng: np.random.Generator,
    roughness: float,
) -> dict[str, Any]:
    """Shading inputs of `count` strands.

    Grey hair is a mix of white and pigmented strands: a strand is white where its `strand_random`
    (N,) in [0, 1) is below `grey`. Where `grey` is local, (N,), the random numbers are stretched
    so that the mean share gives each place its own.
    """
    share = np.broadcast_to(np.asarray(grey, float), (count,))
    mean = float(share.mean()) if count else 0.0
    random = rng.random(count)
    white = random < share
    low = random * mean / np.maximum(share, 1e-9)
    high = mean + (random - share) * (1 - mean) / np.maximum(1 - share, 1e-9)
    return {
        "melanin": float(melanin),
        "redness": float(redness),
        "grey": mean,
        "roughness": roughness,
        "radial_roughness": 0.35,
        "strand_random": np.where(white, low, high).astype(np.float32),
    }


def toned(
    shading: dict[str, Any], hair: Hair, tone: np.ndarray, length: np.ndarray
) -> dict[str, Any]:
    """`colouring` of scalp hair with what differs between and along its strands.

    `tone` (N,) is the natural logarithm of each strand's amount of pigment, relative; `length`
    (N,) are metres. Fair long hair bleaches towards its ends.
    """
    shading = dict(shading, tone=np.exp(tone).astype(np.float32))
    worn = np.clip(length / 0.25, 0, 1) * np.clip((0.9 - hair.melanin) / 0.4, 0, 1)
    shading["bleached"] = np.clip(hair.tips + 0.35 * worn, 0, 1).astype(np.float32)
    if hair.dye is not None:
        shading["dye"] = hair.dye
        # Undyed at the root by a length of regrowth.
        shading["regrowth"] = (hair.regrowth_mm * 1e-3 / np.maximum(length, 1e-3)).astype(
            np.float32
        )
    return shading
