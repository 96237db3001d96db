"""Writing panoramas and other pixels as EXR with a header of our own; reading: `panorama_reading`.

OpenEXR is imported where it is used: the command line imports this module.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.files import replacing

_HALF_MAX = 65504.0


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
