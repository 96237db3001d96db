"""Frames as a player shows them: pictures and videos to (H, W, 3) uint8, upright.

Applied, or refused with `ValueError`: EXIF orientation and display matrices, 16-bit grey, sample
aspect ratios, the matrix of untagged colours, presentation times. Names are `Turn`s: what takes
stored pixels to those shown, for pictures and for the vectors of a normal map alike.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.stream import Disposition
from PIL import Image

PICTURES = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    ".bmp": "BMP",
}
"""Suffix -> the one format that such a file may have."""
LARGEST = 100_000_000
"""Pixels of a picture or frame; beyond it is a decompression bomb."""
_HIGH_DEFINITION = 720  # lines from which untagged colours are Rec.709's, as players have it


@dataclass(frozen=True)
class Turn:
    """From stored to shown pixels: transpose first, then flip rows (up-down) and columns."""

    transpose: bool = False
    rows: bool = False
    columns: bool = False

    def pixels(self, stored: np.ndarray) -> np.ndarray:
        """(h, w, …) as it is shown."""
        shown = stored.swapaxes(0, 1) if self.transpose else stored
        return np.ascontiguousarray(shown[:: -1 if self.rows else 1, :: -1 if self.columns else 1])

    def normals(self, colours: np.ndarray) -> np.ndarray:
        """Normals as colours (h, w, 3) uint8, (n + 1) / 2: pixels and vectors turned."""
        shown = self.pixels(colours)
        x, y, z = (shown[..., k] for k in range(3))
        if self.transpose:  # right becomes down, so up becomes left
            x, y = 255 - y, 255 - x
        if self.columns:
            x = 255 - x
        if self.rows:
            y = 255 - y
        return np.stack([x, y, z], axis=-1)


UPRIGHT = Turn()
_EXIF = {
    1: UPRIGHT,
    2: Turn(columns=True),
    3: Turn(rows=True, columns=True),
    4: Turn(rows=True),
    5: Turn(transpose=True),
    6: Turn(transpose=True, columns=True),
    7: Turn(transpose=True, rows=True, columns=True),
    8: Turn(transpose=True, rows=True),
}


def is_litter(name: str) -> bool:
    """Whether a file is what operating systems leave behind: `._0001.png`, `Thumbs.db`."""
    return name.startswith(".") or name.lower() in ("thumbs.db", "desktop.ini")


def read_picture(path: Path) -> tuple[np.ndarray, Turn]:
    """A picture as stored, (h, w, 3) uint8, and its turn.

    Raises:
        ValueError, OSError: it is damaged, too large, or not of the format of its suffix.
    """
    kind = PICTURES.get(path.suffix.lower())
    if kind is None:
        raise ValueError(f"{path.name}: not one of {', '.join(PICTURES)}")
    if not path.is_file():  # a pipe would block
        raise ValueError(f"{path.name} is not a file")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            # The format is pinned: others, PostScript for one, run programs.
            with Image.open(path, formats=[kind]) as image:
                if image.width * image.height > LARGEST:
                    raise ValueError(f"{path.name} is {image.width} x {image.height} pixels")
                turn = _EXIF.get(image.getexif().get(0x0112, 1), UPRIGHT)
                return _eight_bits(image), turn
        except (Image.DecompressionBombError, SyntaxError) as error:
            raise ValueError(f"{path.name}: {error}") from None


def _eight_bits(image: Image.Image) -> np.ndarray:
    """(h, w, 3) uint8; deeper grey is scaled, where Pillow would clip it."""
    if image.mode.startswith("I"):
        grey = np.asarray(image).astype(np.float64) / 257.0
        grey = np.clip(np.round(grey), 0, 255).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)
    if image.mode == "F":
        raise ValueError("holds floats; store 8 or 16 bits")
    return np.array(image.convert("RGB"))


@dataclass(frozen=True)
class VideoIndex:
    """Which frames a video has: of stream `stream`, at presentation times `pts` (F,), ticks."""

    stream: int
    pts: tuple[int, ...]


def index_video(path: Path) -> VideoIndex:
    """Find the video's pictures by reading its packets once.

    Raises:
        ValueError, OSError, FFmpegError: there is no video in it, or it is damaged.
    """
    if not path.is_file():
        raise ValueError(f"{path.name} is not a file")
    with av.open(str(path)) as container:
        stream = best_stream(container)
        packets = [packet for packet in container.demux(stream) if packet.pts is not None]
        if len(packets) < stream.frames:
            raise ValueError(
                f"{path.name} ends early: {len(packets)} of {stream.frames} frames are there"
            )
        times = {packet.pts for packet in packets if not packet.is_discard}
        return VideoIndex(stream.index, tuple(sorted(times)))


def best_stream(container: Any) -> Any:
    """The stream that a player shows: no cover picture; the default one, else the largest."""
    streams = [
        stream
        for stream in container.streams.video
        if not _attached(stream) and stream.width and stream.height
    ]
    # A cover that is not marked as one has a single packet; so it is only taken for want of others.
    moving = [s for s in streams if s.frames > 1 or s.codec_context.name not in _STILLS]
    streams = moving or streams
    if not streams:
        raise ValueError("has no video stream")
    return max(
        streams,
        key=lambda s: (bool(s.disposition & Disposition.default), s.width * s.height, -s.index),
    )


_STILLS = ("mjpeg", "png", "bmp", "gif", "webp", "tiff")


def _attached(stream: Any) -> bool:
    return bool(stream.disposition & (Disposition.attached_pic | Disposition.still_image))


def read_video(
    path: Path, index: VideoIndex, numbers: Sequence[int]
) -> tuple[list[np.ndarray], Turn]:
    """Frames by number, (h, w, 3) uint8 with square pixels, as stored, and their turn.

    Raises:
        ValueError, OSError, FFmpegError: a frame is damaged or missing.
    """
    pictures: dict[int, np.ndarray] = {}
    turn = UPRIGHT
    with av.open(str(path)) as container:
        stream = container.streams[index.stream]
        stream.codec_context.thread_count = 1  # the loader's workers are the threads
        for number in dict.fromkeys(numbers):
            wanted = index.pts[number]
            container.seek(wanted, stream=stream, backward=True, any_frame=False)
            for frame in container.decode(stream):
                if frame.pts is not None and frame.pts >= wanted:
                    if frame.pts > wanted:
                        raise ValueError(f"{path.name}: frame {number} is damaged")
                    pictures[number] = _shown_colours(frame, stream)
                    turn = _display_turn(frame)
                    break
            else:
                raise ValueError(f"{path.name} ends early: no frame {number} of {len(index.pts)}")
    return [pictures[number] for number in numbers], turn


def play_video(path: Path, index: VideoIndex) -> Iterator[tuple[float, np.ndarray]]:
    """All frames in their order: seconds, and (h, w, 3) uint8 upright with square pixels.

    Raises:
        ValueError, OSError, FFmpegError: a frame is damaged or missing.
    """
    wanted = iter(index.pts)
    expected = next(wanted, None)
    with av.open(str(path)) as container:
        stream = container.streams[index.stream]
        stream.codec_context.thread_count = 1  # as in `read_video`
        played: Any = container.decode(stream)
        for frame in played:
            if expected is None:
                return
            if frame.pts is None or frame.pts < expected:
                continue
            if frame.pts > expected:
                raise ValueError(f"{path.name}: the frame at {expected} ticks is damaged")
            seconds = float(frame.pts * frame.time_base)
            yield seconds, _display_turn(frame).pixels(_shown_colours(frame, stream))
            expected = next(wanted, None)
    if expected is not None:
        raise ValueError(f"{path.name} ends early: no frame at {expected} ticks")


def _shown_colours(frame: Any, stream: Any) -> np.ndarray:
    """A frame in RGB, by its own matrix and range, with square pixels."""
    if frame.width * frame.height > LARGEST:
        raise ValueError(f"frames of {frame.width} x {frame.height} pixels are too large")
    width, height = frame.width, frame.height
    aspect = stream.sample_aspect_ratio or Fraction(1)
    if aspect > 0 and aspect != 1:
        width = max(1, round(width * aspect))
    options: dict[str, Any] = {}
    if frame.colorspace == _UNSPECIFIED and frame.height >= _HIGH_DEFINITION:
        options["src_colorspace"] = "ITU709"
    shown = frame.reformat(width=width, height=height, format="rgb24", **options)
    return shown.to_ndarray()


_UNSPECIFIED = 2  # of AVColorSpace


def _display_turn(frame: Any) -> Turn:
    """Of the display matrix: x' = a x + c y, y' = b x + d y, for x right and y down."""
    for data in frame.side_data:  # a mapping that iterates over its values
        if data.type.name == "DISPLAYMATRIX":
            a, b, _, c, d = np.frombuffer(bytes(data), np.int32)[:5] / 65536.0
            break
    else:
        return UPRIGHT
    linear = np.array([[a, c], [b, d]])
    if np.abs(np.abs(linear) - np.eye(2)).max() < 1e-3:
        return Turn(rows=d < 0, columns=a < 0)
    if np.abs(np.abs(linear) - np.eye(2)[::-1]).max() < 1e-3:
        return Turn(transpose=True, rows=b < 0, columns=c < 0)
    raise ValueError("is turned by an angle that is not a quarter; turn its pixels")
