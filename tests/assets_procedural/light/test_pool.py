"""Panoramas: the direction convention (against Blender), files, the pool, sky, studio, backdrop."""

from __future__ import annotations

import hashlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from assets_procedural.conventions import panorama as pano
from assets_procedural.light.backdrop import backdrop, blur_radius
from assets_procedural.light.pool import (
    EnvironmentSettings,
    PanoramaError,
    pool,
    write_pool,
)
from assets_procedural.light.sky import SkyParameters, sky, sky_rand
from assets_procedural.light.studio import Softbox, StudioParameters, blackbody, studio, studio_rand

_HAS_BPY = importlib.util.find_spec("bpy") is not None
needs_bpy = pytest.mark.skipif(not _HAS_BPY, reason="bpy is not installed")


def hdr(height: int = 16, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).gamma(0.5, 2.0, (height, 2 * height, 3)).astype(np.float32)


def save(path: Path, image: np.ndarray, kind: str = "half") -> Path:
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], kind)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(image), output.geterror()
    output.close()
    return path


def test_directions_of_landmarks_of_the_convention() -> None:
    uv = pano.direction_to_uv(np.array([[1.0, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]]))
    np.testing.assert_allclose(uv[:3], [[0.5, 0.5], [0.75, 0.5], [0.25, 0.5]], atol=1e-12)
    np.testing.assert_allclose(uv[3:, 1], [0.0, 1.0], atol=1e-12)


def test_direction_uv_round_trip() -> None:
    direction = np.random.default_rng(1).normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    back = pano.uv_to_direction(pano.direction_to_uv(direction))
    np.testing.assert_allclose(back, direction, atol=1e-12)


def test_solid_angles_cover_the_sphere() -> None:
    assert pano.texel_solid_angles(32).sum() * 64 == pytest.approx(4 * np.pi)


def test_lookup_returns_texels_at_their_centres_and_has_no_seam() -> None:
    image = hdr()
    np.testing.assert_allclose(pano.lookup(image, pano.texel_directions(16)), image, atol=1e-4)
    near_seam = pano.uv_to_direction(np.array([[1e-9, 0.4], [1 - 1e-9, 0.4]]))
    a, b = pano.lookup(image, near_seam)
    np.testing.assert_allclose(a, b, atol=1e-4)
    near_pole = pano.uv_to_direction(np.array([[0.1, 1e-9], [0.6, 1e-9]]))
    a, b = pano.lookup(image, near_pole)
    np.testing.assert_allclose(a, b, atol=1e-4)


def test_lookup_turns_the_environment_counter_clockwise() -> None:
    image = np.zeros((32, 64, 3), np.float32)
    image[16, 32] = 1.0  # close to +X
    from_y = pano.lookup(image, np.array([0.0, 1.0, 0.0]), rotation=np.pi / 2)
    assert from_y.max() > 0.2
    assert pano.lookup(image, np.array([0.0, -1.0, 0.0]), rotation=np.pi / 2).max() == 0.0


def test_shrink_keeps_irradiance() -> None:
    image = hdr(64)
    up = np.array([0.0, 0.0, 1.0])
    whole = pano.irradiance(image, up)
    np.testing.assert_allclose(pano.irradiance(pano.shrink(image, 4), up), whole, rtol=0.02)


_RENDER = """
import sys, numpy as np, bpy
from mathutils import Vector
source, target, rotation = sys.argv[1], sys.argv[2], float(sys.argv[3])
direction = [float(v) for v in sys.argv[4:7]]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.samples = 4
scene.cycles.use_denoising = False
scene.cycles.pixel_filter_type = "GAUSSIAN"  # the box ignores filter_width
scene.cycles.filter_width = 0.01
scene.render.threads_mode, scene.render.threads = "FIXED", 1
scene.render.resolution_x = scene.render.resolution_y = 33
world = bpy.data.worlds.new("world"); scene.world = world; world.use_nodes = True
tree = world.node_tree
image = tree.nodes.new("ShaderNodeTexEnvironment")
image.image = bpy.data.images.load(source)
image.image.colorspace_settings.name = "Linear Rec.709"
mapping = tree.nodes.new("ShaderNodeMapping"); mapping.vector_type = "TEXTURE"
mapping.inputs["Rotation"].default_value = (0, 0, rotation)
coordinates = tree.nodes.new("ShaderNodeTexCoord")
tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
tree.links.new(mapping.outputs[0], image.inputs[0])
tree.links.new(image.outputs[0], tree.nodes["Background"].inputs[0])
camera = bpy.data.cameras.new("camera"); camera.angle = np.radians(50)
item = bpy.data.objects.new("camera", camera); scene.collection.objects.link(item)
item.rotation_euler = Vector(direction).to_track_quat("-Z", "Y").to_euler()
scene.camera = item
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.filepath = target
bpy.ops.render.render(write_still=True)
np.save(target + ".npy", np.array(item.matrix_world))
"""


