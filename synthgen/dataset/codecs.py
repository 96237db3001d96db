"""Arrays and JSON to bytes of PNG, EXR, NPZ and JSON, deterministic byte for byte, and back.

What is decoded may come from anybody. Each decoder takes its one format alone, as it is written
here, and looks at what the bytes claim to hold before it makes room for that: beyond `most` bytes
it raises `ValueError`, as it does for damage.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
import zlib
from typing import Any

import numpy as np
from PIL import Image

from assets_procedural.conventions import console
from assets_procedural.conventions.pictures import open_picture

LARGEST = 4 << 30
"""Bytes that the arrays of one sample, or one panorama, may take once they are decoded."""
_ARRAYS = 1000  # of an NPZ
_PNG = b"\x89PNG\r\n\x1a\n"


def encode_png(array: np.ndarray) -> bytes:
    """(H, W), (H, W, 3) or (H, W, 4) uint8."""
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()


def decode_png(data: bytes, most: int = LARGEST) -> np.ndarray:
    """The inverse of `encode_png`; `ValueError` if a checksum in the file does not hold."""
    _check_png(data)
    with open_picture(data) as image:
        if image.mode not in ("L", "RGB", "RGBA"):
            raise ValueError(f"is a PNG of mode {image.mode}, not of 8 bits in grey, RGB or RGBA")
        _check_room(image.width * image.height * len(image.getbands()), most)
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


def decode_exr(data: bytes, most: int = LARGEST) -> dict[str, np.ndarray]:
    """Channel name -> (H, W) plane, in the type it is stored in."""
    import OpenEXR

    with console.without_chatter():
        parts = OpenEXR.File(io.BytesIO(data), separate_channels=True, header_only=True).parts
        header = parts[0].header
        if len(parts) != 1 or header["type"] != OpenEXR.scanlineimage:
            raise ValueError("is an EXR of several parts, of tiles or of depths, not of scan lines")
        if any((c.xSampling, c.ySampling) != (1, 1) for c in header["channels"]):
            raise ValueError("is an EXR with channels of several sizes")
        low, high = (corner.tolist() for corner in header["dataWindow"])
        width, height = (b - a + 1 for a, b in zip(low, high, strict=True))
        _check_room(width * height * 4 * len(header["channels"]), most)
        file = OpenEXR.File(io.BytesIO(data), separate_channels=True, num_threads=0)
        if not file.parts:  # it leaves out what it cannot read
            raise ValueError("is an EXR whose pixels are damaged")
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


def decode_npz(data: bytes, most: int = LARGEST) -> dict[str, np.ndarray]:
    """The inverse of `encode_npz`; `ValueError` if a checksum in the file does not hold."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > _ARRAYS:
                raise ValueError(f"holds {len(entries)} arrays; at most {_ARRAYS} are read")
            for entry in entries:
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError(f"{entry.filename[:40]!r} is packed in another way than ours")
            # An entry gives no more bytes than it claims. It is read to its end, where its
            # checksum is compared.
            _check_room(sum(entry.file_size for entry in entries), most)
            return {e.filename.removesuffix(".npy"): _array(archive.read(e)) for e in entries}
    # RuntimeError: zipfile's word for encrypted entries and, as NotImplementedError, for packing it
    # does not know.
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise ValueError(f"is damaged: {error}") from None


def _array(content: bytes) -> np.ndarray:
    """An array of numbers from the bytes of a .npy, which must be exactly as many as it claims."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in read:
        raise ValueError(f"holds an array of format {version}")
    shape, fortran, kind = read[version](file)
    if kind.kind not in "biuf" or kind.subdtype is not None:
        raise ValueError(f"holds an array of {kind}, not of numbers")
    if math.prod(shape) * kind.itemsize != len(content) - file.tell():
        raise ValueError(f"holds an array that claims the shape {shape} and has another size")
    flat = np.frombuffer(content, kind, offset=file.tell())
    return flat.reshape(shape, order="F" if fortran else "C").copy()


def _check_room(size: int, most: int) -> None:
    if size > most:
        raise ValueError(f"claims {size:,} bytes once it is decoded; at most {most:,} are left")


def encode_json(value: Any) -> bytes:
    """Compact UTF-8 JSON with sorted keys; `ValueError` for NaN and Inf."""
    text = json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"), default=_plain)
    return text.encode()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} does not go to JSON")
