"""Labels and light against independent truths, with real Blender at 64 pixels."""

from __future__ import annotations

import re

import numpy as np
import pytest
import stage_scenes as scenes
import trimesh

from assets_procedural.conventions import panorama
from assets_procedural.conventions.camera import Camera
from assets_procedural.conventions.colour import srgb_decode
from synthgen.dataset.gate import inspect
from synthgen.dataset.shot import camera_of

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def lights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lights")
    scenes.write_gradient(folder, "gradient", (1.0, 1.0, 1.0))
    scenes.write_gradient(folder, "ember", (6.0, 1.0, 0.2))
    return folder


@pytest.fixture(scope="module")
def shots(blender, lights):
    return blender(scenes.dressed, lights, "gradient")


@pytest.mark.parametrize("towards", [(-0.6, -0.7, 0.4), (0.7, -0.6, -0.3)])
def test_a_bright_texel_lights_the_side_that_the_convention_says(blender, lights, towards):
    direction = np.array(towards) / np.linalg.norm(towards)
    rotation = 0.5
    seen = blender(
        scenes.ball_under_a_spot, lights, panorama.rotate_z(direction, -rotation), rotation
    )
    assert np.degrees(np.arccos(seen @ direction)) < 4  # a texel of the panorama spans 2.8 degrees


def test_clear_surfaces_take_no_light_from_what_is_behind_them(blender):
    shown = {name: image.mean(axis=-1) for name, image in blender(scenes.furnace).items()}
    bare = shown.pop("bare")
    for name, image in shown.items():
        assert 0.99 < image.mean() / bare.mean() < 1.03, name
        with_it, without = (i.reshape(8, 8, 8, 8).mean(axis=(1, 3)) for i in (image, bare))
        assert (with_it / without).min() > 0.97, name
        assert (with_it - without).max() < 0.08, name  # what two sides of a lens reflect


def test_depth_and_normals_lie_on_the_evaluated_mesh(blender, lights):
    shown = blender(scenes.bare_head, lights)
    quads = shown["faces"]
    mesh = trimesh.Trimesh(
        shown["vertices"],
        np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
        process=False,
    )
    camera = Camera(shown["camera_to_world"], shown["intrinsics"], scenes.SIZE, scenes.SIZE)
    hit = shown["depth"] > 0
    assert hit.mean() > 0.3
    points = camera.unproject(camera.pixel_centres(), shown["depth"])[hit]

    nearest, distance, triangle = trimesh.proximity.closest_point(mesh, points)
    assert np.quantile(distance, 0.999) < 0.0005

    # Which side of a quad's diagonal was split differs, so corners are weighted over triangles.
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[triangle], nearest)
    expected = np.einsum("pk,pkc->pc", weights, mesh.vertex_normals[mesh.faces[triangle]])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    seen = shown["normal"][hit] @ camera.camera_to_world[:3, :3].T
    angle = np.degrees(np.arccos(np.clip((seen * expected).sum(axis=1), -1, 1)))
    assert np.median(angle) < 0.3
    assert np.quantile(angle, 0.95) < 1

    # The mean over a pixel is that of the normals around it, shorter where they bend.
    whole = hit & (shown["coverage"] > 0.999)
    length = np.linalg.norm(shown["mean_normal"], axis=-1)
    assert np.median(length[whole]) > 0.97 and length.max() < 1.001
    cosine = (shown["mean_normal"] * shown["normal"]).sum(-1)[whole] / length[whole]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.median(angle) < 4 and np.quantile(angle, 0.95) < 15

    ray = points - camera.position
    origins = np.broadcast_to(camera.position, ray.shape)
    first = mesh.ray.intersects_location(origins, ray, multiple_hits=False)
    gap = np.linalg.norm(first[0] - points[first[1]], axis=1)
    assert np.quantile(gap, 0.99) < 0.0005


def test_the_bvh_of_strands_is_built_once_a_pose_not_for_every_view_and_label_render(shots, lights):
    log = (lights / "gradient.log").read_text()
    assert len(re.findall(r"Geometry BVH hair \d+/\d+ \| Building BVH$", log, re.MULTILINE)) == 2


def test_visible_landmarks_land_on_their_canonical_coordinates(shots):
    off = []
    for shot in shots:
        pixels = np.array(shot.meta["landmarks"]["points"])[:68]
        seen = np.array(shot.meta["landmarks"]["visible"])[:68]
        footprint = shot.depth.max() / camera_of(shot.meta).intrinsics[0, 0]
        column, row = np.floor(pixels[seen]).astype(int).T
        skin = np.isin(shot.parts[row, column], (1, 2, 7, 8, 10, 11, 12))
        wanted = shot.geometry["landmarks_canonical"][:68][seen][skin]
        off += list(np.linalg.norm(shot.canonical[row, column][skin] - wanted, axis=1) / footprint)
    assert len(off) > 100
    assert np.mean(np.array(off) < 1.0) > 0.9
    assert np.median(off) < 0.6


def test_albedo_and_normals_are_means_over_the_pixel_premultiplied(shots):
    """Neighbours in hair differ little, no pixel is brighter than it is covered."""
    for shot in shots:
        length = np.linalg.norm(shot.normal.astype(np.float32), axis=-1)
        hair = (shot.parts == 13) & (shot.alpha == 255)
        assert hair.sum() > 30
        assert (length[hair] < 0.97).mean() > 0.5  # strands of several directions
        edge = (shot.alpha > 30) & (shot.alpha < 225)
        assert edge.sum() > 50
        assert (length <= shot.alpha / 255 + 0.02).all()
        assert not shot.albedo[shot.alpha == 0].any() and not shot.normal[shot.alpha == 0].any()
        brightest = srgb_decode(shot.albedo / 255.0).max(-1)
        assert (brightest <= shot.alpha / 255 + 0.02).all()


def test_labels_do_not_depend_on_the_light(blender, lights, shots):
    for one, other in zip(shots, blender(scenes.dressed, lights, "ember"), strict=True):
        for name in ("albedo", "normal", "depth", "uv", "canonical", "alpha", "parts"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
        assert not np.array_equal(one.rgb, other.rgb)


def test_shots_pass_the_gate_and_show_all_that_a_head_has(shots):
    for shot in shots:
        assert inspect(shot)[0] == []
    present = set(np.unique(np.stack([shot.parts for shot in shots])))
    assert {1, 2, 3, 4, 5, 6, 10, 11, 12, 13, 15} <= present
