"""A panorama is what its header says: each property is applied, or refused by name."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from assets_procedural.conventions import stored_panorama
from assets_procedural.conventions.panorama_reading import PanoramaError, read
from assets_procedural.conventions.primaries import REC709, to_rec709

HEIGHT, WIDTH = 16, 32
ACES = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


def scene() -> np.ndarray:
    """(16, 32, 3) float32: unlike in every direction and channel, with a lamp of 40."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    pixels = np.stack([1 + rows / 8, 2 + columns / 16, 1 + (rows + columns) / 24], axis=-1)
    pixels[3:5, 6:9] = (40, 30, 20)
    return pixels.astype(np.float32)


def planes(pixels: np.ndarray, layer: str = "") -> dict[str, np.ndarray]:
    return {layer + c: np.ascontiguousarray(pixels[..., k]) for k, c in enumerate("RGB")}


def exr(path: Path, channels: dict[str, np.ndarray], **header: Any) -> Path:
    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(kind | header, channels).write(str(path))
    return path


def window(left: int, top: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([left, top], np.int32)
    return low, low + np.array([width - 1, height - 1], np.int32)


def parts(path: Path, *several: tuple[str, dict[str, np.ndarray]]) -> Path:
    made = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": name}, channels)
        for name, channels in several
    ]
    OpenEXR.File(made).write(str(path))
    return path


def rgbe(pixels: np.ndarray) -> bytes:
    mantissa, exponent = np.frexp(pixels.max(axis=-1))
    scale = mantissa * 256 / pixels.max(axis=-1)
    encoded = np.empty((*pixels.shape[:2], 4), np.uint8)
    encoded[..., :3] = np.minimum(pixels * scale[..., None] + 0.5, 255)
    encoded[..., 3] = exponent + 128
    return encoded.tobytes()


def hdr(path: Path, pixels: np.ndarray, header: str = "", axes: str = "-Y {h} +X {w}") -> Path:
    height, width = pixels.shape[:2]
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{header}\n" + axes.format(h=height, w=width)
    path.write_bytes(head.encode() + b"\n" + rgbe(pixels))
    return path


def assert_shows_the_scene(source: str | Path, **options: Any) -> dict[str, Any]:
    pixels, facts = read(source, **options)
    np.testing.assert_allclose(pixels, scene(), rtol=0.02, atol=0.02)
    assert facts["reader"] >= 1
    return facts


# ---------------------------------------------------------------- windows


def test_overscan_is_cut(tmp_path: Path):
    wide = np.full((HEIGHT + 6, WIDTH + 8, 3), 500.0, np.float32)
    wide[2:-4, 3:-5] = scene()
    file = exr(
        tmp_path / "o.exr",
        planes(wide),
        dataWindow=window(-3, -2, WIDTH + 8, HEIGHT + 6),
        displayWindow=window(0, 0, WIDTH, HEIGHT),
    )
    assert assert_shows_the_scene(file)["data_window"] == [-3, -2, WIDTH + 8, HEIGHT + 6]


def test_windows_count_from_the_display_window(tmp_path: Path):
    where = window(100, 50, WIDTH, HEIGHT)
    assert_shows_the_scene(
        exr(tmp_path / "o.exr", planes(scene()), dataWindow=where, displayWindow=where)
    )


def test_a_cropped_panorama_is_refused_unless_the_rest_is_black(tmp_path: Path):
    file = exr(
        tmp_path / "c.exr",
        planes(scene()[:12]),
        dataWindow=window(0, 0, WIDTH, 12),
        displayWindow=window(0, 0, WIDTH, HEIGHT),
    )
    with pytest.raises(PanoramaError, match=r"data window leaves 14\.6% of the sphere"):
        read(file)
    pixels, facts = read(file, missing="black")
    np.testing.assert_allclose(pixels[:12], scene()[:12], rtol=1e-3)
    assert not pixels[12:].any() and facts["missing_black"] == pytest.approx(0.1464, abs=1e-3)


