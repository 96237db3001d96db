"""What is denoised, how often, and that a held scene follows its settings."""

from __future__ import annotations

import numpy as np
import pytest
import stage_scenes as scenes

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def denoised(blender):
    return blender(scenes.denoisings)


def test_noise_goes_and_its_mean_stays(denoised):
    assert denoised["light"].std() < 0.1  # it was 1
    assert abs(denoised["light"].mean() - 1) < 0.1
    assert denoised["coverage"].std() < 0.1  # it was 0.46
    assert abs(denoised["coverage"].mean() - 0.7) < 0.1
    assert denoised["whole"].min() > 0.99


def test_one_pixel_that_is_no_number_spoils_nothing(denoised):
    assert np.isfinite(denoised["light"]).all()


def test_threads_do_not_change_a_bit(denoised):
    assert np.array_equal(denoised["light"], denoised["two"])


def test_guides_and_coverage_are_denoised_once_a_shot(blender):
    asked = blender(scenes.denoised_with_shared_guides, 5)
    assert sorted(asked) == ["albedo", "color"] + ["color+albedo+normal"] * 5 + ["normal"]


def test_a_held_scene_follows_seed_and_samples(blender, tmp_path):
    scenes.write_gradient(tmp_path, "gradient", (1.0, 1.0, 1.0))
    images = blender(scenes.held_scene, tmp_path)
    first, again = images["1_2"]
    assert np.array_equal(first, again)
    assert not np.array_equal(first, images["2_2"][0])
    assert np.abs(images["2_32"][0] - images["2_2"][0]).max() > 1e-3
