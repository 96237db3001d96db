"""Small pictures of shots, kept in the cache folder under a size limit.

A thumbnail is named by the bytes that it shows: shard, place, size and time of change. So a shard
that is written anew gets new ones, and two datasets never mix.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import threading
from pathlib import Path

from assets_procedural.conventions.files import cache_folder, write_atomically
from synthgen.browse.shot.samples import Broken, Sample
from synthgen.dataset.codecs import decode_png
from synthgen.pictures.page import fit

SIZES = (96, 160, 240, 320, 480)
"""Widths that are drawn; a request gets the next larger one."""
LIMIT = 256 << 20
"""Bytes that the cache may hold."""
_LARGEST = 256 << 20  # bytes of a picture, once it is decoded
_decoding = threading.BoundedSemaphore(4)  # of them at once


class Thumbnails:
    """A cache of JPEG files; safe for several threads and processes."""

    def __init__(self, folder: Path | None = None, limit: int = LIMIT) -> None:
        self.folder = folder or cache_folder() / "thumbnails"
        self.limit = limit
        self._lock = threading.Lock()
        self._bytes: int | None = None

    def get(self, sample: Sample, environment: int, size: int) -> bytes:
        """A JPEG of one environment's picture, `size` wide at least (see `SIZES`).

        Raises `Broken` if the picture does not decode, `Refused` if there is no such environment.
        """
        width = next((s for s in SIZES if s >= size), SIZES[-1])
        name = f"rgb_{environment:02d}.png"
        sample.member(name)
        place = (*sample.place(), name, width)
        digest = hashlib.sha256(repr(place).encode()).hexdigest()
        kept = self.folder / digest[:2] / f"{digest}.jpg"
        with contextlib.suppress(OSError):
            data = kept.read_bytes()
            os.utime(kept)  # the least recently used go first
            return data
        data = draw(sample.read(name), width)
        with contextlib.suppress(OSError):  # without a disk for it, it is drawn every time
            write_atomically(kept, data)
            self._count(len(data))
        return data

    def _count(self, added: int) -> None:
        with self._lock:
            if self._bytes is None:
                self._bytes = sum(size for *_, size in self._files())
            else:
                self._bytes += added
            if self._bytes > self.limit:
                self._sweep()

    def _sweep(self) -> None:
        """Remove what was not looked at for longest, down to three quarters of the limit."""
        left = 0
        for _, path, size in sorted(self._files(), reverse=True):
            if left + size > 0.75 * self.limit:
                with contextlib.suppress(OSError):
                    path.unlink()
            else:
                left += size
        self._bytes = left

    def _files(self) -> list[tuple[float, Path, int]]:
        found = []
        for path in self.folder.glob("*/*.jpg"):
            with contextlib.suppress(OSError):
                stat = path.stat()
                found.append((stat.st_mtime, path, stat.st_size))
        return found


def draw(png: bytes, width: int) -> bytes:
    """A PNG scaled to `width` as JPEG; raises `Broken` if it does not decode."""
    try:
        with _decoding:
            pixels = decode_png(png, _LARGEST)
            height = min(max(1, round(width * pixels.shape[0] / pixels.shape[1])), 4 * width)
            buffer = io.BytesIO()
            fit(pixels, width, height).save(buffer, "JPEG", quality=86)
            return buffer.getvalue()
    except Exception as error:  # decoders raise whatever they like on damaged bytes
        lines = str(error).splitlines() or [type(error).__name__]
        raise Broken(f"the picture does not decode: {lines[0][:160]}") from None
