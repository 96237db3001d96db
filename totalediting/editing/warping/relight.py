"""Another light on a photograph, with nothing learnt: a ratio image in linear light.

The light of a photograph is fitted to its skin as spherical harmonics of second order over the
bust's normals (Ramamoorthi and Hanrahan 2001), with skin of one colour, lit neutrally in the mean.
What is shown is multiplied by the new light over the old one; shadows that are cast, hot spots and
what is off the bust, which is lit as the nearest of the bust, are beyond that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from assets_procedural.conventions.panorama import texel_directions
from totalediting.editing.warping.distances import distance, nearest
from totalediting.editing.warping.numbers import blurred
from totalediting.editing.warping.portrait import Portrait

Light = Callable[[np.ndarray], np.ndarray]
"""From unit normals (..., 3) in model space to what falls on them (..., 3), of any scale."""

_ROUNDS, _STRAY = 8, 0.06  # of reweighting; linear light by which skin counts less
_STIFF = 0.6  # ridge, in square roots of the number of pixels
_DARKEST = 0.25  # of the light in the mean: below it, a picture tells nothing
_ADAPTED = 0.5  # share of a light's tint that a camera's white balance takes out
_OF_FACE = 0.6  # of the exposure that goes by the face; the rest goes by all directions
_SPHERE = texel_directions(8).reshape(-1, 3)
_LIMITS = (0.15, 4.0)  # of the ratio
_REDDER, _YELLOWER = 1.1, 1.0  # least of red over green and green over blue, for skin


def light_of(portrait: Portrait, linear: np.ndarray) -> Light:
    """The light of a portrait, whose picture (S, S, 3) in linear light is given."""
    raster = portrait.raster
    red, green, blue = np.moveaxis(linear, -1, 0)
    skin = raster.covered & (red > _REDDER * green) & (green > _YELLOWER * blue)
    if skin.sum() < 0.05 * raster.covered.sum():  # a picture without colour, or tinted
        skin = raster.covered
    basis, values = _harmonics(portrait.normals[skin]), linear[skin]
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


def ratio_of(
    covered: np.ndarray, skin: np.ndarray, was: np.ndarray, becomes: np.ndarray
) -> np.ndarray:
    """(S, S, 3) by what a picture in linear light is multiplied to be in another one.

    `was` (S, S, 3) is the light that fell on its points when it was taken, `becomes` the one to
    show it in. `covered` (S, S) is the bust, `skin` (S, S) from 0 to 1 what of it is lit as its own
    normals say: not what hair hides, nor teeth.
    """
    ratio = (becomes / was.clip(_DARKEST / 4, None)).clip(*_LIMITS)
    row, column = nearest(covered)
    side = len(covered)
    spread = ratio[row, column]
    near, fine = blurred(spread, side / 42), blurred(spread, side / 256)
    share = (1 - distance(covered) / (side / 64)).clip(0, 1) * skin[row, column]
    share = gaussian_filter(share, side / 256)[..., None]
    return share * fine + (1 - share) * near


class Levelled:
    """A light as a camera exposes for it that is set between the face and all around.

    Half of the tint goes, as white balance has it, and half of how bright the face is in it.
    """

    def __init__(self, light: Light, face: np.ndarray) -> None:
        """`face` (N, 3) are the normals of the photograph's bust."""
        self.light = light
        mean, around = light(face).mean(0), light(_SPHERE).mean()
        exposed = mean.mean() ** _OF_FACE * around ** (1 - _OF_FACE)
        tint = (mean / mean.mean().clip(1e-9)).clip(1e-3) ** _ADAPTED
        self.scale = 1 / (exposed * tint).clip(1e-6)

    def __call__(self, normals: np.ndarray) -> np.ndarray:
        return self.light(normals) * self.scale


def _harmonics(normals: np.ndarray) -> np.ndarray:
    """(..., 9) of second order, unnormalised."""
    x, y, z = np.moveaxis(normals, -1, 0)
    return np.stack(
        [np.ones_like(x), x, y, z, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], -1
    )
