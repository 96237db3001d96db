"""Equirectangular panoramas: the direction-pixel convention, lookup, files.

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

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.errors import UserError
from assets_procedural.mesh.vectors import arctan2

HALF_MAX = 65504.0


class PanoramaError(UserError, ValueError):
    """A panorama file that cannot be used; the message names file, fault and remedy."""


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
    weight = texel_solid_angles(height).reshape(height // factor, factor, 1, 1, 1)
    mean = (blocks * weight).sum(axis=(1, 3)) / (weight.sum(axis=(1, 3)) * factor)
    return mean.astype(panorama.dtype)


def load(path: Path, max_width: int | None = None) -> np.ndarray:
    """Read an .exr or .hdr panorama as (H, 2H, 3) float32, linear Rec.709, all values >= 0.

    Small negatives (ringing of a resampling) become 0. A panorama wider than `max_width` is
    area-averaged.

    Raises:
        PanoramaError: missing, unreadable, not RGB, not 2:1, NaN or Inf, black, or low dynamic
            range.
    """
    import OpenImageIO as oiio  # here: a quick import of this module matters to the command line

    if not path.is_file():
        raise PanoramaError(f"{path}: no such file; give an existing .exr or .hdr panorama")
    image = oiio.ImageInput.open(str(path))
    if image is None:
        reason = oiio.geterror().splitlines() or ["unknown format"]
        raise PanoramaError(f"{path}: cannot be read ({reason[0]}); export it as .exr or .hdr")
    try:
        spec = image.spec()
        if spec.format.basetype not in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE):
            raise PanoramaError(
                f"{path}: stores {spec.format} integers, low dynamic range; "
                "use an .exr or .hdr with linear float radiance"
            )
        if spec.width != 2 * spec.height or spec.height < 2:
            raise PanoramaError(
                f"{path}: is {spec.width} x {spec.height}, an equirectangular panorama is twice "
                "as wide as high; crop or convert it to 2:1"
            )
        names = [name.upper() for name in spec.channelnames]
        if all(name in names for name in "RGB"):
            channels = [names.index(name) for name in "RGB"]
        elif spec.nchannels == 1:
            channels = [0, 0, 0]
        else:
            raise PanoramaError(
                f"{path}: has channels {', '.join(spec.channelnames)}; R, G and B are needed"
            )
        pixels = image.read_image(0, 0, 0, spec.nchannels, oiio.FLOAT)
        if pixels is None:
            raise PanoramaError(
                f"{path}: is damaged ({image.geterror().splitlines()[0]}); copy or export it again"
            )
    finally:
        image.close()
    panorama = np.ascontiguousarray(pixels[..., channels], dtype=np.float32)
    _check_radiance(path, panorama)
    np.maximum(panorama, 0.0, out=panorama)
    if max_width is not None and panorama.shape[1] > max_width:
        panorama = _resize(panorama, max_width)
    return panorama


def _check_radiance(path: Path, panorama: np.ndarray) -> None:
    bad = int(np.count_nonzero(~np.isfinite(panorama)))
    if bad:
        raise PanoramaError(f"{path}: holds {bad} NaN or Inf values; repair or replace the file")
    low, high = float(panorama.min()), float(panorama.max())
    if high <= 0.0:
        raise PanoramaError(f"{path}: is black; an environment must emit light")
    if high > 1.0 or low == high:
        return
    # At most 1 everywhere: a photograph saved as float betrays itself by its 256 levels or by
    # highlights clipped to one value.
    levels = max(len(np.unique(panorama[..., channel])) for channel in range(3))
    clipped = float(np.mean(panorama == high))
    if levels <= 256 or clipped > 5e-4:
        sign = f"only {levels} levels" if levels <= 256 else f"{clipped:.1%} clipped at {high:g}"
        raise PanoramaError(
            f"{path}: is a low dynamic range image in a float file ({sign}, nothing above 1); "
            "use a true HDR panorama"
        )


def _resize(panorama: np.ndarray, width: int) -> np.ndarray:
    height = width // 2
    factor = panorama.shape[0] // height
    if factor * height == panorama.shape[0]:
        return shrink(panorama, factor)
    # Not a whole factor: average four by four samples of each new texel.
    fine = texel_directions(height * 4 if height * 4 <= panorama.shape[0] * 2 else height * 2)
    return shrink(lookup(panorama, fine).astype(np.float32), fine.shape[0] // height)


def write(path: Path, panorama: np.ndarray, header: dict[str, Any]) -> None:
    """Store a panorama atomically as EXR (ZIP; half, or float where half would overflow).

    `header` goes into the file as string attributes, dicts and lists as JSON. Equal input gives
    equal bytes.
    """
    if panorama.ndim != 3 or panorama.shape[2] != 3 or panorama.shape[1] != 2 * panorama.shape[0]:
        raise ValueError(f"a panorama is (H, 2H, 3), not {panorama.shape}")
    precision = np.float16 if float(panorama.max()) <= HALF_MAX else np.float32
    write_channels(path, {"RGB": panorama.astype(precision)}, header)


def write_channels(path: Path, channels: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Store arrays of one height and width atomically as EXR (ZIP), in the precision they have.

    An array (H, W) becomes the channel of its name; one (H, W, 3) the channels <name>.R, .G and .B,
    or R, G and B if its name is "RGB". `header` as in `write`. Equal input gives equal bytes.

    Raises:
        OSError: the file cannot be written.
    """
    import OpenEXR

    attributes: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
    }
    attributes |= encode_header(header)
    data = {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}
    with replacing(path) as temporary:
        try:
            OpenEXR.File(attributes, data).write(str(temporary))
        except RuntimeError as error:
            raise OSError(f"{path}: cannot be written ({error})") from None


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Where to write a file that then appears as `path` whole, or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        with open(temporary, "rb") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def encode_header(header: dict[str, Any]) -> dict[str, str]:
    """Header values as the strings that an EXR attribute holds."""
    return {
        key: value if isinstance(value, str) else json.dumps(value, sort_keys=True)
        for key, value in header.items()
    }


def read_header(path: Path) -> dict[str, Any]:
    """The attributes that `write` stored."""
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        return {key: value for key, value in file.header().items() if isinstance(value, str)}
