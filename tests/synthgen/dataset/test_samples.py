"""Shots as arrays for training, through the libraries that training uses, with several workers."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import warnings
from pathlib import Path
from typing import Any

import datasets
import datasets.config
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, default_collate
from webdataset import WebDataset  # pyright: ignore[reportAttributeAccessIssue]

from synthgen.dataset import decoder, open_dataset
from synthgen.dataset.folder import DamageError, StorageError
from synthgen.dataset.samples import FIELDS

ARRAYS = ("rgb_00", "hdr_01", "rgb", "albedo", "normal", "depth", "parts", "landmarks", "joints")
WORKERS: dict[str, Any] = {"num_workers": 2, "multiprocessing_context": "spawn"}
"""Started afresh, as on other systems than Linux: all that a worker needs goes to it. Forked off a
process that ran other tests, whose libraries have threads, one now and then dies of its start."""
LABELS = ("camera", "expression", "head", "gaze", "landmarks_2d", "landmarks_visible", "exposures")


def members(tar: Path) -> dict[str, bytes]:
    """The members of the first sample of a shard."""
    with tarfile.open(tar) as archive:
        entries = archive.getmembers()
        key = entries[0].name.split(".")[0]
        return {
            e.name.partition(".")[2]: archive.extractfile(e).read()  # type: ignore[union-attr]
            for e in entries
            if e.name.startswith(key + ".")
        }


def shards(out: Path) -> list[str]:
    return sorted(str(path) for path in out.glob("data/multiview/*.tar"))


def test_samples_are_the_arrays_of_the_shots(small_dataset: Path):
    dataset = open_dataset(small_dataset, subset="multiview")
    samples = dataset.samples(("key", *ARRAYS, *LABELS))
    assert len(samples) == len(dataset) == 10
    sample, shot = samples[3], dataset[3]
    assert list(sample) == ["key", *ARRAYS, *LABELS]
    assert sample["key"] == dataset.keys()[3]
    np.testing.assert_array_equal(sample["rgb_00"], shot.rgb[0])
    np.testing.assert_array_equal(sample["rgb"], shot.rgb)
    assert shot.hdr is not None
    np.testing.assert_array_equal(sample["hdr_01"], shot.hdr[1])
    for name in ("albedo", "normal", "depth", "parts"):
        np.testing.assert_array_equal(sample[name], shot.passes[name])
        assert sample[name].dtype == shot.passes[name].dtype
    for name in ("landmarks", "joints"):
        np.testing.assert_array_equal(sample[name], shot.geometry[name])
    stored = shot.meta["camera"]
    for name in ("camera_to_world", "intrinsics"):
        np.testing.assert_allclose(sample["camera"][name], stored[name], rtol=1e-6)
    assert sample["expression"].shape == (52,)
    assert sample["landmarks_2d"].shape == (70, 2)
    assert sample["landmarks_visible"].dtype == bool


def test_torch_collates_every_field_in_several_workers(small_dataset: Path):
    fields = [f for f in FIELDS if f != "key"]
    samples = open_dataset(small_dataset, subset="video").samples(fields)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of memory that may not be written, say
        batches = list(DataLoader(samples, 2, **WORKERS))  # type: ignore[arg-type]
    assert len(batches) == 3
    for number, batch in enumerate(batches):
        assert batch["parts"].dtype == torch.uint8
        assert batch["depth"].shape == (2, 48, 48)
        assert batch["camera"]["intrinsics"].shape == (2, 3, 3)
        for name in ("rgb", "normal", "landmarks"):
            expected = np.stack([samples[2 * number + i][name] for i in (0, 1)])
            np.testing.assert_array_equal(batch[name].numpy(), expected)


def test_fields_that_there_are_not_are_refused_at_once(small_dataset: Path):
    dataset = open_dataset(small_dataset)
    for field, message in (
        ("rgb_02", "no rgb_02; these shots have 2 lights"),  # of multiview; video has three
        ("deph", "no deph; choose from rgb, hdr"),
        ("../x", "no ../x; choose from"),
    ):
        with pytest.raises(StorageError, match=message):
            dataset.samples((field,))
    with pytest.raises(StorageError, match="none is named"):
        dataset.samples(())
    assert open_dataset(small_dataset, subset="video").samples(["rgb_02"])[0]["rgb_02"].any()


def test_the_decoder_knows_every_member(small_dataset: Path):
    shot = open_dataset(small_dataset, subset="multiview")[0]
    stored = members(Path(shards(small_dataset)[0]))
    decoded = {name: decoder(f".{name}", data) for name, data in stored.items()}
    assert not [name for name, value in decoded.items() if value is None]
    assert set(np.unique(decoded["parts.png"])) <= {*range(19), 255}
    assert decoded["parts.png"].dtype == np.uint8
    assert decoded["aov.exr"].keys() == {"normal", "depth", "uv", "canonical"}
    assert decoded["geometry.npz"].keys() == shot.geometry.keys()
    assert isinstance(decoded["meta.json"]["person"], dict)
    assert decoder(".txt", b"another's") is None
    with pytest.raises(ValueError, match=r"parts.png does not decode"):
        decoder("parts.png", b"\x89PNG")


def test_webdataset_streams_whole_arrays_in_several_workers(small_dataset: Path):
    stream = (
        WebDataset(shards(small_dataset), shardshuffle=False, empty_check=False)
        .decode(decoder)
        .to_tuple("__key__", "parts.png", "aov.exr", "geometry.npz")
    )
    ours = open_dataset(small_dataset, subset="multiview")
    seen: list[str] = []
    for keys, parts, aov, geometry in DataLoader(stream, batch_size=2, **WORKERS):
        for i, key in enumerate(keys):
            shot = ours[key.split("/")[-1]]
            np.testing.assert_array_equal(parts[i], shot.parts)
            np.testing.assert_array_equal(aov["depth"][i], shot.depth)
            np.testing.assert_array_equal(geometry["joints"][i], shot.geometry["joints"])
        seen += keys
    assert sorted(key.split("/")[-1] for key in seen) == sorted(map(str, ours.index.key))


def row_of_arrays(row: dict[str, Any]) -> dict[str, Any]:
    landmarks = row["geometry.npz"]["landmarks"]
    assert isinstance(landmarks, np.ndarray)  # not a list of 70 lists
    depth, parts = decoder("aov.exr", row["aov.exr"])["depth"], np.array(row["parts.png"])
    return {"key": row["__key__"], "parts": parts, "depth": depth, "landmarks": landmarks}


def collated(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return default_collate([row_of_arrays(row) for row in rows])


def test_hugging_face_keeps_arrays_in_several_workers(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(datasets.config, "HF_DATASETS_OFFLINE", True)
    rows = datasets.load_dataset(
        "webdataset", data_files={"train": shards(small_dataset)}, split="train", streaming=True
    ).with_format("numpy")
    ours = open_dataset(small_dataset, subset="multiview")
    seen = []
    for batch in DataLoader(rows, batch_size=2, collate_fn=collated, **WORKERS):  # type: ignore[arg-type]
        for i, key in enumerate(batch["key"]):
            shot = ours[key]
            np.testing.assert_array_equal(batch["parts"][i], shot.parts)
            np.testing.assert_array_equal(batch["depth"][i], shot.depth)
            np.testing.assert_array_equal(batch["landmarks"][i], shot.geometry["landmarks"])
        seen += batch["key"]
    assert sorted(seen) == sorted(map(str, ours.index.key))


def test_a_damaged_shard_says_which_shot_and_what_to_do(small_dataset: Path, tmp_path: Path):
    copy = tmp_path / "copy"
    shutil.copytree(small_dataset, copy)
    dataset = open_dataset(copy, subset="multiview")
    shard = copy / dataset.index.shards[0]
    shard.write_bytes(shard.read_bytes()[:1000])
    last = f"`synthgen verify {copy}` lists what is damaged"
    for reading in (lambda: dataset[0], lambda: dataset.samples(("depth",))[0]):
        with pytest.raises(DamageError, match=r"multiview/s00000._p00: ") as raised:
            reading()
        assert isinstance(raised.value, ValueError)
        assert str(raised.value).endswith(last)
    shard.unlink()
    with pytest.raises(DamageError, match="No such file"):
        dataset.read(0, ("depth",))


def test_the_reader_imports_no_torch():
    code = "import sys, synthgen.dataset.samples; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
