"""The One Euro filter (Casiez, Roussel and Vogel, 2012): smooth when slow, prompt when fast."""

from __future__ import annotations

import numpy as np

_DERIVATIVE_CUTOFF = 1.0  # Hz, the authors'


def one_euro(
    values: np.ndarray, times: np.ndarray, cutoff: np.ndarray | float, beta: np.ndarray | float
) -> np.ndarray:
    """Smooth signals (T, C) sampled at `times` (T,), rising seconds.

    `cutoff` (C,) in Hz is that of a signal at rest, `beta` (C,) by how much it rises with the
    signal's speed (per unit of the signal).
    """
    if not len(values):
        return values
    smooth, speed = values[0].astype(np.float64), np.zeros(values.shape[1])
    found = [smooth]
    for value, last, step in zip(values[1:], values[:-1], np.diff(times), strict=True):
        speed = speed + _share(_DERIVATIVE_CUTOFF, step) * ((value - last) / step - speed)
        smooth = smooth + _share(cutoff + beta * np.abs(speed), step) * (value - smooth)
        found.append(smooth)
    return np.stack(found)


def _share(cutoff: np.ndarray | float, step: float) -> np.ndarray | float:
    """What a low pass of first order takes of the new value after `step` seconds."""
    return 1.0 / (1.0 + 1.0 / (2 * np.pi * cutoff * step))
