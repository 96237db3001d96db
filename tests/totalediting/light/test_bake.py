"""`totalediting bake`: the file of lightmaps, its pictures, the ball, errors of one line."""

from __future__ import annotations

import hashlib
import importlib.util
import math
import resource
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from answer import Answer
from PIL import Image

from assets_procedural.conventions import console, panorama, panorama_files, panorama_reading
from assets_procedural.light.pool import EnvironmentSettings, pool
from totalediting import cli
from totalediting.errors import InputError
from totalediting.light import lightmaps
from totalediting.light.ball import shade_ball
from totalediting.light.files import read_lightmaps, write_lightmaps
from totalediting.light.pictures import WHITE, exposure_of

CHANNELS = {f"{lobe}.{c}" for lobe in lightmaps.LOBES for c in "RGB"}


Run = Callable[..., Answer]


@pytest.fixture
def totalediting(run_main: Callable[..., Answer]) -> Run:
    """Runs a command of `totalediting` in this process."""
    return partial(run_main, cli.main)


@pytest.fixture
def failure(totalediting: Run) -> Callable[..., str]:
    """The one line of a user's error."""
    return lambda *arguments: totalediting(*arguments).error


@pytest.fixture
def environment(tmp_path: Path) -> Path:
    """A dim sky with one coloured light."""
    direction = panorama.texel_directions(16)
    radiance = 0.2 + 0.1 * direction[..., 2:] + np.zeros(3)
    radiance[5, 20] = (40.0, 20.0, 5.0)
    path = tmp_path / "sky.exr"
    panorama_files.write(path, radiance.astype(np.float32), {})
    return path


def radiance_of(path: Path) -> torch.Tensor:
    return torch.from_numpy(panorama_reading.load(path))