def test_a_data_window_of_2_to_1_in_another_display_is_refused(tmp_path: Path):
    file = exr(
        tmp_path / "d.exr",
        planes(scene()),
        dataWindow=window(0, 0, WIDTH, HEIGHT),
        displayWindow=window(0, 0, WIDTH, WIDTH),
    )
    with pytest.raises(PanoramaError, match="32 x 32"):
        read(file)


def test_a_transparent_part_is_missing(tmp_path: Path):
    alpha = np.ones((HEIGHT, WIDTH), np.float32)
    alpha[-2:] = 0
    file = exr(tmp_path / "a.exr", planes(scene()) | {"A": alpha})
    with pytest.raises(PanoramaError, match="alpha leaves"):
        read(file)
    assert not read(file, missing="black")[0][-2:].any()


# ---------------------------------------------------------------- colour


@pytest.mark.parametrize("primaries", [ACES, AP0])
@pytest.mark.parametrize("said_by", ["chromaticities", "colorInteropID", "PRIMARIES"])
def test_primaries_are_applied(tmp_path: Path, primaries: tuple[float, ...], said_by: str):
    matrix = to_rec709(primaries)
    assert matrix is not None
    foreign = (scene() @ np.linalg.inv(matrix).T).astype(np.float32)
    if said_by == "PRIMARIES":
        text = " ".join(map(str, primaries))
        file = hdr(tmp_path / "p.hdr", foreign, header=f"PRIMARIES= {text}\n")
    elif said_by == "chromaticities":
        file = exr(tmp_path / "p.exr", planes(foreign), chromaticities=primaries)
    else:
        name = "lin_ap1_scene" if primaries == ACES else "lin_ap0_scene"
        file = exr(tmp_path / "p.exr", planes(foreign), colorInteropID=name)
    facts = assert_shows_the_scene(file)
    assert facts["primaries"] == pytest.approx(primaries, abs=1e-4)


def test_the_matrix_is_that_of_colour_science():
    colour = pytest.importorskip("colour")

    def space(values: tuple[float, ...]) -> Any:
        xy = np.reshape(values, (4, 2))
        return colour.RGB_Colourspace("x", xy[:3], xy[3])

    for primaries in (ACES, AP0, (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)):
        expected = colour.matrix_RGB_to_RGB(space(primaries), space(REC709), "Bradford")
        ours = to_rec709(primaries)
        assert ours is not None and np.abs(ours - expected).max() < 1e-12


def test_rec709_seen_from_another_white_stays_as_it_is(tmp_path: Path):
    adapted = (0.64845, 0.33088, 0.32119, 0.59789, 0.1559, 0.06606, 0.34571, 0.35854)
    pixels, _ = read(exr(tmp_path / "w.exr", planes(scene()), chromaticities=adapted))
    assert np.array_equal(pixels, scene())


@pytest.mark.parametrize(
    ("header", "named"),
    [
        ({"colorInteropID": "srgb_rec709_scene"}, "colorInteropID = srgb_rec709_scene"),
        ({"colorInteropID": "lin_rec709_scene", "chromaticities": ACES}, "contradicts"),
        ({"chromaticities": (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3)}, "chromaticities"),
        ({"chromaticities": (np.nan,) * 8}, "chromaticities"),
        ({"pixelAspectRatio": 2.0}, "pixelAspectRatio = 2"),
    ],
)
def test_what_cannot_be_applied_is_named(tmp_path: Path, header: dict[str, Any], named: str):
    with pytest.raises(PanoramaError, match=named) as raised:
        read(exr(tmp_path / "x.exr", planes(scene()), **header))
    assert "\n" not in str(raised.value)


# ---------------------------------------------------------------- Radiance


