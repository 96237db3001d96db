"""The cost model: what is fitted, how it is carried over, and what a plan makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets_procedural.conventions.console import size
from synthgen.farm import calibration, measure
from synthgen.farm.calibration import Calibration
from synthgen.farm.estimate import estimate
from synthgen.planning.job import JobSpec, SubsetSpec
from synthgen.planning.plan import Plan

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
    assert result.subsets[0].exact


def test_a_measurement_replaces_the_older_one() -> None:
    calibration.save([measured(), measured(samples=8)])
    calibration.save([measured(frame_s=1.0)])
    assert sorted((c.samples, c.frame_s) for c in calibration.load()) == [(8, 8.0), (16, 1.0)]


def test_the_nearest_measurement_is_carried_over() -> None:
    calibration.save([measured(resolution=512, shot_s=8.0, frame_s=32.0), measured(resolution=64)])
    found = calibration.find(JOB, "multiview", "cpu", 1, RENDERER)
    assert found is not None
    best, exact = found
    assert not exact
    assert (best.resolution, best.shot_s, best.frame_s) == (256, 2.0, 8.0)
    more = JOB.model_copy(update={"samples": 64})
    found = calibration.find(more, "multiview", "cpu", 1, RENDERER)
    assert found is not None
    assert found[0].frame_s == pytest.approx(8.0 * (0.25 + 0.75 * 4))


@pytest.mark.parametrize(
    "other", [{"machine": "elsewhere"}, {"device": "cuda"}, {"renderer": "a:b"}, {"kind": "video"}]
)
def test_other_machines_devices_and_kinds_say_nothing(other: dict[str, str]) -> None:
    calibration.save([measured(**other)])
    result = estimate(PLAN, "cpu", 1, RENDERER)
    assert result.hours is None
    assert result.machines(1.0) is None
    assert result.subsets[0].bytes > 0


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
