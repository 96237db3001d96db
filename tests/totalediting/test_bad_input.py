"""What a user does wrong, or a machine: one line that says what to do, and no checkpoint lost."""

from __future__ import annotations

import dataclasses
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import fake_renderer
import pytest
import torch
from answer import Answer
from typer.testing import CliRunner
from videos import write_video

from synthgen.farm.local import render_job
from totalediting import cli
from totalediting.data.clips import Clips
from totalediting.errors import InputError
from totalediting.presets import PRESETS
from totalediting.training import checkpoints
from totalediting.training.stages import STAGES
from totalediting.training.tracker import TrackerStage

Run = Callable[..., Answer]
STEP = ("--steps", 1, "--batch", 1, "--workers", 0)
NOT_HERE = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")


@pytest.fixture
def totalediting(run_main: Callable[..., Answer]) -> Run:
    return partial(run_main, cli.main)


@pytest.fixture(scope="module")
def trained(small_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a checkpoint of three stages. Do not change it."""
    run = tmp_path_factory.mktemp("trained")
    for name in ("tracker", "lightmaps", "reconstruct"):
        train = ["train", name, small_dataset, "--out", run, *STEP]
        assert CliRunner().invoke(cli.app, list(map(str, train))).exit_code == 0
    return run


@pytest.fixture
def unread(small_dataset: Path, tmp_path: Path) -> Path:
    """A dataset of a format that is still to come."""
    folder = tmp_path / "unread"
    shutil.copytree(small_dataset, folder)
    path = folder / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_bytes()) | {"format": 7}))
    return folder


@pytest.fixture(scope="module")
def unseen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose subjects are all in the split test."""
    folder = tmp_path_factory.mktemp("unseen") / "out"
    job = fake_renderer.small_job(splits={"validation": 0.0, "test": 1.0})
    assert render_job(job, folder, workers=1, renderer=fake_renderer.RENDERER).complete
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture
def refused(totalediting: Run, trained: Path) -> Callable[..., str]:
    """The one line of a command that leaves `trained` as it was, to the byte."""

    def run(*arguments: object) -> str:
        before = contents(trained)
        line = totalediting(*arguments).error
        assert contents(trained) == before
        return line

    return run


# ---------------------------------------------------------------- datasets


def test_another_format_is_refused(
    refused: Callable[..., str], trained: Path, unread: Path, tmp_path: Path
) -> None:
    said = f"error: {unread}: a dataset of format 7, this version reads 1 and 2; render it again or"
    for stage in STAGES:
        assert refused("train", stage, unread, "--out", trained, *STEP).startswith(said)
    assert refused("evaluate", trained, unread).startswith(said)
    page = tmp_path / "page.png"
    assert refused("show", trained, unread, "--output", page).startswith(said)
    assert not page.exists()


def test_another_format_is_one_line_of_a_process(unread: Path, tmp_path: Path) -> None:
    code = "from totalediting.cli import main; main()"
    command = [sys.executable, "-c", code, "train", "tracker", unread, "--out", tmp_path / "run"]
    done = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_an_empty_split_is_refused(
    refused: Callable[..., str], trained: Path, unseen: Path
) -> None:
    def said(split: str) -> str:
        remedy = "render more subjects or take another split"
        return f"error: {unseen}: no shot in the split {split}; {remedy}"

    for stage in ("tracker", "reconstruct"):
        assert refused("train", stage, unseen, "--out", trained, *STEP) == said("train")
    assert refused("evaluate", trained, unseen, "--split", "validation") == said("validation")


# ---------------------------------------------------------------- checkpoints of another run


def test_a_checkpoint_of_another_preset_is_refused(
    refused: Callable[..., str], trained: Path, small_dataset: Path
) -> None:
    train = ("train", "tracker", small_dataset, "--out", trained, "--preset", "small", *STEP)
    assert refused(*train) == (
        f"error: {trained / 'tracker'}: was trained with preset = tiny, not small; "
        "give the same, or another --out"
    )


@pytest.mark.parametrize("stage", ["reconstruct", "lightmaps"])
def test_the_joint_stage_goes_on_from_its_own_preset_alone(
    totalediting: Run, trained: Path, small_dataset: Path, tmp_path: Path, stage: str
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    path = run / stage / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"preset": "full"}))
    before = contents(run)
    assert totalediting("train", "joint", small_dataset, "--out", run, *STEP).error == (
        f"error: {run / stage}: was trained with preset = full, not tiny; "
        "give --preset full, or another --out"
    )
    assert contents(run) == before


