"""The pool of environments, skies, studios, and the backdrop."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from panoramas import hdr, save
from pydantic import ValidationError

from assets_procedural.conventions import panorama as pano
from assets_procedural.conventions import panorama_files, panorama_reading
from assets_procedural.conventions.panorama_reading import PanoramaError
from assets_procedural.light.backdrop import backdrop, blur_radius
from assets_procedural.light.pool import (
    EnvironmentSettings,
    panorama_of,
    pool,
    provenance,
    write_pool,
)
from assets_procedural.light.sky import SkyParameters, sky, sky_rand
from assets_procedural.light.studio import Softbox, StudioParameters, blackbody, studio, studio_rand

_HAS_BPY = importlib.util.find_spec("bpy") is not None
needs_bpy = pytest.mark.skipif(not _HAS_BPY, reason="bpy is not installed")


@needs_bpy
def test_pool_lists_and_writes_every_kind(tmp_path: Path) -> None:
    user = tmp_path / "mine"
    user.mkdir()
    save(user / "My Garden.exr", hdr())
    save(user / "my-garden.hdr", hdr() + 0.1, "float")
    settings = EnvironmentSettings(bundled=("city",), folder=user, skies=1, studios=1)
    specs = pool(settings, 7)
    assert [s.id for s in specs][:2] == ["city", "user_my_garden"]
    assert len({s.id for s in specs}) == len(specs) == 5
    assert specs[0].licence == "CC0-1.0" and "polyhaven" in specs[0].source
    paths = write_pool(specs, tmp_path / "pool")
    for spec, path in zip(specs, paths, strict=True):
        header = panorama_files.read_header(path)
        assert header["environment_id"] == spec.id
        assert header["environment_licence"] == spec.licence
        stored = panorama_reading.load(path)
        assert stored.shape[1] == 2 * stored.shape[0]
    user_header = panorama_files.read_header(paths[1])
    expected = hashlib.sha256((user / "My Garden.exr").read_bytes()).hexdigest()
    assert user_header["environment_sha256"] == expected
    before = [p.stat().st_mtime_ns for p in paths]
    paths[0].write_bytes(b"damaged")
    write_pool(specs, tmp_path / "pool")
    assert [p.stat().st_mtime_ns for p in paths][1:] == before[1:]
    assert panorama_reading.load(paths[0]).shape == (512, 1024, 3)


def test_procedural_pool_depends_on_seed_and_number_alone() -> None:
    few = pool(EnvironmentSettings(bundled=(), skies=2, studios=1), 3)
    more = pool(EnvironmentSettings(bundled=(), skies=5, studios=1), 3)
    assert few[:2] == more[:2] and few[-1] == more[-1]
    assert pool(EnvironmentSettings(bundled=(), skies=2, studios=1), 4)[0] != few[0]


def test_pool_errors_name_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(PanoramaError, match="no such folder"):
        pool(EnvironmentSettings(bundled=(), folder=tmp_path / "none"), 0)
    (tmp_path / "x.jpg").write_bytes(b"")
    with pytest.raises(PanoramaError, match=r"x\.jpg is low dynamic range"):
        pool(EnvironmentSettings(bundled=(), folder=tmp_path), 0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bundled": []}, "no environment"),
        ({"bundled": ["moon"]}, "city"),
        ({"bundled": ["city", "city"]}, "twice"),
        ({"skies": -1}, "greater than or equal to 0"),
        ({"rotation": [90, 10]}, "low <= high"),
        ({"rotation": [0, 720]}, "within"),
        ({"exposre": [0, 1]}, "Extra inputs"),
    ],
)
def test_bad_settings(settings: dict, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        EnvironmentSettings(**settings)


def test_skies_are_deterministic_finite_and_seamless() -> None:
    for seed in range(12):
        parameters = sky_rand(np.random.default_rng(seed))
        assert parameters == sky_rand(np.random.default_rng(seed))
        image = sky(parameters, 64)
        assert image.shape == (64, 128, 3) and image.dtype == np.float32
        assert np.isfinite(image).all() and image.min() >= 0.0 and image.max() > 0.0
        np.testing.assert_array_equal(image, sky(parameters, 64))


def test_sun_stands_where_the_parameters_say() -> None:
    parameters = SkyParameters(sun_elevation=40, sun_azimuth=70, cloud_cover=0)
    image = sky(parameters, 128)
    row, column = np.unravel_index(image.sum(axis=2).argmax(), image.shape[:2])
    direction = pano.texel_directions(128)[row, column]
    elevation, azimuth = np.radians([40, 70])
    sun = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)]
    assert direction @ [*sun, np.sin(elevation)] > np.cos(np.radians(3))


def test_a_dusk_is_no_pink_world() -> None:
    for seed in range(8):
        drawn = sky_rand(np.random.default_rng(seed))
        image = sky(drawn.model_copy(update={"sun_elevation": 2.0, "cloud_cover": 0.9}), 64)
        mean = pano.texel_solid_angles(64) @ image.mean(axis=1)
        assert mean.max() < 1.7 * mean.min(), mean  # up to 5 times without


def test_low_sun_is_redder_and_dimmer_clear_sky_is_blue() -> None:
    up = np.array([0.0, 0.0, 1.0])
    light = [
        pano.irradiance(sky(SkyParameters(sun_elevation=e, cloud_cover=0), 128), up)
        for e in (5, 60)
    ]
    assert light[0].sum() < 0.3 * light[1].sum()
    assert light[0][0] / light[0][2] != pytest.approx(light[1][0] / light[1][2], rel=0.02)
    zenith = sky(SkyParameters(sun_elevation=30, cloud_cover=0), 128)[2].mean(axis=0)
    assert zenith[2] > 1.5 * zenith[0]


def test_studios_are_deterministic_and_the_key_gives_its_irradiance() -> None:
    for seed in range(8):
        parameters = studio_rand(np.random.default_rng(seed))
        assert parameters == studio_rand(np.random.default_rng(seed))
        image = studio(parameters, 64)
        assert np.isfinite(image).all() and image.min() >= 0.0
    key = Softbox(azimuth=40, elevation=20, width=40, height=50, irradiance=1, kelvin=5300)
    bare = StudioParameters(lights=(key,), backdrop=(0, 0, 0), room=(0, 0, 0), floor=(0, 0, 0))
    azimuth, elevation = np.radians([40, 20])
    axis = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    np.testing.assert_allclose(pano.irradiance(studio(bare, 128), axis), 1.0, rtol=0.03)
    assert pano.irradiance(studio(bare, 128), -axis).max() < 1e-6


def test_blackbody() -> None:
    assert blackbody(2500)[0] > 2 * blackbody(2500)[2]
    assert blackbody(12000)[2] > blackbody(12000)[0]
    np.testing.assert_allclose(blackbody(6600), 1.0, atol=0.08)


def rays(width: int, height: int, focal: float) -> np.ndarray:
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, z = (column - width / 2) / focal, (height / 2 - row) / focal
    return np.stack([x, np.ones_like(x), z], axis=-1)  # looks along +Y


def test_backdrop_without_blur_is_the_lookup_of_a_smooth_panorama() -> None:
    direction = pano.texel_directions(128)
    image = (2.0 + direction @ np.array([0.5, 0.3, 0.8]))[..., None].repeat(3, -1)
    picture = backdrop(image.astype(np.float32), rays(40, 30, 60.0), 0.4, 0.0)
    expected = pano.lookup(image, rays(40, 30, 60.0), 0.4)
    np.testing.assert_allclose(picture, expected, atol=5e-3)
    unit = rays(40, 30, 60.0)
    unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        picture, backdrop(image.astype(np.float32), unit, 0.4, 0.0), atol=1e-4
    )


def test_a_small_light_becomes_a_disc_of_the_same_energy() -> None:
    image = np.zeros((256, 512, 3), np.float32)
    uv = pano.direction_to_uv(np.array([0.0, 1.0, 0.0]))
    row, column = int(uv[1] * 256), int(uv[0] * 512)
    image[row, column] = 1000.0
    view = rays(97, 97, 100.0)
    sharp, blurred = (backdrop(image, view, 0.0, radius) for radius in (0.0, 20.0))
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=1e-3)
    lit = blurred[..., 0] > 0.5 * np.median(blurred[..., 0][blurred[..., 0] > 0.01])
    assert lit.sum() == pytest.approx(np.pi * 20.5**2, rel=0.1)
    assert blurred.min() >= 0.0


def test_light_outside_the_frame_blurs_into_it() -> None:
    image = np.zeros((256, 512, 3), np.float32)
    view = rays(64, 64, 100.0)
    outside = view[32, 63] + (view[32, 63] - view[32, 62]) * 8
    uv = pano.direction_to_uv(outside)
    image[int(uv[1] * 256), int(uv[0] * 512)] = 1000.0
    assert backdrop(image, view, 0.0, 0.0)[:, :55].max() == 0.0
    assert backdrop(image, view, 0.0, 16.0)[:, 58].max() > 0.0


def test_blur_radius() -> None:
    # 85 mm at f/2.8, focused at 1.2 m: aperture 30.4 mm, so c = 85 / 1115 * 30.4 mm = 2.31 mm.
    assert blur_radius(85, 2.8, 1.2, 36, 512) == pytest.approx(0.5 * 2.314 / 36 * 512, rel=1e-3)
    with pytest.raises(ValueError, match="nearer"):
        blur_radius(85, 2.8, 0.05, 36, 512)


def test_the_store_says_how_a_file_was_read(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    save(folder / "a.exr", hdr())
    (spec,) = pool(EnvironmentSettings(bundled=(), folder=folder), 0)
    (path,) = write_pool([spec], tmp_path / "pool")
    facts = json.loads(panorama_files.read_header(path)["environment_reading"])
    assert facts["reader"] >= 1
    before = path.stat().st_mtime_ns
    write_pool([spec], tmp_path / "pool")
    assert path.stat().st_mtime_ns == before


def test_a_missing_part_is_black_where_the_job_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    image = hdr(16)
    window = np.array([0, 0], np.int32), np.array([31, 11], np.int32)
    display = np.array([0, 0], np.int32), np.array([31, 15], np.int32)
    header = {"dataWindow": window, "displayWindow": display, "type": OpenEXR.scanlineimage}
    header["compression"] = OpenEXR.ZIP_COMPRESSION
    OpenEXR.File(header, {c: image[:12, :, k].copy() for k, c in enumerate("RGB")}).write(
        str(folder / "cropped.exr")
    )
    (refused,) = pool(EnvironmentSettings(bundled=(), folder=folder), 0)
    with pytest.raises(PanoramaError, match="without pixels"):
        panorama_of(refused)
    (black,) = pool(EnvironmentSettings(bundled=(), folder=folder, missing="black"), 0)
    assert not panorama_of(black)[12:].any()
    assert provenance(black)["parameters"]["missing"] == "black"
