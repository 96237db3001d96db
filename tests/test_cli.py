"""The command line: quick to start, one clear line for what is wrong, the right exit codes."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FAKE = ("--renderer", "tests.fake_renderer:render_subject")
SMALL = """
name = "small"
resolution = 64
[subsets.multiview]
kind = "multiview"
subjects = 3
environments = 2
views = 2
[subsets.video]
kind = "video"
subjects = 1
environments = 1
frames = 3
[environments]
bundled = []
skies = 2
"""
COMMANDS = ["plan", "render", "status", "verify", "show", "sheet", "rerender", "query", "export"]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Calibrations of this test alone."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("SYNTHGEN_CACHE", str(folder))
    monkeypatch.setenv("COLUMNS", "200")
    return folder


@pytest.fixture
def job(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def synthgen(*arguments: object) -> subprocess.CompletedProcess[str]:
    code = "from synthgen.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"NO_COLOR": "1"},
        timeout=300,
        check=False,
    )


def seconds(*arguments: object) -> float:
    """Processor seconds of a command, the best of three: others may keep the machine busy."""
    times = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert synthgen(*arguments).returncode == 0
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def failure(*arguments: object) -> str:
    """The one line of a user's error."""
    result = synthgen(*arguments)
    assert result.returncode == 2, result.stderr
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1, result.stderr
    return result.stderr.strip()


def test_help_is_quick_and_lists_every_command() -> None:
    assert seconds("--help") < 0.5
    listed = synthgen("--help").stdout
    assert all(f" {command} " in listed for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    result = synthgen(command, "--help")
    assert result.returncode == 0
    assert "Usage" in result.stdout


@pytest.mark.parametrize("module", ["cli", "plan", "ledger", "manifest", "dataset"])
def test_nothing_heavy_is_imported(module: str) -> None:
    code = f"import sys, synthgen.{module}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    ).stdout.split()
    heavy = {"bpy", "torch", "anny", "trimesh", "colour", "datasets"}
    if module == "cli":
        heavy |= {"numpy", "pydantic", "pyarrow"}
    assert not heavy & set(loaded)


def test_plan_counts_quickly() -> None:
    assert seconds("plan", "render_jobs/demo.toml") < 1.0
    shown = synthgen("plan", "render_jobs/paper.toml").stdout
    assert "2,000,000" in shown
    assert "60,000" in shown
    assert "not measured" in shown
    assert "Add --calibrate" in shown


def test_calibration_is_measured_kept_and_used(job: Path, cache: Path) -> None:
    shown = synthgen("plan", job, "--calibrate", "--within", "1m", *FAKE)
    assert shown.returncode == 0, shown.stderr
    assert "core-hours" in shown.stdout
    assert "Within 1 minutes: 1 machine like this one." in shown.stdout
    assert (cache / "calibration.json").exists()
    exact = synthgen("plan", job, *FAKE).stdout
    assert "not measured" not in exact
    assert "Carried over" not in exact
    assert "Carried over" in synthgen("plan", job, "--set", "samples=64", *FAKE).stdout
    assert "not measured" in synthgen("plan", job).stdout
    many = "--set", "subsets.multiview.subjects=1000000"
    assert "--shard 1/" in synthgen("plan", job, "--within", "1m", *many, *FAKE).stdout


def test_calibration_reports_a_broken_renderer(job: Path) -> None:
    line = failure("plan", job, "--calibrate", "--renderer", "tests.fake_renderer:missing")
    assert "--calibrate: the renderer failed: AttributeError" in line


def test_render_status_verify_and_the_rest(job: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    done = synthgen("render", job, "--out", out, "--workers", "1", "--limit", "1", *FAKE)
    assert done.returncode == 0, done.stderr
    assert "1 subjects" in done.stdout
    assert "complete" not in done.stdout
    assert "4 of 15 frames" in synthgen("status", out).stdout
    assert "holds another job" in failure("render", job, "--out", out, "--set", "seed=1", *FAKE)

    done = synthgen("render", job, "--out", out, "--workers", "2", *FAKE)
    assert done.returncode == 0, done.stderr
    assert "the dataset is complete" in done.stdout
    assert "15 of 15 frames" in synthgen("status", out).stdout
    checked = synthgen("verify", out)
    assert checked.returncode == 0, checked.stdout
    assert "9" in synthgen("query", out, "SELECT count(*) FROM manifest").stdout

    for command in ("show", "sheet", "export"):
        key = ("s000001_p01", "--subset", "multiview") if command == "show" else ()
        result = synthgen(command, out, *key)
        assert result.returncode == 0, result.stderr
        assert Path(result.stdout.split()[-1]).exists()

    shard = next((out / "data").rglob("*.tar"))
    shard.write_bytes(shard.read_bytes()[:-2000])
    checked = synthgen("verify", out)
    assert checked.returncode == 1
    assert shard.name in checked.stdout


def test_errors_are_one_line(job: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert "no such job file" in failure("plan", tmp_path / "nothing.toml")
    assert "--set: samples = 0" in failure("plan", job, "--set", "samples=0")
    assert "--within: soon" in failure("plan", job, "--within", "soon")
    assert "it is a file; give another" in failure("render", job, "--out", job)
    assert "--device: gpu: choose" in failure("render", job, "--out", out, "--device", "gpu")
    assert "--shard: 5/4" in failure("render", job, "--out", out, "--shard", "5/4")
    assert "--format: obj: choose nerfstudio" in failure("export", out, "--format", "obj")
    for command in ("status", "verify", "sheet", "export"):
        assert "no dataset here" in failure(command, out)
    assert not out.exists()


def test_usage_errors_exit_with_2(job: Path) -> None:
    assert synthgen("render", job).returncode == 2
    assert synthgen("render", job, "--out", "x", "--workers", "0").returncode == 2
    assert synthgen("dance").returncode == 2
