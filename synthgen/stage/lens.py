"""What a lens and a sensor do to a picture, if a job asks for it: bloom, blur, grain, sharpening.

All of it is off by default, so that a picture stays a function of each pixel's linear light.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from assets_procedural.conventions.colour import LUMINANCE, display
from synthgen.planning.job import LensSettings

_BLOOM_REACH = 0.012  # of the picture's width
_SHARPEN_REACH = 0.8  # pixels
_READ_NOISE = 0.004  # linear light that is as noisy as the sensor in the dark


def finish(light: np.ndarray, settings: LensSettings, rng: np.random.Generator) -> np.ndarray:
    """The display-referred picture (H, W, 3) in [0, 1] of exposed linear `light` (H, W, 3).

    D(light) exactly, if nothing in `settings` is on.
    """
    if settings.bloom:
        light = light + settings.bloom * (_blurred(light, _BLOOM_REACH * light.shape[1]) - light)
    if settings.blur:
        light = _blurred(light, settings.blur)
    if settings.grain:
        # Photons are counted: noise grows with the root of light. Demosaicing correlates it.
        grey = _blurred(rng.normal(size=(*light.shape[:2], 1)), 0.5) / 0.56
        tint = _blurred(rng.normal(size=light.shape), 0.55) / 0.51
        level = np.sqrt(np.maximum(light @ LUMINANCE, 0)[..., None] + _READ_NOISE)
        light = light + settings.grain * level * (0.95 * grey + 0.3 * tint)
    shown = display(light)
    if settings.sharpen:
        shown = shown + settings.sharpen * (shown - _blurred(shown, _SHARPEN_REACH))
    return np.clip(shown, 0, 1)


def _blurred(values: np.ndarray, sigma: float) -> np.ndarray:
    return gaussian_filter(values, (sigma, sigma, 0), mode="nearest")
