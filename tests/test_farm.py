"""Workers, resuming and quarantine, with a renderer that crashes and hangs when told to."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_renderer
import pytest

from synthgen import ledger, manifest, publish
from synthgen.atomic import sha256
from synthgen.farm import run
from synthgen.farm.local import render_job
from synthgen.verify import verify

JOB = fake_renderer.small_job()


def render(out: Path, **options: Any) -> run.Summary:
    options = {"workers": 2, "renderer": fake_renderer.RENDERER} | options
    return render_job(options.pop("job", JOB), out, **options)


def fingerprint(out: Path) -> dict[str, Any]:
    """What two runs of a job must have in common: shards byte for byte, manifest but for costs."""
    tars = {p.relative_to(out).as_posix(): sha256(p) for p in (out / "data").rglob("*.tar")}
    rows = {}
    for subset in JOB.subsets:
        table = manifest.read_rows(out / "manifest" / f"{subset}.parquet")
        rows[subset] = [{k: v for k, v in r.items() if not k.startswith("cost_")} for r in table]
    counts = ledger.read_dataset_json(out)["counts"]
    return {"tars": tars, "rows": rows, "counts": counts}


@pytest.fixture
def whole(small_dataset: Path) -> Path:
    """A dataset that was rendered without interruption by one worker."""
    return small_dataset


def test_a_finished_dataset_is_tidy_and_true(whole: Path):
    names = {p.name for p in whole.iterdir()}
    assert names == {
        *("data", "dataset.json", "README.md", "croissant.json", "manifest"),
        *("environments", "subjects", "ledger"),
    }
    assert not list(whole.rglob("*.tmp"))
    assert verify(whole) == []
    status = ledger.status(whole)
    assert status.complete
    assert status.frames == (5 * 4 + 3 * 6, 5 * 4 + 3 * 6)
    assert [s.done for s in status.subsets] == [5, 3]


def test_the_number_of_workers_changes_nothing(whole: Path, tmp_path: Path):
    summary = render(tmp_path / "out", workers=2, subjects_per_worker=1)
    assert (summary.complete, summary.rendered, summary.frames) == (True, 8, 38)
    assert fingerprint(tmp_path / "out") == fingerprint(whole)


def test_rendering_again_does_nothing(whole: Path):
    before = {p: p.stat().st_mtime_ns for p in (whole / "data").rglob("*")}
    assert render(whole).rendered == 0
    assert {p: p.stat().st_mtime_ns for p in (whole / "data").rglob("*")} == before


def test_slices_and_limits_add_up(whole: Path, tmp_path: Path):
    out = tmp_path / "out"
    assert not render(out, shard=(2, 2)).complete
    limited = render(out, shard=(1, 2), limit=1)
    assert (limited.rendered, limited.complete) == (1, False)
    status = ledger.status(out)
    assert sum(s.done for s in status.subsets) < 8
    assert manifest.query(out, "SELECT count(*) FROM manifest").rows[0][0] > 0
    assert render(out, shard=(1, 2)).complete
    assert fingerprint(out) == fingerprint(whole)


# ---------------------------------------------------------------- kill and resume

COMMAND = """
import sys
from pathlib import Path
import fake_renderer
from synthgen.farm import commit, local, run
exec(sys.argv[2])
if __name__ == "__main__":
    local.render_job(
        fake_renderer.small_job(), Path(sys.argv[1]), workers=2, renderer=fake_renderer.RENDERER
    )
