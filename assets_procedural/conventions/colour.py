"""Colour: sRGB, luminance, and the display transform D from linear light to pictures and back.

D is the response of a camera: a toe, contrast, and a long shoulder at which colours keep their hue
and pale. With x linear Rec.709 after exposure (1 = white), m its largest channel,

    t = (g(m + e) - g(e)) / (g(CLIP + e) - g(e)),    g(u) = (u^n / (u^n + c^n))^k,
    y = encode(t - s(t) (t - x t / m)),              s(t) = 1 - p t^6,

where `encode` is the piecewise sRGB transfer function (IEC 61966-2-1), n `SHOULDER`, k `DEPTH`,
c `PIVOT`, e `TOE` and p `PALING`. The largest channel alone says how bright a pixel becomes, so
that none clips before the others: the hue, (max - middle) / (max - min) of the channels, stays. A
pixel gets brighter in all channels with exposure up to a largest channel of `CLIP`, and D is
inverted exactly up to there; brighter pixels are shown as if they were scaled down to it.
"""

from __future__ import annotations

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""(3,) luminance of linear Rec.709: `linear @ LUMINANCE`."""
SHOULDER = 1.25
"""How fast bright light approaches white."""
DEPTH = 1.6
"""How dark blacks are: log over log, the slope of the dark part is `SHOULDER * DEPTH`."""
PIVOT = 0.2835
"""Linear light in the middle of the curve, where u^n / (u^n + c^n) is half of white."""
TOE = 0.002
"""Linear light below which the curve is straight, so that its inverse has a slope at 0."""
CLIP = 16.0
"""Linear light that maps to just 1."""
PALING = 0.6
"""Share of its colour that the brightest light loses."""
BLACK, _WHITE = (
    (u**SHOULDER / (u**SHOULDER + PIVOT**SHOULDER)) ** DEPTH for u in (TOE, CLIP + TOE)
)
RANGE = _WHITE - BLACK
"""g(TOE), and g(CLIP + TOE) - g(TOE)."""
DARKEST = 1e-6
"""Light below which the gain of a pixel no longer changes."""
DARKEST_TONE = 1e-7
"""About what `DARKEST` becomes."""


def display(linear: np.ndarray) -> np.ndarray:
    """D: linear light (..., 3), float, to display-referred values in [0, 1], float.

    Negative light gives 0, and NaN a pixel of NaN. float32 stays float32, all else becomes float64.
    """
    x = np.maximum(floating(linear), 0.0)
    x = x / np.maximum(x.max(axis=-1, keepdims=True) / CLIP, 1.0)
    brightest = np.maximum(x.max(axis=-1, keepdims=True), DARKEST)
    ratio = ((brightest + TOE) / PIVOT) ** SHOULDER
    tone = ((ratio / (1.0 + ratio)) ** DEPTH - BLACK) / RANGE
    colour = 1.0 - PALING * tone**6
    shown = srgb_encode(tone * (1.0 - colour) + colour * (tone / brightest) * x)
    return np.minimum(shown, 1.0).astype(x.dtype)


def undisplay(shown: np.ndarray) -> np.ndarray:
    """The inverse of `display`: values (..., 3) in [0, 1] to linear light in [0, CLIP].

    Colours that D never shows, brilliant and bright at once, give the nearest that has no negative
    channel.
    """
    y = srgb_decode(np.clip(floating(shown), 0.0, 1.0))
    tone = np.maximum(y.max(axis=-1, keepdims=True), DARKEST_TONE)
    share = (tone * RANGE + BLACK) ** (1.0 / DEPTH)
    brightest = PIVOT * (share / (1.0 - share)) ** (1.0 / SHOULDER) - TOE
    colour = 1.0 - PALING * tone**6
    x = brightest / tone * (y - tone * (1.0 - colour)) / colour
    return np.clip(x, 0.0, CLIP).astype(y.dtype)


def to_bytes(shown: np.ndarray) -> np.ndarray:
    """Display-referred values to uint8, rounded to nearest; NaN is refused with `ValueError`."""
    shown = np.asarray(shown)
    if np.isnan(shown).any():
        raise ValueError("a picture with NaN cannot be stored")
    return np.round(np.clip(shown, 0.0, 1.0) * 255.0).astype(np.uint8)


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Linear light >= 0 to sRGB values (the transfer function alone)."""
    x = floating(linear)
    power = 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(x <= 0.0031308, 12.92 * x, power).astype(x.dtype)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_encode`."""
    y = floating(encoded)
    power = ((np.maximum(y, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(y <= 0.04045, y / 12.92, power).astype(y.dtype)


def floating(values: np.ndarray) -> np.ndarray:
    """float32 as it is, all else as float64."""
    values = np.asarray(values)
    return values if values.dtype == np.float32 else values.astype(np.float64)
