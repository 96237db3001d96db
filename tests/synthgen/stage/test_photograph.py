"""From linear light to the picture: metering of backgrounds, mattes, pages behind, the lens."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.conventions.colour import display, to_bytes
from synthgen.planning.job import LensSettings, parse_job
from synthgen.stage import photograph
from synthgen.stage.lens import finish

OFF = LensSettings()
RNG = np.random.default_rng


def test_bright_backgrounds_are_metered_by_a_quarter_stop_at_most() -> None:
    alpha = np.zeros((8, 8))
    alpha[4:] = 1
    factors = [photograph.spared(np.full((8, 8, 3), level), alpha) for level in (0.3, 1.2, 1.5, 99)]
    assert factors == pytest.approx([1, 1, 0.8**0.5, 0.7**0.5])
    assert photograph.spared(np.full((8, 8, 3), 99.0), np.ones((8, 8))) == 1


def test_a_matte_is_soft_at_its_edge_and_whole_inside() -> None:
    coverage = np.zeros((16, 16))
    coverage[:, 8:] = 1
    soft = photograph.matte(coverage)
    assert (soft[:, 11:] == 1).all() and 0 < soft[8, 7] < 0.5 < soft[8, 8] < 1
    assert soft.sum() == pytest.approx(coverage.sum(), rel=1e-3)


def test_the_mean_of_what_is_covered_does_not_depend_on_how_much_is() -> None:
    coverage = RNG(0).random((16, 16, 1)) ** 3
    coverage[:, :8] = 1
    coverage[12:] = 0
    colour = np.array([0.2, 0.5, 0.9])
    found = photograph.mean_surface(coverage * colour, coverage)
    np.testing.assert_allclose(found[:12], np.broadcast_to(colour, (12, 16, 3)), rtol=1e-6)


@pytest.mark.parametrize("page", [(1.0, 1.0, 1.0), (0.0, 1.0, 0.0)])
def test_a_coloured_page_is_just_that_colour_and_does_not_shine_through(
    page: tuple[float, float, float],
) -> None:
    light = np.full((1, 3, 3), 0.02) * np.array([0.0, 0.9, 1.0])[None, :, None]
    alpha = np.array([[0.0, 0.9, 1.0]])
    shown = photograph.develop(light, alpha, 1.0, page, OFF, RNG(0))[0]
    np.testing.assert_array_equal(shown[0], to_bytes(np.array(page)))
    np.testing.assert_array_equal(shown[2], to_bytes(display(np.full(3, 0.02))))
    assert shown[1].max() < 100  # a tenth of a white page, not of a lamp


def test_the_lens_is_off_unless_asked_for() -> None:
    light = RNG(1).random((32, 32, 3)) * 2
    np.testing.assert_array_equal(finish(light, OFF, RNG(0)), display(light))
    for name in ("bloom", "blur", "grain", "sharpen"):
        settings = LensSettings.model_validate({name: 0.1 if name != "blur" else 0.5})
        assert settings.changes_pictures
        one, again, other = (finish(light, settings, RNG(seed)) for seed in (0, 0, 1))
        np.testing.assert_array_equal(one, again)
        assert not np.array_equal(one, display(light)) and 0 <= one.min() <= one.max() <= 1
        assert np.array_equal(one, other) == (name != "grain")
    assert not LensSettings(f_number=4.0).changes_pictures


def test_a_lens_needs_the_picture_of_an_environment() -> None:
    subset = {"kind": "multiview", "subjects": 1, "environments": 1, "views": 1}
    job = {"name": "lens", "subsets": {"a": subset}, "lens": {"grain": 0.01}}
    assert parse_job(job, "job.toml").lens.grain == 0.01
    with pytest.raises(Exception, match="lens: bloom, blur, grain and sharpen need"):
        parse_job(job | {"image": {"background": "#ffffff"}}, "job.toml")
