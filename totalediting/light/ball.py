"""A Phong ball under lightmaps, through an orthographic camera: the effect of light at a glance.

The ball has the unit radius and fills the square picture. Normals and directions are in the world
frame of the lightmaps; the camera has OpenGL axes (x right, y up, it looks along -z).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from totalediting.light import phong

FRONT = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
"""Axes of a camera that looks along +Y, as the dataset's cameras see the subject: +X is to the
right, +Z up."""


def shade_ball(
    lightmaps: torch.Tensor,
    size: int,
    albedo: Sequence[float] = (0.5, 0.5, 0.5),
    k_d: float = 1.0,
    k_s: Sequence[float] = (0.0, 0.0, 0.2, 0.0),
    view_axes: torch.Tensor | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The ball's linear light (size, size, 3) and coverage (size, size) in [0, 1], row 0 on top.

    Light is that of the surface point at each pixel's centre. Outside the rim it continues as at
    the rim, so that light times coverage is an anti-aliased picture. Coverage runs from 0 to 1 over
    the pixel's width across the rim.

    Args:
        lightmaps: (5, 3, H, 2H), normalised, as `lightmaps.bake` makes them.
        albedo: linear Rec.709.
        k_s: of the exponents `lightmaps.SHININESS`.
        view_axes: (3, 3) rotation of the camera to the world; `FRONT` if None.
    """
    axes = torch.tensor(FRONT) if view_axes is None else view_axes
    axes = axes.to(lightmaps)
    right = (torch.arange(size).to(lightmaps) + 0.5) * (2.0 / size) - 1.0
    across = torch.stack(torch.meshgrid(right, -right, indexing="xy"), dim=-1)
    radius = across.norm(dim=-1, keepdim=True)
    across = across / radius.clamp_min(1.0)
    towards = (1.0 - across.square().sum(-1, keepdim=True)).clamp_min(0.0).sqrt()
    normal = (torch.cat([across, towards], dim=-1) @ axes.T).flatten(0, 1)
    light = phong.shade(
        lightmaps,
        normal,
        axes[:, 2].expand_as(normal),
        lightmaps.new_tensor(albedo).expand_as(normal),
        lightmaps.new_tensor([k_d]).expand(len(normal), 1),
        lightmaps.new_tensor(k_s).expand(len(normal), -1),
    )
    coverage = ((1.0 - radius[..., 0]) * (size / 2) + 0.5).clamp(0.0, 1.0)
    return light.unflatten(0, (size, size)), coverage
