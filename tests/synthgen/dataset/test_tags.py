"""Tags: kept outside of the dataset, undone, merged, and read by `open_dataset`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from answer import Answer

from synthgen import cli
from synthgen.dataset import open_dataset, tags
from synthgen.dataset.folder import StorageError
from synthgen.dataset.records import Selection, read_description
from synthgen.publish.subsetting import take
from synthgen.publish.verify import verify

A, B, C = "multiview/s000000_p00", "multiview/s000000_p01", "video/s000001_p00"


def book(out: Path, place: Path, person: str = "ann") -> tags.Book:
    return tags.Book(place, read_description(out), person)


def test_open_dataset_reads_what_several_people_say(small_dataset: Path, tmp_path: Path):
    ann, bob = (book(small_dataset, tmp_path, person) for person in ("ann", "bob"))
    assert ann.change(True, "star", [A, B]) == 2
    assert bob.change(True, "star", [B, C]) == 2
    assert bob.change(True, "reject", [A]) == 1

    def keys(*wanted: str) -> set[str]:
        return set(open_dataset(small_dataset, tags=wanted, tags_in=tmp_path).keys())

    assert keys("star") == {A, B, C}
    assert keys("star", "-reject") == {B, C}
    assert keys("-star") == {*open_dataset(small_dataset).keys()} - {A, B, C}
    chosen = open_dataset(small_dataset, subset="video", tags=["star"], tags_in=tmp_path)
    assert chosen.keys() == [C] and chosen[0].key == C.split("/")[1] and chosen.lights() == 3
    with pytest.raises(StorageError, match=r'no shot of .* is tagged "sta"; tags: star, reject'):
        keys("sta")
    # What anybody may be asked for, before anybody has.
    assert len(open_dataset(small_dataset, tags=["-reject"], tags_in=tmp_path / "none")) == 16


def test_a_change_is_only_of_what_changes_and_can_be_undone(small_dataset: Path, tmp_path: Path):
    ann = book(small_dataset, tmp_path)
    assert ann.undo() is None
    ann.change(True, "star", [A])
    assert ann.change(True, "star", [A, B]) == 1
    assert ann.change(True, "star", [A, B]) == 0
    assert ann.change(False, "star", [A]) == 1
    undone = [ann.undo() for _ in range(2)]
    assert [(u.added, u.shots) for u in undone if u] == [(False, (A,)), (True, (B,))]
    assert tags.state(tags.changes(ann.path)) == {"star": {A}}
    ann.undo()
    assert tags.read(tmp_path, read_description(small_dataset)).names() == []


def test_a_selection_has_the_tags_of_its_source(small_dataset: Path, tmp_path: Path):
    book(small_dataset, tmp_path / "tags").change(True, "star", [A, C])
    chosen = open_dataset(small_dataset, tags=["star"], tags_in=tmp_path / "tags")
    out = take(chosen, tmp_path / "starred", Selection(source="", tags=["star"])).folder
    assert verify(out) == []
    assert sorted(open_dataset(out, tags=["star"], tags_in=tmp_path / "tags").keys()) == [A, C]
    assert json.loads((out / "dataset.json").read_text())["selections"][0]["tags"] == ["star"]


@pytest.mark.parametrize(
    "line",
    [
        "no json",
        "[]",
        '{"add": "star"}',
        '{"add": "../star", "shots": []}',
        '{"add": "star", "shots": ["../../etc/passwd"]}',
        '{"undo": true}',
    ],
)
def test_a_file_that_is_none_is_named_with_its_line(small_dataset: Path, tmp_path: Path, line: str):
    ann = book(small_dataset, tmp_path)
    ann.change(True, "star", [A])
    ann.undo()
    with ann.path.open("a") as file:
        file.write(f"{line}\n")
    with pytest.raises(StorageError, match=r"ann\.jsonl: line 3: is no change of tags"):
        open_dataset(small_dataset, tags=["star"], tags_in=tmp_path)


@pytest.mark.parametrize("name", ["", "..", "a/b", "-", "x" * 41])
def test_names_that_are_none_are_refused(small_dataset: Path, tmp_path: Path, name: str):
    with pytest.raises(StorageError):
        book(small_dataset, tmp_path, name)
    with pytest.raises(StorageError):
        book(small_dataset, tmp_path).change(True, name, [A])


def test_the_commands_list_merge_and_select(
    small_dataset: Path, tmp_path: Path, run_main: Callable[..., Answer]
):
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    book(small_dataset, mine).change(True, "star", [A])
    other = book(small_dataset, theirs, "bob")
    other.change(True, "star", [C])
    place = ("--tags-in", mine)
    answer = run_main(cli.main, "tags", small_dataset, *place, "--take", other.path)
    assert "star: 2 shots (ann 1, bob 1)" in answer.stdout
    # Taken in again after more was said, it grows; what differs is not overwritten.
    other.change(True, "reject", [B])
    answer = run_main(cli.main, "tags", small_dataset, *place, "--take", other.path)
    assert "reject: 1 shot (bob 1)" in answer.stdout
    other.path.write_text('{"add":"odd","shots":[]}\n')
    answer = run_main(cli.main, "tags", small_dataset, *place, "--take", other.path)
    assert "has other changes by bob" in answer.error
    out = tmp_path / "out"
    run_main(cli.main, "subset", small_dataset, *place, "--tags", "star,-reject", "--out", out)
    assert sorted(open_dataset(out).keys()) == [A, C]