def test_help_is_quick_and_imports_nothing_heavy(totalediting: Run) -> None:
    code = (
        "import sys\nsys.argv = ['totalediting', '--help']\nfrom totalediting.cli import main\n"
        "try:\n    main()\nfinally:\n    print(*sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert " bake " in shown.stdout
    assert not {"torch", "numpy", "PIL", "scipy", "OpenEXR"} & set(shown.stdout.split())
    explained = totalediting("bake", "--help")
    assert explained.returncode == 0
    assert "--unnormalised" in explained.stdout


def test_the_file_holds_fifteen_float_channels_that_equal_the_bake(
    totalediting: Run, environment: Path, tmp_path: Path
) -> None:
    import OpenEXR
    import OpenImageIO as oiio

    out = tmp_path / "maps.exr"
    result = totalediting("bake", environment, "--out", out, "--size", 8)
    assert (result.returncode, result.stdout) == (0, f"{out}\n"), result.stderr
    spec = oiio.ImageInput.open(str(out)).spec()
    assert set(spec.channelnames) == CHANNELS
    assert (spec.width, spec.height, spec.format) == (16, 8, oiio.TypeFloat)
    expected = lightmaps.bake(radiance_of(environment), 8).numpy()
    with OpenEXR.File(str(out), separate_channels=True) as file:
        for lobe, maps in zip(lightmaps.LOBES, expected, strict=True):
            for c, plane in zip("RGB", maps, strict=True):
                assert np.array_equal(file.channels()[f"{lobe}.{c}"].pixels, plane)
    header = panorama_files.read_header(out)
    assert header["lightmaps_source"] == "sky.exr"
    assert header["lightmaps_sha256"] == hashlib.sha256(environment.read_bytes()).hexdigest()
    assert header["lightmaps_normalised"] == "true"
    assert "equirectangular" in header["lightmaps_convention"]
    first = out.read_bytes()
    totalediting("bake", environment, "--out", out, "--size", 8)
    assert out.read_bytes() == first
    assert sorted(p.name for p in tmp_path.iterdir()) == ["maps.exr", "sky.exr"]


def test_long_work_says_from_its_start_how_far_it_is(
    totalediting: Run, environment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "FIRST_LINE", 0.0)
    result = totalediting("bake", environment, "--out", tmp_path / "maps.exr")
    assert result.returncode == 0 and "baking: 0 of 1" in result.stderr


def test_unnormalised_maps_are_the_integrals(
    totalediting: Run, environment: Path, tmp_path: Path
) -> None:
    plain, integrals = tmp_path / "plain.exr", tmp_path / "integrals.exr"
    totalediting("bake", environment, "--out", plain)
    totalediting("bake", environment, "--out", integrals, "--unnormalised")
    assert panorama_files.read_header(integrals)["lightmaps_normalised"] == "false"
    factors = torch.tensor([math.pi, *(2 * math.pi / (n + 1) for n in (1, 16, 32, 64))])
    wanted = read_lightmaps(plain) * factors[:, None, None, None]
    torch.testing.assert_close(read_lightmaps(integrals), wanted)


def test_lightmaps_come_back_as_they_were_written(environment: Path, tmp_path: Path) -> None:
    maps = lightmaps.bake(radiance_of(environment), 12) * 1e5  # beyond what half holds
    write_lightmaps(tmp_path / "maps.exr", maps, environment, normalised=True)
    assert torch.equal(read_lightmaps(tmp_path / "maps.exr"), maps)


def test_other_files_are_no_lightmaps(environment: Path, tmp_path: Path) -> None:
    (tmp_path / "text.exr").write_text("not an image")
    square = {lobe: np.ones((8, 8, 3), np.float32) for lobe in lightmaps.LOBES}
    panorama_files.write_channels(tmp_path / "square.exr", square, {})
    panorama_files.write_channels(
        tmp_path / "grey.exr", {"diffuse": np.ones((8, 16), np.float32)}, {}
    )
    cases = {
        "missing.exr": "no such file",
        "text.exr": "cannot be read",
        "square.exr": "twice as wide as high",
        "grey.exr": r"holds diffuse \(8, 16\); lightmaps are diffuse, specular1,",
        environment.name: r"holds RGB \(16, 32, 3\)",
    }
    for name, reason in cases.items():
        with pytest.raises(InputError, match=reason) as raised:
            read_lightmaps(tmp_path / name)
        assert str(raised.value).startswith(f"{tmp_path / name}: ")
        assert "\n" not in str(raised.value)


# Not importorskip: a bpy in this process would break those that other tests spawn.
_HAS_BPY = importlib.util.find_spec("bpy") is not None
needs_bpy = pytest.mark.skipif(not _HAS_BPY, reason="the bundled panoramas are part of bpy")


@pytest.mark.parametrize("bundled", [pytest.param(True, marks=needs_bpy), False])
def test_pictures_are_drawn(
    totalediting: Run, environment: Path, tmp_path: Path, bundled: bool
) -> None:
    if bundled:
        (spec,) = pool(EnvironmentSettings(bundled=("sunset",)), 0)
        assert spec.path is not None
        environment = spec.path
    out, page, ball = tmp_path / "maps.exr", tmp_path / "maps.png", tmp_path / "ball.png"
    outputs = ("--out", out, "--picture", page, "--ball", ball)
    result = totalediting("bake", environment, *outputs, "--albedo", "0.8,0.4,0.3")
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == [str(out), str(page), str(ball)]
    with Image.open(page) as picture:
        assert picture.mode == "RGB" and 800 < picture.width < 1600
        assert 0.5 < picture.height / picture.width < 0.8
    with Image.open(ball) as picture:
        assert picture.size == (512, 512)
        red, _, blue = np.asarray(picture)[256, 256]
        assert red > blue > 0


def test_the_exposure_puts_the_brightest_diffuse_light_at_white(environment: Path) -> None:
    maps = lightmaps.bake(radiance_of(environment) * 37.0)
    assert float(maps[0].max()) * exposure_of(maps) == pytest.approx(WHITE)


def test_errors_are_one_line(
    failure: Callable[..., str], environment: Path, tmp_path: Path
) -> None:
    def fails(*arguments: object) -> str:
        return failure("bake", environment, "--out", tmp_path / "maps.exr", *arguments)

    assert fails("--size", 0) == "error: --size: 0: give 4 to 512 rows, such as 32"
    assert "--size: 4096: give" in fails("--size", 4096)
    assert fails("--ks", "1,2") == (
        "error: --ks: 1,2: give 4 numbers of at least 0, such as 0,0,0.2,0"
    )
    assert "--ks: 0,0,-1,0: give 4 numbers" in fails("--ks", "0,0,-1,0")
    assert "--albedo: 1,2,3: give 3 numbers from 0 to 1" in fails("--albedo", "1,2,3")
    assert "--albedo: red: give 3 numbers" in fails("--albedo", "red")
    assert "--kd: nan: give a number of at least 0" in fails("--kd", "nan")
    assert "maps.jpg: is written as .png" in fails("--picture", tmp_path / "maps.jpg")
    assert f"there is no folder {tmp_path}/no" in fails("--ball", tmp_path / "no" / "ball.png")
    same = ("--picture", tmp_path / "a.png", "--ball", tmp_path / "a.png")
    assert "a.png: is also the file of --picture; give another name" in fails(*same)
    (tmp_path / "folder.png").mkdir()
    assert "is a folder; give a file's name" in fails("--ball", tmp_path / "folder.png")
    onto = failure("bake", environment, "--out", environment)
    assert onto == f"error: --out: {environment}: is also the panorama; give another name"
    assert "maps: is written as .exr" in failure("bake", environment, "--out", tmp_path / "maps")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder.png", "sky.exr"]


def test_a_full_disk_is_one_line_and_leaves_nothing(
    failure: Callable[..., str], environment: Path, tmp_path: Path
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    out = tmp_path / "maps.exr"
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
        line = failure("bake", environment, "--out", out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert line.startswith(f"error: {out}: cannot be written (")
    assert [p.name for p in tmp_path.iterdir()] == ["sky.exr"]


def test_another_device_is_refused_and_the_choices_are_named(
    totalediting: Run, environment: Path, tmp_path: Path
) -> None:
    given = ("bake", environment, "--out", tmp_path / "maps.exr", "--device", "gpu")
    said = totalediting(*given)
    assert "--device = gpu" in said.error
    assert "'cpu', 'cuda'" in said.stderr


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_device_that_is_not_there_is_one_line(
    failure: Callable[..., str], environment: Path, tmp_path: Path
) -> None:
    line = failure("bake", environment, "--out", tmp_path / "maps.exr", "--device", "cuda")
    assert line.endswith("--device: cuda: PyTorch finds no CUDA device here; use --device cpu")


def test_bad_panoramas_are_one_line(failure: Callable[..., str], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    light = rng.gamma(0.5, 2.0, (8, 16, 3)).astype(np.float32)
    panorama_files.write_channels(tmp_path / "square.exr", {"RGB": light[:, :8]}, {})
    light[2, 3, 1] = np.nan
    panorama_files.write_channels(tmp_path / "nan.exr", {"RGB": light}, {})
    Image.fromarray(rng.integers(0, 256, (8, 16, 3), np.uint8)).save(tmp_path / "photo.png")
    cases = {
        "missing.exr": "no such file",
        "square.exr": "twice as wide as high",
        "nan.exr": "1 NaN or Inf",
        "photo.png": "low dynamic range",
    }
    for name, reason in cases.items():
        line = failure("bake", tmp_path / name, "--out", tmp_path / "maps.exr")
        assert line.startswith(f"error: {tmp_path / name}: ") and reason in line
    assert not (tmp_path / "maps.exr").exists()


def test_a_matte_ball_under_constant_light_has_its_albedo_everywhere() -> None:
    maps = lightmaps.bake(torch.ones(16, 32, 3))
    light, coverage = shade_ball(maps, 64, (0.5, 0.5, 0.5), 1.0, (0.0, 0.0, 0.0, 0.0))
    torch.testing.assert_close(light, torch.full((64, 64, 3), 0.5))
    assert float(coverage.mean()) == pytest.approx(math.pi / 4, rel=2e-3)
    assert coverage[32, 32] == 1.0 and coverage[0, 0] == 0.0


@pytest.mark.parametrize(
    ("towards", "half"),
    [
        ((1.0, 0.0, 0.0), np.s_[:, 32:]),
        ((-1.0, 0.0, 0.0), np.s_[:, :32]),
        ((0.0, 0.0, 1.0), np.s_[:32]),
        ((0.0, 0.0, -1.0), np.s_[32:]),
    ],
)
def test_light_from_a_side_lights_that_side(towards: tuple[float, ...], half: tuple) -> None:
    light, coverage = shade_ball(spot(towards), 64, (1.0, 1.0, 1.0), 1.0, (0.0, 0.0, 0.0, 0.0))
    lit = light.sum(-1) * (coverage == 1.0)
    assert float(lit[half].sum()) > 0.98 * float(lit.sum()) > 0.0


def test_the_camera_may_stand_anywhere() -> None:
    """From +X, +Y is to the right; a light behind the camera shines in the middle of the ball."""
    axes = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    light, _ = shade_ball(spot((1.0, 0.0, 0.0)), 65, (1, 1, 1), 0.0, (0, 0, 0, 1), axes)
    brightest = int(light.sum(-1).argmax())
    assert abs(brightest // 65 - 32) <= 2 and abs(brightest % 65 - 32) <= 2
    light, _ = shade_ball(spot((0.0, 1.0, 0.0)), 64, (1, 1, 1), 1.0, (0, 0, 0, 0), axes)
    assert light[32, 60].sum() > 20 * light[32, 30].sum()


def test_a_highlight_lies_where_the_mirror_direction_meets_the_light() -> None:
    """Light from +X, seen from -Y: the normal halfway between the two."""
    light, coverage = shade_ball(spot((1.0, 0.0, 0.0)), 129, (1, 1, 1), 0.0, (0, 0, 0, 1))
    brightest = int((light.sum(-1) * coverage).argmax())
    assert brightest // 129 == pytest.approx(64, abs=2)
    assert brightest % 129 == pytest.approx(64 + 64.5 * math.sqrt(0.5), abs=3)


def spot(towards: tuple[float, ...]) -> torch.Tensor:
    """Lightmaps of one bright texel at `towards`."""
    nearness = panorama.texel_directions(32) @ np.array(towards)
    sky = torch.zeros(32, 64, 3)
    sky[torch.from_numpy(nearness >= nearness.max() - 1e-9)] = 100.0
    return lightmaps.bake(sky)
