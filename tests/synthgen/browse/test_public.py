"""`synthgen browse --public`: a page for everybody writes nothing, tells no path, takes turns."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from answer import Answer
from starlette.responses import JSONResponse
from starlette.testclient import TestClient

from synthgen import cli
from synthgen.browse.access import public
from synthgen.browse.access.public import TakingTurns
from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library
from synthgen.browse.tagging import Tagging
from synthgen.dataset import tags
from synthgen.dataset.records import read_description

SHOT = "multiview/s000002_p01"


def client(out: Path, place: Path, host: str = "data.example.org") -> TestClient:
    library = Library(Folder(out, hidden=True))
    tagging = Tagging(library, place / "tags", None)
    app = create(library, Thumbnails(place / "thumbnails"), None, 0, tagging, "data.example.org")
    return TestClient(app, base_url=f"http://{host}")


@pytest.fixture
def ask(browse_dataset: Path, tmp_path: Path) -> TestClient:
    return client(browse_dataset, tmp_path)


def test_everybody_may_ask_under_the_name_of_the_proxy_alone(
    ask: TestClient, browse_dataset: Path, tmp_path: Path
):
    assert ask.get("/api/shots").json()["total"] == 16
    other = client(browse_dataset, tmp_path, "evil.example")
    assert other.get("/api/shots").status_code == 403


def test_nothing_is_written_and_nothing_uploaded(ask: TestClient, tmp_path: Path):
    shots = {"add": "star", "shots": [SHOT]}
    for path in ("/api/tags", "/api/tags/undo", "/lightmaps"):
        answer = ask.post(path, json=shots)
        assert answer.status_code == 403 and "read-only" in answer.json()["error"]
    assert ask.get("/api/tags").json()["writable"] is False
    assert not list(tmp_path.rglob("*.jsonl"))


def test_no_answer_holds_a_path_or_a_name_of_a_person(
    ask: TestClient, browse_dataset: Path, tmp_path: Path
):
    info = read_description(browse_dataset)
    tags.Book(tmp_path / "tags", info, "somebody").change(True, "star", [SHOT])
    odd = tmp_path / "tags" / tags.identity(info) / "other.jsonl"
    odd.write_text("nonsense\n")
    asked = ["/", "/api/dataset", "/api/shots", "/api/counts", "/api/selection?where=view%3D1"]
    asked += [f"/api/shot/{SHOT}", "/api/shot/multiview/s000004_p01", "/api/tags"]
    asked += ["/thumbnail/multiview/s000004_p01", "/values/multiview/s000004_p01/depth"]
    asked += ["/api/subject/multiview/s000004", "/subject/multiview/s000009.glb"]
    asked += ["/lightmaps/nowhere", "/rows?format=csv", "/api/shots?where=x", "/member/a/b/c"]
    for path in asked:
        answer = ask.get(path)
        said = answer.text + json.dumps(dict(answer.headers))
        for secret in (str(browse_dataset), str(tmp_path), str(Path.home()), "somebody"):
            assert secret not in said, path
    assert "DATASET" in ask.get(f"/api/shot/{SHOT}").json()["command"]
    assert ask.get("/api/tags").json()["tags"] == [["star", 1]]


def test_who_asks_too_much_waits_and_others_do_not(
    ask: TestClient, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(public, "PURSE", 20.0)
    monkeypatch.setattr(public, "INCOME", 5.0)
    now = [0.0]
    turns = TakingTurns(JSONResponse({}), clock=lambda: now[0])

    def asked(address: str) -> int:
        asking = TestClient(turns, base_url="http://localhost", client=(address, 1))
        return asking.get("/api/dataset").status_code

    assert [asked("192.0.2.1") for _ in range(5)] == [200] * 4 + [429]
    assert asked("192.0.2.2") == 200
    answer = TestClient(turns, base_url="http://localhost", client=("192.0.2.1", 1)).get("/rows")
    assert answer.status_code == 429
    assert int(answer.headers["Retry-After"]) == 100
    assert re.search("try again in 100 s", answer.json()["error"])
    now[0] = 1.0
    assert [asked("192.0.2.1") for _ in range(2)] == [200, 429]
    # And so it is on the page.
    assert 429 in [ask.get("/api/dataset").status_code for _ in range(6)]
    # Of IPv6, a household has a whole net.
    assert [asked(f"2001:db8::{n}") for n in range(5)] == [200] * 4 + [429]


def test_it_listens_for_a_proxy_on_this_machine(
    browse_dataset: Path, run_main: Callable[..., Answer]
):
    browse = ("browse", browse_dataset, "--port", 0, "--public")
    answer = run_main(cli.main, *browse, "data.example.org", "--host", "0.0.0.0")
    assert "it is the proxy that others reach" in answer.error
    assert "give the host of the proxy" in run_main(cli.main, *browse, "http://x/").error
