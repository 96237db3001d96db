"""The display transform: straight, then a soft shoulder, then sRGB; invertible."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from assets_procedural.conventions.colour import (
    CLIP,
    KNEE,
    display,
    srgb_decode,
    srgb_encode,
    to_bytes,
    undisplay,
)


def test_srgb_agrees_with_colour_science() -> None:
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_encode(x), colour.models.eotf_inverse_sRGB(x), atol=1e-7)
    np.testing.assert_allclose(srgb_decode(x), colour.models.eotf_sRGB(x), atol=1e-7)
    np.testing.assert_allclose(srgb_decode(srgb_encode(x)), x, atol=1e-12)


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


def test_round_trip_of_all_byte_values() -> None:
    levels = np.arange(256) / 255
    np.testing.assert_array_equal(to_bytes(display(undisplay(levels))), np.arange(256))


def test_single_precision_stays_single_and_close() -> None:
    x = np.linspace(0, CLIP, 999, dtype=np.float32)
    assert display(x).dtype == undisplay(x).dtype == np.float32
    np.testing.assert_allclose(display(x), display(x.astype(np.float64)), atol=2e-7)
    assert display(np.array([0.5], np.float16)).dtype == np.float64


def test_bytes_round_and_refuse_nan() -> None:
    np.testing.assert_array_equal(
        to_bytes(np.array([-1, 0.0019, 0.002, 1, 2])), [0, 0, 1, 255, 255]
    )
    with pytest.raises(ValueError, match="NaN"):
        to_bytes(np.array([np.nan]))
