"""Tags on the page: who may change them, what is chosen by them, and what the server answers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from page_client import selected
from starlette.testclient import TestClient

from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library
from synthgen.browse.tagging import Tagging
from synthgen.dataset import open_dataset, tags

A, B = "multiview/s000000_p00", "multiview/s000000_p01"


def client(out: Path, place: Path, person: str | None = "ann") -> TestClient:
    library = Library(Folder(out))
    tagging = Tagging(library, place / "tags", person)
    app = create(library, Thumbnails(place / "thumbnails"), None, 0, tagging)
    return TestClient(app, base_url="http://localhost")


@pytest.fixture
def ask(small_dataset: Path, tmp_path: Path) -> TestClient:
    return client(small_dataset, tmp_path)


def tagged(ask: TestClient, *wanted: str, **more: Any) -> list[str]:
    return selected(ask, tags=json.dumps(wanted), **more)


def test_tags_are_given_shown_counted_chosen_and_undone(ask: TestClient):
    assert ask.get("/api/tags").json()["writable"]
    answer = ask.post("/api/tags", json={"add": "star", "shots": [A, B]}).json()
    assert answer["changed"] == 2
    assert answer["marks"][A] == {"tags": ["star"], "mine": ["star"]}
    ask.post("/api/tags", json={"add": "odd", "shots": [B]})
    assert sorted(tagged(ask, "star")) == [A, B]
    assert tagged(ask, "star", "-odd") == [A]
    assert tagged(ask, "star", where="view = 1", sort="head_yaw") == [B]
    assert len(tagged(ask, "-star")) == 14
    counts = ask.get("/api/counts", params={"tags": '["odd"]', "columns": "subset"}).json()
    assert counts["tags"] == [["star", 2], ["odd", 1]]
    assert counts["facets"]["subset"] == [["multiview", 1]] and counts["total"] == 1
    assert ask.get(f"/api/shot/{B}").json()["tags"] == ["star", "odd"]
    undone = ask.post("/api/tags/undo", json={}).json()["undone"]
    assert undone == {"added": True, "tag": "odd", "shots": 1}
    assert tagged(ask, "odd") == []
    assert ask.post("/api/tags/undo", json={}).status_code == 200
    assert ask.post("/api/tags/undo", json={}).status_code == 409


def test_a_whole_selection_is_tagged_and_taken_along(
    ask: TestClient, small_dataset: Path, tmp_path: Path
):
    selection = "where=subset%20%3D%20%27video%27&sort=head_yaw"
    answer = ask.post("/api/tags", json={"add": "reject", "selection": selection}).json()
    assert answer["changed"] == 6 and "marks" not in answer
    said = ask.get("/api/selection", params={"tags": '["-reject"]'}).json()
    chosen = eval(said["python"], {"open_dataset": open_dataset})
    assert len(chosen) == 10
    assert f"--tags=-reject --tags-in {tmp_path}/tags" in said["command"]
    keys = ask.get("/rows", params={"tags": '["reject"]', "format": "keys"}).text.split()
    assert len(keys) == 6


def test_people_are_merged_and_a_damaged_file_is_reported(
    ask: TestClient, small_dataset: Path, tmp_path: Path
):
    ask.post("/api/tags", json={"add": "star", "shots": [A]})
    other = client(small_dataset, tmp_path, "bob")
    other.post("/api/tags", json={"add": "star", "shots": [A, B]})
    (row,) = [r for r in ask.get("/api/shots").json()["rows"] if r["key"] == B.split("/")[1]][:1]
    assert row["tags"] == ["star"] and row["mine"] == []
    # Taking a tag away takes only one's own.
    answer = ask.post("/api/tags", json={"remove": "star", "shots": [A, B]}).json()
    assert answer["changed"] == 1 and answer["people"] == ["ann", "bob"]
    assert sorted(tagged(ask, "star")) == [A, B]
    path = next((tmp_path / "tags").rglob("bob.jsonl"))
    path.write_text("nonsense\n")
    answer = ask.get("/api/tags").json()
    assert "bob.jsonl: line 1" in answer["problems"][0]
    assert str(tmp_path) not in answer["problems"][0]
    assert tagged(ask, "star") == []


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"add": "star", "remove": "star", "shots": [A]}, 400),
        ({"add": "../star", "shots": [A]}, 400),
        ({"add": 3, "shots": [A]}, 400),
        ({"add": "star", "shots": ["../../x"]}, 400),
        ({"add": "star", "shots": "all"}, 400),
        ({"add": "star", "selection": "where=DROP TABLE manifest"}, 400),
        ([], 400),
        ({"add": "star", "shots": ["multiview/s000000_p00"] * 400_000}, 413),
    ],
)
def test_what_makes_no_sense_is_refused(ask: TestClient, tmp_path: Path, body: Any, status: int):
    answer = ask.post("/api/tags", json=body)
    assert answer.status_code == status
    assert "\n" not in answer.json()["error"]
    assert not list(tmp_path.rglob("*.jsonl"))


def test_a_selection_of_too_many_shots_is_refused(ask: TestClient, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tags, "MOST_SHOTS", 5)
    answer = ask.post("/api/tags", json={"add": "star", "selection": ""})
    assert answer.status_code == 413 and "choose fewer" in answer.json()["error"]


def test_nobody_else_can_tag(ask: TestClient, small_dataset: Path, tmp_path: Path):
    body = json.dumps({"add": "star", "shots": [A]})
    kind = {"Content-Type": "application/json"}
    for headers, status in (
        ({"Content-Type": "text/plain"}, 415),
        (kind | {"Sec-Fetch-Site": "cross-site"}, 403),
        (kind | {"Sec-Fetch-Site": "same-site"}, 403),
        (kind | {"Origin": "http://evil.example"}, 403),
        (kind | {"Host": "evil.example"}, 403),
        (kind | {"Origin": "http://localhost"}, 200),
    ):
        assert ask.post("/api/tags", content=body, headers=headers).status_code == status
    reader = client(small_dataset, tmp_path, None)
    assert reader.get("/api/tags").json()["writable"] is False
    assert reader.post("/api/tags", content=body, headers=kind).status_code == 403
    assert reader.post("/api/tags/undo", content="{}", headers=kind).status_code == 403
    assert sorted(tagged(reader, "star")) == [A]


def test_nothing_is_written_into_the_dataset(small_dataset: Path, tmp_path: Path):
    before = {p: p.stat().st_mtime_ns for p in small_dataset.rglob("*")}
    client(small_dataset, tmp_path).post("/api/tags", json={"add": "star", "shots": [A]})
    assert {p: p.stat().st_mtime_ns for p in small_dataset.rglob("*")} == before
