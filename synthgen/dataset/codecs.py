"""Arrays and JSON to bytes of PNG, EXR, NPZ and JSON, deterministic byte for byte, and back."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from typing import Any

import numpy as np
from PIL import Image

_PNG = b"\x89PNG\r\n\x1a\n"


def encode_png(array: np.ndarray) -> bytes:
    """(H, W), (H, W, 3) or (H, W, 4) uint8."""
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()


def decode_png(data: bytes) -> np.ndarray:
    """The inverse of `encode_png`; `ValueError` if a checksum in the file does not hold."""
    _check_png(data)
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image)


def _check_png(data: bytes) -> None:
    """Compare the CRC of every chunk, of which Pillow skips those of the pixels."""
    position = len(_PNG)
    if not data.startswith(_PNG):
        raise ValueError("not a PNG")
    kind = b""
    while kind != b"IEND":
        length, kind = int.from_bytes(data[position : position + 4]), data[position + 4 :][:4]
        end = position + 8 + length
        if data[end : end + 4] != zlib.crc32(data[position + 4 : end]).to_bytes(4):
            raise ValueError("changed since it was written (CRC)")
        position = end + 4
    if position != len(data):
        raise ValueError("bytes after its end")


def encode_exr(planes: dict[str, np.ndarray]) -> bytes:
    """One scan-line EXR, ZIP-compressed, from (H, W) planes of float16 or float32."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    buffer = io.BytesIO()
    contiguous = {name: np.ascontiguousarray(plane) for name, plane in planes.items()}
    OpenEXR.File(header, contiguous, num_threads=0).write(buffer)
    return buffer.getvalue()


def decode_exr(data: bytes) -> dict[str, np.ndarray]:
    """Channel name -> (H, W) plane, in the type it is stored in."""
    import OpenEXR

    file = OpenEXR.File(io.BytesIO(data), separate_channels=True, num_threads=0)
    return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def encode_npz(arrays: dict[str, np.ndarray]) -> bytes:
    """A compressed NPZ with sorted names and fixed dates."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(arrays):
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(arrays[name]), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content.getvalue())
    return buffer.getvalue()


def decode_npz(data: bytes) -> dict[str, np.ndarray]:
    """The inverse of `encode_npz`; `BadZipFile` if a checksum in the file does not hold."""
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for entry in archive.namelist():
            # Read to the end, where the checksum is compared; numpy stops at the last number.
            content = io.BytesIO(archive.read(entry))
            array = np.lib.format.read_array(content, allow_pickle=False)
            arrays[entry.removesuffix(".npy")] = array
    return arrays


def encode_json(value: Any) -> bytes:
    """Compact UTF-8 JSON with sorted keys; `ValueError` for NaN and Inf."""
    text = json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"), default=_plain)
    return text.encode()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} does not go to JSON")
