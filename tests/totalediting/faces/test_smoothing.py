import numpy as np

from totalediting.faces.smoothing import one_euro

TIMES = np.arange(200) / 25.0


def test_jitter_goes_and_a_jump_comes_through():
    jump = np.where(TIMES > 4, 1.0, 0.0)[:, None]
    noise = np.random.default_rng(0).normal(0, 0.02, jump.shape)
    smooth = one_euro(jump + noise, TIMES, 1.0, 2.0)
    assert smooth[20:90].std() < 0.5 * noise[20:90].std()
    assert abs(smooth[110, 0] - 1) < 0.1  # 0.4 s later


def test_what_rests_stays():
    values = np.full((50, 3), 0.7)
    assert np.allclose(one_euro(values, TIMES[:50], 1.0, 1.0), values)
