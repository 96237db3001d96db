"""Workers, resuming and quarantine, with a renderer that crashes and hangs when told to."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_renderer
import numpy as np
import pytest

from assets_procedural.conventions import console, panorama_files
from assets_procedural.conventions.files import sha256
from synthgen.dataset import ledger, manifest
from synthgen.dataset.folder import DatasetFolder, StorageError
from synthgen.dataset.records import read_description
from synthgen.farm import local, run, worker
from synthgen.farm.local import render_job
from synthgen.farm.rerender import rerender
from synthgen.planning.plan import subject_key
from synthgen.publish import publish
from synthgen.publish.verify import verify

JOB = fake_renderer.small_job()
ONE = fake_renderer.small_job(subsets={"multiview": JOB.subsets["multiview"].model_dump()})
IDS = ["city", "night", "studio"]


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
    counts = read_description(out).counts
    return {"tars": tars, "rows": rows, "counts": counts}


@pytest.fixture
def whole(small_dataset: Path) -> Path:
    """A dataset that was rendered without interruption by one worker."""
    return small_dataset


def test_a_finished_dataset_is_tidy_and_true(whole: Path):
    names = {p.name for p in whole.iterdir()}
    assert names == {
        *("data", "dataset.json", "README.md", "croissant.json", "SHA256SUMS", "manifest"),
        *("environments", "subjects", "ledger"),
    }
    assert not list(whole.rglob("*.tmp"))
    assert verify(whole) == []
    status = ledger.status(whole)
    assert status.complete
    assert status.frames == (5 * 4 + 3 * 6, 5 * 4 + 3 * 6)
    assert [s.done for s in status.subsets] == [5, 3]


def test_a_log_gets_lines_of_progress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(console, "FIRST_LINE", 60.0)
    render(tmp_path / "quick", job=ONE)  # short work says nothing
    for name in ("FIRST_LINE", "LINE_EVERY"):
        monkeypatch.setattr(console, name, 0.0)
    assert capsys.readouterr().err == ""
    render(tmp_path / "out", job=ONE)
    lines = capsys.readouterr().err.splitlines()
    assert any(line.startswith("storing panoramas: ") for line in lines)
    lines = [line for line in lines if line.startswith("rendering: ")]
    begun = "rendering: 0 of 20 frames, "
    assert lines[0] in (begun + "starting workers", begun + "first subjects")
    assert re.fullmatch(r"rendering: \d+ of 20 frames, [\d.]+ frames/s, \d+ s left", lines[-1])


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
    folder = str(Path(fake_renderer.__file__).parent)
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
    reasons = {f.key: f.reason for f in summary.failed}
    assert reasons.keys() == trouble.keys()
    assert reasons["s000000"] == "crashed: worker died of SIGKILL"
    assert reasons["s000002"].startswith("hung: killed after")
    assert reasons["s000003"] == "RuntimeError: no hair left"
    assert reasons["s000004"].startswith("gate: s000004_p01: depth has")
    assert all(f.attempts == ledger.ATTEMPTS for f in summary.failed)
    log = out / next(f.log for f in summary.failed if f.key == "s000003")
    assert "no hair left" in log.read_text()
    status = ledger.status(out)
    assert (status.subsets[0].done, status.subsets[0].failed) == (1, 4)
    assert {q.key for q in read_description(out).quarantined} == trouble.keys()
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
    with pytest.raises(StorageError, match="the disk is full; make room"):
        render(out)
    assert ledger.status(out).failures == []
    monkeypatch.delenv("TROUBLE")
    assert render(out).complete
    assert fingerprint(out) == fingerprint(whole)


def test_a_renderer_that_cannot_start_is_one_line(tmp_path: Path):
    with pytest.raises(StorageError, match=r"nowhere:f: cannot start: ModuleNotFoundError"):
        render(tmp_path / "out", renderer="nowhere:f")
    assert ledger.failures(DatasetFolder(tmp_path / "out")) == []


def test_a_shot_that_cannot_be_rendered_again_is_one_line(
    whole: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "raise", "s000002": "hang"}))
    failed = "s00000._p01: rendering it again failed"
    with pytest.raises(StorageError, match=f"{failed}: RuntimeError: no hair left$"):
        rerender(whole, "multiview/s000001_p01", renderer=fake_renderer.RENDERER)
    with pytest.raises(StorageError, match=f"{failed}: took more than 2 s$"):
        rerender(whole, "multiview/s000002_p01", time_limit=2.0, renderer=fake_renderer.RENDERER)


def test_a_broken_set_up_does_not_quarantine_everybody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    trouble = {f"s{i:06d}": "raise" for i in range(8)}
    monkeypatch.setenv("TROUBLE", json.dumps(trouble))
    monkeypatch.setattr(run, "HOPELESS", 4)
    with pytest.raises(StorageError, match="attempts all failed, the last with: Runtime"):
        render(tmp_path / "out")


def test_a_set_up_that_breaks_later_stops_and_quarantines_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "out"
    first, *others = [
        subject_key(i) for s in publish.Plan(ONE, IDS).shards("multiview") for i in s.subjects
    ]
    monkeypatch.setenv("TROUBLE", json.dumps(dict.fromkeys(others, "raise")))
    monkeypatch.setattr(run, "HOPELESS", 4)
    with pytest.raises(StorageError, match="the last 4 attempts all failed"):
        render(out, job=ONE, workers=1)
    assert ledger.status(out).subsets[0].done == 1, first
    assert [f.attempts for f in ledger.failures(DatasetFolder(out))] == [1, 1, 1, 1]


def test_a_subject_may_take_as_long_as_its_frames_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    big = JOB.model_copy(update={"resolution": 512, "samples": 16})
    assert run.time_allowed(big, 100) > 4 * 100 * 4 * 0.5 * 16
    asked = []

    def allowed(job: Any, frames: int) -> float:
        asked.append(frames)
        return 2.0

    monkeypatch.setattr(run, "time_allowed", allowed)
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "hang once"}))
    assert render(tmp_path / "out", job=ONE).complete
    assert set(asked) == {4}


def test_a_full_folder_is_told_from_a_failed_subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    orders = worker.Orders(JOB, tmp_path, "", "cpu", 1, tmp_path / "log")
    error = RuntimeError("Error: could not write image")
    assert worker._full_folder(orders, error) is None
    assert worker._full_folder(orders, OSError(errno.EDQUOT, "quota")) == tmp_path
    temporary = Path(tempfile.gettempdir())
    for folder in (tmp_path, temporary):
        usage = {tmp_path: 10**12, temporary: 10**12} | {folder: 10**7}
        free = {k: SimpleNamespace(free=v) for k, v in usage.items()}
        monkeypatch.setattr(worker.shutil, "disk_usage", free.__getitem__)
        assert worker._full_folder(orders, error) == folder


def test_a_worker_that_dies_while_idle_costs_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    give, calls = run.Slot.give, []

    def broken(slot: run.Slot, task: run.Task) -> None:
        calls.append(task)
        if len(calls) == 2:
            slot.process.kill()
            slot.task = task
            raise BrokenPipeError
        give(slot, task)

    monkeypatch.setattr(run.Slot, "give", broken)
    summary = render(tmp_path / "out", job=ONE, workers=1)
    assert (summary.complete, summary.failed) == (True, [])


def test_what_is_done_has_no_failure(tmp_path: Path):
    out = tmp_path / "out"
    job = ONE.model_copy(update={"shard_subjects": 5})
    render(out, job=job, limit=1)
    key = next(out.glob("work/multiview/*.json")).stem
    ledger.record_failure(DatasetFolder(out), "multiview", key, "crashed", "log")
    the_plan = publish.stored_plan(out)
    a_run = run.Run(the_plan, worker.Orders(job, out, "", "cpu", 1, out), (1, 1), 1, None, 20)
    shard = next(s for s in a_run.shards if int(key[1:]) in s.subjects)
    a_run.missing[shard.name] = {int(key[1:]), 99}
    task = run.Task(shard, the_plan.subject("multiview", int(key[1:])))
    slot: Any = SimpleNamespace(task=task, number=0, kill=lambda: None)
    a_run.slots[0] = slot
    a_run._lose(slot, "crashed")
    assert ledger.failures(DatasetFolder(out)) == []
    ledger.record_failure(DatasetFolder(out), "multiview", key, "crashed", "log")
    summary = render(out, job=job)
    assert (summary.complete, summary.failed, summary.rendered) == (True, [], 4)


def test_killed_while_failures_are_forgiven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "out"
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "raise"}))
    assert render(out, job=ONE).complete
    monkeypatch.delenv("TROUBLE")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt  # not a signal: a shell's background jobs ignore SIGINT

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(run, "unpack_shard", interrupted)
        render(out, job=ONE, retry_failed=True)
    assert [f.key for f in ledger.failures(DatasetFolder(out))] == ["s000001"]
    assert render(out, job=ONE, retry_failed=True).rendered == 1
    assert ledger.status(out).subsets[0].done == 5
    assert verify(out) == []


def test_temporary_files_of_a_killed_process_are_removed(tmp_path: Path):
    out = tmp_path / "out"
    (out / "work" / "locks").mkdir(parents=True)
    (out / ".dataset.json.123.tmp").touch()
    assert not render(out, job=ONE, limit=1).complete
    left = [
        *("README.md", "manifest/multiview.parquet", "environments/city.exr"),
        *("ledger/multiview/train-000000.json", "ledger/failed/multiview/s000001.json"),
    ]
    for path in (out / name for name in left):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_name(f".{path.name}.123.tmp").touch()
    foreign = out / "ledger" / "multiview" / ".train-000099.json.123.tmp"  # another slice's
    foreign.touch()
    assert render(out, job=ONE).complete
    assert list(out.rglob("*.tmp")) == [foreign]


def test_workers_default_to_the_cores_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(local.calibration, "cores", lambda: 6)
    seen = []
    monkeypatch.setattr(
        local.Run, "render", lambda self, *_: seen.append(self.workers) or run.Summary()
    )
    render(tmp_path / "out", workers=None, threads=2)
    assert seen == [3]


# ---------------------------------------------------------------- refusals


def test_another_job_is_refused_with_the_fields(whole: Path):
    changed = fake_renderer.small_job(resolution=64, image={"linear": False})
    with pytest.raises(StorageError) as error:
        render(whole, job=changed)
    assert "image.linear: true there, false here" in str(error.value)
    assert "resolution: 48 there, 64 here" in str(error.value)
    assert "\n" not in str(error.value)


def test_foreign_folders_are_refused(tmp_path: Path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(StorageError, match=r"holds other files \(thesis.tex"):
        render(tmp_path)
    with pytest.raises(StorageError, match="is a file"):
        render(tmp_path / "thesis.tex")
    own = tmp_path / "own"
    (own / "work").mkdir(parents=True)
    (own / "work" / "thesis.tex").touch()
    with pytest.raises(StorageError, match=r"holds other files \(work/thesis.tex"):
        render(own)
    assert [p.name for p in own.rglob("*")] == ["work", "thesis.tex"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["own", "thesis.tex"]


def test_another_panorama_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    mine, out = tmp_path / "mine", tmp_path / "out"
    mine.mkdir()
    for name in "abcd":
        panorama_files.write(mine / f"{name}.exr", np.full((8, 16, 3), 0.5), {})
    job = fake_renderer.small_job(environments={"bundled": [], "folder": mine})
    shown: list[str] = []
    track = console.track

    def noted(items: Any, what: str, total: int | None = None) -> Any:
        if "panoramas" in what:
            items = list(items)
            shown.extend(spec.id for spec in items)
        return track(items, what, total)

    monkeypatch.setattr(console, "track", noted)
    render(out, job=job, limit=1)
    assert shown == ["user_a", "user_b", "user_c", "user_d"]
    entries = read_description(out).environments
    assert entries[1]["sha256"] == sha256(mine / "b.exr")
    stored = sha256(out / "environments" / "user_b.exr")
    panorama_files.write(mine / "b.exr", np.full((8, 16, 3), 0.7), {})
    with pytest.raises(StorageError, match=r"environment user_b has another content") as e:
        render(out, job=job)
    assert "\n" not in str(e.value)
    assert sha256(out / "environments" / "user_b.exr") == stored
    panorama_files.write(mine / "b.exr", np.full((8, 16, 3), 0.5), {})
    (out / "environments" / "user_b.exr").unlink()
    render(out, job=job, limit=1)
    assert sha256(out / "environments" / "user_b.exr") == stored
    (mine / "d.exr").unlink()
    with pytest.raises(StorageError, match=r"environment user_d is missing here"):
        render(out, job=job)


def test_two_runs_of_a_slice_are_refused(tmp_path: Path):
    with ledger.slice_lock(DatasetFolder(tmp_path), (1, 2)):
        with pytest.raises(StorageError, match="another process is rendering slice 1/2"):
            render(tmp_path, shard=(1, 2))
        with pytest.raises(StorageError, match="being rendered in 2 slice"):
            render(tmp_path)
        with ledger.slice_lock(DatasetFolder(tmp_path), (2, 2)):
            pass
    with ledger.slice_lock(DatasetFolder(tmp_path), (1, 1)):
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
