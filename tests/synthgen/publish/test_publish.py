"""dataset.json, the card and Croissant."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import fake_renderer
import mlcroissant
import pytest
import yaml

from assets_procedural.conventions.files import sha256
from synthgen.dataset import open_dataset
from synthgen.dataset.folder import StorageError
from synthgen.dataset.records import Counts, PlannedSubset, read_description
from synthgen.dataset.shards import read_sample
from synthgen.farm.local import render_job
from synthgen.pictures import sheet
from synthgen.publish import card, publish

JOB = fake_renderer.small_job()


@pytest.fixture
def out(small_dataset: Path) -> Path:
    return small_dataset


def test_dataset_json_tells_everything(out: Path):
    info = read_description(out)
    assert info.format == 2
    assert info.job["seed"] == JOB.seed
    assert info.code["version"]
    assert info.renderer == fake_renderer.RENDERER
    assert [e["id"] for e in info.environments] == ["city", "night", "studio"]
    assert all(e["licence"] for e in info.environments + info.licences)
    assert card.totals(info) == Counts(subjects=8, shots=16, frames=38)
    for shard in info.shards:
        assert sha256(out / shard.tar) == shard.sha256
    for name, digest in info.files.items():
        assert sha256(out / name) == digest


def test_completing_again_changes_nothing(out: Path):
    names = ("dataset.json", "README.md", "croissant.json")
    before = [(out / name).read_bytes() for name in names]
    assert publish.complete(out)
    assert [(out / name).read_bytes() for name in names] == before


def test_card_has_configs_with_files(out: Path):
    _, header, text = (out / "README.md").read_text().split("---\n", 2)
    configs = yaml.safe_load(header)["configs"]
    assert [c["config_name"] for c in configs] == ["multiview", "video"]
    for config in configs:
        assert config["data_files"]
        for entry in config["data_files"]:
            assert entry["split"] in ("train", "validation", "test")
            assert list(out.glob(entry["path"])), entry
    assert "38 synthetic portraits of 8 people" in text
    assert "Apache-2.0" in text


def test_people_that_subsets_share_are_counted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    subsets = JOB.model_dump()["subsets"]
    subsets["video"]["people_of"] = "multiview"
    job = fake_renderer.small_job(subsets=subsets)
    out = tmp_path / "out"
    assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
    said = "38 synthetic portraits of 5 people"
    assert said in (out / "README.md").read_text()
    assert json.loads((out / "croissant.json").read_text())["description"].startswith(said)
    # s000001 fails in both subsets, s000004 is in one of them alone.
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "gate", "s000004": "gate"}))
    out = tmp_path / "failed"
    assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
    assert " of 3 people at " in (out / "README.md").read_text()


def test_one_of_a_kind_is_no_plural():
    assert card.contents(frames=1, people=1) == "1 synthetic portrait of 1 person"
    plan = PlannedSubset(kind="video", subjects=1, shots_per_subject=1, frames_per_subject=1)
    assert sheet.title("video", plan) == "video: 1 frame of a track under 1 environment"
    views = PlannedSubset(kind="multiview", subjects=1, shots_per_subject=2, frames_per_subject=2)
    assert sheet.title("few", views) == "few: 2 views under 1 environment"


def test_croissant_names_what_exists(out: Path):
    croissant = json.loads((out / "croissant.json").read_text())
    assert croissant["conformsTo"] == "http://mlcommons.org/croissant/1.1"
    # What the specification requires of every dataset.
    required = {"name", "description", "license", "url", "creator", "datePublished"}
    assert required <= croissant.keys()
    objects = {d["@id"]: d for d in croissant["distribution"]}
    for entry in objects.values():
        if entry["@type"] == "cr:FileObject":
            assert sha256(out / entry["contentUrl"]) == entry["sha256"]
        else:
            assert list(out.glob(entry["includes"]))
    for records in croissant["recordSet"]:
        for field in records["field"]:
            assert field["source"]["fileObject"]["@id"] in objects


def test_croissant_is_valid_for_mlcroissant(out: Path, caplog: pytest.LogCaptureFixture):
    dataset = mlcroissant.Dataset(out / "croissant.json")
    assert not dataset.metadata.ctx.issues.errors
    assert not [r for r in caplog.records if r.levelname != "INFO"], caplog.text
    for subset in JOB.subsets:
        rows = list(dataset.records(subset))
        keys = [row[f"{subset}/key"].decode() for row in rows]
        assert keys == [str(key) for key in open_dataset(out, subset=subset).index.key]
        shard = out / rows[0][f"{subset}/shard"].decode()
        place = rows[0][f"{subset}/offset"], rows[0][f"{subset}/size"]
        members = read_sample(shard, *place, keys[0])
        assert members["albedo.png"].startswith(b"\x89PNG")


def test_an_unfinished_dataset_has_no_card(tmp_path: Path):
    summary = render_job(JOB, tmp_path / "out", workers=1, renderer=fake_renderer.RENDERER, limit=1)
    assert not summary.complete
    assert not (tmp_path / "out" / "README.md").exists()
    assert not publish.complete(tmp_path / "out")


def test_another_version_may_not_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "out"
    code = {"package": "synthgen", "version": "1.0", "commit": "abc-dirty"}
    monkeypatch.setattr(publish, "code_version", lambda: code)
    assert not render_job(JOB, out, workers=1, renderer=fake_renderer.RENDERER, limit=1).complete
    assert render_job(JOB, out, workers=1, renderer=fake_renderer.RENDERER, limit=1).rendered == 1
    monkeypatch.setattr(publish, "code_version", lambda: code | {"commit": "def"})
    with pytest.raises(StorageError) as error:
        render_job(JOB, out, workers=1, renderer=fake_renderer.RENDERER)
    assert "begun by synthgen 1.0 (abc-dirty), this is 1.0 (def)" in str(error.value)
    assert "\n" not in str(error.value)


def test_another_version_may_open_but_not_add_to_what_is_complete(out: Path, tmp_path: Path):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    info = json.loads((copy / "dataset.json").read_text())
    info["code"] = {"package": "synthgen", "version": "0.0"}
    (copy / "dataset.json").write_text(json.dumps(info))
    assert render_job(JOB, copy, renderer=fake_renderer.RENDERER).rendered == 0
    next((copy / "data").rglob("*.tar")).unlink()
    with pytest.raises(StorageError, match=r"begun by synthgen 0.0, this is "):
        render_job(JOB, copy, renderer=fake_renderer.RENDERER)


def test_a_checkout_knows_its_commit():
    commit = publish.code_version().get("commit")
    here = Path(__file__)
    is_checkout = any((folder / ".git").exists() for folder in here.parents)
    assert (commit is not None) == is_checkout