@needs_bpy
@pytest.mark.parametrize(("row", "column", "rotation"), [(9, 11, 0.0), (21, 52, 0.9)])
def test_blender_sees_what_lookup_says(
    tmp_path: Path, row: int, column: int, rotation: float
) -> None:
    import OpenImageIO as oiio

    image = np.full((32, 64, 3), 0.01, np.float32)
    image[row, column] = (50.0, 20.0, 5.0)
    pano.write(tmp_path / "p.exr", image, {})
    texel = pano.uv_to_direction(np.array([(column + 0.5) / 64, (row + 0.5) / 32]))
    direction = pano.rotate_z(texel, rotation)
    target = tmp_path / "out.exr"
    argv = [sys.executable, "-c", _RENDER, str(tmp_path / "p.exr"), str(target), str(rotation)]
    subprocess.run(
        [*argv, *[str(v) for v in direction]], check=True, capture_output=True, timeout=120
    )
    seen = np.asarray(oiio.ImageBuf(str(target)).get_pixels(oiio.FLOAT))[..., :3]
    world = np.load(str(target) + ".npy")
    column_px, row_px = np.meshgrid(np.arange(33) + 0.5, np.arange(33) + 0.5)
    focal = 16.5 / np.tan(np.radians(25))
    local = np.stack(
        [(column_px - 16.5) / focal, (16.5 - row_px) / focal, -np.ones_like(row_px)], axis=-1
    )
    expected = pano.lookup(image, local @ world[:3, :3].T, rotation)
    assert seen[16, 16, 0] == pytest.approx(50.0, rel=0.03)
    np.testing.assert_allclose(seen, expected, atol=0.02 * 50.0)


def test_write_read_round_trip_and_equal_bytes(tmp_path: Path) -> None:
    image = hdr()
    for name in ("a.exr", "b.exr"):
        pano.write(tmp_path / name, image, {"source": "here", "numbers": [1, 2]})
    np.testing.assert_allclose(pano.load(tmp_path / "a.exr"), image, rtol=1e-3, atol=1e-6)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert pano.read_header(tmp_path / "a.exr")["numbers"] == "[1, 2]"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "b.exr"]


def test_radiance_beyond_half_is_stored_as_float(tmp_path: Path) -> None:
    image = hdr()
    image[3, 4] = 2e5
    pano.write(tmp_path / "a.exr", image, {})
    assert pano.load(tmp_path / "a.exr")[3, 4, 0] == pytest.approx(2e5)


def test_bad_panoramas_are_refused_with_the_reason(tmp_path: Path) -> None:
    nan = hdr()
    nan[2, 3, 1] = np.nan
    photo = np.random.default_rng(0).integers(0, 256, (16, 32, 3)).astype(np.float32) / 255
    clipped = np.minimum(hdr() * 0.9, 1.0)
    (tmp_path / "text.exr").write_text("not an image")
    cases = [
        (tmp_path / "missing.exr", "no such file"),
        (tmp_path / "text.exr", "cannot be read"),
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
            pano.load(path)
        assert str(path) in str(raised.value)


def test_truncated_file_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "p.exr", hdr(64))
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(PanoramaError):
        pano.load(path)


def test_negatives_become_zero_hdr_reads_and_wide_files_shrink(tmp_path: Path) -> None:
    image = hdr(64)
    image[0, 0] = -0.01
    assert pano.load(save(tmp_path / "n.exr", image)).min() == 0.0
    assert pano.load(save(tmp_path / "n.exr", image), max_width=32).shape == (16, 32, 3)
    assert pano.load(save(tmp_path / "n.exr", image), max_width=100).shape == (50, 100, 3)
    smooth = hdr(8) + 0.1
    rgbe = pano.load(save(tmp_path / "n.hdr", smooth, "float"))
    np.testing.assert_allclose(rgbe, smooth, atol=float(smooth.max()) / 100)


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
        header = pano.read_header(path)
        assert header["environment_id"] == spec.id
        assert header["environment_licence"] == spec.licence
        stored = pano.load(path)
        assert stored.shape[1] == 2 * stored.shape[0]
    user_header = pano.read_header(paths[1])
    expected = hashlib.sha256((user / "My Garden.exr").read_bytes()).hexdigest()
    assert user_header["environment_sha256"] == expected
    before = [p.stat().st_mtime_ns for p in paths]
    paths[0].write_bytes(b"damaged")
    write_pool(specs, tmp_path / "pool")
    assert [p.stat().st_mtime_ns for p in paths][1:] == before[1:]
    assert pano.load(paths[0]).shape == (512, 1024, 3)


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
