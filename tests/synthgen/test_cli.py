"""The command line: quick to start, one clear line for what is wrong, the right exit codes."""

from __future__ import annotations

import csv
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from math import isnan
from pathlib import Path

import duckdb
import fake_renderer
import pytest
from answer import Answer
from PIL import Image

from assets_procedural.conventions import console
from synthgen import __version__, cli, open_dataset

ROOT = Path(__file__).parents[2]
FAKE = ("--renderer", fake_renderer.RENDERER)
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
COMMANDS = [c.callback.__name__ for c in cli.app.registered_commands if c.callback]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Calibrations of this test alone."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("SYNTHGEN_CACHE", str(folder))
    return folder


@pytest.fixture
def job(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


Synthgen = Callable[..., Answer]


@pytest.fixture
def synthgen(monkeypatch: pytest.MonkeyPatch, run_main: Callable[..., Answer]) -> Synthgen:
    """Runs a command of `synthgen` in this process."""
    monkeypatch.chdir(ROOT)
    return partial(run_main, cli.main)


@pytest.fixture
def failure(synthgen: Synthgen) -> Callable[..., str]:
    """The one line of a user's error."""
    return lambda *arguments: synthgen(*arguments).error


def process(*arguments: object) -> subprocess.CompletedProcess[str]:
    """A command as a user starts it."""
    command = [sys.executable, "-m", "synthgen", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, timeout=300, check=False
    )


def seconds(*arguments: object) -> float:
    """Processor seconds of a command, the best of three: others may keep the machine busy."""
    times = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert process(*arguments).returncode == 0
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def test_help_is_quick_and_lists_every_command(synthgen: Synthgen) -> None:
    assert seconds("--help") < 0.5
    listed = synthgen("--help").stdout
    assert all(f" {command} " in listed for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(synthgen: Synthgen, command: str) -> None:
    result = synthgen(command, "--help")
    assert result.returncode == 0
    assert "Usage" in result.stdout


@pytest.mark.parametrize("module", ["cli", "planning.plan", "dataset"])
def test_nothing_heavy_is_imported(module: str) -> None:
    code = f"import sys, synthgen.{module}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    ).stdout.split()
    heavy = {"bpy", "torch", "anny", "trimesh", "colour", "datasets"}
    if module == "cli":
        heavy |= {"numpy", "pydantic", "pyarrow"}
    assert not heavy & set(loaded)


def test_plan_counts_quickly(synthgen: Synthgen) -> None:
    assert seconds("plan", "render_jobs/demo.toml") < 1.0
    shown = synthgen("plan", "render_jobs/paper.toml").stdout
    assert "2,000,000" in shown
    assert "60,000" in shown


def test_plan_counts_the_people_as_asked_and_as_drawn(synthgen: Synthgen, tmp_path: Path) -> None:
    asked = ("--population", "--people", "100", "--set", "people.quotas.sex={male=0.3}")
    shown = synthgen("plan", "demo", *asked, "--plot", tmp_path / "people.png")
    assert "100 people of multiview" in shown.stdout
    assert re.search(r"sex +male +30\.0 % +(29|30|31)\.0 % +█", shown.stdout)
    assert "south_asian" in shown.stdout and "hair_colour" in shown.stdout
    with Image.open(tmp_path / "people.png") as picture:
        assert picture.width > 800
    counted = json.loads(synthgen("plan", "demo", *asked, "--json").stdout)
    assert counted["people"] == 100
    for name, marginal in counted["marginals"].items():
        assert sum(marginal["drawn"].values()) == pytest.approx(1), name
    assert counted["marginals"]["sex"]["asked"] == {"male": 0.3}


def test_a_plan_answers_before_anything_was_measured(synthgen: Synthgen) -> None:
    shown = synthgen("plan", "paper", "--within", "7d", "--threads", "2").stdout
    assert "Hours are reference figures" in shown
    assert "--calibrate" in shown
    assert "Within 7.0 days: " in shown
    shown = synthgen("plan", "paper", "--within", "7d", "--device", "cuda").stdout
    assert "Hours are an upper bound" in shown
    assert "Within 7.0 days: " in shown


def test_jobs_are_listed_with_their_size_and_purpose(synthgen: Synthgen) -> None:
    lines = {line.split()[0]: line for line in synthgen("jobs").stdout.splitlines()}
    assert lines.keys() == {"job", *(path.stem for path in (ROOT / "render_jobs").glob("*.toml"))}
    assert lines["demo"].split()[1:5] == ["8", "60", "A", "first"]
    # Its subsets share people.
    assert lines["paper"].split()[1:3] == ["50,000", "2,000,000"]


def test_a_shipped_job_goes_by_its_name(
    synthgen: Synthgen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = synthgen("plan", "demo")
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.startswith("demo: 256 x 256")
    small = ("--set", "resolution=48", "--set", "environments.bundled=[]")
    small += ("--set", "environments.skies=3", "--limit", "1", "--workers", "1")
    done = synthgen("render", "demo", "--out", "out", *small, *FAKE)
    assert done.returncode == 0, done.stderr
    described = json.loads((tmp_path / "out" / "dataset.json").read_text())
    assert described["job"]["name"] == "demo"


def test_a_shell_completes_commands(synthgen: Synthgen, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_COMMAND_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "command re")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert synthgen().stdout.split() == ["render", "rerender"]


def test_the_version_is_printed(synthgen: Synthgen) -> None:
    assert synthgen("--version").stdout == f"synthgen {__version__}\n"


def test_calibration_is_measured_kept_and_used(synthgen: Synthgen, job: Path, cache: Path) -> None:
    shown = synthgen("plan", job, "--calibrate", "--within", "1m", *FAKE)
    assert shown.returncode == 0, shown.stderr
    assert "core-hours" in shown.stdout
    assert "Within 1 minutes: 1 machine like this one." in shown.stdout
    assert (cache / "calibration.json").exists()
    exact = synthgen("plan", job, *FAKE).stdout
    assert "Hours as calibrated on this machine" in exact
    assert "carried over" not in exact
    other = synthgen("plan", job, "--set", "samples=64", *FAKE).stdout
    assert "carried over from 64 x 64, 16 samples, 1 thread." in other
    assert "reference figures" in synthgen("plan", job).stdout
    many = "--set", "subsets.multiview.subjects=1000000"
    assert "--shard 1/" in synthgen("plan", job, "--within", "1m", *many, *FAKE).stdout


def test_what_was_rendered_here_is_what_a_plan_goes_by(synthgen: Synthgen, job: Path) -> None:
    out = job.with_name("data")
    assert synthgen("render", job, "--out", out, "--workers", "1", *FAKE).returncode == 0
    assert f"Hours are what {out} took on this machine" in synthgen("plan", job, *FAKE).stdout
    named = synthgen("plan", "demo", "--like", out).stdout
    assert f"Hours are what {out} took, carried over from 64 x 64, 16 samples" in named


def test_a_cache_that_cannot_be_written_spoils_no_rendering(
    synthgen: Synthgen, job: Path, cache: Path
) -> None:
    cache.write_text("a file, not a folder")
    done = synthgen("render", job, "--out", job.with_name("data"), "--limit", "1", *FAKE)
    assert done.returncode == 0, done.stderr


def test_json_has_the_keys_that_the_help_promises(
    synthgen: Synthgen, job: Path, small_dataset: Path
) -> None:
    plan = json.loads(synthgen("plan", job, "--within", "1h", "--json").stdout)
    assert plan["frames"] == sum(subset["frames"] for subset in plan["subsets"]) == 15
    assert plan["subsets"][0]["costs"]["source"] == "reference"
    assert plan["machines"] == 1
    status = json.loads(synthgen("status", small_dataset, "--json").stdout)
    assert status["frames"] == status["frames_done"] == 38
    assert status["complete"]
    for command, answer in (("plan", plan), ("status", status)):
        promised = synthgen(command, "--help").stdout
        promised = promised[promised.index("JSON:") : promised.index("Arguments")]
        words = set(re.findall(r"[a-z_]+", promised))
        assert keys(answer) <= words
        assert {word for word in words if "_" in word} <= keys(answer)


def keys(value: object) -> set[str]:
    """Every key in a JSON value."""
    if isinstance(value, dict):
        return set(value).union(*(keys(v) for v in value.values()))
    return set().union(*(keys(v) for v in value)) if isinstance(value, list) else set()


def test_calibration_reports_a_broken_renderer(failure: Callable[..., str], job: Path) -> None:
    line = failure("plan", job, "--calibrate", "--renderer", "fake_renderer:missing")
    assert "--calibrate: the renderer failed: AttributeError" in line


def test_render_status_and_verify(
    synthgen: Synthgen, failure: Callable[..., str], job: Path, tmp_path: Path
) -> None:
    out = tmp_path / "data"
    done = synthgen("render", job, "--out", out, "--workers", "1", "--limit", "1", *FAKE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 subject, 4 frames in ")
    assert "complete" not in done.stdout
    assert "4 of 15 frames" in synthgen("status", out).stdout
    assert "holds another job" in failure("render", job, "--out", out, "--set", "seed=1", *FAKE)

    done = synthgen("render", job, "--out", out, "--workers", "2", "--time-limit", "90", *FAKE)
    assert done.returncode == 0, done.stderr
    assert "the dataset is complete" in done.stdout
    assert "15 of 15 frames" in synthgen("status", out).stdout
    checked = synthgen("verify", out)
    assert checked.returncode == 0, checked.stdout

    shard = next((out / "data").rglob("*.tar"))
    shard.write_bytes(shard.read_bytes()[:-2000])
    checked = synthgen("verify", out)
    assert checked.returncode == 1
    assert shard.name in checked.stdout

    refused = synthgen("verify", out, "--repair")
    assert refused.returncode == 2
    assert "was rendered by 'fake_renderer:render_subject'" in refused.stderr
    repaired = synthgen("verify", out, "--repair", *FAKE)
    assert repaired.returncode == 0, repaired.stdout
    assert (
        f"repaired: data/{shard.relative_to(out / 'data')}: it or what belongs" in repaired.stdout
    )
    assert repaired.stdout.endswith("all checks passed\n")
    description = out / "dataset.json"
    description.unlink()
    assert "no dataset here" in failure("verify", out)
    repaired = synthgen("verify", out, "--repair", *FAKE)
    assert repaired.returncode == 0, repaired.stdout
    assert "repaired: dataset.json: restored from ledger/dataset.json" in repaired.stdout


@pytest.fixture
def out(small_dataset: Path, tmp_path: Path) -> Path:
    """A copy, since pictures and exports go beside a dataset."""
    shutil.copytree(small_dataset, tmp_path / "out")
    return tmp_path / "out"


def test_query_sheet_and_export(synthgen: Synthgen, out: Path) -> None:
    assert "16" in synthgen("query", out, "SELECT count(*) FROM manifest").stdout
    for command in ("sheet", "export"):
        result = synthgen(command, out)
        assert result.returncode == 0, result.stderr
        assert Path(result.stdout.split()[-1]).exists()


def test_pictures_edge_to_edge_and_a_clip(synthgen: Synthgen, out: Path, tmp_path: Path) -> None:
    page, played = tmp_path / "people.png", tmp_path / "clip.webp"
    chosen = ("--portraits", "--subset", "multiview", "--columns", "3")
    assert synthgen("sheet", out, *chosen, "--output", page).returncode == 0
    people = len(open_dataset(out, subset="multiview").subjects())
    with Image.open(page) as image:
        assert image.size == (1560, 520 * -(-people // 3))
    shots = open_dataset(out, subset="video").subjects()["video", "s000001"]
    assert synthgen("clip", out, "video/s000001", "--output", played, "--fps", "10").returncode == 0
    with Image.open(played) as image:
        assert getattr(image, "n_frames", 1) == len(shots)
        image.seek(len(shots) - 1)
        image.load()
        assert image.info["duration"] == 100


def test_a_sheet_of_a_subset_that_is_not_begun_is_one_line(
    failure: Callable[..., str], out: Path, tmp_path: Path
) -> None:
    begun = shutil.copytree(out, tmp_path / "begun")
    shutil.rmtree(begun / "ledger" / "video")
    shutil.rmtree(begun / "manifest")
    assert "nothing of subset video is finished yet" in failure(
        "sheet", begun, "--portraits", "--subset", "video"
    )


def test_a_clip_of_nothing_is_one_line(failure: Callable[..., str], out: Path) -> None:
    assert "s000077 is no subject of it" in failure("clip", out, "video/s000077")
    assert "not 7" in failure("clip", out, "video/s000001", "--environment", "7")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("sheet",), ("drawing the sheet: ",)),
        (("sheet", "--portraits"), ("drawing portraits: ",)),
        (("export",), ("exporting: ",)),
        (
            ("verify",),
            tuple(
                f"verifying {what}: "
                for what in ("panoramas and manifests", "hashes", "manifests", "shards")
            ),
        ),
    ],
)
def test_long_work_says_from_its_start_how_far_it_is(
    synthgen: Synthgen,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    said: tuple[str, ...],
) -> None:
    monkeypatch.setattr(console, "FIRST_LINE", 0.0)
    command, *options = arguments
    result = synthgen(command, out, *options)
    assert result.returncode == 0
    for line in said:
        assert line in result.stderr


KEYS = [
    (("s000004_p01",), "multiview/s000004_p01"),
    (("video/s000001_p00",), "video/s000001_p00"),
    (("s000001_p00", "--subset", "video"), "video/s000001_p00"),
]
BAD_KEYS = [
    (("s000001_p00",), "is ambiguous: say multiview/s000001_p00 or video/s000001_p00"),
    (("s000004",), "no shot s000004; keys look like multiview/s00000"),
    (("video/s000004_p00",), "no shot video/s000004_p00; keys look like"),
    (("s000004_p00", "--subset", "audio"), "no subset audio; it has multiview, video"),
]


@pytest.mark.parametrize(("key", "name"), KEYS)
def test_show_takes_every_form_of_a_key(
    synthgen: Synthgen, out: Path, key: tuple[str, ...], name: str
) -> None:
    result = synthgen("show", out, *key)
    assert result.returncode == 0, result.stderr
    picture = Path(result.stdout.strip())
    assert picture == out.with_name(f"out-{key[0].replace('/', '-')}.png")
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("key", "name"), KEYS)
def test_rerender_takes_every_form_of_a_key(
    synthgen: Synthgen, out: Path, key: tuple[str, ...], name: str
) -> None:
    result = synthgen("rerender", out, *key, *FAKE)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(f"{name}: identical\n")


@pytest.mark.parametrize("command", ["show", "rerender"])
@pytest.mark.parametrize(("key", "message"), BAD_KEYS)
def test_bad_keys_are_one_line(
    failure: Callable[..., str],
    small_dataset: Path,
    command: str,
    key: tuple[str, ...],
    message: str,
) -> None:
    assert message in failure(command, small_dataset, *key)


def test_errors_are_one_line(failure: Callable[..., str], job: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert "no such job file" in failure("plan", tmp_path / "nothing.toml")
    assert "--set: samples = 0" in failure("plan", job, "--set", "samples=0")
    assert "--within: soon" in failure("plan", job, "--within", "soon")
    assert "it is a file; give another" in failure("render", job, "--out", job)
    assert "--shard: 5/4" in failure("render", job, "--out", out, "--shard", "5/4")
    for command in ("status", "verify", "sheet", "export"):
        assert "no dataset here" in failure(command, out)
    assert not out.exists()


def test_errors_of_a_process_are_one_line(tmp_path: Path) -> None:
    result = process("status", tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == f"error: {tmp_path}: no dataset here (no dataset.json)\n"


def test_usage_errors_exit_with_2(synthgen: Synthgen, job: Path) -> None:
    assert synthgen("render", job).returncode == 2
    assert synthgen("render", job, "--out", "x", "--workers", "0").returncode == 2
    assert synthgen("render", job, "--out", "x", "--time-limit", "0").returncode == 2
    assert synthgen("dance").returncode == 2
    for arguments in (
        ("render", job, "--out", "x", "--device", "gpu"),
        ("export", "x", "--format", "obj"),
    ):
        answer = synthgen(*arguments)
        assert answer.returncode == 2
        assert "is not" in answer.stderr


EVERYTHING = "SELECT key, width, environments, head_yaw, NULL AS nothing FROM manifest ORDER BY 1"


def test_a_pipe_gets_csv_whole(synthgen: Synthgen, small_dataset: Path) -> None:
    rows = list(csv.DictReader(synthgen("query", small_dataset, EVERYTHING).stdout.splitlines()))
    assert len(rows) == 16
    assert rows[0]["width"] == "48" and rows[0]["nothing"] == ""
    assert json.loads(rows[0]["environments"])
    long = synthgen("query", small_dataset, "SELECT repeat('x', 5000) AS x").stdout
    assert long == "x\n" + "x" * 5000 + "\n"


def test_json_and_parquet_keep_types(
    synthgen: Synthgen, small_dataset: Path, tmp_path: Path
) -> None:
    rows = json.loads(synthgen("query", small_dataset, EVERYTHING, "--format", "json").stdout)
    assert len(rows) == 16 and rows[0]["width"] == 48
    assert isinstance(rows[0]["environments"], list)
    target = tmp_path / "rows.parquet"
    everything = (
        "SELECT *, 'nan'::FLOAT AS n, '2020-01-02'::DATE AS d, 1 AS a, 2 AS a FROM manifest"
    )
    assert synthgen("query", small_dataset, everything, "--output", target).returncode == 0
    with duckdb.connect() as connection:
        table = connection.read_parquet(str(target))
        kinds = dict(zip(table.columns, map(str, table.types), strict=True))
        assert len(table) == 16
        assert isnan(table.select("n").fetchall()[0][0])
    assert (kinds["d"], kinds["n"], kinds["a"], kinds["a_1"]) == (
        *("DATE", "FLOAT"),
        *("INTEGER", "INTEGER"),
    )
    assert kinds["environments"] == "VARCHAR[]" and kinds["members"].startswith("STRUCT(")
    assert [path.name for path in tmp_path.iterdir()] == ["rows.parquet"]
    assert "no rows" not in synthgen("query", small_dataset, "SELECT 1 WHERE false").stdout


def test_a_wide_answer_stands_upright(synthgen: Synthgen, small_dataset: Path) -> None:
    narrow = synthgen("query", small_dataset, EVERYTHING, "--format", "table").stdout.splitlines()
    assert narrow[0].split() == ["key", "width", "environments", "head_yaw", "nothing"]
    assert len(narrow) == 2 + 16
    wide = synthgen("query", small_dataset, "SELECT * FROM manifest", "--format", "table").stdout
    assert wide.startswith("── row 1 ──")
    assert re.search(r"^person_age_years +[\d.]+$", wide, re.MULTILINE)


def test_many_rows_take_seconds(synthgen: Synthgen, small_dataset: Path) -> None:
    start = time.process_time()
    many = synthgen("query", small_dataset, "SELECT key, range FROM manifest, range(12500)").stdout
    assert many.count("\n") == 200_001
    assert time.process_time() - start < 5


NO_QUERY = ["", "/* nothing */", "SELECT", "SELECT nonsense FROM manifest", "SELECT '\udcff'"]


@pytest.mark.parametrize("sql", NO_QUERY, ids=map(ascii, NO_QUERY))
def test_what_is_no_query_is_one_line(
    failure: Callable[..., str], small_dataset: Path, sql: str
) -> None:
    assert failure("query", small_dataset, sql).startswith("error: query: ")


@pytest.mark.parametrize("value", ["repeat('x', 4000000000)", "len(range(2000000000))"])
def test_a_query_that_takes_too_much_memory_is_one_line(
    failure: Callable[..., str], small_dataset: Path, value: str
) -> None:
    before = resource.getrlimit(resource.RLIMIT_AS)
    said = failure("query", small_dataset, f"SELECT {value} FROM manifest LIMIT 1")
    assert "memory" in said.lower()
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def test_pictures_go_where_they_can_be_written(
    synthgen: Synthgen, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    can, monkey = os.access, monkeypatch
    monkey.setattr(os, "access", lambda path, mode: Path(path) != tmp_path and can(path, mode))
    monkey.chdir(here)
    assert synthgen("sheet", out).returncode == 0
    assert [path.name for path in here.iterdir()] == ["out.png"]
    monkey.setattr(os, "access", lambda path, mode: not mode & os.W_OK and can(path, mode))
    line = synthgen("export", out).error
    assert line.startswith("error: --output: neither ") and line.endswith("give another place")


def test_a_part_of_a_dataset_is_exported(synthgen: Synthgen, out: Path, tmp_path: Path) -> None:
    target = tmp_path / "part"
    chosen = ("--subset", "video", "--split", "train", "--where", "view = 0 AND pose < 1")
    assert synthgen("export", out, *chosen, "--output", target).returncode == 0
    assert [path.name for path in target.iterdir()] == ["video"]
    frames = [json.loads(p.read_text())["frames"] for p in target.rglob("transforms.json")]
    assert frames and all(len(each) == 1 for each in frames)
    assert "no shot to export" in synthgen("export", out, "--where", "false").error


def test_damaged_files_are_one_line_in_every_command(
    failure: Callable[..., str], out: Path
) -> None:
    for shard in (out / "data" / "multiview").glob("*.tar"):
        shard.write_bytes(shard.read_bytes()[:3000])
    for command in (("show", out, "s000004_p01"), ("rerender", out, "s000004_p01"), ("sheet", out)):
        assert failure(*command).endswith(f"`synthgen verify {out}` lists what is damaged")
    assert "synthgen verify" in failure("export", out)
    assert not out.with_name("out-nerfstudio").exists()
    (out / "manifest" / "multiview.parquet").write_bytes(b"PAR1 and no more")
    for command in (("show", out, "s000004_p01"), ("query", out, "SELECT 1"), ("export", out)):
        assert "manifest cannot be read" in failure(*command)


def test_a_folder_whose_name_is_no_text_is_one_line(failure: Callable[..., str]) -> None:
    for command in ("status", "verify", "sheet", "export"):
        assert "the path is no UTF-8 text; rename the folder" in failure(command, "x\udcff")


def test_a_limited_run_counts_what_it_renders(
    synthgen: Synthgen, job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "FIRST_LINE", 0.0)
    render = ("render", job, "--out", job.with_name("data"), "--workers", "1", *FAKE)
    assert "rendering: 0 of 4 frames" in synthgen(*render, "--limit", "1").stderr
    assert "rendering: 0 of 8 frames" in synthgen(*render, "--limit", "2").stderr
    assert "rendering: 12 of 15 frames" in synthgen(*render).stderr
