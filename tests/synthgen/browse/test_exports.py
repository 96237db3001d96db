"""A selection that is taken along chooses the same shots in Python, in a shell and in files."""

from __future__ import annotations

import csv
import io
import json
import shlex
from pathlib import Path
from typing import Any

import duckdb
import pytest
from page_client import client, selected
from starlette.testclient import TestClient

from synthgen import cli
from synthgen.browse.table import exports
from synthgen.dataset import open_dataset
from synthgen.dataset.manifest import query
from synthgen.publish.verify import verify

CHOICES: list[dict[str, Any]] = [
    {},
    {"facets": {"subset": ["multiview"], "failed": [False]}},
    {"facets": {"environments": ["city"], "person_hair_style": [None, "bob", "it's"]}},
    {"ranges": {"head_yaw": [None, 0.1], "person_age_years": [20, 70.5]}},
    {"where": "head_yaw < 0 OR subset = 'video' -- a comment", "ranges": {"index": [0, 3]}},
    {"facets": {"failed": [True]}},
]


@pytest.fixture(scope="module")
def ask(small_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> TestClient:
    return client(small_dataset, tmp_path_factory.mktemp("thumbnails"))


def parameters(choice: dict[str, Any]) -> dict[str, str]:
    return {k: v if isinstance(v, str) else json.dumps(v) for k, v in choice.items()}


@pytest.mark.parametrize("choice", CHOICES)
def test_python_and_the_command_choose_what_the_page_does(
    ask: TestClient, small_dataset: Path, choice: dict[str, Any]
):
    said = ask.get("/api/selection", params=parameters(choice)).json()
    expected = sorted(selected(ask, **choice))
    chosen = eval(said["python"], {"open_dataset": open_dataset})
    assert sorted(chosen.keys()) == expected
    words = shlex.split(said["command"])
    where = words[words.index("--where") + 1] if "--where" in words else None
    assert words[:3] == ["synthgen", "subset", str(small_dataset)]
    assert sorted(open_dataset(small_dataset, where=where).keys()) == expected


@pytest.mark.parametrize("choice", CHOICES)
def test_keys_come_in_the_order_of_the_page(ask: TestClient, choice: dict[str, Any]):
    asked = parameters(choice | {"sort": "head_yaw", "descending": "1"})
    answer = ask.get("/rows", params=asked | {"format": "keys"})
    assert answer.text.split() == selected(ask, **asked)
    assert "attachment" in answer.headers["content-disposition"]


def test_csv_and_parquet_hold_the_rows(
    ask: TestClient, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(exports, "_CHUNK", 3)
    asked = parameters({"where": "subset = 'multiview'", "sort": "key"})
    text = ask.get("/rows", params=asked | {"format": "csv"}).text
    rows = list(csv.DictReader(io.StringIO(text)))
    sql = "SELECT key, head_yaw, environments FROM manifest WHERE subset = 'multiview' ORDER BY key"
    stored = query(small_dataset, sql).rows
    assert [(r["key"], float(r["head_yaw"]), json.loads(r["environments"])) for r in rows] == stored
    content = ask.get("/rows", params=asked | {"format": "parquet"}).content
    (tmp_path / "rows.parquet").write_bytes(content)
    with duckdb.connect() as connection:
        connection.execute(sql.replace("manifest", f"'{tmp_path}/rows.parquet'"))
        assert connection.fetchall() == stored


def test_too_many_rows_for_parquet_are_refused_with_a_remedy(
    ask: TestClient, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(exports, "MOST_PARQUET", 3)
    answer = ask.get("/rows", params={"format": "parquet"})
    assert answer.status_code == 413
    assert "take CSV" in answer.json()["error"]
    assert ask.get("/rows", params={"format": "xls"}).status_code == 400


def test_the_command_of_the_page_makes_a_dataset(
    ask: TestClient, tmp_path: Path, run_main: Any, monkeypatch: pytest.MonkeyPatch
):
    said = ask.get("/api/selection", params={"where": "view = 1"}).json()
    monkeypatch.chdir(tmp_path)
    run_main(cli.main, *shlex.split(said["command"])[1:])
    assert verify(tmp_path / "NEW_DIR") == []
