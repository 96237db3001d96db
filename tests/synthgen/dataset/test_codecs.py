"""Decoders take one format each, and look at what bytes claim before they make room."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from synthgen.dataset import codecs

ROOT = Path(__file__).parents[3]


def chunk(name: bytes, content: bytes) -> bytes:
    check = struct.pack(">I", zlib.crc32(name + content))
    return struct.pack(">I", len(content)) + name + content + check


def png(width: int, height: int) -> bytes:
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    pixels = chunk(b"IDAT", zlib.compress(bytes(1000)))
    return b"\x89PNG\r\n\x1a\n" + head + pixels + chunk(b"IEND", b"")


def picture(format_: str, mode: str = "RGB") -> bytes:
    buffer = io.BytesIO()
    Image.new(mode, (4, 4)).save(buffer, format_)
    return buffer.getvalue()


def archive(content: bytes, compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as file:
        file.writestr("x.npy", content)
    return buffer.getvalue()


def npy(shape: tuple[int, ...], content: bytes, kind: str = "<f4") -> bytes:
    buffer = io.BytesIO()
    header = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue() + content


def exr(claim: tuple[int, int]) -> bytes:
    content = codecs.encode_exr({"R": np.zeros((4, 4), np.float32)})
    at = content.index(b"dataWindow\0box2i\0") + 21
    return content[:at] + struct.pack("<4i", 0, 0, claim[0] - 1, claim[1] - 1) + content[at + 16 :]


def tiled() -> bytes:
    buffer = io.BytesIO()
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": OpenEXR.TileDescription(),
    }
    OpenEXR.File(header, {"R": np.zeros((4, 4), np.float32)}).write(buffer)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("decode", "data", "reason"),
    [
        (codecs.decode_png, b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n", "PNG"),
        *((codecs.decode_png, picture(f), "PNG") for f in ("GIF", "TIFF", "JPEG", "BMP", "EPS")),
        (codecs.decode_png, picture("PNG", "P"), "mode P"),
        (codecs.decode_png, picture("PNG", "I;16"), "mode I;16"),
        (codecs.decode_png, png(60_000, 60_000), "at most"),
        (codecs.decode_png, png(2_000_000_000, 1), "at most"),
        (codecs.decode_exr, exr((1 << 20, 1 << 20)), "claims"),
        (codecs.decode_exr, tiled(), "tiles"),
        (codecs.decode_npz, archive(npy((10**6, 10**6), b"")), "claims the shape"),
        (codecs.decode_npz, archive(npy((1,), b"\x80\x04N.", "|O")), "not of numbers"),
        (codecs.decode_npz, archive(npy((1,), bytes(8), "<U2")), "not of numbers"),
        (codecs.decode_npz, archive(npy((1,), bytes(4)), zipfile.ZIP_LZMA), "another way"),
        (codecs.decode_npz, b"PK nonsense", "damaged"),
    ],
)
def test_what_is_not_as_we_write_it_is_refused(
    decode: Callable[[bytes], object], data: bytes, reason: str
):
    with pytest.raises(ValueError, match=reason):
        decode(data)


@pytest.mark.parametrize(
    ("decode", "data"),
    [
        (codecs.decode_png, codecs.encode_png(np.zeros((64, 64, 3), np.uint8))),
        (codecs.decode_exr, codecs.encode_exr({"R": np.zeros((64, 64), np.float32)})),
        (codecs.decode_npz, codecs.encode_npz({"x": np.zeros(4096, np.float32)})),
    ],
)
def test_what_takes_more_room_than_there_is_is_refused(decode: Callable[..., object], data: bytes):
    decode(data)
    with pytest.raises(ValueError, match=r"claims [\d,]+ bytes"):
        decode(data, most=10_000)


def test_arrays_keep_their_order_and_type():
    arrays = {
        "rows": np.arange(6, dtype=np.int64).reshape(2, 3),
        "columns": np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
        "none": np.zeros((0, 3), np.float64),
        "one": np.array(3.5),
    }
    decoded = codecs.decode_npz(codecs.encode_npz(arrays))
    for name, array in arrays.items():
        assert decoded[name].dtype == array.dtype
        np.testing.assert_array_equal(decoded[name], array)
        decoded[name][...] = 0  # they may be written to


def test_every_picture_is_opened_as_one_format():
    for package in ("assets_procedural", "synthgen", "totalediting"):
        for path in (ROOT / package).rglob("*.py"):
            for call in re.findall(r"Image\.open\(.*", path.read_text()):
                assert "formats=[" in call, f"{path}: {call}"


def test_a_damaged_exr_is_one_error_and_no_lines_of_its_library(capfd: pytest.CaptureFixture[str]):
    whole = codecs.encode_exr({"R": np.linspace(0, 1, 4096, dtype=np.float32).reshape(64, 64)})
    for damaged in (whole[: len(whole) // 2], whole[:500] + bytes(300) + whole[800:]):
        with pytest.raises(ValueError, match="pixels are damaged"):
            codecs.decode_exr(damaged)
    assert capfd.readouterr() == ("", "")