@pytest.mark.parametrize("file", ["config.json", "best.json"])
def test_a_damaged_file_of_a_run_is_named(
    totalediting: Run, trained: Path, small_dataset: Path, tmp_path: Path, file: str
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    path = run / "tracker" / file
    path.write_text("{")
    said = f"error: {path}: not valid JSON ("
    assert totalediting("evaluate", run, small_dataset).error.startswith(said)


# ---------------------------------------------------------------- a full disk


@pytest.fixture
def fill():
    """`fill(n)`: no file can grow beyond n bytes any more, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size=soft: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def two_steps(
    totalediting: Run, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[], Answer]:
    """Trains the tracker in `tmp_path` for two steps, with a checkpoint after each."""
    spec = STAGES["tracker"]
    often = dataclasses.replace(spec.schedule, save_every=1)
    monkeypatch.setitem(STAGES, "tracker", dataclasses.replace(spec, schedule=often))
    train = ("train", "tracker", small_dataset, "--out", tmp_path, *STEP, "--steps", 2)
    return lambda: totalediting(*train)


def test_a_full_disk_while_saving_loses_no_checkpoint(
    two_steps: Callable[[], Answer],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fill: Callable[..., None],
) -> None:
    run, before = tmp_path / "tracker", {}
    save = checkpoints.save

    def filling(*arguments) -> Path:
        if (run / "best.json").exists():  # the first is there
            before.update(contents(run / "checkpoints"))
            fill(1_000_000)
        return save(*arguments)

    monkeypatch.setattr(checkpoints, "save", filling)
    said = two_steps()
    fill()
    assert said.returncode == 2
    line = said.stderr.splitlines()[-1]
    assert line.startswith(f"error: {run}: step 2 cannot be saved (")
    assert "the checkpoint of step 1 is intact; free disk space and run the same" in line
    assert before and contents(run / "checkpoints") == before

    monkeypatch.setattr(checkpoints, "save", save)
    assert two_steps().returncode == 0
    found = checkpoints.latest(run)
    assert found is not None and found.step == 2
    logged = [json.loads(line)["step"] for line in (run / "losses.jsonl").read_text().splitlines()]
    assert logged == [0, 1]


def test_a_full_disk_while_logging_loses_no_checkpoint(
    two_steps: Callable[[], Answer],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fill: Callable[..., None],
) -> None:
    run, before = tmp_path / "tracker", {}
    loss = TrackerStage.loss

    def filling(self, network, batch, step):
        if step == 1:
            before.update(contents(run / "checkpoints"))
            fill(10)
        return loss(self, network, batch, step)

    monkeypatch.setattr(TrackerStage, "loss", filling)
    said = two_steps()
    fill()
    assert said.returncode == 2
    line = said.stderr.splitlines()[-1]
    assert line.startswith(f"error: {run}: cannot be written to (File too large); free")
    assert "run the same command again" in line
    assert before and contents(run / "checkpoints") == before


def test_a_run_that_cannot_be_written_is_one_line(
    totalediting: Run, small_dataset: Path, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"mine")
    said = totalediting("train", "tracker", small_dataset, "--out", file, *STEP).error
    assert said.startswith(f"error: {file / 'tracker'}: cannot be written to (")
    assert said.endswith("give another --out") and file.read_bytes() == b"mine"


# ---------------------------------------------------------------- machines, videos


@NOT_HERE
def test_a_gpu_that_is_not_there_is_refused(
    refused: Callable[..., str], trained: Path, small_dataset: Path
) -> None:
    train = ("train", "tracker", small_dataset, "--out", trained, "--device", "cuda", *STEP)
    assert refused(*train) == (
        "error: --device: cuda: PyTorch finds no CUDA device here; use --device cpu"
    )


def test_more_gpus_than_there_are_are_refused(
    refused: Callable[..., str],
    trained: Path,
    small_dataset: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    train = ("train", "tracker", small_dataset, "--out", trained, "--device", "cuda")
    assert refused(*train, "--devices", 4, "--batch", 8) == (
        "error: --devices: 4: PyTorch finds 1 CUDA devices here; give at most 1"
    )


def test_where_every_video_ends_early_it_is_one_line(tmp_path: Path) -> None:
    write_video(tmp_path / "talk.mp4", list(range(20, 220, 10)))
    whole = (tmp_path / "talk.mp4").read_bytes()
    (tmp_path / "talk.mp4").write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(InputError, match=r"talk.mp4: talk.mp4 ends early: \d+ of 20 frames") as e:
        Clips(tmp_path, PRESETS["tiny"])[0]
    assert "\n" not in str(e.value)


def test_edits_that_cannot_be_are_one_line(totalediting: Run, tmp_path: Path):
    def edit(*words: object) -> Answer:
        return totalediting("edit", "--appearance", *words, "--out", tmp_path / "o.png")

    nowhere = tmp_path / "nowhere.png"
    for answer, said in (
        (edit(nowhere, "--background", "blur"), "no such file"),
        (edit(nowhere), "nothing to edit"),
        (edit(nowhere, "--view", "left"), "give 2 angles"),
        (edit(nowhere, "--view", "nan,0"), "give degrees"),
        (edit(nowhere, "--expression", "jawOpen"), "such as jawOpen=0.6"),
        (edit(nowhere, "--rotate-light", "nan"), "give degrees"),
        (edit(nowhere, "--background", "grue"), "give keep"),
    ):
        assert said in answer.error
    assert not (tmp_path / "o.png").exists()
