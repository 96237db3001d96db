"""A complete dataset takes more subjects and subsets, and equals one rendered at once."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import fake_renderer
import pytest

from assets_procedural.conventions.files import sha256
from assets_procedural.light.pool import pool, provenance
from synthgen.dataset.folder import StorageError
from synthgen.dataset.records import read_description
from synthgen.farm.local import extend_job, render_job
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import Plan
from synthgen.publish.extending import extend
from synthgen.publish.verify import verify

OPTIONS: Any = {"workers": 1, "renderer": fake_renderer.RENDERER}


def larger(subjects: int = 8, **changes: Any) -> JobSpec:
    """More people in `multiview`, so that its last shards grow, and a subset of its people."""
    subsets = {name: s.model_dump() for name, s in fake_renderer.small_job().subsets.items()}
    subsets["multiview"]["subjects"] = subjects
    subsets["more"] = subsets["video"] | {"subjects": 1, "people_of": "multiview"}
    return fake_renderer.small_job(subsets=subsets, **changes)


@pytest.fixture
def dataset(small_dataset, tmp_path) -> Path:
    return Path(shutil.copytree(small_dataset, tmp_path / "out"))


def files(out: Path) -> dict[str, str]:
    kept = ("data", "subjects", "environments")
    found = (p for name in kept for p in (out / name).rglob("*") if p.is_file())
    return {p.relative_to(out).as_posix(): sha256(p) for p in found}


def test_it_equals_a_dataset_that_was_rendered_at_once(dataset, tmp_path):
    summary = extend_job(larger(), dataset, **OPTIONS)
    assert summary.complete and summary.rendered == 4  # 3 people and 1 of the new subset
    assert verify(dataset) == []
    render_job(larger(), tmp_path / "whole", **OPTIONS)
    assert files(dataset) == files(tmp_path / "whole")


def test_an_extension_that_was_interrupted_goes_on(dataset):
    job = larger()
    specs = pool(job.environments, job.seed)
    plan = Plan(job, [spec.id for spec in specs])
    extend(dataset, plan, [provenance(spec) for spec in specs], fake_renderer.RENDERER)
    assert not read_description(dataset).complete
    assert not render_job(job, dataset, limit=1, **OPTIONS).complete
    assert render_job(job, dataset, **OPTIONS).complete
    assert verify(dataset) == []


def test_the_same_job_adds_nothing(dataset):
    before = files(dataset)
    assert extend_job(fake_renderer.small_job(), dataset, **OPTIONS).rendered == 0
    assert files(dataset) == before


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"resolution": 64}, "resolution: 48 there, 64 here"),
        ({"subjects": 4}, "subsets.multiview.subjects"),
    ],
)
def test_other_changes_are_refused_by_name(dataset, changes, said):
    before = files(dataset)
    with pytest.raises(StorageError, match=said):
        extend_job(larger(**changes), dataset, **OPTIONS)
    assert read_description(dataset).complete
    assert files(dataset) == before


def test_an_unfinished_dataset_is_finished_first(tmp_path):
    render_job(fake_renderer.small_job(), tmp_path / "out", limit=1, **OPTIONS)
    with pytest.raises(StorageError, match="not complete"):
        extend_job(larger(), tmp_path / "out", **OPTIONS)
