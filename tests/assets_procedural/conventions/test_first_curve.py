"""The curve of datasets of format 1: straight, then a soft shoulder, then sRGB; invertible."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.conventions.colour import srgb_decode, srgb_encode, to_bytes
from assets_procedural.conventions.first_curve import CLIP, KNEE, display, undisplay


def test_straight_up_to_the_knee() -> None:
    x = np.linspace(0, KNEE, 100)
    np.testing.assert_allclose(display(x), srgb_encode(x), atol=1e-15)


def test_ends() -> None:
    values = display(np.array([-1.0, 0.0, CLIP, 100.0]))
    np.testing.assert_allclose(values, [0, 0, 1, 1], atol=1e-12)
    assert display(np.array(CLIP - 0.01)) < 1


def test_shoulder_joins_smoothly_and_rises() -> None:
    step = 1e-6
    below, at, above = srgb_decode(display(np.array([KNEE - step, KNEE, KNEE + step])))
    assert (at - below) / step == pytest.approx(1, abs=1e-3)
    assert (above - at) / step == pytest.approx(1, abs=1e-3)
    assert (np.diff(display(np.linspace(0, CLIP, 10_000))) > 0).all()


def test_round_trip() -> None:
    x = np.concatenate([np.linspace(0, 1, 500), np.linspace(1, CLIP, 500)])
    np.testing.assert_allclose(undisplay(display(x)), x, rtol=1e-9, atol=1e-12)
    levels = np.arange(256) / 255
    np.testing.assert_array_equal(to_bytes(display(undisplay(levels))), np.arange(256))
