"""The display transform: toe, contrast, a shoulder that keeps hue; invertible."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from assets_procedural.conventions.colour import (
    CLIP,
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


def test_ends() -> None:
    values = display(np.array([-1.0, 0.0, CLIP, 100.0])[:, None].repeat(3, 1))
    np.testing.assert_allclose(values[:, 0], [0, 0, 1, 1], atol=1e-12)
    assert (display(np.full(3, CLIP - 0.1)) < 1).all()
    assert np.isnan(display(np.array([0.1, np.nan, 0.3]))).all()


def test_it_has_a_toe_contrast_and_a_shoulder() -> None:
    grey = display(np.array([0.002, 0.016, 0.15, 0.3, 1.0])[:, None].repeat(3, 1))[:, 0]
    plain = srgb_encode(np.array([0.002, 0.016, 0.15, 0.3, 1.0]))
    assert (grey[:2] < 0.6 * plain[:2]).all()  # blacks are black
    assert grey[3] - grey[2] > 1.15 * (plain[3] - plain[2])
    assert grey[3] > plain[3] and grey[4] < 0.92 < 0.97 < display(np.full(3, 4.0))[0] < 0.99


def test_every_channel_rises_with_exposure() -> None:
    tint = np.random.default_rng(0).random((200, 1, 3)) + 0.01
    light = tint / tint.max(-1, keepdims=True) * np.geomspace(1e-4, CLIP, 3000)[None, :, None]
    assert (np.diff(display(light), axis=1) > 0).all()


def test_hue_stays_and_nothing_clips_in_one_channel() -> None:
    rng = np.random.default_rng(1)
    light = rng.random((5000, 3)) * 10 ** rng.uniform(-2, 2, (5000, 1))

    def hue(linear: np.ndarray) -> np.ndarray:
        low, middle, high = np.sort(linear, -1).T
        return (middle - low) / (high - low)

    shown = srgb_decode(display(light))
    np.testing.assert_array_equal(np.argsort(shown), np.argsort(light))
    np.testing.assert_allclose(hue(shown), hue(light), atol=1e-6)
    # A lamp's orange: paler where it glares, yet not yellow, and still no white at ten times CLIP.
    dim, bright, glaring = display(np.array([4.0, 2.0, 0.8]) * np.array([[0.1], [1.0], [40.0]]))
    assert np.ptp(glaring) < np.ptp(bright) < np.ptp(dim) and glaring[2] < 0.9


def test_round_trip() -> None:
    rng = np.random.default_rng(2)
    x = 10 ** rng.uniform(-5, np.log10(CLIP), (10_000, 3))
    np.testing.assert_allclose(undisplay(display(x)), x, rtol=1e-7, atol=1e-9)
    grey = np.linspace(0, CLIP, 999)[:, None].repeat(3, 1)
    np.testing.assert_allclose(undisplay(display(grey)), grey, rtol=1e-9, atol=1e-12)


def test_round_trip_of_all_byte_values() -> None:
    levels = (np.arange(256) / 255)[:, None].repeat(3, 1)
    again = to_bytes(display(undisplay(levels)))
    np.testing.assert_array_equal(again, np.arange(256)[:, None].repeat(3, 1))


def test_single_precision_stays_single_and_close() -> None:
    x = np.random.default_rng(3).random((999, 3), np.float32) * np.float32(CLIP)
    assert display(x).dtype == undisplay(x).dtype == np.float32
    np.testing.assert_allclose(display(x), display(x.astype(np.float64)), atol=1e-6)
    assert display(np.full(3, 0.5, np.float16)).dtype == np.float64


def test_bytes_round_and_refuse_nan() -> None:
    np.testing.assert_array_equal(
        to_bytes(np.array([-1, 0.0019, 0.002, 1, 2])), [0, 0, 1, 255, 255]
    )
    with pytest.raises(ValueError, match="NaN"):
        to_bytes(np.array([np.nan]))
