"""Another light on a photograph, with nothing learnt: a ratio image in linear light.

The light of a photograph is fitted to its skin as spherical harmonics of second order over the
bust's normals (Ramamoorthi and Hanrahan 2001), with skin of one colour, lit neutrally in the mean.
What is shown is multiplied by the new light over the old one; shadows that are cast, hot spots and
what is off the bust, which is lit as the nearest of the bust, are beyond that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from totalediting.editing.bust import triangles
from totalediting.editing.distances import distance, nearest
from totalediting.editing.warp import Portrait
from totalediting.light.lightmaps import sample

Light = Callable[[np.ndarray], np.ndarray]
"""From unit normals (..., 3) in model space to what falls on them (..., 3), of any scale."""

_ROUNDS, _STRAY = 8, 0.06  # of reweighting; linear light by which skin counts less
_STIFF = 0.6  # ridge, in square roots of the number of pixels
_DARKEST = 0.25  # of the light in the mean: below it, a picture tells nothing
_ADAPTED = 0.5  # share of a light's tint that a camera's white balance takes out
_LIMITS = (0.15, 4.0)  # of the ratio
_REDDER, _YELLOWER = 1.1, 1.0  # least of red over green and green over blue, for skin


def light_of(portrait: Portrait, linear: np.ndarray) -> Light:
    """The light of a portrait, whose picture (S, S, 3) in linear light is given."""
    raster = portrait.raster
    normals = _unit(raster.interpolate(portrait.bust.normals, triangles()))
    red, green, blue = np.moveaxis(linear, -1, 0)
    skin = raster.covered & (red > _REDDER * green) & (green > _YELLOWER * blue)
    if skin.sum() < 0.05 * raster.covered.sum():  # a picture without colour, or tinted
        skin = raster.covered
    basis, values = _harmonics(normals[skin]), linear[skin]
    values = values / np.median(values, axis=0).clip(1e-4)
    ridge = _STIFF * np.sqrt(len(basis)) * np.diag([0, 0.3, 0.3, 0.3, 1, 1, 1, 1, 1])
    coefficients = np.zeros((9, 3))
    for channel in range(3):
        weight = np.ones(len(basis))
        for _ in range(_ROUNDS):
            left = np.concatenate([basis * weight[:, None], ridge])
            right = np.append(values[:, channel] * weight, np.zeros(9))
            coefficients[:, channel] = np.linalg.lstsq(left, right, rcond=None)[0]
            off = values[:, channel] - basis @ coefficients[:, channel]
            weight = 1 / np.sqrt(1 + (off / (4 * _STRAY)) ** 2)

    def light(directions: np.ndarray) -> np.ndarray:
        return (_harmonics(directions) @ coefficients).clip(_DARKEST, None)

    return light


def panorama_light(lightmaps: torch.Tensor) -> Light:
    """That of baked lightmaps (5, 3, H, 2H) in the world's axes, which the trunk looks along."""

    def light(directions: np.ndarray) -> np.ndarray:
        flat = torch.from_numpy(directions.reshape(-1, 3)).float()
        return sample(lightmaps[0], flat).double().numpy().reshape(directions.shape)

    return light


def turned(light: Light, source: np.ndarray, target: np.ndarray) -> Light:
    """A light of one camera (3, 3), axes in its model space, before another one."""
    return lambda directions: light(directions @ target @ source.T)


def relit(
    linear: np.ndarray,
    covered: np.ndarray,
    old: tuple[Light, np.ndarray],
    new: tuple[Light, np.ndarray],
) -> np.ndarray:
    """A picture (S, S, 3) in linear light under another one.

    `old` is the light that it was taken in, with the normals (S, S, 3) that its colours had then;
    `new` the one to show it in, with those that they have now. `covered` (S, S) is the bust.
    """
    was, becomes = _levelled(*old, covered), _levelled(*new, covered)
    ratio = (becomes / was.clip(_DARKEST / 4, None)).clip(*_LIMITS)
    row, column = nearest(covered)
    side = len(linear)
    near = np.stack([gaussian_filter(ratio[row, column, k], side / 42) for k in range(3)], -1)
    fine = np.stack([gaussian_filter(ratio[row, column, k], side / 256) for k in range(3)], -1)
    edge = (distance(covered) / (side / 64)).clip(0, 1)[..., None]
    ratio = (1 - edge) * fine + edge * near
    return linear * ratio


def _levelled(light: Light, normals: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(S, S, 3) a light on normals, of mean 1 where the bust is, half of its tint taken out."""
    shown = light(normals)
    mean = shown[covered].mean(0)
    return shown / (mean**_ADAPTED * mean.mean() ** (1 - _ADAPTED)).clip(1e-6)


def _harmonics(normals: np.ndarray) -> np.ndarray:
    """(..., 9) of second order, unnormalised."""
    x, y, z = np.moveaxis(normals, -1, 0)
    return np.stack(
        [np.ones_like(x), x, y, z, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], -1
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
