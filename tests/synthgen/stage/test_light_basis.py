"""All environments in one pass, with real Blender: as each alone, whole or in parts."""

from __future__ import annotations

import numpy as np
import pytest
import stage_scenes as scenes

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def balls(blender, tmp_path_factory):
    folder = tmp_path_factory.mktemp("skies")
    scenes.write_skies(folder)
    return blender(scenes.ball_in_a_basis, folder, 48)


def _smooth(picture: np.ndarray) -> np.ndarray:
    """Means of blocks of 4 x 4 pixels, which have little noise."""
    return picture.reshape(12, 4, 12, 4, 3).mean(axis=(1, 3))


def test_each_environment_lights_as_if_it_were_alone(balls):
    for alone, together in zip(balls["worlds"], balls["basis"], strict=True):
        wanted, found = _smooth(alone), _smooth(together)
        assert np.abs(found - wanted).max() < 0.06 * wanted.max()
        assert np.abs(found - wanted).mean() < 0.015 * wanted.mean()


def test_parts_make_the_same_picture(balls):
    for whole, parts in zip(balls["basis"], balls["parts"], strict=True):
        assert np.abs(_smooth(whole) - _smooth(parts)).max() < 0.05 * whole.max()
