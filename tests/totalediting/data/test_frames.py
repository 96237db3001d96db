"""Frames are what a player shows."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image, ImageOps

from totalediting.data.frames import (
    Turn,
    best_stream,
    index_video,
    is_litter,
    read_picture,
    read_video,
)

QUARTERS = np.array([[30, 90], [150, 220]], np.uint8)
"""Grey levels of the quarters of a frame: no turn leaves it as it is."""
TURNS = [Turn(t, r, c) for t in (False, True) for r in (False, True) for c in (False, True)]


def quarters(height: int = 48, width: int = 64) -> np.ndarray:
    grey = np.kron(QUARTERS, np.ones((height // 2, width // 2), np.uint8))
    return np.repeat(grey[..., None], 3, axis=-1)


def write_video(
    path: Path,
    levels: list[int],
    times: list[int] | None = None,
    size: tuple[int, int] = (64, 48),
    aspect: Fraction | None = None,
) -> Path:
    """A video whose k-th frame has grey level k, at these times in hundredths of a second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=100)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 100)
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        for k, level in enumerate(levels):
            picture = np.full((size[1], size[0], 3), level, np.uint8)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = 10 * k if times is None else times[k]
            frame.time_base = Fraction(1, 100)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def turned_video(path: Path, a: int, b: int, c: int, d: int) -> Path:
    """A video of `quarters` whose header has this display matrix."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(2):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(quarters(), format="rgb24")))
        container.mux(stream.encode())
    content = bytearray(path.read_bytes())
    identity = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    start = content.index(identity, content.index(b"tkhd"))
    matrix = struct.pack(">9i", a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)
    content[start : start + 36] = matrix
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_turned_as_its_tag_says(tmp_path: Path, orientation: int):
    path = tmp_path / "p.png"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(quarters()).save(path, exif=exif)
    stored, turn = read_picture(path)
    with Image.open(path) as image:
        shown = np.asarray(ImageOps.exif_transpose(image))
    assert np.array_equal(turn.pixels(stored), shown)


@pytest.mark.parametrize(
    ("matrix", "corner"),
    [
        ((1, 0, 0, 1), QUARTERS),
        ((0, 1, -1, 0), np.rot90(QUARTERS, -1)),
        ((-1, 0, 0, -1), np.rot90(QUARTERS, 2)),
        ((0, -1, 1, 0), np.rot90(QUARTERS, 1)),
        ((-1, 0, 0, 1), QUARTERS[:, ::-1]),
        ((1, 0, 0, -1), QUARTERS[::-1]),
    ],
)
def test_a_video_is_turned_by_its_display_matrix(
    tmp_path: Path, matrix: tuple[int, int, int, int], corner: np.ndarray
):
    path = turned_video(tmp_path / "v.mp4", *matrix)
    (frame,), turn = read_video(path, index_video(path), [1])
    shown = turn.pixels(frame)[..., 0]
    height, width = shown.shape
    centres = shown[height // 4 :: height // 2, width // 4 :: width // 2]
    np.testing.assert_allclose(centres, corner, atol=4)


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_normals_turn_with_their_picture(turn: Turn):
    rng = np.random.default_rng(0)
    heights = rng.random((6, 9)).cumsum(0).cumsum(1)

    def normals(surface: np.ndarray) -> np.ndarray:
        """Of the surface, x right, y up: its slopes as colours."""
        down, right = np.gradient(surface)
        slopes = np.stack([-right, down, np.ones_like(surface)], axis=-1)
        unit = slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)
        return np.round((unit + 1) * 127.5)

    stored = normals(heights).astype(np.uint8)
    shown = normals(turn.pixels(heights[..., None])[..., 0])
    assert np.abs(turn.normals(stored).astype(float) - shown).max() <= 1


def test_sixteen_bits_of_grey_are_scaled(tmp_path: Path):
    levels = np.array([[0, 16384], [32768, 65535]], np.uint16)
    Image.fromarray(levels).save(tmp_path / "g.png")
    stored, _ = read_picture(tmp_path / "g.png")
    assert stored[..., 0].tolist() == [[0, 64], [128, 255]]


def test_frames_of_any_rate_are_all_reached(tmp_path: Path):
    levels = [20, 60, 100, 140, 180, 220]
    path = write_video(tmp_path / "v.mp4", levels, times=[37, 39, 41, 43, 143, 643])
    index = index_video(path)
    frames, _ = read_video(path, index, [5, 0, 3, 1, 4, 2])
    assert len(index.pts) == 6
    np.testing.assert_allclose([f.mean() for f in frames], [220, 20, 140, 60, 180, 100], atol=4)


def test_pixels_that_are_not_square_are_stretched(tmp_path: Path):
    path = write_video(tmp_path / "v.mp4", [10, 200], aspect=Fraction(4, 3))
    (frame,), _ = read_video(path, index_video(path), [0])
    assert frame.shape == (48, 85, 3)


@pytest.mark.parametrize(("lines", "rec709"), [(480, False), (720, True)])
def test_untagged_colours_are_those_that_players_take(tmp_path: Path, lines: int, rec709: bool):
    path = tmp_path / "v.mkv"
    # Pure green in video range by Rec.709: Y 173, Cb 42, Cr 26.
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, lines, "yuv420p"
        frame = av.VideoFrame(64, lines, "yuv420p")
        for plane, value in zip(frame.planes, (173, 42, 26), strict=True):
            plane.update(bytes([value]) * plane.buffer_size)
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    (shown,), _ = read_video(path, index_video(path), [0])
    red, green, blue = shown[lines // 2, 32].astype(int)
    assert (red < 12 and blue < 12 and green > 243) == rec709


def test_a_cover_is_not_the_video(tmp_path: Path):
    path = tmp_path / "v.mkv"
    with av.open(str(path), "w") as container:
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 128, 96, "yuvj420p"
        talk = container.add_stream("mpeg4", rate=10)
        talk.width, talk.height, talk.pix_fmt = 64, 48, "yuv420p"
        still = np.zeros((96, 128, 3), np.uint8)
        container.mux(cover.encode(av.VideoFrame.from_ndarray(still, format="rgb24")))
        container.mux(cover.encode())
        for _ in range(3):
            container.mux(talk.encode(av.VideoFrame.from_ndarray(quarters(), format="rgb24")))
        container.mux(talk.encode())
    with av.open(str(path)) as container:
        assert best_stream(container).width == 64
    assert len(index_video(path).pts) == 3


def test_only_the_format_of_the_suffix_is_decoded(tmp_path: Path):
    script = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"
    for name in ("a.png", "b.jpg"):
        (tmp_path / name).write_bytes(script)
        with pytest.raises((ValueError, OSError)):
            read_picture(tmp_path / name)
    Image.new("RGB", (8, 8)).save(tmp_path / "c.png", "JPEG")
    with pytest.raises((ValueError, OSError)):
        read_picture(tmp_path / "c.png")


def test_a_bomb_is_refused_unread(tmp_path: Path):
    path = tmp_path / "bomb.png"
    Image.new("1", (30_000, 30_000)).save(path)
    with pytest.raises(ValueError, match="pixels"):
        read_picture(path)


def test_litter_of_operating_systems_is_known():
    assert all(map(is_litter, ("._0001.png", ".DS_Store", "Thumbs.db", "desktop.ini")))
    assert not is_litter("0001.png")
