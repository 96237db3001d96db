"""`synthgen subset`: some shots of a dataset as a dataset that keeps every promise."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import fake_renderer
import numpy as np
import pytest
from answer import Answer

from synthgen import cli
from synthgen.dataset import open_dataset
from synthgen.dataset.folder import DamageError, StorageError
from synthgen.dataset.manifest import query
from synthgen.dataset.records import Selection
from synthgen.farm.local import render_job
from synthgen.farm.repair import repair
from synthgen.publish.subsetting import take
from synthgen.publish.verify import verify

SOME = "(subset = 'multiview' AND view = 1) OR subject = 's000001'"


def taken(source: Path, out: Path, where: str) -> Path:
    return take(open_dataset(source, where=where), out, Selection(source="", where=where)).folder


def test_a_selection_passes_every_check_and_has_the_same_shots(small_dataset: Path, tmp_path: Path):
    out = taken(small_dataset, tmp_path / "some", SOME)
    assert verify(out) == []
    here, there = open_dataset(out), open_dataset(small_dataset, where=SOME)
    assert sorted(here.keys()) == sorted(there.keys())
    for key in sorted(here.keys()):
        a, b = here[key], there[key]
        assert a.meta == b.meta
        assert np.array_equal(a.rgb, b.rgb)
        assert all(np.array_equal(a.passes[n], b.passes[n]) for n in a.passes)
    # Rows are those of the source but for the place of the bytes.
    sql = 'SELECT * EXCLUDE ("offset", members) FROM manifest ORDER BY subset, "key"'
    assert (
        query(out, sql).rows
        == query(small_dataset, sql.replace("ORDER", f"WHERE {SOME} ORDER")).rows
    )


def test_what_is_whole_is_linked_and_what_is_not_needed_is_left(
    small_dataset: Path, tmp_path: Path
):
    out = taken(small_dataset, tmp_path / "video", "subset = 'video' AND split = 'train'")
    assert verify(out) == []
    tars = list((out / "data").rglob("*.tar"))
    assert tars and all(path.stat().st_nlink > 1 for path in tars)
    assert not (out / "data/multiview").exists()
    lights = {use for s in open_dataset(out) for use in (e["id"] for e in s.meta["environments"])}
    assert {path.stem for path in (out / "environments").iterdir()} == lights


def test_a_selection_says_where_it_comes_from_and_can_be_selected_from(
    small_dataset: Path, tmp_path: Path
):
    out = taken(taken(small_dataset, tmp_path / "a", SOME), tmp_path / "b", "subset = 'multiview'")
    assert verify(out) == []
    described = json.loads((out / "dataset.json").read_text())
    assert [s["where"] for s in described["selections"]] == [SOME, "subset = 'multiview'"]
    assert all(len(s["source"]) == 64 for s in described["selections"])
    assert SOME in (out / "README.md").read_text()


def test_a_shard_that_is_gone_from_a_selection_is_missed(small_dataset: Path, tmp_path: Path):
    out = taken(small_dataset, tmp_path / "some", SOME)
    shard = next((out / "data/multiview").iterdir())
    shard.unlink()
    (out / "ledger/multiview" / f"{shard.stem}.json").unlink()
    assert any(shard.name in problem for problem in verify(out))


def test_damage_is_found_and_nothing_is_left(small_dataset: Path, tmp_path: Path):
    source = shutil.copytree(small_dataset, tmp_path / "source")
    dataset = open_dataset(source, where=SOME)
    path = source / dataset.index.shards[0]
    data = bytearray(path.read_bytes())
    data[int(dataset.index.offset[0]) + 600] ^= 1
    path.write_bytes(data)
    with pytest.raises(DamageError, match="changed since it was written"):
        taken(source, tmp_path / "some", SOME)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["source"]


def test_a_link_to_a_file_elsewhere_is_not_taken(small_dataset: Path, tmp_path: Path):
    source = shutil.copytree(small_dataset, tmp_path / "source")
    mesh = next((source / "subjects").rglob("*.glb"))
    (tmp_path / "secret").write_bytes(mesh.read_bytes())
    mesh.unlink()
    mesh.symlink_to(tmp_path / "secret")
    with pytest.raises(StorageError, match="leads out of the dataset"):
        taken(source, tmp_path / "all", "true")


def test_nothing_is_rendered_into_a_selection(small_dataset: Path, tmp_path: Path):
    out = taken(small_dataset, tmp_path / "some", SOME)
    with pytest.raises(StorageError, match="is a selection"):
        render_job(fake_renderer.small_job(), out, workers=1, renderer=fake_renderer.RENDERER)
    with pytest.raises(StorageError, match="is a selection"):
        repair(out, workers=1, renderer=fake_renderer.RENDERER)
    assert verify(out) == []


def test_the_command_refuses_what_exists_and_an_empty_choice(
    small_dataset: Path, tmp_path: Path, run_main: Callable[..., Answer]
):
    out = tmp_path / "some"
    arguments = ("subset", small_dataset, "--out", out, "--where")
    answer = run_main(cli.main, *arguments, "false")
    assert "no shot is chosen" in answer.error
    answer = run_main(cli.main, *arguments, SOME)
    assert "shots of" in answer.stdout
    answer = run_main(cli.main, *arguments, SOME)
    assert "exists; give a new folder" in answer.error
    assert os.listdir(tmp_path) == ["some"]
