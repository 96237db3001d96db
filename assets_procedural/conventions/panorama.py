"""Equirectangular panoramas: the direction-pixel convention, lookup, resampling.

A panorama is (H, 2H, 3) float32, linear Rec.709 radiance. For a unit direction (x, y, z) in world
axes (Z up, the subject looks along -Y):

    u = 0.5 - atan2(y, x) / 2 pi        v = acos(z) / pi

u runs to the right and v down, both in [0, 1]; texel (row, column) has its centre at
u = (column + 0.5) / 2H, v = (row + 0.5) / H. So row 0 is +Z, the image's middle column +X, three
quarters to the right -Y (what the subject looks at), one quarter +Y. Blender's Environment Texture
(equirectangular, 'Generated' coordinates) does the same.

`rotation` (radians) turns the environment by that angle about +Z, counter-clockwise seen from
above: what was at direction d appears at Rz(rotation) d. In Blender that is a Mapping node of
vector_type 'TEXTURE' with Rotation Z = rotation between 'Generated' and the Environment Texture
(with vector_type 'POINT' the sign would be the opposite).
"""

from __future__ import annotations

import numpy as np

from assets_procedural.mesh.vectors import arctan2

_BAND = 1 << 21  # texels of a panorama that are averaged at once


def direction_to_uv(direction: np.ndarray) -> np.ndarray:
    """Directions (..., 3), any length above 0, to (..., 2) (u, v) in [0, 1]."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    u = 0.5 - arctan2(y, x) / (2.0 * np.pi)
    v = arctan2(np.hypot(x, y), z) / np.pi
    return np.stack([u, v], axis=-1)


def uv_to_direction(uv: np.ndarray) -> np.ndarray:
    """(..., 2) (u, v) to unit directions (..., 3); u may lie outside [0, 1]."""
    u, v = np.moveaxis(np.asarray(uv, dtype=np.float64), -1, 0)
    azimuth = (0.5 - u) * 2.0 * np.pi
    sine = np.sin(v * np.pi)
    return np.stack(
        [sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(v * np.pi)],
        axis=-1,
    )


def texel_directions(height: int) -> np.ndarray:
    """(height, 2 height, 3) unit directions of the texel centres."""
    v, u = np.meshgrid(
        (np.arange(height) + 0.5) / height,
        (np.arange(2 * height) + 0.5) / (2 * height),
        indexing="ij",
    )
    return uv_to_direction(np.stack([u, v], axis=-1))


def texel_solid_angles(height: int) -> np.ndarray:
    """(height,) solid angle in steradians of a texel in each row; all texels sum to 4 pi."""
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    return (edges[:-1] - edges[1:]) * np.pi / height


def rotate_z(direction: np.ndarray, angle: float) -> np.ndarray:
    """Directions (..., 3) turned by `angle` radians about +Z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(np.asarray(direction), -1, 0)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)


def pad_sphere(panorama: np.ndarray, margin: int) -> np.ndarray:
    """(H, W, C) to (H + 2 margin, W + 2 margin, C), continued over the seam and over the poles."""
    height, width = panorama.shape[:2]
    if width % 2 or margin > height:
        raise ValueError(f"need an even width and margin <= height, not {panorama.shape}, {margin}")
    opposite = np.roll(panorama, width // 2, axis=1)
    tall = np.concatenate(
        [opposite[:margin][::-1], panorama, opposite[height - margin :][::-1]],
    )
    return np.concatenate([tall[:, width - margin :], tall, tall[:, :margin]], axis=1)


def lookup(panorama: np.ndarray, direction: np.ndarray, rotation: float = 0.0) -> np.ndarray:
    """Radiance (..., 3) seen in `direction` (..., 3): bilinear, without seams."""
    height, width = panorama.shape[:2]
    uv = direction_to_uv(rotate_z(direction, -rotation))
    padded = pad_sphere(panorama, 1)
    column = uv[..., 0] * width + 0.5
    row = uv[..., 1] * height + 0.5
    left = np.clip(np.floor(column).astype(np.intp), 0, width)
    top = np.clip(np.floor(row).astype(np.intp), 0, height)
    right_share = (column - left)[..., None].astype(np.float32)
    bottom_share = (row - top)[..., None].astype(np.float32)
    upper = padded[top, left] * (1 - right_share) + padded[top, left + 1] * right_share
    lower = padded[top + 1, left] * (1 - right_share) + padded[top + 1, left + 1] * right_share
    return upper * (1 - bottom_share) + lower * bottom_share


def irradiance(panorama: np.ndarray, normal: np.ndarray, rotation: float = 0.0) -> np.ndarray:
    """Irradiance (..., 3) on surfaces that face `normal` (..., 3), unit vectors."""
    small = shrink(panorama, max(1, panorama.shape[0] // 64))
    weights = small * texel_solid_angles(small.shape[0])[:, None, None]
    local = rotate_z(normal, -rotation)
    cosine = np.clip(np.einsum("...k,hwk->...hw", local, texel_directions(small.shape[0])), 0, None)
    return np.einsum("...hw,hwc->...c", cosine, weights)


def shrink(panorama: np.ndarray, factor: int) -> np.ndarray:
    """Area average of `factor` x `factor` blocks; rows and columns must divide evenly."""
    height, width, channels = panorama.shape
    if height % factor or width % factor:
        raise ValueError(f"{height} x {width} does not divide by {factor}")
    blocks = panorama.reshape(height // factor, factor, width // factor, factor, channels)
    # Rows shrink towards the poles, so energy is kept by weighting with their solid angles.
    weights = texel_solid_angles(height).reshape(height // factor, factor, 1, 1, 1)
    mean = np.empty((height // factor, width // factor, channels), panorama.dtype)
    step = max(1, _BAND // (width * factor))  # rows at once: a large panorama is not doubled
    for top in range(0, len(mean), step):
        weight = weights[top : top + step]
        total = (blocks[top : top + step] * weight).sum(axis=(1, 3))
        mean[top : top + step] = total / (weight.sum(axis=(1, 3)) * factor)
    return mean


def resize(panorama: np.ndarray, width: int) -> np.ndarray:
    """A smaller panorama, `width` texels wide, area-averaged."""
    height = width // 2
    factor = panorama.shape[0] // height
    if factor * height == panorama.shape[0]:
        return shrink(panorama, factor)
    # Not a whole factor: average four by four samples of each new texel.
    fine = texel_directions(height * 4 if height * 4 <= panorama.shape[0] * 2 else height * 2)
    return shrink(lookup(panorama, fine).astype(np.float32), fine.shape[0] // height)
