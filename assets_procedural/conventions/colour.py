"""Colour: sRGB, luminance, and the display transform D from linear light to pictures and back.

y = encode(shoulder(x)), per channel, x linear Rec.709 with 1 = white, after exposure. `shoulder` is
the identity up to `KNEE` and then a logarithm that joins with equal value and slope, reaches 1 at
`CLIP` and stays there; `encode` is the piecewise sRGB transfer function (IEC 61966-2-1). D is
strictly increasing on [0, CLIP], so it is inverted exactly there; above, light is lost.
"""

from __future__ import annotations

import math

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""(3,) luminance of linear Rec.709: `linear @ LUMINANCE`."""
KNEE = 0.8
"""Linear light up to which the curve is straight."""
CLIP = 8.0
"""Linear light that maps to just 1."""


def _rate() -> float:
    """a > 0 of the shoulder KNEE + log(1 + a (x - KNEE)) / a, which is 1 at x = CLIP.

    The slope at KNEE is 1 for every a. log(1 + a t) / a falls in a from t to 0: bisect.
    """
    low, high = 1e-3, 1e3
    for _ in range(200):
        middle = 0.5 * (low + high)
        if math.log1p(middle * (CLIP - KNEE)) / middle > 1.0 - KNEE:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


RATE = _rate()
"""Constant a of the shoulder, about 26.2."""


def display(linear: np.ndarray) -> np.ndarray:
    """D: linear light (any shape, float) to display-referred values in [0, 1], float.

    Negative light gives 0 and NaN stays NaN. float32 stays float32, all else becomes float64.
    """
    x = np.clip(_floating(linear), 0.0, CLIP)
    # The logarithm's branch is evaluated everywhere, hence the maximum.
    bent = KNEE + np.log1p(RATE * (np.maximum(x, KNEE) - KNEE)) / RATE
    return np.minimum(srgb_encode(np.where(x <= KNEE, x, bent)), 1.0).astype(x.dtype)


def undisplay(shown: np.ndarray) -> np.ndarray:
    """The inverse of `display`: values in [0, 1] to linear light in [0, CLIP]."""
    y = srgb_decode(np.clip(_floating(shown), 0.0, 1.0))
    straight = KNEE + np.expm1(RATE * (np.maximum(y, KNEE) - KNEE)) / RATE
    return np.minimum(np.where(y <= KNEE, y, straight), CLIP).astype(y.dtype)


def to_bytes(shown: np.ndarray) -> np.ndarray:
    """Display-referred values to uint8, rounded to nearest; NaN is refused with `ValueError`."""
    shown = np.asarray(shown)
    if np.isnan(shown).any():
        raise ValueError("a picture with NaN cannot be stored")
    return np.round(np.clip(shown, 0.0, 1.0) * 255.0).astype(np.uint8)


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Linear light >= 0 to sRGB values (the transfer function alone)."""
    x = _floating(linear)
    power = 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(x <= 0.0031308, 12.92 * x, power).astype(x.dtype)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_encode`."""
    y = _floating(encoded)
    power = ((np.maximum(y, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(y <= 0.04045, y / 12.92, power).astype(y.dtype)


def _floating(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    return values if values.dtype == np.float32 else values.astype(np.float64)
