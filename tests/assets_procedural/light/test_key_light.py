"""Panoramas are turned so that their key falls on the face from where it is wanted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets_procedural.conventions.panorama import (
    rotate_z,
    texel_directions,
    texel_solid_angles,
)
from assets_procedural.light.key_light import rotation, sample_key, survey

FRONT = [(0.0, 0.0)]


def lamp(azimuth: float, elevation: float = 0.4, height: int = 64, ambient: float = 0.2):
    """(H, 2H, 3) with a soft lamp."""
    towards = [
        math.sin(azimuth) * math.cos(elevation),
        -math.cos(azimuth) * math.cos(elevation),
        math.sin(elevation),
    ]
    cosine = texel_directions(height) @ np.array(towards)
    return np.repeat((ambient + 20.0 * (cosine > 0.95))[..., None], 3, -1).astype(np.float32)


@pytest.mark.parametrize("azimuth", [-2.5, -0.7, 0.0, 1.1, 3.0])
@pytest.mark.parametrize("height", [32, 50, 64])
def test_a_lamp_is_found_and_turned_to_where_the_key_is_wanted(azimuth: float, height: int):
    found = survey(lamp(azimuth, height=height))
    assert abs(math.remainder(found.key - azimuth, 2 * math.pi)) < 0.06
    assert found.luminance.shape == (32, 64) and found.luminance.mean() > 0.2
    angle = rotation(found, 0.7, FRONT)
    assert 0 <= angle < 2 * math.pi
    # What was at the lamp's place appears at azimuth 0.7: to the subject's left, in front.
    place = rotate_z(np.array([math.sin(azimuth), -math.cos(azimuth), 0.0]), angle)
    np.testing.assert_allclose(place[:2], [math.sin(0.7), -math.cos(0.7)], atol=0.06)


def test_a_glaring_background_sends_the_key_to_the_other_side():
    scene = lamp(0.0)
    behind = math.pi - 0.6  # a white wall, behind the head once the lamp is at 0.6
    wall = texel_directions(64) @ np.array([math.sin(behind), -math.cos(behind), 0.0]) > 0.9
    scene[wall] = 12.0
    found = survey(scene)
    key = found.key + 0.6
    for wanted in (key, -key):
        seen = rotate_z(np.array([0.0, 1.0, 0.0]), -rotation(found, wanted, FRONT))
        row, column = np.unravel_index(np.argmax(texel_directions(64) @ seen), (64, 128))
        assert scene[row, column].max() < 1


def test_keys_are_those_of_photographers():
    keys = np.degrees([sample_key(np.random.default_rng(i)) for i in range(2000)])
    side = np.abs(keys)
    assert side.max() <= 90  # never from behind
    assert 0.7 < ((side > 20) & (side < 60)).mean() < 0.8
    assert 0.45 < (keys > 0).mean() < 0.55


def test_the_key_falls_on_a_face_that_is_turned_and_seen_from_aside():
    found = survey(lamp(1.1))
    for facing, yaw in ((0.5, 0.6), (-0.5, 0.3), (0.0, -0.7)):
        angle = rotation(found, 0.7, [(yaw, 0.0)], facing)
        azimuth = 1.1 + angle
        assert abs(math.remainder(azimuth - 0.5 * (facing + yaw), 2 * math.pi)) < 0.75


def test_a_face_is_not_left_in_its_own_shade():
    # Between two lamps their mean direction says little: the brighter one is to light the face.
    for seed in range(12):
        rng = np.random.default_rng(seed)
        low, high = rng.uniform(0, 2 * math.pi, 2)
        found = survey(lamp(low) + 0.6 * lamp(high))
        side = rng.uniform(-0.6, 0.6)
        angle = rotation(found, sample_key(rng), [(side, 0.0)], side)
        assert upright(found.luminance, side - angle) > 0.4 * max(
            upright(found.luminance, turn) for turn in np.linspace(0, 2 * math.pi, 32)
        )


def upright(luminance: np.ndarray, azimuth: float) -> float:
    """The light on an upright surface that looks towards an azimuth."""
    towards = texel_directions(32) @ np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    return float((luminance * texel_solid_angles(32)[:, None] * towards.clip(0)).sum())
