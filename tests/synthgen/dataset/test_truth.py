"""Reading tells what is damaged, and reads a dataset in the making once and whole."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_renderer
import numpy as np
import pytest

from synthgen.dataset import ledger, manifest, open_dataset
from synthgen.dataset.codecs import decode_npz, decode_png, encode_npz, encode_png
from synthgen.dataset.columns import misfits
from synthgen.dataset.folder import DatasetFolder, StorageError
from synthgen.farm import commit
from synthgen.farm.local import render_job
from synthgen.publish import publish

JOB = fake_renderer.small_job(shard_subjects=5)
SHARD = "multiview/train-000000.tar"


def render(out: Path, limit: int | None = None) -> None:
    render_job(JOB, out, workers=1, limit=limit, renderer=fake_renderer.RENDERER)


@pytest.fixture
def out(small_dataset: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(small_dataset, tmp_path / "out"))


def test_every_flipped_bit_of_a_png_is_found():
    data = encode_png(np.random.default_rng(0).integers(0, 255, (24, 24, 3), np.uint8))
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 1 << (position % 8)
        with pytest.raises(ValueError):
            decode_png(bytes(damaged))
    for damaged in (data[:-1], data + b"\0", b"", data[:20]):
        with pytest.raises(ValueError):
            decode_png(damaged)


def test_no_flipped_bit_of_an_npz_gives_other_numbers():
    arrays = {"a": np.arange(60.0), "b": np.ones((3, 4), np.float32)}
    data = encode_npz(arrays)
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 1 << (position % 8)
        try:
            found = decode_npz(bytes(damaged))
        except Exception:
            continue
        for name, array in found.items():
            np.testing.assert_array_equal(array, arrays.get(name, array))


def test_a_flipped_bit_among_the_pixels_is_not_read(out: Path):
    dataset = open_dataset(out, subset="multiview")
    row = manifest.query(out, "SELECT * FROM multiview LIMIT 1").to_pylist()[0]
    member = row["members"][0]
    path = out / row["shard"]
    data = bytearray(path.read_bytes())
    data[member["offset"] + member["size"] // 2] ^= 4
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"rgb_00\.png does not decode: changed since"):
        dataset[row["key"]]
    assert dataset.read(row["key"], ("alpha",))["alpha"].shape == (48, 48)


@pytest.mark.parametrize("ask", [lambda d: d[0], lambda d: d.read(0, ("alpha",))])
def test_a_sample_of_another_key_is_not_read(out: Path, ask: Callable):
    dataset = open_dataset(out, subset="multiview")
    keys = dataset.index.key
    keys[[0, 1]] = keys[[1, 0]]
    with pytest.raises(ValueError, match=r"holds 's00000._p0.' where s00000._p0. should be"):
        ask(dataset)


def test_metadata_of_another_sample_are_not_read(out: Path):
    path = out / "data" / SHARD
    data = path.read_bytes()
    assert data.count(b'"key":"s000000_p00"') == 1
    path.write_bytes(data.replace(b'"key":"s000000_p00"', b'"key":"s000000_p01"'))
    with pytest.raises(ValueError, match=r"meta\.json of multiview/s000000_p00 is that of"):
        open_dataset(out)["multiview/s000000_p00"]
    with pytest.raises(ValueError, match=r"meta\.json of"):
        open_dataset(out).read("multiview/s000000_p00", ("meta",))


def test_a_changed_panorama_is_not_read(out: Path):
    shutil.copy(out / "environments" / "city.exr", out / "environments" / "night.exr")
    with pytest.raises(ValueError, match=r"night\.exr: changed since it was written"):
        open_dataset(out).environment("night")


# ---------------------------------------------------------------- in the making


def test_subjects_that_a_record_lists_do_not_wait(out: Path, monkeypatch: pytest.MonkeyPatch):
    """The moment between a shard's record and the removal of its work files."""
    shard = next(s for s in publish.stored_plan(out).shards("multiview") if s.name == SHARD)
    record = ledger.shard_record(DatasetFolder(out), SHARD)
    assert record is not None
    rows = DatasetFolder(out).shard(SHARD).record.read_bytes()
    commit.unpack_shard(DatasetFolder(out), shard, record)
    publish.reopen(DatasetFolder(out))
    assert len(open_dataset(out, subset="multiview")) == 10
    DatasetFolder(out).shard(SHARD).record.write_bytes(rows)
    dataset = open_dataset(out, subset="multiview")
    assert len(dataset) == len(set(dataset.keys())) == 10
    assert ledger.status(out).subsets[0].done == 5
    assert manifest.query(out, "SELECT count(*) FROM manifest").rows == [(16,)]


def test_shots_are_found_again_in_the_shard_that_they_moved_to(tmp_path: Path):
    out = tmp_path / "out"
    render(out, limit=2)
    dataset = open_dataset(out)
    before = [shot.meta for shot in dataset]
    assert len(before) == 4
    render(out)
    assert [shot.meta for shot in dataset] == before
    assert dataset.keys() == [f"{m['subset']}/{m['key']}" for m in before]


def test_work_files_that_vanish_while_they_are_listed_are_looked_for_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "out"
    render(out, limit=2)
    real = manifest._waiting_rows

    def slow(*arguments: Any) -> list[dict[str, Any]]:
        monkeypatch.setattr(manifest, "_waiting_rows", real)
        render(out)
        return real(*arguments)

    monkeypatch.setattr(manifest, "_waiting_rows", slow)
    assert len(open_dataset(out)) == 16


def test_a_file_that_is_gone_for_good_is_an_error(out: Path):
    dataset = open_dataset(out, subset="multiview")
    (out / "data" / SHARD).unlink()
    with pytest.raises(StorageError, match=r"s000000_p00: .*No such file"):
        dataset["s000000_p00"]


# ---------------------------------------------------------------- rows


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("index", "one"),
        ("index", 1.5),
        ("index", True),
        ("index", 2**63),
        ("pose", 2**31),
        ("key", 7),
        ("key", "\ud800"),
        ("key", None),
        ("exposures", 1.0),
        ("exposures", [1.0, "x"]),
        ("environments", ["a", None]),
        ("head_yaw", "left"),
        ("members", [{"name": "a", "offset": 1}]),
        ("person_skin", {"a": 1}),
        ("unheard_of", 1),
    ],
)
def test_a_row_that_does_not_fit_the_manifest_is_told(
    small_dataset: Path, name: str, value: object
):
    row = json.loads(json.dumps(manifest.read_rows(small_dataset / "manifest/video.parquet")[0]))
    assert misfits(row) == []
    assert len(misfits(row | {name: value})) == 1
    assert misfits([row]) == ["is no row of the manifest"]
