"""Panoramas in files: round trips, and what is refused with which reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from panoramas import hdr, save

from assets_procedural.conventions import panorama_files, panorama_reading
from assets_procedural.conventions.panorama_reading import PanoramaError


def test_write_read_round_trip_and_equal_bytes(tmp_path: Path) -> None:
    image = hdr()
    for name in ("a.exr", "b.exr"):
        panorama_files.write(tmp_path / name, image, {"source": "here", "numbers": [1, 2]})
    np.testing.assert_allclose(
        panorama_reading.load(tmp_path / "a.exr"), image, rtol=1e-3, atol=1e-6
    )
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert panorama_files.read_header(tmp_path / "a.exr")["numbers"] == "[1, 2]"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "b.exr"]


def test_radiance_beyond_half_is_stored_as_float(tmp_path: Path) -> None:
    image = hdr()
    image[3, 4] = 2e5
    panorama_files.write(tmp_path / "a.exr", image, {})
    assert panorama_reading.load(tmp_path / "a.exr")[3, 4, 0] == pytest.approx(2e5)


def test_bad_panoramas_are_refused_with_the_reason(tmp_path: Path) -> None:
    nan = hdr()
    nan[2, 3, 1] = np.nan
    photo = np.random.default_rng(0).integers(0, 256, (16, 32, 3)).astype(np.float32) / 255
    clipped = np.minimum(hdr() * 0.9, 1.0)
    (tmp_path / "text.exr").write_text("not an image")
    cases = [
        (tmp_path / "missing.exr", "no such file"),
        (tmp_path / "text.exr", "neither an .exr nor an .hdr"),
        (save(tmp_path / "ldr.png", photo, "uint8"), "low dynamic range"),
        (save(tmp_path / "photo.exr", photo), "low dynamic range"),
        (save(tmp_path / "clipped.exr", clipped), "low dynamic range"),
        (save(tmp_path / "square.exr", hdr()[:, :16]), "2:1"),
        (save(tmp_path / "nan.exr", nan, "float"), "1 NaN or Inf"),
        (save(tmp_path / "black.exr", np.zeros((8, 16, 3), np.float32)), "black"),
        (save(tmp_path / "two.exr", hdr()[..., :2]), "R, G and B"),
    ]
    for path, reason in cases:
        with pytest.raises(PanoramaError, match=reason) as raised:
            panorama_reading.load(path)
        assert str(path) in str(raised.value)


def test_truncated_file_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "p.exr", hdr(64))
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(PanoramaError):
        panorama_reading.load(path)


def test_negatives_become_zero_hdr_reads_and_wide_files_shrink(tmp_path: Path) -> None:
    image = hdr(64)
    image[0, 0] = -0.01
    assert panorama_reading.load(save(tmp_path / "n.exr", image)).min() == 0.0
    assert panorama_reading.load(save(tmp_path / "n.exr", image), max_width=32).shape == (16, 32, 3)
    assert panorama_reading.load(save(tmp_path / "n.exr", image), max_width=100).shape == (
        50,
        100,
        3,
    )
    smooth = hdr(8) + 0.1
    rgbe = panorama_reading.load(save(tmp_path / "n.hdr", smooth, "float"))
    np.testing.assert_allclose(rgbe, smooth, atol=float(smooth.max()) / 100)