@pytest.mark.parametrize("second", ["+X", "-X"])
@pytest.mark.parametrize("first", ["+Y", "-Y"])
@pytest.mark.parametrize("transposed", [False, True])
def test_all_orientations_show_the_scene(tmp_path: Path, first: str, second: str, transposed: bool):
    stored = scene() if first == "-Y" else scene()[::-1]
    stored = stored if second == "+X" else stored[:, ::-1]
    axes = f"{first} {{h}} {second} {{w}}"
    if transposed:
        stored, axes = stored.transpose(1, 0, 2), f"{second} {{h}} {first} {{w}}"
    assert_shows_the_scene(hdr(tmp_path / "o.hdr", np.ascontiguousarray(stored), axes=axes))


def test_exposure_and_colour_correction_are_divided_out(tmp_path: Path):
    scaled = scene() * 4 * np.array([1, 2, 0.5], np.float32)
    file = hdr(
        tmp_path / "e.hdr", scaled, "EXPOSURE=2\nEXPOSURE= 2.0\nCOLORCORR=1 2 0.5\nSOFTWARE=x\n"
    )
    assert assert_shows_the_scene(file)["exposure"] == [4.0, 8.0, 2.0]


@pytest.mark.parametrize(
    ("header", "named"),
    [
        ("GAMMA=2.2\n", "GAMMA=2.2"),
        ("EXPOSURE=0\n", "EXPOSURE"),
        ("EXPOSURE=bright\n", "EXPOSURE=bright"),
        ("COLORCORR=1 2\n", "COLORCORR=1 2"),
        ("PRIMARIES=0.6 0.3\n", "PRIMARIES"),
        ("PIXASPECT=2\n", "PIXASPECT=2"),
        ("FORMAT=32-bit_rle_xyze\n", "xyze"),
    ],
)
def test_what_radiance_says_and_cannot_be_applied_is_named(tmp_path: Path, header: str, named: str):
    with pytest.raises(PanoramaError, match=named):
        read(hdr(tmp_path / "x.hdr", scene(), header))


def test_the_old_run_length_code_is_called_unsupported(tmp_path: Path):
    file = hdr(tmp_path / "old.hdr", scene())
    content = bytearray(file.read_bytes())
    content[-400:-396] = b"\x01\x01\x01\x03"
    file.write_bytes(content)
    with pytest.raises(PanoramaError, match="old run-length code"):
        read(file)


# ---------------------------------------------------------------- parts and channels


def test_the_one_rgb_of_all_parts_is_found(tmp_path: Path):
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    file = parts(
        tmp_path / "m.exr",
        ("depth", {"Z": depth}),
        ("normals", {"N.X": depth, "N.Y": depth, "N.Z": depth}),
        ("picture", planes(scene())),
    )
    assert assert_shows_the_scene(file)["layer"] == "picture"


def test_the_one_rgb_of_all_layers_is_found(tmp_path: Path):
    depth = {"ViewLayer.Depth.Z": np.ones((HEIGHT, WIDTH), np.float32)}
    file = exr(tmp_path / "l.exr", planes(scene(), "ViewLayer.Combined.") | depth)
    assert assert_shows_the_scene(file)["layer"] == "ViewLayer.Combined"


def test_several_images_are_listed_and_one_can_be_chosen(tmp_path: Path):
    file = parts(
        tmp_path / "m.exr", ("left", planes(scene() * 3)), ("right", planes(scene(), "sky."))
    )
    with pytest.raises(PanoramaError, match=r"several images \(left, right/sky\).*m\.exr#left"):
        read(file)
    assert_shows_the_scene(f"{file}#right/sky")
    assert_shows_the_scene(Path(f"{file}#sky"))
    with pytest.raises(PanoramaError, match=r'"up" is not one of its images'):
        read(f"{file}#up")


def test_the_picture_that_every_viewer_shows_needs_no_choice(tmp_path: Path):
    file = exr(tmp_path / "b.exr", planes(scene()) | planes(scene() * 9, "albedo."))
    assert_shows_the_scene(file)
    assert read(f"{file}#albedo")[0].max() == pytest.approx(360)


def test_a_name_with_a_hash_is_a_file_first(tmp_path: Path):
    assert_shows_the_scene(exr(tmp_path / "sky #2.exr", planes(scene())))


