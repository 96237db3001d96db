"""Points and pixels of a pinhole camera, batched.

B batch, P points, S side of pictures. Cameras as of `volume`: `camera_to_world` (B, 4, 4) with
OpenGL axes into model space, `intrinsics` (B, 3, 3) in pixels of side S. Depth is planar, metres.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def project(
    points: Tensor, camera_to_world: Tensor, intrinsics: Tensor, side: int
) -> tuple[Tensor, Tensor]:
    """Where points (B, P, 3) appear: (B, P, 2), [-1, 1] from left and top; and their depth (B, P).

    Depths below 1 mm, and those behind the camera, count as 1 mm.
    """
    local = (points - camera_to_world[:, None, :3, 3]) @ camera_to_world[:, :3, :3]
    depth = (-local[..., 2]).clamp_min(1e-3)
    focal = torch.stack([intrinsics[:, 0, 0], -intrinsics[:, 1, 1]], -1)[:, None]
    pixels = focal * local[..., :2] / depth[..., None] + intrinsics[:, None, :2, 2]
    return 2 * pixels / side - 1, depth


def unproject(depth: Tensor, camera_to_world: Tensor, intrinsics: Tensor) -> Tensor:
    """Points (B, S, S, 3) that the pixel centres of depth pictures (B, 1, S, S) show."""
    side = depth.shape[-1]
    middle = torch.arange(side, dtype=depth.dtype, device=depth.device) + 0.5
    fx, fy, cx, cy = (intrinsics[:, i, j, None, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    z = depth[:, 0]
    x, y = (middle - cx) / fx * z, (cy - middle[:, None]) / fy * z
    local = torch.stack([x, y, -z], -1)
    turned = local.flatten(1, 2) @ camera_to_world[:, :3, :3].mT + camera_to_world[:, None, :3, 3]
    return turned.view_as(local)


def look_up(picture: Tensor, places: Tensor, mode: str = "bilinear") -> Tensor:
    """(B, P, C) of a picture (B, C, H, W) at `places` (B, P, 2), as `project` gives them."""
    found = functional.grid_sample(
        picture, places[:, None], mode=mode, padding_mode="border", align_corners=False
    )
    return found[:, :, 0].mT