"""


def start(out: Path, sabotage: str = "", **environment: str) -> subprocess.Popen[str]:
    folder = str(Path(__file__).parent)
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(out), sabotage],
        env=os.environ | {"PYTHONPATH": folder} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def kill_when(process: subprocess.Popen[str], ripe: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not ripe() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    process.kill()
    process.communicate()


# What the parent does not survive: it kills itself right there.
DIE = "__import__('os').kill(__import__('os').getpid(), 9)"
POINTS = {
    "before the first tar": f"commit.concatenate = lambda *_: {DIE}",
    "between tar and manifest part": f"commit.manifest.write_part = lambda *_: {DIE}",
    "between manifest part and record": f"commit.sha256 = lambda *_: {DIE}",
    "before tidying": f"run.Run._tidy = lambda *_: {DIE}",
    "before publishing": f"local.publish.complete = lambda *_: {DIE}",
    "between manifests and dataset.json": f"local.publish.card.card = lambda *_: {DIE}",
    "while panoramas are written": f"local.write_pool = lambda *_: {DIE}",
}


@pytest.mark.parametrize("point", POINTS)
def test_killed_at_a_point_then_resumed(whole: Path, tmp_path: Path, point: str):
    out = tmp_path / "out"
    process = start(out, POINTS[point])
    _, errors = process.communicate(timeout=120)
    assert process.returncode == -signal.SIGKILL, errors
    assert render(out).complete
    assert fingerprint(out) == fingerprint(whole)
    assert not list(out.rglob("*.tmp"))
    assert verify(out) == []


@pytest.mark.parametrize("finished", [0, 3])
def test_killed_while_workers_render(whole: Path, tmp_path: Path, finished: int):
    out = tmp_path / "out"
    process = start(out, FAKE_SECONDS="0.2")
    kill_when(process, lambda: len(list(out.glob("subjects/*/*.json"))) >= finished)
    time.sleep(0.3)
    done = len(list(out.glob("subjects/*/*.json")))
    time.sleep(0.6)
    assert len(list(out.glob("subjects/*/*.json"))) == done, "workers outlive their parent"
    summary = render(out)
    assert summary.complete
    assert summary.rendered <= 8 - finished + 2
    assert fingerprint(out) == fingerprint(whole)


def test_interrupt_is_clean(tmp_path: Path):
    out = tmp_path / "out"
    process = start(out, FAKE_SECONDS="0.5")
    time.sleep(0.1)
    deadline = time.monotonic() + 60
    while not list(out.glob("work/runs/*.json")) and time.monotonic() < deadline:
        time.sleep(0.01)
    status = ledger.status(out)
    assert status.running
    assert status.workers >= 1
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=20)
    assert "KeyboardInterrupt" in errors
    assert not ledger.status(out).running
    assert render(out).complete


# ---------------------------------------------------------------- trouble


def test_crash_hang_and_exception_cost_one_subject_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "out"
    trouble = {"s000000": "crash", "s000002": "hang", "s000003": "raise", "s000004": "gate"}
    monkeypatch.setenv("TROUBLE", json.dumps(trouble))
    job = fake_renderer.small_job(
        subsets={"multiview": JOB.subsets["multiview"].model_dump()}, shard_subjects=5
    )
    summary = render(out, job=job, time_limit=2.0)
    assert summary.complete
    reasons = {f["key"]: f["reason"] for f in summary.failed}
    assert reasons.keys() == trouble.keys()
    assert reasons["s000000"] == "crashed: worker died of SIGKILL"
    assert reasons["s000002"].startswith("hung: killed after")
    assert reasons["s000003"] == "RuntimeError: no hair left"
    assert reasons["s000004"].startswith("gate: s000004_p01: depth has")
    assert all(f["attempts"] == ledger.ATTEMPTS for f in summary.failed)
    log = out / next(f["log"] for f in summary.failed if f["key"] == "s000003")
    assert "no hair left" in log.read_text()
    status = ledger.status(out)
    assert (status.subsets[0].done, status.subsets[0].failed) == (1, 4)
    info = ledger.read_dataset_json(out)
    assert {q["key"] for q in info["quarantined"]} == trouble.keys()
    assert verify(out) == []
    assert render(out, job=job).rendered == 0

    monkeypatch.delenv("TROUBLE")
    assert render(out, job=job, retry_failed=True).rendered == 4
    assert verify(out) == []
    assert ledger.status(out).failures == []
    render(tmp_path / "straight", job=job)
    for path in (tmp_path / "straight" / "data").rglob("*.tar"):
        again = out / path.relative_to(tmp_path / "straight")
        assert path.read_bytes() == again.read_bytes()


def test_what_fails_once_is_retried(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "crash once", "s000002": "raise once"}))
    summary = render(tmp_path / "out")
    assert summary.complete
    assert summary.failed == []
    assert fingerprint(tmp_path / "out") == fingerprint(whole)


def test_a_full_disk_stops_cleanly(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "out"
    monkeypatch.setenv("TROUBLE", json.dumps({"s000002": "full"}))
    with pytest.raises(ledger.StorageError, match="the disk is full; make room"):
        render(out)
    assert ledger.status(out).failures == []
    monkeypatch.delenv("TROUBLE")
    assert render(out).complete
    assert fingerprint(out) == fingerprint(whole)


def test_a_renderer_that_cannot_start_is_one_line(tmp_path: Path):
    with pytest.raises(ledger.StorageError, match=r"nowhere:f: cannot start: ModuleNotFoundError"):
        render(tmp_path / "out", renderer="nowhere:f")
    assert ledger.failures(tmp_path / "out") == []


def test_a_broken_set_up_does_not_quarantine_everybody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    trouble = {f"s{i:06d}": "raise" for i in range(8)}
    monkeypatch.setenv("TROUBLE", json.dumps(trouble))
    monkeypatch.setattr(run, "HOPELESS", 4)
    with pytest.raises(ledger.StorageError, match="attempts all failed, the last with: Runtime"):
        render(tmp_path / "out")


# ---------------------------------------------------------------- refusals


def test_another_job_is_refused_with_the_fields(whole: Path):
    changed = fake_renderer.small_job(resolution=64, image={"linear": False})
    with pytest.raises(ledger.StorageError) as error:
        render(whole, job=changed)
    assert "image.linear: true there, false here" in str(error.value)
    assert "resolution: 48 there, 64 here" in str(error.value)
    assert "\n" not in str(error.value)


def test_foreign_folders_are_refused(tmp_path: Path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ledger.StorageError, match=r"holds other files \(thesis.tex"):
        render(tmp_path)
    with pytest.raises(ledger.StorageError, match="is a file"):
        render(tmp_path / "thesis.tex")


def test_two_runs_of_a_slice_are_refused(tmp_path: Path):
    with ledger.slice_lock(tmp_path, (1, 2)):
        with pytest.raises(ledger.StorageError, match="another process is rendering slice 1/2"):
            render(tmp_path, shard=(1, 2))
        with pytest.raises(ledger.StorageError, match="being rendered in 2 slice"):
            render(tmp_path)
        with ledger.slice_lock(tmp_path, (2, 2)):
            pass
    with ledger.slice_lock(tmp_path, (1, 1)):
        pass


def test_a_lost_shard_is_rendered_again(whole: Path, tmp_path: Path):
    import shutil

    out = tmp_path / "out"
    shutil.copytree(whole, out)
    lost = sorted((out / "data").rglob("*.tar"))[0]
    lost.unlink()
    assert any("missing" in line for line in verify(out))
    assert render(out).complete
    assert fingerprint(out) == fingerprint(whole)


def test_the_stored_plan_is_the_jobs(whole: Path):
    assert publish.stored_plan(whole).job == JOB
