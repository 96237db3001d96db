"""What several test files share."""

from __future__ import annotations

from pathlib import Path

import fake_renderer
import pytest

from synthgen.farm.local import render_job


@pytest.fixture(scope="session")
def small_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`fake_renderer.small_job` rendered by one worker without interruption. Do not change it."""
    out = tmp_path_factory.mktemp("small") / "out"
    job = fake_renderer.small_job()
    assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
    return out
