"""Edited pictures as files: PNG, MP4 with the motion's sound, or a folder of PNGs.

All say in their metadata what they are (IPTC's digital source type, as XMP), and appear whole or
not at all.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import struct
import uuid
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from assets_procedural.conventions.files import replacing, write_atomically
from totalediting.data import frames
from totalediting.errors import InputError

SOURCE_TYPE = "http://cv.iptc.org/newscodes/digitalsourcetype/compositeSynthetic"
"""IPTC: a composite of which at least one element is synthetic."""
XMP_BOX = uuid.UUID("be7acfcb-97a9-42e8-9c71-999491e3afac")
"""Of the ISO base media file format's box that holds XMP."""
_XMP = f"""<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:Iptc4xmpExt="http://iptc.org/std/Iptc4xmpExt/2008-02-29/"
 xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmp:CreatorTool="totalediting"
 Iptc4xmpExt:DigitalSourceType="{SOURCE_TYPE}"/>
</rdf:RDF></x:xmpmeta>
<?xpacket end="w"?>"""
_TICKS = 90_000  # a second
_HIGH_DEFINITION = 720  # lines from which colours are Rec.709's; below, Rec.601's


def png(picture: np.ndarray) -> bytes:
    """The file of a picture (H, W[, 3]) uint8."""
    note = PngInfo()
    note.add_itxt("XML:com.adobe.xmp", _XMP)
    target = io.BytesIO()
    Image.fromarray(picture).save(target, "PNG", pnginfo=note)
    return target.getvalue()


def write_picture(path: Path, picture: np.ndarray) -> None:
    """A PNG of (H, W[, 3]) uint8."""
    write_atomically(path, png(picture))


def write_folder(folder: Path, pictures: Iterator[np.ndarray]) -> None:
    """PNGs 000000.png, 000001.png, … in a new folder."""
    with new_folder(folder) as made:
        for number, picture in enumerate(pictures):
            (made / f"{number:06d}.png").write_bytes(png(picture))


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A folder to fill, which appears as `folder`, whole or not at all."""
    made = folder.with_name(f".{folder.name}.{os.getpid()}.tmp")
    made.mkdir()
    try:
        yield made
        made.rename(folder)
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        raise


def write_video(
    path: Path,
    pictures: Iterator[np.ndarray],
    seconds: list[float],
    shape: tuple[int, ...],
    sound: Path | None,
) -> None:
    """H.264 of pictures (H, W, 3) uint8 of `shape`, shown at rising `seconds`, of even width and
    height; with the sound of a video, if it has any, as AAC."""
    with replacing(path) as file:
        with av.open(file.name, "w", format="mp4", options={"movflags": "faststart"}) as container:
            stream: Any = container.add_stream("h264", rate=_rate(seconds), options={"crf": "18"})
            height, width = (size - size % 2 for size in shape[:2])
            stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
            stream.codec_context.time_base = Fraction(1, _TICKS)
            wide = height >= _HIGH_DEFINITION
            stream.codec_context.colorspace = 1 if wide else 6  # as H.264 numbers them
            stream.codec_context.color_range = 1
            with _sound(sound, container) as sounds:
                for picture, time in zip(pictures, seconds, strict=True):
                    frame = av.VideoFrame.from_ndarray(
                        np.ascontiguousarray(picture[:height, :width]), format="rgb24"
                    ).reformat(
                        format="yuv420p",
                        dst_colorspace="ITU709" if wide else "ITU601",
                        dst_color_range="MPEG",
                    )
                    frame.pts, frame.time_base = round(time * _TICKS), Fraction(1, _TICKS)
                    container.mux(stream.encode(frame))
                container.mux(stream.encode())
                for packet in sounds(seconds[-1] + 1 / float(_rate(seconds))):
                    container.mux(packet)
        with open(file.name, "ab") as end:
            content = _XMP.encode()
            end.write(struct.pack(">I4s", 24 + len(content), b"uuid") + XMP_BOX.bytes + content)


def _rate(seconds: list[float]) -> Fraction:
    span = seconds[-1] - seconds[0]
    if len(seconds) < 2 or span <= 0:
        return Fraction(25)
    return Fraction((len(seconds) - 1) / span).limit_denominator(1001)


@contextlib.contextmanager
def _sound(source: Path | None, container: Any) -> Iterator[Any]:
    """A function from the seconds at which to end to packets of a video's sound."""
    if source is None or not source.is_file():
        yield lambda end: []
        return
    with av.open(str(source)) as opened:
        if not opened.streams.audio:
            yield lambda end: []
            return
        heard: Any = opened.streams.audio[0]
        rate = heard.rate or 48_000
        out: Any = container.add_stream("aac", rate=rate, layout="stereo")
        resampler = av.AudioResampler(format="fltp", layout="stereo", rate=rate)
        index = frames.index_video(source)
        base = opened.streams[index.stream].time_base
        start = float(index.pts[0] * base) if base else 0.0

        def packets(end: float) -> Iterator[Any]:
            try:
                for frame in opened.decode(heard):
                    if frame.time is not None and not 0 <= frame.time - start < end:
                        continue
                    for part in resampler.resample(frame):
                        if part.pts is not None:
                            part.pts -= round(start * rate)
                        yield from out.encode(part)
            except FFmpegError as error:
                raise InputError(f"{source}: its sound is damaged ({error}); mend it") from None
            yield from out.encode()

        yield packets
