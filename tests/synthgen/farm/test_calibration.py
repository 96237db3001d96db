"""The cost model: what is fitted, how it is carried over, and what a plan makes of it."""

from __future__ import annotations

from pathlib import Path

import fake_renderer
import numpy as np
import pytest

from assets_procedural.conventions.console import size
from synthgen.dataset import manifest
from synthgen.dataset.folder import StorageError
from synthgen.farm import calibration, measure
from synthgen.farm.calibration import Calibration
from synthgen.farm.estimate import estimate
from synthgen.farm.recorded import recorded_costs
from synthgen.planning.job import JobSpec, SubsetSpec
from synthgen.planning.plan import Plan, subject_bytes

SPEC = SubsetSpec(kind="multiview", subjects=100, environments=4, views=5)
JOB = JobSpec(name="test", resolution=256, samples=16, subsets={"multiview": SPEC})
PLAN = Plan(JOB, [f"light_{i}" for i in range(4)])
RENDERER = "some:renderer"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path))


def measured(**changes: object) -> Calibration:
    values: dict[str, object] = {
        "machine": calibration.machine_name(),
        "renderer": RENDERER,
        "device": "cpu",
        "threads": 1,
        "kind": "multiview",
        "resolution": 256,
        "samples": 16,
        "linear": True,
        "subject_s": 10.0,
        "shot_s": 2.0,
        "frame_s": 8.0,
        "shot_bytes": 1e6,
        "frame_bytes": 5e5,
        "measured": "2026-01-01",
    }
    return Calibration.model_validate(values | changes)


def test_fit_finds_the_costs() -> None:
    shots, frames = np.array([1, 3, 1, 1, 3, 1]), np.array([1, 3, 3, 1, 3, 3])
    rows = np.stack([shots, frames, 5 + 2 * shots + 7 * frames, 1e6 * shots, 3e5 * frames], 1)
    fitted = measure._fit(rows.astype(float))
    expected = {"subject_s": 5, "shot_s": 2, "frame_s": 7, "shot_bytes": 1e6, "frame_bytes": 3e5}
    assert fitted == pytest.approx(expected)


def test_rounds_tell_subjects_shots_and_frames_apart() -> None:
    sizes = [(len(s.shots), s.frames) for s in measure._rounds(PLAN, "video")]
    assert sizes[0] == (1, 1)
    assert sizes[1:] == 2 * [(1, 1), (3, 3), (1, 3)]


def test_an_exact_measurement_is_used_as_it_is() -> None:
    calibration.save([measured()])
    result = estimate(PLAN, "cpu", 1, RENDERER)
    assert result.hours == pytest.approx(100 * (10 + 5 * (2 + 4 * 8)) / 3600)
    assert result.subsets[0].bytes == pytest.approx(100 * 5 * (1e6 + 4 * 5e5))
    assert result.subsets[0].found.exact
    assert result.subsets[0].found.source == "calibration"


def test_a_measurement_replaces_the_older_one() -> None:
    calibration.save([measured(), measured(samples=8)])
    calibration.save([measured(frame_s=1.0)])
    assert sorted((c.samples, c.frame_s) for c in calibration.load()) == [(8, 8.0), (16, 1.0)]


def test_the_nearest_measurement_is_carried_over() -> None:
    calibration.save([measured(resolution=512, shot_s=8.0, frame_s=32.0), measured(resolution=64)])
    found = calibration.find(JOB, "multiview", "cpu", 1, RENDERER)
    assert not found.exact
    assert found.measured.resolution == 512
    costs = found.costs
    assert (costs.resolution, costs.shot_s, costs.frame_s) == (256, 2.0, 8.0)
    more = JOB.model_copy(update={"samples": 64})
    costs = calibration.find(more, "multiview", "cpu", 1, RENDERER).costs
    assert costs.frame_s == pytest.approx(8.0 * (0.25 + 0.75 * 4))


def test_threads_share_the_work_of_a_frame_on_a_cpu_alone() -> None:
    calibration.save([measured(), measured(device="cuda")])
    costs = calibration.find(JOB, "multiview", "cpu", 4, RENDERER).costs
    assert (costs.threads, costs.frame_s, costs.shot_s) == (4, 2.0, 2.0)
    assert calibration.find(JOB, "multiview", "cuda", 4, RENDERER).costs.frame_s == 8.0


@pytest.mark.parametrize(
    "other", [{"machine": "elsewhere"}, {"device": "cuda"}, {"renderer": "a:b"}, {"kind": "video"}]
)
def test_without_a_measurement_of_this_kind_the_reference_answers(other: dict[str, str]) -> None:
    calibration.save([measured(**other)])
    result = estimate(PLAN, "cpu", 1, RENDERER)
    (subset,) = result.subsets
    assert subset.found.source == "reference"
    assert not subset.found.exact
    assert subset.hours == pytest.approx(100 * (2.8 + 5 * (0.86 + 4 * 11.2)) / 3600)
    assert subset.bytes == 100 * subject_bytes(JOB, SPEC)
    assert result.machines(0.01) > 1


def test_a_named_dataset_comes_first_then_a_calibration_then_what_was_rendered() -> None:
    calibration.save([measured(dataset="out/a", frame_s=5.0)])
    assert calibration.find(JOB, "multiview", "cpu", 1, RENDERER).source == "rendered"
    calibration.save([measured()])
    found = calibration.find(JOB, "multiview", "cpu", 1, RENDERER)
    assert (found.source, found.costs.frame_s) == ("calibration", 8.0)
    named = [measured(dataset="out/b", kind="video", frame_s=3.0)]
    found = calibration.find(JOB, "multiview", "cpu", 1, RENDERER, named)
    assert (found.source, found.costs.frame_s) == ("named", 3.0)


def test_what_a_dataset_took_is_read_from_its_manifest(small_dataset: Path) -> None:
    costs = {c.kind: c for c in recorded_costs(small_dataset, "cpu", 1)}
    assert costs.keys() == {"multiview", "video"}
    # Two lights of a view, three of a video's frame: 0.01 s of `beauty` in each shot.
    assert costs["multiview"].frame_s == pytest.approx(0.01 / 2)
    assert costs["video"].frame_s == pytest.approx(0.01 / 3)
    spec = fake_renderer.small_job().subsets["multiview"]
    sql = "SELECT avg(cost_store), sum(size) FROM multiview"
    ((stored, size),) = manifest.query(small_dataset, sql).rows
    assert costs["multiview"].shot_s == pytest.approx(0.002 + stored)
    assert costs["multiview"].subject_s >= 0.0
    assert costs["multiview"].bytes(spec) * spec.subjects == pytest.approx(size)


def test_a_dataset_without_costs_is_one_line(small_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no dataset here"):
        recorded_costs(tmp_path, "cpu", 1)


def test_machines_for_a_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "cores", lambda: 8)
    calibration.save([measured(), measured(device="cuda")])
    result = estimate(PLAN, "cpu", 1, RENDERER)
    assert result.processes == 8
    assert result.hours == pytest.approx(5.0)
    assert result.machines(1.0) == 1
    assert result.machines(0.1) == 7
    assert estimate(PLAN, "cpu", 4, RENDERER).processes == 2
    assert estimate(PLAN, "cuda", 1, RENDERER).processes == 1


def test_a_damaged_store_counts_as_empty() -> None:
    calibration.save([measured()])
    calibration.store().write_text("{")
    assert calibration.load() == []


def test_sizes_for_people() -> None:
    shown = [size(n) for n in (0, 999, 12_345, 3.21e9, 4.5e15)]
    assert shown == ["0 B", "999 B", "12.3 kB", "3.21 GB", "4,500 TB"]
