"""Pictures rolled and scaled about their middle, and the camera that would have taken them.

A roll of the picture is a roll of the camera; a crop about the middle is a longer lens from the
same place. Both are exact, so tracker and lightmap estimator learn from them as from other cameras.
`photographed` changes colours, focus and noise, which tell the tracker nothing.

B, S as in `totalediting.networks.head_tracker`, h rows of a lightmap.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.tracking import Tracking
from totalediting.light.lightmaps import rotate

ROLL, SCALE = 0.15, 0.12
"""Standard deviations in training: radians, and of the scale's logarithm."""

_EXPOSURE, _BALANCE, _CONTRAST, _SATURATION = 0.2, 0.06, 0.2, 0.3  # of logarithms, likewise
_NOISE = 0.02  # deviation of its deviation


def jittered(
    image: Tensor, truth: Tracking, roll: Tensor, log_scale: Tensor
) -> tuple[Tensor, Tracking]:
    """Pictures (B, 3, S, S) of a camera rolled by `roll` more (B,), with a lens longer by
    exp(`log_scale`) (B,), and what a tracker should find in them.

    Beyond the old border, the outermost pixels are repeated.
    """
    zero, scale = torch.zeros_like(roll), log_scale.exp()
    old = rolled_axes(roll)[:, :2, :2]

    def moved(places: Tensor) -> Tensor:
        return scale[:, None] * (places.unflatten(-1, (-1, 2)) @ old).flatten(1)

    more = torch.stack([zero, zero, roll], -1)
    return resampled(image, roll, log_scale), truth._replace(
        camera_yaw_pitch_roll=truth.camera_yaw_pitch_roll + more,
        log_focal=truth.log_focal + log_scale[:, None],
        log_fill=truth.log_fill + log_scale[:, None],
        shift=moved(truth.shift),
        face=moved(truth.face),
    )


def jittered_light(
    image: Tensor,
    normal: Tensor,
    alpha: Tensor,
    lightmaps: Tensor,
    roll: Tensor,
    log_scale: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The same of pictures, their normals (B, 3, S, S) in camera space, alpha (B, 1, S, S) and
    lightmaps (B, 5, 3, h, 2h) in the camera's frame, which turn with the camera."""
    old = rolled_axes(roll)
    whole = resampled(torch.cat([image, normal, alpha], 1), roll, log_scale)
    image, normal, alpha = whole.split([3, 3, 1], 1)
    normal = (old.mT @ normal.flatten(2)).view_as(normal)
    return image, normal, alpha, rotate(lightmaps, old)


def photographed(image: Tensor) -> Tensor:
    """Pictures (B, 3, S, S) in [0, 1] as other cameras might have taken them, for networks that
    must not depend on that: random exposure, white balance, contrast, saturation, focus and noise.

    Draws come from the global generator.
    """
    exposure, contrast, saturation, blur, noise = torch.randn(5, len(image), 1, 1, 1).to(image)
    balance = torch.randn(len(image), 3, 1, 1).to(image)
    soft = functional.avg_pool2d(image, 3, 1, 1, count_include_pad=False)
    image = image.lerp(soft, blur.abs().clamp_max(1))
    image = image.clamp_min(1e-3) ** (_CONTRAST * contrast).exp()
    image = image * (_EXPOSURE * exposure + _BALANCE * balance).exp()
    image = image.mean(1, keepdim=True).lerp(image, (_SATURATION * saturation).exp())
    return (image + _NOISE * noise.abs() * torch.randn_like(image)).clamp(0, 1)


def rolled_axes(roll: Tensor) -> Tensor:
    """(B, 3, 3) from the axes of cameras rolled by `roll` more (B,) to those before."""
    cosine, sine, zero = roll.cos(), roll.sin(), torch.zeros_like(roll)
    rows = [cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def resampled(picture: Tensor, roll: Tensor, log_scale: Tensor) -> Tensor:
    """What the jittered camera sees of a picture (B, C, S, S)."""
    back = rolled_axes(roll)[:, :, :2].mT / log_scale.exp()[:, None, None]
    grid = functional.affine_grid(back, list(picture.shape), align_corners=False)
    return functional.grid_sample(picture, grid, padding_mode="border", align_corners=False)
