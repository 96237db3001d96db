"""Panoramas in Radiance files (.hdr): orientation, exposure, primaries."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.primaries import REC709
from assets_procedural.conventions.stored_panorama import (
    PanoramaError,
    StoredPanorama,
    check_fits,
    reason,
)

MAGIC = (b"#?RADIANCE", b"#?RGBE")
"""How a Radiance file begins."""
_ORIENTATIONS = {  # first axis, second axis -> (transpose, flip rows, flip columns)
    "-Y +X": (False, False, False),
    "-Y -X": (False, False, True),
    "+Y +X": (False, True, False),
    "+Y -X": (False, True, True),
    "+X -Y": (True, False, False),
    "-X -Y": (True, False, True),
    "+X +Y": (True, True, False),
    "-X +Y": (True, True, True),
}


def read_hdr(path: Path, largest: int | None) -> StoredPanorama:
    import OpenImageIO as oiio

    lines, orientation, (height, width), start = hdr_header(path)
    if "32-bit_rle_xyze" in lines.get("FORMAT", ["32-bit_rle_rgbe"]):
        raise PanoramaError(f"{path}: FORMAT=32-bit_rle_xyze is not supported; save it as RGBE")
    if unknown := set(lines.get("FORMAT", [])) - {"32-bit_rle_rgbe"}:
        raise PanoramaError(f"{path}: FORMAT={unknown.pop()} is not supported; save it as RGBE")
    gamma = [value for text in lines.get("GAMMA", []) for value in _floats(path, "GAMMA", text, 1)]
    if any(abs(value - 1.0) > 1e-3 for value in gamma):
        raise PanoramaError(f"{path}: GAMMA={gamma[0]:g}; save it with linear radiance, GAMMA=1")
    aspects = [
        value
        for text in lines.get("PIXASPECT", [])
        for value in _floats(path, "PIXASPECT", text, 1)
    ]
    if any(abs(value - 1.0) > 1e-3 for value in aspects):
        raise PanoramaError(f"{path}: PIXASPECT={aspects[0]:g}; resample it to square pixels")
    scale = np.ones(3)
    for text in lines.get("EXPOSURE", []):
        scale *= _floats(path, "EXPOSURE", text, 1)
    for text in lines.get("COLORCORR", []):
        scale *= _floats(path, "COLORCORR", text, 3)
    if not (np.isfinite(scale) & (scale > 0)).all():
        raise PanoramaError(f"{path}: EXPOSURE or COLORCORR is not above 0; mend its header")
    primaries = REC709
    if texts := lines.get("PRIMARIES"):
        primaries = tuple(_floats(path, "PRIMARIES", texts[-1], 8))
    check_fits(path, 12 * height * width, largest)
    _check_scanlines(path, start, height, width)
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise PanoramaError(f"{path}: is damaged ({reason(oiio.geterror())}); copy it again")
    try:
        pixels = image.read_image(0, 0, 0, 3, oiio.FLOAT)
        if pixels is None:
            raise PanoramaError(f"{path}: is damaged ({reason(image.geterror())}); copy it again")
    finally:
        image.close()
    pixels = np.asarray(pixels, np.float32).reshape(height, width, 3)
    transpose, rows, columns = _ORIENTATIONS[orientation]
    if transpose:
        pixels = pixels.transpose(1, 0, 2)
    pixels = pixels[:: -1 if rows else 1, :: -1 if columns else 1]
    pixels = np.ascontiguousarray(pixels)
    facts: dict[str, Any] = {}
    if orientation != "-Y +X":
        facts["orientation"] = orientation
    if (scale != 1.0).any():
        pixels /= scale.astype(np.float32)
        facts["exposure"] = scale.tolist()
    return StoredPanorama(
        pixels, display=(pixels.shape[1], pixels.shape[0]), primaries=primaries, facts=facts
    )


def hdr_header(path: Path) -> tuple[dict[str, list[str]], str, tuple[int, int], int]:
    """Variables, axes, (scanlines, their length) and where pixels start."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    found = re.search(rb"\n\r?\n([+-])([XY]) +(\d{1,7}) +([+-])([XY]) +(\d{1,7})[ \r]*\n", head)
    if found is None or found[2] == found[5]:
        raise PanoramaError(f"{path}: is damaged (no resolution line in its header); copy it again")
    variables: dict[str, list[str]] = {}
    for line in head[: found.start()].decode("latin-1").splitlines()[1:]:
        name, mark, value = line.partition("=")
        if mark and not line.startswith("#"):
            variables.setdefault(name.strip().upper(), []).append(value.strip())
    axes = f"{found[1].decode()}{found[2].decode()} {found[4].decode()}{found[5].decode()}"
    return variables, axes, (int(found[3]), int(found[6])), found.end()


def _floats(path: Path, name: str, text: str, count: int) -> list[float]:
    words = text.split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise PanoramaError(
            f"{path}: {name}={text[:40]}: {count} numbers are wanted; mend its header"
        )
    return values


def _check_scanlines(path: Path, start: int, height: int, width: int) -> None:
    """Refuse the run-length code of before 1991, which the library reads as pixels."""
    size = path.stat().st_size - start
    with path.open("rb") as file:
        file.seek(start)
        first = file.read(4)
        if first[:2] == b"\x02\x02" and len(first) == 4 and first[2] < 128:
            return
        file.seek(start)
        pixels = np.frombuffer(file.read(min(size, 4 * height * width)), np.uint8)
    pixels = pixels[: len(pixels) // 4 * 4].reshape(-1, 4)
    if (pixels[:, :3] == 1).all(axis=1).any():
        raise PanoramaError(
            f"{path}: has Radiance's old run-length code, which is not supported; save it again"
        )
