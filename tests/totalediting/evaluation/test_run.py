"""Tables of held-out people: what is asked, and what a perfect and a poor system score."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from totalediting.cli import main
from totalediting.data.pairs import PortraitPairs
from totalediting.errors import InputError
from totalediting.evaluation import run, scores, tasks
from totalediting.presets import PRESETS
from totalediting.pretrained.fetch import NetworkError

PRESET = replace(PRESETS["tiny"], image=32)


@pytest.fixture(autouse=True)
def without_networks(monkeypatch):
    def absent(*_):
        raise NetworkError("not here")

    monkeypatch.setattr(scores, "Lpips", absent)
    monkeypatch.setattr(scores, "Recognition", absent)


@pytest.fixture(scope="module")
def pairs(small_dataset):
    return PortraitPairs(small_dataset, PRESET, "train")


def answers(pairs, folder, shown):
    """A system's pictures, as `shown` makes them of a pair."""
    for question in tasks.questions(pairs):
        pair = tasks.pair_of(pairs, question)
        path = folder / f"{tasks.key_of(question, pair.app_key, pair.key)}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = (255 * shown(pair)).round().byte().movedim(0, -1).numpy()
        Image.fromarray(np.ascontiguousarray(pixels)).save(path)


def scored(pairs, folder, out):
    device = torch.device("cpu")
    run.evaluate(None, folder, pairs.shots.folder, PRESET, "train", out, device)
    return json.loads((out / "tables.json").read_text())["tables"]


def test_every_task_is_asked_and_nobody_drives_himself_in_cross(pairs):
    asked = tasks.questions(pairs)
    assert {q.task for q in asked} == set(tasks.NAMES)
    subjects = pairs.shots.subjects
    for q in asked:
        same = subjects[q.source] == subjects[q.target]
        assert same == (q.task != "cross")
        assert (q.lights[0] != q.lights[1]) == (q.task == "relighting")


def test_the_truth_scores_best_and_the_source_is_beside_it(pairs, tmp_path):
    answers(pairs, tmp_path / "true", lambda pair: pair.mot_image)
    tables = scored(pairs, tmp_path / "true", tmp_path / "out")
    for task in ("views", "reenactment", "relighting"):
        best, source = tables[task]["result"], tables[task]["the source itself"]
        assert best["psnr"] > max(55, source["psnr"] + 1) and best["ssim"] > 0.99
    text = (tmp_path / "out" / "tables.md").read_text()
    assert "| Self-reenactment, " in text and "without CSIM: not here" in text
    with Image.open(tmp_path / "out" / "page.png") as page:
        assert page.width > page.height


def test_frames_that_flicker_are_told_from_those_that_do_not(pairs, tmp_path):
    count = iter(range(1000))
    answers(
        pairs, tmp_path / "a", lambda pair: (pair.mot_image + 0.2 * (next(count) % 2)).clamp(0, 1)
    )
    answers(pairs, tmp_path / "b", lambda pair: (pair.mot_image + 0.2).clamp(0, 1))
    found = [scored(pairs, tmp_path / n, tmp_path / f"out_{n}")["reenactment"] for n in "ab"]
    flickers = [tables["result"].get("flicker", 0.0) for tables in found]
    assert flickers[0] > 2 * flickers[1] or flickers == [0.0, 0.0]


def test_a_missing_or_oblong_picture_is_one_line(pairs, tmp_path):
    with pytest.raises(InputError, match=r"is missing; questions\.json says"):
        scored(pairs, tmp_path, tmp_path / "out")
    answers(pairs, tmp_path, lambda pair: pair.mot_image[:, :16])
    with pytest.raises(InputError, match="give a square"):
        scored(pairs, tmp_path, tmp_path / "out")


def test_folders_that_cannot_serve_are_said_first(run_main, tmp_path):
    (tmp_path / "file").touch()
    for options, said in (
        (["--predictions", tmp_path], "give --out, too"),
        (["--predictions", tmp_path / "no", "--out", tmp_path / "o"], "is no folder"),
        (["--out", tmp_path / "file"], "is a file; give a folder's name"),
    ):
        answer = run_main(main, "evaluate", tmp_path / "run", tmp_path / "data", *options)
        assert answer.returncode == 2 and said in answer.stderr
    assert not (tmp_path / "o").exists()