def test_a_lone_y_is_grey_light(tmp_path: Path):
    grey = np.ascontiguousarray(scene()[..., 0])
    pixels, _ = read(exr(tmp_path / "y.exr", {"Y": grey}))
    np.testing.assert_allclose(pixels, np.repeat(grey[..., None], 3, axis=-1))


@pytest.mark.parametrize("name", ["Z", "A", "R", "depth.Z", "V"])
def test_another_lone_channel_is_no_light(tmp_path: Path, name: str):
    grey = np.ascontiguousarray(scene()[..., 0])
    with pytest.raises(PanoramaError, match="no R, G and B"):
        read(exr(tmp_path / "z.exr", {name: grey}))


# ---------------------------------------------------------------- values


@pytest.mark.parametrize(
    ("value", "texels", "named"),
    [
        (np.nan, 1, "1 NaN or Inf values, the first at row 3, column 7"),
        (np.inf, 1, "NaN or Inf"),
        (3e38, 1, "1 huge values, the first at row 3, column 7"),
        (-30.0, 24, "72 negative values.*% of its energy"),
    ],
)
def test_values_that_are_no_light_are_counted_and_placed(
    tmp_path: Path, value: float, texels: int, named: str
):
    pixels = scene()
    if texels == 1:
        pixels[3, 7, 1] = value
    else:
        pixels[8, :texels] = value
    with pytest.raises(PanoramaError, match=named):
        read(exr(tmp_path / "v.exr", planes(pixels)))


def test_a_little_ringing_becomes_black(tmp_path: Path):
    pixels = scene()
    pixels[0, 0] = -0.01
    read_back, facts = read(exr(tmp_path / "r.exr", planes(pixels)))
    assert read_back.min() == 0 and 0 < facts["negative_share"] < 1e-4


def test_no_library_speaks_to_the_terminal(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    file = exr(tmp_path / "d.exr", planes(scene()))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(PanoramaError, match="is damaged"):
        read(file)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["HTJ2K256_COMPRESSION", "PIZ_COMPRESSION", "ZIPS_COMPRESSION"])
def test_all_compressions_are_read(tmp_path: Path, name: str):
    half = {n: p.astype(np.float16) for n, p in planes(scene()).items()}
    assert_shows_the_scene(exr(tmp_path / "c.exr", half, compression=getattr(OpenEXR, name)))


@pytest.mark.parametrize(
    "content",
    [b"PF\n32 16\n-1.0\n" + bytes(6144), b"II*\0" + bytes(100), b"", b"\x89PNG\r\n\x1a\n"],
)
def test_another_format_is_refused_whatever_its_name(tmp_path: Path, content: bytes):
    (tmp_path / "p.exr").write_bytes(content)
    with pytest.raises(PanoramaError, match=r"p\.exr: .*\.exr or \.hdr"):
        read(tmp_path / "p.exr")


# ---------------------------------------------------------------- memory


def large(path: Path) -> Path:
    """1024 x 512, half a megapixel, as EXR or else Radiance."""
    pixels = np.ones((512, 1024, 3), np.float32)
    return exr(path, planes(pixels)) if path.suffix == ".exr" else hdr(path, pixels)


@pytest.mark.parametrize("name", ["l.exr", "l.hdr"])
def test_reading_holds_at_most_twice_the_picture(tmp_path: Path, name: str):
    file = large(tmp_path / name)
    read(exr(tmp_path / "first.exr", planes(scene())))  # what is imported once
    tracemalloc.start()
    try:
        pixels, _ = read(file)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 2.1 * pixels.nbytes


@pytest.mark.parametrize("name", ["l.exr", "l.hdr"])
def test_what_does_not_fit_into_memory_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    file = large(tmp_path / name)
    monkeypatch.setattr(stored_panorama, "available_memory", lambda: 10_000_000)
    with pytest.raises(PanoramaError, match=r"takes 0\.0 GB of memory, 0\.0 GB are free; scale it"):
        read(file)
