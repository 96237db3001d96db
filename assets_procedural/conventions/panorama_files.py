"""Reading panoramas from .exr and .hdr files, and writing .exr.

OpenImageIO and OpenEXR are imported where they are used: the command line imports this module.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.errors import UserError
from assets_procedural.conventions.files import replacing
from assets_procedural.conventions.panorama import resize

_HALF_MAX = 65504.0


class PanoramaError(UserError, ValueError):
    """A panorama file that cannot be used; the message names file, fault and remedy."""


def load(path: Path, max_width: int | None = None) -> np.ndarray:
    """Read an .exr or .hdr panorama as (H, 2H, 3) float32, linear Rec.709, all values >= 0.

    Small negatives (ringing of a resampling) become 0. A panorama wider than `max_width` is
    area-averaged.

    Raises:
        PanoramaError: missing, unreadable, not RGB, not 2:1, NaN or Inf, black, or low dynamic
            range.
    """
    import OpenImageIO as oiio

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
        panorama = resize(panorama, max_width)
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
    # At most 1 everywhere: a photograph saved as float gives itself away by its 256 levels or by
    # highlights clipped to one value.
    levels = max(len(np.unique(panorama[..., channel])) for channel in range(3))
    clipped = float(np.mean(panorama == high))
    if levels <= 256 or clipped > 5e-4:
        sign = f"only {levels} levels" if levels <= 256 else f"{clipped:.1%} clipped at {high:g}"
        raise PanoramaError(
            f"{path}: is a low dynamic range image in a float file ({sign}, nothing above 1); "
            "use a true HDR panorama"
        )


def write(path: Path, panorama: np.ndarray, header: dict[str, Any]) -> None:
    """Store a panorama atomically as EXR (ZIP; half, or float where half would overflow).

    `header` goes into the file as string attributes, dicts and lists as JSON. Equal input gives
    equal bytes.
    """
    if panorama.ndim != 3 or panorama.shape[2] != 3 or panorama.shape[1] != 2 * panorama.shape[0]:
        raise ValueError(f"a panorama is (H, 2H, 3), not {panorama.shape}")
    precision = np.float16 if float(panorama.max()) <= _HALF_MAX else np.float32
    write_channels(path, {"RGB": panorama.astype(precision)}, header)


def write_channels(path: Path, channels: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Store arrays of equal height and width atomically as EXR (ZIP), in their own precision.

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
    with replacing(path) as file:
        try:
            OpenEXR.File(attributes, data).write(file.name)
        except RuntimeError as error:
            raise OSError(f"{path}: cannot be written ({error})") from None


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
