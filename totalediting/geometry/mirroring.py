"""Labels in a mirror: x of directions changes sign, left and right change places."""

from __future__ import annotations

import torch
from torch import Tensor

from assets_procedural.motion.poses import ARKIT_NAMES


def mirrored_code(code: Tensor) -> Tensor:
    """e (..., 54) of the mirrored face."""
    count = len(ARKIT_NAMES)
    gaze = code[..., count:] * MIRROR[:2].to(code)
    return torch.cat([code[..., :count][..., EXPRESSIONS], gaze], -1)


def mirrored_lightmaps(maps: Tensor) -> Tensor:
    """Maps (..., H, 2H) whose value at (x, y, z) is the old one at (-x, y, z), exactly.

    The azimuth becomes pi less it, so that column j takes column H - 1 - j, modulo 2H.
    """
    return maps.flip(-1).roll(maps.shape[-2], -1)


def _other_side(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    return name.removesuffix("Right") + "Left" if name.endswith("Right") else name


MIRROR = torch.tensor([-1.0, 1.0, 1.0])
"""Factors of x, y, z."""
EXPRESSIONS = [ARKIT_NAMES.index(_other_side(name)) for name in ARKIT_NAMES]
"""Place in a mirrored expression → place of the same coefficient before."""
PARTS = torch.arange(256, dtype=torch.uint8)
"""Part id → id of its counterpart: eyes, brows and ears change sides."""
PARTS[[3, 4, 5, 6, 7, 8]] = torch.tensor([4, 3, 6, 5, 8, 7], dtype=torch.uint8)
FACE_POINTS = [1, 0, 2, 4, 3]
"""Place among a mirrored face's five points → place of the same point before."""
