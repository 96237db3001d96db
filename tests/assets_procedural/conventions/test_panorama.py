"""Panoramas: the direction convention, against Blender as well, lookup and resampling."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from panoramas import hdr

from assets_procedural.conventions import panorama as pano
from assets_procedural.conventions import panorama_files

_HAS_BPY = importlib.util.find_spec("bpy") is not None
needs_bpy = pytest.mark.skipif(not _HAS_BPY, reason="bpy is not installed")


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
    panorama_files.write(tmp_path / "p.exr", image, {})
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


def test_the_mathematics_imports_numpy_and_no_library_of_pictures() -> None:
    code = "import sys, assets_procedural.conventions.panorama; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "numpy" in loaded
    assert not loaded & {"OpenImageIO", "OpenEXR", "PIL"}
