"""Turning a panorama as a photographer turns the sitter: its key falls on the face from the side.

Azimuths are radians about +Z, 0 straight in front of the trunk (-Y), positive towards the subject's
left (+X).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from assets_procedural.conventions.colour import LUMINANCE
from assets_procedural.conventions.panorama import (
    rotate_z,
    texel_directions,
    texel_solid_angles,
)

_ROWS = 32
# How much less than its brightest side a face may get, in stops, before it counts as in the shade.
_SHADE = 0.8
_CONE = math.cos(math.radians(15))
# What is behind the face, relative to a white surface in the face's light: brighter than the first
# it glares, darker than the second it is night around a lit face.
_GLARE, _NIGHT = 2.0, 0.06


@dataclass(frozen=True)
class Survey:
    """What decides how a panorama is turned."""

    key: float
    """Azimuth that most light comes from."""
    luminance: np.ndarray
    """(32, 64) mean luminance."""


def sample_key(rng: np.random.Generator) -> float:
    """An azimuth for the key: mostly 20 to 60 degrees to either side, at times frontal or a rim."""
    kind = rng.random()
    low, high = (20, 60) if kind < 0.75 else (0, 20) if kind < 0.94 else (60, 90)
    return math.radians(rng.uniform(low, high)) * float(rng.choice([-1.0, 1.0]))


def survey(panorama: np.ndarray) -> Survey:
    """Survey a panorama (H, 2H, 3), H >= 32; its key is the mean direction of its light, weighted
    by luminance."""
    light = panorama @ LUMINANCE
    height = len(light)
    towards = (light * texel_solid_angles(height)[:, None])[..., None] * texel_directions(height)
    x, y, _ = towards.sum((0, 1))
    rows, columns = (np.arange(n) * height // _ROWS for n in (_ROWS, 2 * _ROWS))
    small = np.add.reduceat(np.add.reduceat(light, rows, 0), columns, 1)
    count = np.outer(np.diff(rows, append=height), np.diff(columns, append=2 * height))
    return Survey(math.atan2(x, -y), small / count)


def rotation(
    found: Survey, key: float, views: Sequence[tuple[float, float]], facing: float = 0.0
) -> float:
    """The rotation in [0, 2 pi) that brings a panorama's key to `key` from a face, or near it.

    `views` are yaw and pitch of the cameras about the head, `facing` is the face's own azimuth; a
    face is lit between where it looks and where it is seen from. Where that side of it would lie
    in the shade, or the background glare or be black, the other side and azimuths 25 degrees off
    are tried.
    """
    step = math.radians(25)
    middle = 0.5 * (facing + sum(yaw for yaw, _ in views) / len(views))
    tried = [side * turn for turn in (key, key - step, key + step) for side in (1.0, -1.0)]
    tried = [middle + each for each in tried if abs(each) <= math.radians(110)]
    brightest = max(_white(found, 2 * math.pi * i / 16) for i in range(16))
    strain = []
    for i, each in enumerate(tried):
        white = _white(found, middle - each + found.key)
        shade = math.log2(brightest / white) - _SHADE
        strain.append(max(shade, _strain(found, each - found.key, white, views)) + 0.1 * i)
    return (tried[int(np.argmin(strain))] - found.key) % (2 * math.pi)


def _white(found: Survey, azimuth: float) -> float:
    """Luminance of an upright white surface that looks towards an azimuth of the panorama."""
    direction = texel_directions(_ROWS)
    light = found.luminance * texel_solid_angles(_ROWS)[:, None]
    normal = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    return max(float((light * np.clip(direction @ normal, 0, None)).sum() / math.pi), 1e-9)


def _strain(
    found: Survey, angle: float, white: float, views: Sequence[tuple[float, float]]
) -> float:
    """By how many stops the background is too bright behind a face of luminance `white`, or half of
    those it is too dark."""
    direction = rotate_z(texel_directions(_ROWS), angle)
    light = found.luminance * texel_solid_angles(_ROWS)[:, None]
    levels = []
    for yaw, pitch in views:
        away = -np.array(
            [math.sin(yaw) * math.cos(pitch), -math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
        )
        seen = direction @ away > _CONE
        levels.append(light[seen].sum() / (texel_solid_angles(_ROWS)[:, None] * seen).sum())
    level = max(float(np.mean(levels)) / white, 1e-6)
    return max(math.log2(level / _GLARE), 0.5 * math.log2(_NIGHT / level), 0.0)
