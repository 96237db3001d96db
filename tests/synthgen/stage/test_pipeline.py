"""The whole generator with real Blender at 64 pixels: same bytes, whatever renders them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from synthgen.dataset import open_dataset
from synthgen.dataset.manifest import query
from synthgen.farm.local import render_job
from synthgen.farm.rerender import rerender
from synthgen.planning.job import JobSpec
from synthgen.publish.verify import verify

pytestmark = pytest.mark.blender

JOB = JobSpec.model_validate(
    {
        "name": "tiny",
        "seed": 0,
        "resolution": 64,
        "samples": 4,
        "subsets": {
            "multiview": {"kind": "multiview", "subjects": 1, "environments": 2, "views": 2},
            "video": {"kind": "video", "subjects": 1, "environments": 1, "frames": 2},
            "lights": {"kind": "multiview", "subjects": 1, "environments": 8, "views": 2},
        },
        "environments": {"bundled": ["city"], "studios": 7},
    }
)


@pytest.fixture(scope="module")
def datasets(tmp_path_factory) -> tuple[Path, Path]:
    """The same job by two workers with a thread each, and by one with two threads."""
    one, other = (tmp_path_factory.mktemp("tiny") / name for name in ("one", "other"))
    render_job(JOB, one, workers=2, threads=1)
    render_job(JOB, other, workers=1, threads=2)
    return one, other


def test_worker_and_thread_counts_do_not_change_a_byte(datasets):
    one, other = datasets
    for folder in ("data", "environments", "subjects"):
        files = sorted(p.relative_to(one) for p in (one / folder).rglob("*") if p.is_file())
        assert files
        for file in files:
            assert _digest(one / file) == _digest(other / file), file


def test_manifests_agree_timing_columns_aside(datasets):
    first, second = (
        [
            {name: value for name, value in row.items() if not name.startswith("cost_")}
            for row in query(out, "SELECT * FROM manifest ORDER BY subset, key").to_pylist()
        ]
        for out in datasets
    )
    assert len(first) == 6
    assert first == second


def test_the_dataset_keeps_every_promise(datasets):
    assert verify(datasets[0]) == []


@pytest.mark.parametrize("key", ["video/s000000_p01", "lights/s000000_p01"])
def test_a_shot_renders_again_from_its_provenance(datasets, key):
    report = rerender(datasets[0], key)
    assert report.identical, str(report)


def test_a_shot_says_whether_its_lights_share_a_pass(datasets):
    alone = open_dataset(datasets[0], subset="multiview")[0].meta
    together = open_dataset(datasets[0], subset="lights")[0].meta
    assert "light_basis" not in alone
    assert together["light_basis"] == {"samples": 15}


def test_lights_change_the_picture_alone(datasets):
    shot = open_dataset(datasets[0], subset="multiview")[0]
    assert shot.rgb.shape == (2, 64, 64, 3)
    assert (shot.rgb[0] != shot.rgb[1]).mean() > 0.5
    assert shot.albedo.ndim == shot.normal.ndim == 3  # stored once, not per light


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
