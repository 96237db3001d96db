"""Pinhole cameras: where they stand, what they see, and other tools' conventions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets_procedural.conventions.camera import (
    Camera,
    CameraSample,
    nerfstudio_frame,
    resolve,
)
from synthgen.planning.camera_sampling import sample_camera
from synthgen.planning.job import CameraSettings

HEAD = np.array([0.01, -0.05, 0.7])
HEIGHT = 0.25


def random_camera(seed: int, resolution: int = 256) -> tuple[CameraSample, Camera]:
    sample = sample_camera(np.random.default_rng(seed), CameraSettings())
    return sample, resolve(sample, HEAD, HEIGHT, resolution)


def test_frontal_camera_looks_along_plus_y() -> None:
    camera = resolve(CameraSample(focal_mm=72, fill=0.5), HEAD, HEIGHT, 200)
    np.testing.assert_allclose(camera.forward, [0, 1, 0], atol=1e-12)
    # 72 mm on 36 mm: the frame is half as wide as it is far away.
    np.testing.assert_allclose(camera.position, HEAD - [0, 2 * HEIGHT / 0.5, 0], atol=1e-12)
    pixels, depth = camera.project(HEAD + [[0, 0, 0], [0.1, 0, 0], [0, 0, 0.125]])
    np.testing.assert_allclose(depth, 1.0)
    # The subject's left (+X) is on the right of the picture, up is up, half the fill is 50 px.
    np.testing.assert_allclose(pixels, [[100, 100], [140, 100], [100, 50]])


def test_signs_of_yaw_pitch_roll_and_shift() -> None:
    left = resolve(CameraSample(yaw=math.radians(90)), HEAD, HEIGHT, 100)
    assert left.position[0] > HEAD[0] + 0.5
    above = resolve(CameraSample(pitch=math.radians(30)), HEAD, HEIGHT, 100)
    assert above.position[2] > HEAD[2] + 0.3
    # A camera turned counter-clockwise sees the crown of the head to the right of its middle.
    rolled = resolve(CameraSample(roll=math.radians(10)), HEAD, HEIGHT, 100)
    crown, _ = rolled.project(HEAD + [0, 0, 0.1])
    assert crown[0] > 51
    shifted = resolve(CameraSample(shift=(0.1, 0.2), roll=1.0, yaw=0.5), HEAD, HEIGHT, 100)
    centre, _ = shifted.project(HEAD)
    np.testing.assert_allclose(centre, [60, 30], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_resolved_cameras_are_rigid_and_hold_their_fill(seed: int) -> None:
    sample, camera = random_camera(seed)
    rotation = camera.camera_to_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    up = camera.camera_to_world[:3, 1]
    ends, depth = camera.project(HEAD + np.outer([-0.5, 0.5], up) * HEIGHT)
    np.testing.assert_allclose(np.linalg.norm(ends[1] - ends[0]) / 256, sample.fill)
    assert camera.focal_mm == pytest.approx(sample.focal_mm)
    assert depth[0] == pytest.approx(sample.focal_mm / 36 * HEIGHT / sample.fill)


@pytest.mark.parametrize("seed", range(3))
def test_projection_round_trip(seed: int) -> None:
    _, camera = random_camera(seed)
    points = HEAD + np.random.default_rng(seed).normal(0, 0.1, (4, 7, 3))
    pixels, depth = camera.project(points)
    assert pixels.shape == (4, 7, 2)
    assert depth.shape == (4, 7)
    np.testing.assert_allclose(camera.unproject(pixels, depth), points, atol=1e-12)


def test_projection_is_scale_free_in_resolution() -> None:
    small, large = random_camera(3, 64)[1], random_camera(3, 512)[1]
    np.testing.assert_array_equal(small.camera_to_world, large.camera_to_world)
    np.testing.assert_allclose(8 * small.project(HEAD)[0], large.project(HEAD)[0])


def test_pixel_centres() -> None:
    _, camera = random_camera(0, 4)
    centres = camera.pixel_centres()
    assert centres.shape == (4, 4, 2)
    np.testing.assert_array_equal(centres[0, 0], [0.5, 0.5])
    np.testing.assert_array_equal(centres[3, 1], [1.5, 3.5])


def test_points_behind_the_camera_stay_finite() -> None:
    _, camera = random_camera(0)
    pixels, depth = camera.project(np.stack([camera.position, camera.position - camera.forward]))
    assert np.isfinite(pixels).all()
    np.testing.assert_allclose(depth, [0, -1], atol=1e-12)


def test_nerfstudio_frame() -> None:
    _, camera = random_camera(2)
    frame = nerfstudio_frame(camera)
    assert (frame["w"], frame["h"], frame["cx"], frame["cy"]) == (256, 256, 128, 128)
    assert frame["fl_x"] == frame["fl_y"] == camera.intrinsics[0, 0]
    assert frame["transform_matrix"] == camera.camera_to_world.tolist()


def test_samples_stay_in_their_ranges() -> None:
    settings = CameraSettings(yaw=(-10, 20), focal_mm=(50, 50), shift=(0, 0))
    rng = np.random.default_rng(0)
    samples = [sample_camera(rng, settings) for _ in range(200)]
    yaw = np.degrees([s.yaw for s in samples])
    assert -10 <= yaw.min() < -8
    assert 18 < yaw.max() <= 20
    assert {round(s.focal_mm, 9) for s in samples} == {50}
    assert {s.shift for s in samples} == {(0, 0)}


def test_bad_arguments() -> None:
    with pytest.raises(ValueError, match=r"head_centre must be \(..., 3\), got \(2,\)"):
        resolve(CameraSample(), np.zeros(2), HEIGHT, 100)
    with pytest.raises(ValueError, match="head_height must be positive"):
        resolve(CameraSample(), HEAD, 0.0, 100)
    with pytest.raises(ValueError, match=r"points must be \(..., 3\)"):
        random_camera(0)[1].project(np.zeros((3, 4)))
