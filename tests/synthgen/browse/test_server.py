"""`synthgen browse`: what the server says about a dataset is what the dataset holds."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_renderer
import numpy as np
import pytest
from page_client import client, selected
from PIL import Image
from starlette.testclient import TestClient

from assets_procedural.conventions.colour import srgb_decode
from synthgen import cli
from synthgen.browse.folder import Folder
from synthgen.browse.table import snapshot as snapshots
from synthgen.browse.table.snapshot import Library
from synthgen.dataset import Dataset, manifest, open_dataset
from synthgen.dataset.codecs import decode_exr
from synthgen.farm.local import render_job
from synthgen.pictures.drawing import pictures

SHOT = "multiview/s000002_p01"


@pytest.fixture(scope="module")
def ask(small_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> TestClient:
    return client(small_dataset, tmp_path_factory.mktemp("thumbnails"))


@pytest.fixture
def stored(small_dataset: Path) -> Dataset:
    return open_dataset(small_dataset)


@pytest.fixture
def copy(small_dataset: Path, tmp_path: Path) -> Path:
    """A copy of the small dataset that a test may damage."""
    return shutil.copytree(small_dataset, tmp_path / "copy")


def array(answer: Any) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    shape = [int(n) for n in answer.headers["X-Shape"].split(",")]
    return np.frombuffer(answer.content, answer.headers["X-Type"]).reshape(shape)


# ---------------------------------------------------------------- the dataset


def test_the_dataset_is_described(ask: TestClient):
    found = ask.get("/api/dataset").json()
    assert (found["name"], found["format"], found["complete"]) == ("small", 2, True)
    assert (found["shots"], found["frames"], found["failures"]) == (16, 5 * 2 * 2 + 3 * 2 * 3, 0)
    assert [e["id"] for e in found["environments"]] == ["city", "night", "studio"]
    assert found["part_names"][13] | {"colour": None} == {"id": 13, "name": "hair", "colour": None}
    assert len(found["expression_names"]) == 52
    columns = {c["name"]: c for c in found["columns"]}
    kinds = {n: (columns[n]["type"], columns[n]["kind"]) for n in ("split", "head_yaw", "failed")}
    assert kinds == {
        "split": ("text", "facet"),
        "head_yaw": ("number", "range"),
        "failed": ("boolean", "facet"),
    }
    assert columns["environments"]["listed"] and columns["environments"]["kind"] == "facet"
    assert columns["head_yaw"]["unit"] == "rad"
    assert columns["seed_shot"]["kind"] == columns["key"]["kind"] == "other"


def test_without_a_choice_every_shot_comes_in_the_manifests_order(ask: TestClient, stored: Dataset):
    assert selected(ask) == stored.keys()


@pytest.mark.parametrize("descending", [False, True])
def test_sorting_puts_shots_without_a_value_last(
    ask: TestClient, small_dataset: Path, descending: bool
):
    way = "DESC" if descending else "ASC"
    for column in ("person_age_years", "person_glasses_shape", "camera_yaw"):
        rows = manifest.query(
            small_dataset,
            f"SELECT subset || '/' || key, {column} FROM manifest "
            f"ORDER BY {column} {way} NULLS LAST",
        ).rows
        values = dict(rows)
        keys = selected(ask, sort=column, descending="1" if descending else "0")
        assert [values[k] for k in keys] == [value for _, value in rows]
        assert sorted(keys) == sorted(values)


@pytest.mark.parametrize(
    ("query", "where"),
    [
        ({"facets": {"subset": ["video"]}}, "subset = 'video'"),
        ({"facets": {"split": ["train", "test"]}}, "split IN ('train', 'test')"),
        ({"facets": {"environments": ["night"]}}, "list_contains(environments, 'night')"),
        ({"facets": {"environments": ["night", *"abcdefgh"]}}, "'night' IN environments"),
        ({"facets": {"person_hat_style": [None]}}, "person_hat_style IS NULL"),
        ({"facets": {"failed": [False]}}, "true"),
        ({"facets": {"split": []}}, "true"),
        ({"ranges": {"camera_yaw": [-0.2, None]}}, "camera_yaw >= -0.2"),
        ({"ranges": {"camera_yaw": [-0.2, 0.3]}}, "camera_yaw BETWEEN -0.2 AND 0.3"),
        ({"where": "person_age_years > 40 OR view = 1"}, "person_age_years > 40 OR view = 1"),
        (
            {
                "facets": {"subset": ["multiview"], "environments": ["night", "city"]},
                "ranges": {"index": [1, 3]},
                "where": "view = 1 OR view = 0 -- a comment",
                "sort": "head_yaw",
            },
            "subset = 'multiview' AND list_has_any(environments, ['night', 'city']) "
            'AND "index" BETWEEN 1 AND 3 AND view IN (0, 1)',
        ),
        (
            {
                "where": "subset || subject IN "
                "(SELECT subset || subject FROM manifest WHERE view = 1)"
            },
            "kind = 'multiview'",
        ),
    ],
)
def test_a_selection_is_what_the_same_condition_selects(
    ask: TestClient, small_dataset: Path, query: dict[str, Any], where: str
):
    expected = open_dataset(small_dataset, where=where).keys()
    assert sorted(selected(ask, **query)) == sorted(expected)


def test_the_first_answers_come_from_parquet_and_are_the_same(
    ask: TestClient, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(snapshots, "_SMALL", 0)
    monkeypatch.setattr(Library, "_load", lambda self, patience: None)
    early = client(small_dataset, tmp_path)
    assert not early.get("/api/dataset").json()["ready"]
    for query in ({}, {"where": "view = 1", "sort": "camera_yaw"}, {"facets": {"split": ["test"]}}):
        assert selected(early, **query) == selected(ask, **query)
        texts = {k: v if isinstance(v, str) else json.dumps(v) for k, v in query.items()}
        early_counts = early.get("/api/counts", params=texts).json()
        assert early_counts == ask.get("/api/counts", params=texts).json()


@pytest.mark.parametrize("name", ["a[b]", "[!x]*", "wh?t", "it's {} %"])
def test_a_folder_whose_name_is_a_pattern_is_read_before_and_after_it_is_in_memory(
    ask: TestClient, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    monkeypatch.setattr(snapshots, "_SMALL", 0)
    monkeypatch.setattr(snapshots, "_PATIENCE", 60.0)
    shutil.copytree(small_dataset / "manifest", tmp_path / name / "manifest")
    shutil.copy(small_dataset / "dataset.json", tmp_path / name)
    library = Library(Folder(tmp_path / name))
    try:
        early = client(tmp_path / name, tmp_path, library)
        assert not library.snapshot().in_memory
        query = {"where": "view = 1", "sort": "camera_yaw"}
        assert selected(early, **query) == selected(ask, **query)
        assert library.wait().in_memory
        assert selected(early, **query) == selected(ask, **query)
    finally:
        library.close()


def test_what_is_being_loaded_ends_with_the_server(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(snapshots, "_SMALL", 0)
    monkeypatch.setattr(snapshots, "_PATIENCE", 60.0)
    library = Library(Folder(small_dataset))
    assert library._loading is not None and library._loading.is_alive()
    library.close()
    assert not library._loading.is_alive() and not library.snapshot().in_memory


def test_counts_are_those_of_sql_and_leave_their_own_choice_out(
    ask: TestClient, small_dataset: Path
):
    query = {"facets": json.dumps({"split": ["train"], "environments": ["night"]})}
    found = ask.get("/api/counts", params=query).json()

    def sql(column: str, where: str) -> dict[Any, int]:
        text = f"SELECT {column} AS v, count(*) FROM manifest WHERE {where} GROUP BY v"
        return dict(manifest.query(small_dataset, text).rows)

    night, train = "list_contains(environments, 'night')", "split = 'train'"
    assert dict(found["facets"]["split"]) == sql("split", night)
    assert dict(found["facets"]["environments"]) == sql("unnest(environments)", train)
    assert dict(found["facets"]["person_hair_style"]) == sql(
        "person_hair_style", f"{night} AND {train}"
    )
    assert dict(found["facets"]["person_hat_style"]) == sql(
        "person_hat_style", f"{night} AND {train}"
    )
    assert found["total"] == sum(sql("1", f"{night} AND {train}").values())
    counts = [n for _, n in found["facets"]["person_hair_style"]]
    assert counts == sorted(counts, reverse=True)


def test_histograms_hold_every_value_between_their_edges(ask: TestClient, small_dataset: Path):
    query = {"columns": "camera_yaw,person_glasses_tint", "where": "subset = 'multiview'"}
    found = ask.get("/api/counts", params=query).json()["histograms"]
    assert list(found) == ["camera_yaw", "person_glasses_tint"]
    rows = manifest.query(small_dataset, "SELECT subset, camera_yaw FROM manifest").rows
    edges = np.array(found["camera_yaw"]["edges"])
    assert (edges[0], edges[-1]) == (min(v for _, v in rows), max(v for _, v in rows))
    values = [v for subset, v in rows if subset == "multiview"]
    assert found["camera_yaw"]["counts"] == np.histogram(values, edges)[0].tolist()
    tints = "SELECT count(person_glasses_tint) FROM multiview"
    assert (
        sum(found["person_glasses_tint"]["counts"])
        == manifest.query(small_dataset, tints).rows[0][0]
    )


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"facets": "["}, 'facets: must be JSON such as {"column": [...]}'),
        ({"facets": '{"nose": ["big"]}'}, "facets: the manifest has no column 'nose'"),
        ({"facets": '{"split": "train"}'}, "facets: split: give a list of values of type text"),
        (
            {"facets": '{"failed": ["yes"]}'},
            "facets: failed: give a list of values of type boolean",
        ),
        (
            {"ranges": '{"camera_yaw": [1]}'},
            "ranges: camera_yaw: give [low, high]; null leaves an end open",
        ),
        (
            {"ranges": '{"camera_yaw": [NaN, 1]}'},
            "ranges: camera_yaw: give [low, high]; null leaves an end open",
        ),
        (
            {"ranges": '{"split": [0, 1]}'},
            "ranges: split is not a numeric column; use facets or where",
        ),
        ({"sort": "nose"}, "sort: the manifest has no column 'nose'"),
        ({"sort": "environments"}, "sort: environments holds lists; sort by another column"),
        ({"limit": "501"}, "limit = 501: give a whole number from 0 to 500"),
        ({"offset": "-1"}, "offset = -1: give a whole number from 0 to 1000000000"),
        (
            {"where": "nose > 3"},
            'where: Binder Error: Referenced column "nose" not found in FROM clause! Candidate '
            'bindings: "pose", "offset", "motion_seconds", "cost_beauty", "index"',
        ),
    ],
)
def test_a_wrong_selection_is_one_line(ask: TestClient, query: dict[str, str], message: str):
    answer = ask.get("/api/shots", params=query)
    assert answer.status_code == 400
    assert answer.json()["error"] == message


def test_null_and_large_numbers_survive_json(ask: TestClient, small_dataset: Path):
    row = ask.get(f"/api/shot/{SHOT}").json()["row"]
    text = "SELECT seed_subject FROM multiview WHERE key = 's000002_p01'"
    seed = manifest.query(small_dataset, text).rows[0][0]
    # JavaScript would round it.
    assert seed > 2**53 and row["seed_subject"] == str(seed)
    assert row["person_hat_style"] is None or isinstance(row["person_hat_style"], str)


# ---------------------------------------------------------------- pictures and values


def test_a_thumbnail_shows_its_environment(ask: TestClient, stored: Dataset):
    shot = stored[SHOT]
    for e in range(2):
        answer = ask.get(f"/thumbnail/{SHOT}", params={"environment": e, "size": 96})
        assert answer.headers["content-type"] == "image/jpeg"
        assert "max-age" in answer.headers["cache-control"]
        with Image.open(io.BytesIO(answer.content)) as image:
            assert image.size == (96, 96)
            small = np.asarray(image.resize((48, 48), Image.Resampling.BOX)).astype(float)
        gaps = [np.abs(small - picture).mean() for picture in shot.rgb]
        assert gaps[e] < 1 and gaps[e] < 0.7 * gaps[1 - e]
    assert ask.get(f"/thumbnail/{SHOT}?environment=2").status_code == 404


def test_thumbnails_are_kept_outside_the_dataset_under_a_limit(small_dataset: Path, tmp_path: Path):
    before = sorted(p.relative_to(small_dataset) for p in small_dataset.rglob("*"))
    limit = 6000
    ask = client(small_dataset, tmp_path, limit=limit)
    for row in ask.get("/api/shots").json()["rows"]:
        assert ask.get(f"/thumbnail/{row['subset']}/{row['key']}").status_code == 200
        kept = list(tmp_path.rglob("*.jpg"))
        assert kept and sum(p.stat().st_size for p in kept) <= limit
    assert sorted(p.relative_to(small_dataset) for p in small_dataset.rglob("*")) == before
    one = ask.get(f"/thumbnail/{SHOT}").content
    (path,) = [p for p in tmp_path.rglob("*.jpg") if p.read_bytes() == one]
    path.write_bytes(b"from the cache")
    assert ask.get(f"/thumbnail/{SHOT}").content == b"from the cache"


def test_passes_are_drawn_as_show_draws_them(ask: TestClient, stored: Dataset):
    shot = stored[SHOT]
    described = ask.get(f"/api/shot/{SHOT}").json()
    drawn = {"image": shot.rgb[1]} | pictures(shot)
    assert set(described["passes"]) == set(drawn)
    for name, picture in drawn.items():
        answer = ask.get(f"/pass/{SHOT}/{name}", params={"environment": 1})
        assert answer.headers["content-type"] == "image/png"
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(answer.content))), picture)
    assert ask.get(f"/pass/{SHOT}/nose").status_code == 404


def test_values_are_those_stored(ask: TestClient, stored: Dataset):
    shot = stored[SHOT]
    assert shot.hdr is not None
    expected = {
        "image": shot.rgb[1],
        "linear": shot.hdr[1].astype(np.float32),
        "albedo": srgb_decode(shot.albedo / np.float32(255)),
        "normal": shot.normal.astype(np.float32),
        "depth": shot.depth,
        "uv": shot.uv,
        "canonical": shot.canonical,
        "parts": shot.parts,
        "alpha": shot.alpha,
    }
    assert set(ask.get(f"/api/shot/{SHOT}").json()["values"]) == set(expected)
    for name, values in expected.items():
        found = array(ask.get(f"/values/{SHOT}/{name}", params={"environment": 1}))
        assert found.dtype == values.dtype
        np.testing.assert_array_equal(found, values)


def test_a_shot_is_described_with_its_members(
    ask: TestClient, stored: Dataset, small_dataset: Path
):
    found = ask.get(f"/api/shot/{SHOT}").json()
    shot = stored[SHOT]
    assert found["meta"] == json.loads(json.dumps(shot.meta))
    assert found["broken"] is None
    assert found["siblings"] == ["s000002_p00", "s000002_p01"]
    assert found["command"] == f"synthgen rerender {small_dataset} {SHOT}"
    uses = shot.meta["environments"]
    assert [e["id"] for e in found["environments"]] == [use["id"] for use in uses]
    assert [e["factor"] for e in found["environments"]] == shot.meta["exposures"]
    names = [m["name"] for m in found["members"]]
    assert names[:2] == ["rgb_00.png", "rgb_01.png"] and names[-1] == "meta.json"
    for member in found["members"]:
        answer = ask.get(member["url"])
        assert len(answer.content) == member["bytes"] == int(answer.headers["content-length"])
        disposition = f'attachment; filename="s000002_p01.{member["name"]}"'
        assert answer.headers["content-disposition"] == disposition
        assert answer.headers["content-type"] == "application/octet-stream"
    stored_normal = decode_exr(ask.get(f"/member/{SHOT}/aov.exr").content)["normal.X"]
    np.testing.assert_array_equal(stored_normal, shot.normal[..., 0])
    assert ask.get(f"/member/{SHOT}/nose.png").status_code == 404
    assert ask.get("/api/shot/multiview/s000099_p00").status_code == 404


# ---------------------------------------------------------------- light and subjects


def test_lightmaps_are_those_the_model_learns_from(
    ask: TestClient, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    torch = pytest.importorskip("torch")
    from totalediting.light import lightmaps

    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path / "cache"))
    file = small_dataset / "environments" / "city.exr"
    panorama = torch.from_numpy(open_dataset(small_dataset).environment("city"))
    expected = lightmaps.bake(panorama, 32).numpy()
    found = array(ask.get("/lightmaps/city"))
    assert found.shape == (5, 3, 32, 64) and found.dtype == np.float32
    assert np.abs(found - expected).max() <= 0.01 * expected.max()
    sent = array(ask.post("/lightmaps?height=32", content=file.read_bytes()))
    np.testing.assert_allclose(sent, expected, rtol=1e-4, atol=1e-4 * expected.max())


def test_what_cannot_light_is_refused_in_one_line(ask: TestClient, monkeypatch: pytest.MonkeyPatch):
    assert ask.get("/lightmaps/nowhere").status_code == 404
    assert ask.get("/lightmaps/city?height=4").status_code == 400
    answer = ask.post("/lightmaps", content=b"GIF89a")
    assert answer.status_code == 422
    assert answer.json()["error"].startswith("the file is neither .exr nor .hdr")
    answer = ask.post("/lightmaps", content=b"\x76\x2f\x31\x01" + b"\0" * 40)
    assert answer.status_code == 422
    assert answer.json()["error"].startswith("the file: is damaged")
    monkeypatch.setattr("synthgen.browse.shot.light.LARGEST_UPLOAD", 10)
    assert ask.post("/lightmaps", content=b"#?RADIANCE and more").status_code == 413
    monkeypatch.setitem(sys.modules, "totalediting.light.arrays", None)
    answer = ask.get("/lightmaps/city")
    assert answer.status_code == 501
    assert "pip install 'totalediting[model]'" in answer.json()["error"]


def test_a_subject_has_the_cameras_of_its_shots(ask: TestClient, stored: Dataset):
    found = ask.get("/api/subject/video/s000001").json()
    assert found["shots"] == ["s000001_p00", "s000001_p01"]
    for camera in found["cameras"]:
        meta = stored[f"video/{camera['key']}"].meta["camera"]
        for name in ("camera_to_world", "intrinsics", "width", "height"):
            assert camera[name] == meta[name]
    assert ask.get("/subject/video/s000001.glb").content == b"glTFs000001"
    assert ask.get("/api/subject/video/s000099").status_code == 404


def test_expressions_move_the_skin_as_the_head_model_does(ask: TestClient, stored: Dataset):
    from assets_procedural.body.head import HeadModel
    from assets_procedural.motion.poses import ARKIT_NAMES, Pose
    from assets_procedural.person import Person

    found = array(ask.get("/subject/multiview/s000002/expressions"))
    model = HeadModel.load()
    skin = model.groups["skin"]
    identity = model.identity(Person.model_validate(stored[SHOT].meta["person"]))
    for name in ("jawOpen", "eyeBlinkLeft"):
        smiling = identity.pose(Pose(expression={name: 1.0})).unposed
        expected = (smiling - identity.rest)[skin]
        np.testing.assert_allclose(found[ARKIT_NAMES.index(name)], expected, atol=1e-6)
        assert np.abs(expected).max() > 1e-3


# ---------------------------------------------------------------- broken, failed, growing


def _missing(tar: Path) -> None:
    tar.unlink()


def _cut(tar: Path) -> None:
    tar.write_bytes(tar.read_bytes()[:5000])


def _overwritten(tar: Path) -> None:
    tar.write_bytes(b"x" * tar.stat().st_size)


def _spoilt_picture(tar: Path) -> None:
    data = bytearray(tar.read_bytes())
    at = data.index(b"IHDR")
    while at > 0:
        data[at + 20 : at + 200] = bytes(180)
        at = data.find(b"IHDR", at + 1)
    tar.write_bytes(data)


@pytest.mark.parametrize(
    ("damage", "reason", "at_once"),
    [
        (_missing, "no such file in the dataset", True),
        (_cut, "is cut short", True),
        (_overwritten, "no tar entry at byte 0", False),
        (_spoilt_picture, "does not decode", False),
    ],
)
def test_a_broken_shard_is_shown_as_broken_with_its_reason(
    copy: Path, tmp_path: Path, damage: Callable[[Path], None], reason: str, at_once: bool
):
    tar = sorted((copy / "data" / "multiview").glob("*.tar"))[0]
    damage(tar)
    ask = client(copy, tmp_path / "cache")
    rows = ask.get("/api/shots?limit=500").json()["rows"]
    assert len(rows) == 16
    own = [r for r in rows if r["shard"] == f"data/multiview/{tar.name}"]
    assert own and all(r["broken"] is None for r in rows if r not in own)
    if at_once:
        assert all(reason in r["broken"] for r in own)
    key = f"{own[0]['subset']}/{own[0]['key']}"
    small = ask.get(f"/thumbnail/{key}")
    assert small.status_code == 200 and reason in small.headers["X-Broken"]
    assert small.headers["content-type"].startswith("image/svg")
    shot = ask.get(f"/api/shot/{key}").json()
    assert reason in shot["broken"] and shot["meta"]["subject"] == own[0]["subject"]
    answer = ask.get(f"/pass/{key}/depth")
    assert answer.status_code == 422 and reason in answer.json()["error"]


def test_a_failed_subject_is_a_row_with_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "raise"}))
    out = tmp_path / "out"
    render_job(fake_renderer.small_job(), out, workers=1, renderer=fake_renderer.RENDERER)
    ask = client(out, tmp_path / "cache")
    assert ask.get("/api/dataset").json()["failures"] == 2
    assert selected(ask, facets={"failed": [True]}) == ["multiview/s000001", "video/s000001"]
    row = ask.get("/api/shots", params={"where": "failed"}).json()["rows"][0]
    assert row["broken"].startswith("failed: ") and "no hair left" in row["broken"]
    shot = ask.get("/api/shot/multiview/s000001").json()
    assert "no hair left" in shot["broken"]
    assert "no hair left" in ask.get("/thumbnail/video/s000001").headers["X-Broken"]
    assert "no hair left" in ask.get("/api/subject/video/s000001").json()["error"]


def test_a_dataset_that_grows_is_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(snapshots, "_SETTLE", 0.0)
    monkeypatch.setattr(snapshots, "_REST", 0.0)
    out, job = tmp_path / "out", fake_renderer.small_job()
    assert not render_job(job, out, workers=1, limit=1, renderer=fake_renderer.RENDERER).complete
    with contextlib.closing(Library(Folder(out))) as library:
        ask = client(out, tmp_path / "cache", library)
        first = ask.get("/api/dataset").json()
        assert not first["complete"] and first["shots"] == 2
        # A subject that waits for its shard is read from where it waits.
        (row, _) = ask.get("/api/shots").json()["rows"]
        assert row["shard"].startswith("work/")
        key = f"{row['subset']}/{row['key']}"
        before = ask.get(f"/thumbnail/{key}").content
        assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
        deadline = time.monotonic() + 30
        while (found := ask.get("/api/dataset").json())["shots"] < 16:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert found["complete"] and found["revision"] != first["revision"]
        assert selected(ask) == open_dataset(out).keys()
        assert ask.get(f"/thumbnail/{key}").content == before


def test_nothing_finished_yet_is_an_empty_dataset(copy: Path, tmp_path: Path):
    info = json.loads((copy / "dataset.json").read_text())
    (copy / "dataset.json").write_text(json.dumps(info | {"complete": False}))
    for folder in ("manifest", "ledger", "data"):
        shutil.rmtree(copy / folder)
    ask = client(copy, tmp_path / "cache")
    assert ask.get("/api/shots").json() | {"revision": ""} == {
        "total": 0,
        "rows": [],
        "revision": "",
    }
    counts = ask.get("/api/counts").json()
    assert counts["total"] == 0 and counts["facets"]["subset"] == []


# ---------------------------------------------------------------- the command


def test_the_command_says_in_one_line_what_it_cannot_serve(
    run_main: Any, small_dataset: Path, tmp_path: Path
):
    answer = run_main(cli.main, "browse", tmp_path)
    assert "no dataset here" in answer.error
    answer = run_main(cli.main, "browse", small_dataset, "--host", "192.0.2.1", "--port", 8350)
    assert answer.error.startswith("error: --port: 192.0.2.1 = 8350: ")


def test_without_the_extra_the_command_names_it(
    run_main: Any, small_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "synthgen.browse.serve", raising=False)
    answer = run_main(cli.main, "browse", small_dataset)
    assert "pip install 'totalediting[browse]'" in answer.error


# ---------------------------------------------------------------- columns


def test_columns_come_in_a_researchers_order_with_words(ask: TestClient):
    columns = ask.get("/api/dataset").json()["columns"]
    groups = list(dict.fromkeys(c["group"] for c in columns))
    assert groups[:5] == ["people", "light", "camera", "head", "expression"]
    assert groups[-1] == "other"
    by_name = {c["name"]: c for c in columns}
    assert [c["name"] for c in columns[:2]] == ["person_sex", "person_age_years"]
    assert by_name["width"]["constant"] and not by_name["head_yaw"]["constant"]
    assert by_name["person_ancestry"]["words"] and not by_name["environments"]["words"]
    assert by_name["gaze_yaw"]["label"] == "gaze yaw"
    assert by_name["camera_yaw"]["title"] == "camera yaw"
    assert by_name["expression_browDownLeft"]["label"] == "brow down left"


def test_pairs_count_where_both_columns_are(ask: TestClient, small_dataset: Path):
    asked = {"pairs": "camera_yaw:camera_pitch", "columns": "", "where": "subset = 'multiview'"}
    (pair,) = ask.get("/api/counts", params=asked).json()["pairs"]
    wide, high = len(pair["x_edges"]) - 1, len(pair["y_edges"]) - 1
    grid = np.array(pair["counts"]).reshape(high, wide)
    rows = manifest.query(
        small_dataset, "SELECT camera_yaw, camera_pitch FROM manifest WHERE subset = 'multiview'"
    ).rows
    x, y = np.array(rows).T
    expected, *_ = np.histogram2d(y, x, [pair["y_edges"], pair["x_edges"]])
    assert grid.sum() == 10 and np.abs(grid - expected).sum() <= 2  # edges are floats
    # Its own choice is left out, as that of a facet is.
    ranges = json.dumps({"camera_yaw": [0, 0]})
    (same,) = ask.get("/api/counts", params=asked | {"ranges": ranges}).json()["pairs"]
    assert same["counts"] == pair["counts"]
    answer = ask.get("/api/counts", params={"pairs": "subset:camera_yaw"})
    assert answer.status_code == 400 and "columns of numbers" in answer.json()["error"]


def test_a_wrong_name_is_answered_with_those_that_are_near(ask: TestClient):
    answer = ask.get("/api/shots", params={"where": "person_age_year > 3"})
    assert answer.status_code == 400
    assert "person_age_years" in answer.json()["error"] and "\n" not in answer.json()["error"]
