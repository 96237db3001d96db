"""Lights of an edit: a panorama, or the light that another photograph was taken in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from assets_procedural.conventions import panorama_reading
from assets_procedural.conventions.colour import display
from assets_procedural.conventions.panorama import lookup, rotate_z, texel_directions
from totalediting.editing.warping.bust import View
from totalediting.editing.warping.relight import Light
from totalediting.light.lightmaps import bake, rotate, sample

ROWS = 32
"""Of lightmaps."""
_WIDEST = 2048  # pixels of a panorama that is kept
_GREY = 0.35  # display-referred light that the middle of a shown panorama gets


@dataclass(frozen=True, eq=False)
class Panorama:
    """A panorama in the world's axes, which the trunk looks along (-Y), turned about +Z."""

    path: Path
    pixels: np.ndarray
    """(H, 2H, 3) linear."""
    turn: float = 0.0
    """Radians."""

    @classmethod
    def read(cls, path: Path) -> Panorama:
        """Raises `PanoramaError`: it cannot be used."""
        return cls(path, panorama_reading.read(path, max_width=_WIDEST)[0])

    @cached_property
    def lightmaps(self) -> torch.Tensor:
        """(5, 3, H, 2H), not turned."""
        return bake(torch.from_numpy(self.pixels), ROWS)

    @property
    def lightmaps_turned(self) -> torch.Tensor:
        """(5, 3, H, 2H), turned as the panorama is."""
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        back = [[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]
        return rotate(self.lightmaps, torch.tensor(back).float())

    def __call__(self, normals: np.ndarray) -> np.ndarray:
        """What falls on unit normals (..., 3) in model space, of any scale."""
        flat = torch.from_numpy(rotate_z(normals, -self.turn).reshape(-1, 3)).float()
        return sample(self.lightmaps[0], flat).double().numpy().reshape(normals.shape)

    def turned(self, turn: float) -> Panorama:
        """The same, turned by more radians."""
        new = Panorama(self.path, self.pixels, self.turn + turn)
        new.__dict__["lightmaps"] = self.lightmaps
        return new

    def seen(self, view: View, places: np.ndarray) -> np.ndarray:
        """(H, W, 3) in [0, 1]: what a camera sees at places (H, W, 2), in sides of its square."""
        directions = view.unproject(places, np.ones(places.shape[:-1]), 1) - view.frame[:3, 3]
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        light = lookup(self.pixels, directions, self.turn)
        middle = np.exp(np.log(light.mean(-1) + 1e-4).mean())
        return display(_GREY * light / middle)


@dataclass(frozen=True, eq=False)
class OfPhotograph:
    """The light of a photograph, in the axes of its camera, before another camera."""

    light: Light
    """In the model space of the photograph's own bust."""
    axes: np.ndarray
    """(3, 3) from the model space of the bust that is lit to that one."""
    turn: float = 0.0

    def __call__(self, normals: np.ndarray) -> np.ndarray:
        """What falls on unit normals (..., 3) in model space, of any scale."""
        return self.light(rotate_z(normals, -self.turn) @ self.axes.T)

    def turned(self, turn: float) -> OfPhotograph:
        """The same, turned by more radians about the world's +Z."""
        return OfPhotograph(self.light, self.axes, self.turn + turn)


def irradiance_map(light: Light) -> np.ndarray:
    """(H, 2H, 3) float32: what falls on what faces each direction, equirectangular."""
    return light(texel_directions(ROWS)).astype(np.float32)
