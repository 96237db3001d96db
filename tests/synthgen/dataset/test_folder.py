"""Where files of a dataset lie, and what is written in its records."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from synthgen.dataset import ledger, manifest, open_dataset
from synthgen.dataset.folder import DatasetFolder, StorageError, subset_of
from synthgen.dataset.records import Description, Failure, RunNote, ShardRecord

HOSTILE = (
    *("", ".", "..", "../x", "/etc/passwd", "a/b", "a\\b", "x\0", "-rf", ".hidden", "é"),
    *("a\nb", "x" * 251),
)


@pytest.mark.parametrize(
    "ask",
    [
        lambda folder, name: folder.manifest(name),
        lambda folder, name: folder.environment(name),
        lambda folder, name: folder.shard(f"multiview/{name}.tar/"),
        lambda folder, name: folder.shard(f"{name}/train-000000.tar"),
        lambda folder, name: folder.subject("multiview", name),
        lambda folder, name: folder.subject(name, "s000000"),
        lambda folder, name: folder.records(name),
        lambda folder, name: folder.waiting(name),
        lambda folder, name: folder.failed(name),
        lambda folder, name: folder.folders(name),
        lambda folder, name: folder.log(name, 0),
        lambda folder, name: folder.run_note(name),
    ],
)
@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_leads_out_of_the_folder(ask: Callable[[DatasetFolder, str], object], name: str):
    with pytest.raises(StorageError) as error:
        ask(DatasetFolder("out"), name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "data/../../x", "data//x", "a\\b", "", "."]
)
def test_no_record_names_a_file_outside(name: str):
    with pytest.raises(StorageError, match="lies outside the dataset"):
        DatasetFolder("out").inside(name)


def test_a_dataset_lies_where_the_folder_says(small_dataset: Path):
    folder = DatasetFolder(small_dataset)
    dataset = open_dataset(folder)
    known = {folder.description, folder.card, folder.croissant, folder.description_copy}
    known |= {folder.environment(e["id"]) for e in dataset.description.environments}
    for subset in dataset.description.plan:
        known.add(folder.manifest(subset))
        for files, record in ledger.committed(folder, subset):
            known |= {files.record}
            known |= {files.tar, files.rows} if record.subjects else set()
            assert folder.inside(record.tar) == files.tar
            for key in record.subjects:
                subject = folder.subject(subset, key)
                known |= {subject.mesh, subject.parameters}
    assert known == set(folder.published())
    known.add(folder.checksums)
    assert known == {path for path in small_dataset.rglob("*") if path.is_file()}


def test_the_folder_stands_for_its_path(tmp_path: Path):
    folder = DatasetFolder(tmp_path)
    assert Path(folder) == tmp_path and str(folder) == str(tmp_path)
    assert DatasetFolder(folder).root == pickle.loads(pickle.dumps(folder)).root == tmp_path
    assert folder.relative(folder.environment("city")) == "environments/city.exr"
    assert subset_of("data/multiview/train-000000.tar") == "multiview"


def test_records_are_stored_as_they_were_read(small_dataset: Path):
    folder = DatasetFolder(small_dataset)
    content = folder.description.read_bytes()
    info = Description.parse(content, "")
    assert (json.dumps(info.to_json(), indent=1, ensure_ascii=False) + "\n").encode() == content
    for files in folder.committed("multiview"):
        content = files.record.read_bytes()
        assert ledger.encode_json(ShardRecord.parse(content, "").to_json()) == content


def test_no_words_keep_a_record_from_being_stored():
    entry = {"subset": "a", "key": "b", "attempts": 1, "reason": "\ud800é", "log": ""}
    failure = Failure.parse(json.dumps(entry).encode(), "")
    assert failure.reason.encode() == "?é".encode()


def test_records_pass_unknown_keys_through():
    entry = {"subset": "a", "key": "b", "attempts": 1, "reason": "é", "log": "", "more": [1]}
    assert Failure.parse(json.dumps(entry).encode(), "").to_json() == entry
    note = {"pid": 1, "started": 2, "workers": 1, "frames": 0, "running": [["a", "b", 1.5]]}
    assert RunNote.parse(json.dumps(note).encode(), "").running == [("a", "b", 1.5)]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"{", "not valid JSON"),
        (b"[]", "unusable: Input should be"),
        (b'{"plan": {"a": {"kind": "video"}}}', "unusable: plan.a.subjects: Field required"),
        (b'{"plan": {}, "complete": "yes"}', "unusable: complete: Input should be a valid boolean"),
    ],
)
def test_a_damaged_description_is_one_line(tmp_path: Path, content: bytes, reason: str):
    (tmp_path / "dataset.json").write_bytes(content)
    with pytest.raises(StorageError, match=f"dataset.json: {reason}") as error:
        open_dataset(tmp_path)
    assert "\n" not in str(error.value)


def test_a_hostile_subset_reaches_neither_files_nor_sql(tmp_path: Path):
    planned = {"kind": "video", "subjects": 1, "shots_per_subject": 1, "frames_per_subject": 1}
    for name in ("../x", 'x" AS SELECT 1; --'):
        (tmp_path / "dataset.json").write_text(json.dumps({"plan": {name: planned}}))
        for ask in (open_dataset, ledger.status, lambda out: manifest.query(out, "SELECT 1")):
            with pytest.raises(StorageError, match="use letters, digits") as error:
                ask(tmp_path)
            assert "\n" not in str(error.value)
