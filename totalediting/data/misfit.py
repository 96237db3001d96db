"""Sources as a fit would describe them: in training, camera and bust do not lie quite right.

In use both are found by a fit, whose bust appears a share of a per cent of the frame beside the
picture and whose camera is a few degrees off (the rest is made up for by shape). So the picture is
bent against its bust by a smooth random flow, and the camera goes round the head a little.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.source import Source

_BEND = 0.005  # deviation of the flow, shares of the frame
_CELLS = 4  # of the flow along a side
_ORBIT = math.radians(1.5)  # deviation of the camera's direction, about each axis


def misfitted(source: Source, rng: np.random.Generator) -> Source:
    """A source (without batch axis) whose control points and camera are those of a fit."""
    side = source.image.shape[-1]
    flow = torch.from_numpy(rng.normal(0, 2 * _BEND, (1, 2, _CELLS, _CELLS))).float()
    flow = functional.interpolate(flow, (side, side), mode="bicubic", align_corners=True)
    middle = (2 * torch.arange(side) + 1) / side - 1
    grid = torch.stack(torch.meshgrid(middle, middle, indexing="xy"), -1) + flow[0].movedim(0, -1)
    whole = torch.cat([source.image, source.alpha])[None]
    bent = functional.grid_sample(whole, grid[None], padding_mode="border", align_corners=False)[0]
    orbit = torch.eye(4)
    orbit[:3, :3] = _rotation(rng.normal(0, _ORBIT, 3))
    return source._replace(
        image=bent[:3], alpha=bent[3:], camera_to_world=orbit @ source.camera_to_world
    )


def _rotation(vector: np.ndarray) -> Tensor:
    x, y, z = vector.tolist()
    return torch.linalg.matrix_exp(torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
