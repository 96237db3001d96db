"""Panoramas as sums of few lights: patches of the sphere that all share, and suns of their own.

Light adds up: a picture under each patch and each sun gives the picture under any panorama, as a
sum with the weights that are found here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from assets_procedural.conventions import panorama, panorama_reading
from assets_procedural.conventions.colour import LUMINANCE
from synthgen.planning.plan import EnvironmentUse

_FINE = 3
"""Edges that a face of the icosahedron is cut into, along each side."""
PATCHES = 20 * _FINE**2
SUNS = 2
"""The most that a panorama has."""
_HEIGHT = 256  # rows of a panorama that count
_SUN_RADIUS = math.radians(4)
_SUN_CONTRAST = 4.0  # against the median of the ring around it
_SUN_SHARE = 0.02  # of the panorama's whole light
_FAINTEST = 0.02  # strength of a patch against the mean


@dataclass(frozen=True)
class Sun:
    """A peak of a panorama."""

    direction: np.ndarray
    """(3,) unit, towards it."""
    angle: float
    """Of its disc, as its diameter in radians."""
    irradiance: np.ndarray
    """(3,) linear, on a surface that faces it."""


@dataclass(frozen=True)
class Basis:
    """Lights that a figure is rendered in, and how much of each is in which environment.

    Strengths are such that the lights together are about as bright as one environment, whatever
    units its panorama has: so every light gets samples as it matters.
    """

    strengths: np.ndarray
    """(PATCHES,) radiance of each patch, in grey."""
    suns: tuple[Sun, ...]
    """Their irradiance in grey."""
    weights: np.ndarray
    """(E, PATCHES + suns, 3) float32: environment e is the sum of lights times weights[e]."""


def basis(environments: Sequence[EnvironmentUse], folder: Path) -> Basis:
    """The lights that serve these environments; `folder` holds `<id>.exr`."""
    parts = [_parts(folder / f"{use.id}.exr") for use in environments]
    means = np.stack([_means(p.rest, u.rotation) for p, u in zip(parts, environments, strict=True)])
    scales = np.array([1 / max(p.level, 1e-9) for p in parts])
    grey = (means @ LUMINANCE) * scales[:, None]
    strengths = np.sqrt((grey**2).mean(axis=0))
    strengths = np.maximum(strengths, _FAINTEST * max(strengths.mean(), 1e-9))
    count = sum(len(p.suns) for p in parts)
    weights = np.zeros((len(parts), PATCHES + count, 3), np.float32)
    weights[:, :PATCHES] = means / strengths[:, None]
    suns: list[Sun] = []
    for row, (part, use) in enumerate(zip(parts, environments, strict=True)):
        for sun in part.suns:
            grey = float(sun.irradiance @ LUMINANCE) * scales[row] / math.sqrt(len(parts))
            weights[row, PATCHES + len(suns)] = sun.irradiance / grey
            direction = panorama.rotate_z(sun.direction, use.rotation)
            suns.append(Sun(direction, sun.angle, np.full(3, grey)))
    return Basis(strengths, tuple(suns), weights)


def triangles() -> np.ndarray:
    """(PATCHES, 3, 3) corners on the unit sphere, counter-clockwise seen from outside."""
    golden = (1 + math.sqrt(5)) / 2
    corners = [
        np.roll([0.0, side, other * golden], turn)
        for turn in range(3)
        for side in (-1, 1)
        for other in (-1, 1)
    ]
    solid = np.array(corners) / math.hypot(1, golden)
    edge = 2 / math.hypot(1, golden)
    faces = [
        (a, b, c)
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if all(
            abs(np.linalg.norm(solid[i] - solid[j]) - edge) < 1e-6
            for i, j in ((a, b), (b, c), (c, a))
        )
    ]
    cut = []
    for a, b, c in solid[np.array(faces)]:
        if np.linalg.det([a, b, c]) < 0:
            b, c = c, b
        at = {
            (i, j): a + (b - a) * i / _FINE + (c - a) * j / _FINE
            for i in range(_FINE + 1)
            for j in range(_FINE + 1 - i)
        }
        for i, j in at:
            if (i + 1, j) in at and (i, j + 1) in at:
                cut.append((at[i, j], at[i + 1, j], at[i, j + 1]))
            if (i + 1, j + 1) in at:
                cut.append((at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]))
    # An odd turn, so that no edge lies on an axis of the face.
    tilt = np.array([[1, 0, 0], [0, 0.81965, -0.57287], [0, 0.57287, 0.81965]])
    points = panorama.rotate_z(np.array(cut), 0.37) @ tilt
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


@dataclass(frozen=True)
class _Parts:
    """A panorama as suns and the rest, and how bright it all is on faces."""

    suns: tuple[Sun, ...]
    rest: np.ndarray
    level: float


@lru_cache(maxsize=32)
def _parts(path: Path) -> _Parts:
    whole = panorama_reading.load(path)
    if whole.shape[0] > _HEIGHT:
        whole = panorama.resize(whole, 2 * _HEIGHT)
    facing = np.array([[0, -1, 0], [0.6, -0.7, 0.3], [-0.6, -0.7, 0.3], [0, -0.6, 0.8]])
    facing = np.concatenate([facing, facing * (1, -1, 1)])  # it may be turned any way
    facing /= np.linalg.norm(facing, axis=-1, keepdims=True)
    level = float((panorama.irradiance(whole, facing) @ LUMINANCE).mean())
    suns, rest = find_suns(whole)
    return _Parts(suns, rest.astype(np.float32), level)


def find_suns(whole: np.ndarray) -> tuple[tuple[Sun, ...], np.ndarray]:
    """The peaks of a panorama (H, W, 3), at most `SUNS`, and the panorama without them."""
    rest = whole.astype(np.float64)
    directions = panorama.texel_directions(len(rest))
    area = panorama.texel_solid_angles(len(rest))[:, None]
    total = float(((rest @ LUMINANCE) * area).sum())
    suns: list[Sun] = []
    while len(suns) < SUNS:
        grey = rest @ LUMINANCE
        cosine = directions @ directions.reshape(-1, 3)[grey.argmax()]
        near = cosine > math.cos(_SUN_RADIUS)
        base = np.median(rest[~near & (cosine > math.cos(2 * _SUN_RADIUS))], axis=0)
        hot = near & (grey > _SUN_CONTRAST * max(float(base @ LUMINANCE), 1e-9))
        excess = np.where(hot[..., None], np.maximum(rest - base, 0), 0)
        irradiance = (excess * area[..., None]).sum(axis=(0, 1))
        if float(irradiance @ LUMINANCE) <= _SUN_SHARE * total:
            break
        light = excess @ LUMINANCE
        centre = (directions * (light * area)[..., None]).sum(axis=(0, 1))
        # As large as a disc of even light that is as concentrated.
        spread = (light * area).sum() ** 2 / (light**2 * area).sum()
        angle = 2 * math.acos(max(-1.0, 1 - spread / (2 * math.pi)))
        suns.append(Sun(centre / np.linalg.norm(centre), angle, irradiance))
        rest -= excess
    return tuple(suns), rest


@lru_cache(maxsize=4)
def _members(height: int) -> np.ndarray:
    """(height, 2 height) the patch that each texel of a panorama is in."""
    corners = triangles()
    sides = np.cross(corners, np.roll(corners, -1, axis=1))
    sides /= np.linalg.norm(sides, axis=-1, keepdims=True)
    rows = []
    for row in panorama.texel_directions(height):
        inside = np.einsum("pck,wk->wpc", sides, row).min(axis=-1)
        rows.append(inside.argmax(axis=-1))
    return np.array(rows)


def _means(rest: np.ndarray, rotation: float) -> np.ndarray:
    """(PATCHES, 3) mean radiance of a panorama in each patch, turned by whole texels."""
    height, width = rest.shape[:2]
    turned = np.roll(rest, -round(rotation / (2 * math.pi) * width), axis=1).reshape(-1, 3)
    members = _members(height).ravel()
    area = np.repeat(panorama.texel_solid_angles(height), width)
    total = np.bincount(members, area, PATCHES)
    sums = [np.bincount(members, turned[:, c] * area, PATCHES) for c in range(3)]
    return np.stack(sums, axis=-1) / np.maximum(total, 1e-12)[:, None]
