"""A trained run on the page: its pictures, its errors as columns, and what is said without one."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from page_client import selected
from starlette.testclient import TestClient

from assets_procedural.conventions.errors import UserError
from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.shot import runs
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library
from synthgen.dataset import open_dataset
from synthgen.errors import JobError


class FakeRun:
    """A run whose error of a shot is the number of its view, and whose pictures are grey."""

    name, pictures, figures = "fake", ("prediction", "truth"), {"psnr": "PSNR (dB)"}

    def __init__(self) -> None:
        self.measured: list[str] = []

    def measure(self, key: str, split: str) -> dict[str, float]:
        assert split in ("test", "validation")
        self.measured.append(key)
        if key.endswith("s000001_p01"):
            raise UserError("damaged")
        return {"psnr": float(key[-1]) if key.startswith("multi") else float("nan")}

    def picture(self, key: str, split: str, name: str) -> np.ndarray:
        if split == "train":
            raise UserError(f"{key}: cannot be read")
        return np.full((4, 4, 3), 200 if name == "truth" else 100, np.uint8)


@pytest.fixture
def beside(small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> runs.Beside:
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path))
    found = runs.Beside(FakeRun())
    found.measure(small_dataset)
    return found


def held_out(out: Path) -> list[str]:
    found: list[str] = []
    for split in ("test", "validation"):
        found += open_dataset(out, split=split).keys()
    return found


def client(out: Path, place: Path, beside: runs.Beside) -> TestClient:
    library = Library(Folder(out), added=beside.columns())
    app = create(library, Thumbnails(place), None, 0, beside=beside)
    return TestClient(app, base_url="http://localhost")


def test_errors_are_columns_to_sort_filter_and_take_along(
    small_dataset: Path, tmp_path: Path, beside: runs.Beside
):
    ask = client(small_dataset, tmp_path, beside)
    described = ask.get("/api/dataset").json()
    assert described["run"] == ["prediction", "truth"]
    (column,) = [c for c in described["columns"] if c["name"] == "run_psnr"]
    assert column["kind"] == "range" and column["group"] == "run"
    known = sorted(k for k in held_out(small_dataset) if k in beside.errors and k[0] == "m")
    assert known
    assert sorted(selected(ask, where="run_psnr IS NOT NULL")) == known
    ordered = selected(ask, where="run_psnr >= 0", sort="run_psnr")
    assert [k[-1] for k in ordered] == sorted(k[-1] for k in known)
    chosen = {"ranges": '{"run_psnr": [1, null]}'}
    said = ask.get("/api/selection", params=chosen).json()
    found = eval(said["python"], {"open_dataset": open_dataset})
    assert sorted(found.keys()) == [k for k in known if k[-1] != "0"]
    shot = ask.get(f"/api/shot/{known[0]}").json()
    assert shot["errors"] == {"PSNR (dB)": float(known[0][-1])}


def test_pictures_of_the_run_are_shown_and_faults_told(
    small_dataset: Path, tmp_path: Path, beside: runs.Beside
):
    ask = client(small_dataset, tmp_path, beside)
    held, train = held_out(small_dataset)[0], open_dataset(small_dataset, split="train").keys()[0]
    assert ask.get(f"/pass/{held}/run_prediction").headers["content-type"] == "image/png"
    answer = ask.get(f"/pass/{train}/run_truth")
    assert answer.status_code == 422 and "cannot be read" in answer.json()["error"]
    assert ask.get(f"/pass/{held}/run_nothing").status_code == 404


def test_a_run_is_measured_once_and_a_bounded_number_of_shots(
    small_dataset: Path, beside: runs.Beside, monkeypatch: pytest.MonkeyPatch
):
    run = beside.run
    assert isinstance(run, FakeRun) and run.measured == held_out(small_dataset)
    again = runs.Beside(FakeRun())
    again.measure(small_dataset)
    assert again.errors == beside.errors
    assert isinstance(again.run, FakeRun) and not again.run.measured
    monkeypatch.setattr(runs, "MOST", 3)
    few = runs.Beside(FakeRun())
    few.measure(small_dataset)
    assert isinstance(few.run, FakeRun) and len(few.run.measured) == 3


def test_without_the_package_of_the_model_one_line_says_what_to_install(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    def entries(**_: Any) -> list[Any]:
        return [EntryPoint("x", "no_such_package_anywhere", runs.ENTRY_POINTS)]

    monkeypatch.setattr(runs, "entry_points", entries)
    with pytest.raises(JobError, match=r"needs no_such_package_anywhere: pip install"):
        runs.open_beside(Path("run"), small_dataset)
    opened = SimpleNamespace(open_run=lambda run, data: FakeRun())
    monkeypatch.setattr(runs, "entry_points", lambda **_: [SimpleNamespace(load=lambda: opened)])
    assert runs.open_beside(Path("run"), small_dataset).errors
