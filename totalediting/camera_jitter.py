"""Pictures rolled and scaled about their middle, with the camera that would have taken them so.

A roll of the picture is a roll of the camera; a crop about the middle is a longer lens from the
same place. Both are exact, so a tracker learns from them as from other cameras. B, S as in
`totalediting.motion`.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.motion import Tracking

ROLL, SCALE = 0.15, 0.12
"""Standard deviations in training: radians, and of the scale's logarithm."""


def jittered(
    image: Tensor, truth: Tracking, roll: Tensor, log_scale: Tensor
) -> tuple[Tensor, Tracking]:
    """Pictures (B, 3, S, S) of a camera rolled by `roll` more (B,), with a lens longer by
    exp(`log_scale`) (B,), and what a tracker should find in them.

    Beyond the old picture's border its outermost pixels go on.
    """
    cosine, sine, scale = roll.cos(), roll.sin(), log_scale.exp()
    zero = torch.zeros_like(roll)
    back = torch.stack([cosine, sine, zero, -sine, cosine, zero], -1) / scale[:, None]
    grid = functional.affine_grid(
        back.unflatten(-1, (2, 3)), list(image.shape), align_corners=False
    )
    picture = functional.grid_sample(image, grid, padding_mode="border", align_corners=False)
    right, up = truth.shift.unbind(-1)
    shift = torch.stack([cosine * right + sine * up, cosine * up - sine * right], -1)
    more = torch.stack([zero, zero, roll], -1)
    return picture, truth._replace(
        camera_yaw_pitch_roll=truth.camera_yaw_pitch_roll + more,
        log_focal=truth.log_focal + log_scale[:, None],
        log_fill=truth.log_fill + log_scale[:, None],
        shift=scale[:, None] * shift,
    )
