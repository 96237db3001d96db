"""The display transform of datasets of format 1, whose pictures still have to be read.

y = encode(shoulder(x)), per channel, x linear Rec.709 with 1 = white, after exposure. `shoulder` is
the identity up to `KNEE` and then a logarithm that joins with equal value and slope, reaches 1 at
`CLIP` and stays there; `encode` is the sRGB transfer function. Functions of the same names in
`conventions.colour` are the present ones.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.conventions.colour import floating, srgb_decode, srgb_encode

KNEE = 0.8
"""Linear light up to which the curve is straight."""
CLIP = 8.0
"""Linear light that maps to just 1."""
RATE = 26.23164050992174
"""a of the shoulder KNEE + log(1 + a (x - KNEE)) / a, so that it is 1 at `CLIP`."""


def display(linear: np.ndarray) -> np.ndarray:
    """Linear light (any shape, float) to display-referred values in [0, 1], float.

    Negative light gives 0 and NaN stays NaN. float32 stays float32, all else becomes float64.
    """
    x = np.clip(floating(linear), 0.0, CLIP)
    # The logarithm's branch is evaluated everywhere, hence the maximum.
    bent = KNEE + np.log1p(RATE * (np.maximum(x, KNEE) - KNEE)) / RATE
    return np.minimum(srgb_encode(np.where(x <= KNEE, x, bent)), 1.0).astype(x.dtype)


def undisplay(shown: np.ndarray) -> np.ndarray:
    """The inverse of `display`: values in [0, 1] to linear light in [0, CLIP]."""
    y = srgb_decode(np.clip(floating(shown), 0.0, 1.0))
    straight = KNEE + np.expm1(RATE * (np.maximum(y, KNEE) - KNEE)) / RATE
    return np.minimum(np.where(y <= KNEE, y, straight), CLIP).astype(y.dtype)
