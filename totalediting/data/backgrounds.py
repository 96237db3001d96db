"""Backgrounds that transparent pictures are put over: no two steps show the same one.

Half of them are the environment that lights the picture, far out of focus, as which its sharpest
lightmap does; it says of the light what a real background says. The others say nothing: blobs of
several sizes as something out of focus, and straight edges as of a wall or a window, or one colour.
S = side of pictures.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.projection import unproject
from totalediting.light.lightmaps import sample
from totalediting.light.phong import display, undisplay

_OWN = 0.5  # share of backgrounds that are the light's own
_PLAIN = 0.15  # share of backgrounds of one colour
_OCTAVES = (2, 4, 8, 16)  # cells along a side
_EDGES = 3  # at most


def draw_background(
    rng: np.random.Generator, lightmaps: Tensor, intrinsics: Tensor, side: int
) -> Tensor:
    """(3, side, side) display-referred, in [0, 1]: the light's own or any other.

    `lightmaps` (5, 3, h, 2h), exposed, in the camera's frame; `intrinsics` (3, 3) in pixels of
    `side`.
    """
    if rng.random() < _OWN:
        return environment(lightmaps, intrinsics, side)
    return random_background(rng, side)


def environment(lightmaps: Tensor, intrinsics: Tensor, side: int) -> Tensor:
    """(3, side, side) display-referred: what a camera sees of its light, out of focus."""
    far = torch.ones(1, 1, side, side)
    rays = unproject(far, torch.eye(4)[None], intrinsics[None])[0]
    light = sample(lightmaps[-1], rays.flatten(0, 1))
    return display(light).mT.unflatten(-1, (side, side))


def random_background(rng: np.random.Generator, side: int) -> Tensor:
    """(3, side, side) display-referred, in [0, 1], that has nothing to do with the light."""
    base = _colour(rng)
    picture = base[:, None, None].repeat(1, side, side)
    if rng.random() < _PLAIN:
        return picture
    for cells in _OCTAVES:
        grey = rng.normal(size=(1, cells + 1, cells + 1))
        tint = rng.normal(size=(3, cells + 1, cells + 1))
        noise = torch.from_numpy(rng.random() * (0.25 * grey + 0.1 * tint) / np.sqrt(cells)).float()
        picture = (
            picture
            + functional.interpolate(
                noise[None], (side, side), mode="bilinear", align_corners=True
            )[0]
        )
    middle = (torch.arange(side) + 0.5) / side - 0.5
    for _ in range(int(rng.integers(_EDGES + 1))):
        angle, offset = rng.uniform(0, 2 * np.pi), rng.uniform(-0.4, 0.4)
        across = np.cos(angle) * middle + np.sin(angle) * middle[:, None] - offset
        share = (across * side / rng.uniform(1, 6) + 0.5).clamp(0, 1)
        picture = torch.lerp(picture, 0.5 * (picture + _colour(rng)[:, None, None]), share)
    return picture.clamp(0, 1)


def put_over(foreground: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
    """D(alpha c + (1 - alpha) b): subjects over black (..., 3, S, S), D(alpha c), over another
    background b (..., 3, S, S), both display-referred; `alpha` (..., 1, S, S). Light adds up
    before it is shown."""
    return display(undisplay(foreground, -3) + (1 - alpha) * undisplay(background, -3), -3)


def _colour(rng: np.random.Generator) -> Tensor:
    grey = rng.beta(1.2, 1.6)
    return torch.from_numpy(grey + rng.normal(0, 0.12, 3)).float().clamp(0, 1)
