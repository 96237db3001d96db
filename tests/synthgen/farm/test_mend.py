"""Nothing stored is trusted for being there: what is damaged is rendered again, and no more."""

from __future__ import annotations

import json
import os
import shutil
import signal
import tarfile
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_renderer
import pytest

from assets_procedural.conventions.files import sha256
from synthgen.dataset import ledger, manifest, open_dataset
from synthgen.dataset.folder import DatasetFolder, StorageError
from synthgen.dataset.records import read_description
from synthgen.farm import commit, run, temporary
from synthgen.farm.isolated import isolated
from synthgen.farm.local import render_job
from synthgen.farm.repair import repair
from synthgen.publish import publish
from synthgen.publish.verify import verify

JOB = fake_renderer.small_job(
    subsets={"multiview": fake_renderer.small_job().subsets["multiview"].model_dump()},
    shard_subjects=5,
)
SHARD = "multiview/train-000000.tar"


def render(out: Path, **options: Any) -> run.Summary:
    options = {"workers": 1, "renderer": fake_renderer.RENDERER} | options
    return render_job(options.pop("job", JOB), out, **options)


def mend(out: Path) -> run.Summary:
    return repair(out, workers=1, renderer=fake_renderer.RENDERER)


def tree(out: Path) -> dict[str, str]:
    return {p.relative_to(out).as_posix(): sha256(p) for p in out.rglob("*") if p.is_file()}


def stored(out: Path) -> dict[str, str]:
    """What is the same in all runs of a job."""
    kept = ("data/", "subjects/", "environments/")
    return {name: each for name, each in tree(out).items() if name.startswith(kept)}


def flip(path: Path, position: int) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 1
    path.write_bytes(data)


def flip_a_member(path: Path) -> None:
    """One bit amid the largest file of a tar: some bytes between files mean nothing."""
    with tarfile.open(path) as tar:
        largest = max(tar.getmembers(), key=lambda member: member.size)
    flip(path, largest.offset_data + largest.size // 2)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def exchange(a: Path, b: Path) -> None:
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "out"
    assert render(out).complete
    return out


@pytest.fixture(scope="module")
def half(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two subjects of a shard of several are finished, and wait."""
    out = tmp_path_factory.mktemp("half") / "out"
    assert render(out, limit=2).rendered == 2
    assert len(list(out.glob("work/multiview/*.json"))) == 2
    return out


@pytest.fixture
def copy(tmp_path: Path) -> Callable[[Path], Path]:
    def copied(source: Path) -> Path:
        return Path(shutil.copytree(source, tmp_path / "out"))

    return copied


def waiting(out: Path) -> list[Any]:
    folder = DatasetFolder(out)
    keys = sorted(p.stem for p in out.glob("work/multiview/*.json"))
    return [folder.subject("multiview", key) for key in keys]


def digit(path: Path) -> None:
    """Another number, in a file that stays valid JSON."""
    text = path.read_text()
    at = text.index('"pose":0')
    path.write_text(text[:at] + '"pose":1' + text[at + 8 :])


WAITING: dict[str, Callable[[Any, Any], object]] = {
    "tar cut": lambda a, b: cut(a.waiting_tar),
    "tar emptied": lambda a, b: a.waiting_tar.write_bytes(b""),
    "tar removed": lambda a, b: a.waiting_tar.unlink(),
    "tar flipped": lambda a, b: flip(a.waiting_tar, 20_000),
    "tars exchanged": lambda a, b: exchange(a.waiting_tar, b.waiting_tar),
    "rows cut": lambda a, b: cut(a.waiting_rows),
    "rows emptied": lambda a, b: a.waiting_rows.write_bytes(b""),
    "rows lost their last lines": lambda a, b: a.waiting_rows.write_bytes(
        a.waiting_rows.read_bytes().splitlines(keepends=True)[0]
    ),
    "rows changed": lambda a, b: digit(a.waiting_rows),
    "rows no JSON": lambda a, b: a.waiting_rows.write_bytes(b"\xff\x00"),
    "all exchanged": lambda a, b: (
        exchange(a.waiting_rows, b.waiting_rows),
        exchange(a.waiting_tar, b.waiting_tar),
    ),
    "mesh cut": lambda a, b: cut(a.mesh),
    "parameters emptied": lambda a, b: a.parameters.write_bytes(b""),
    "parameters removed": lambda a, b: a.parameters.unlink(),
}


@pytest.mark.parametrize("name", WAITING)
def test_damaged_work_files_are_rendered_again(
    half: Path, whole: Path, copy: Callable[[Path], Path], name: str
):
    out = copy(half)
    WAITING[name](*waiting(out))
    ledger.status(out)
    summary = render(out)
    assert summary.complete
    assert summary.rendered in (4, 5)
    assert len(summary.mended) == summary.rendered - 3
    assert stored(out) == stored(whole)
    assert verify(out) == []


def as_before(out: Path) -> None:
    """As the version before wrote it: work files without seals, panoramas without hashes."""
    for files in waiting(out):
        lines = files.waiting_rows.read_bytes().splitlines(keepends=True)
        files.waiting_rows.write_bytes(b"".join(lines[:-1]))
    path = out / "dataset.json"
    info = json.loads(path.read_bytes())
    del info["files"]
    path.write_text(json.dumps(info))


def test_a_folder_of_the_version_before_is_continued(
    half: Path, whole: Path, copy: Callable[[Path], Path]
):
    out = copy(half)
    as_before(out)
    assert len(open_dataset(out)) == 4
    summary = render(out)
    assert (summary.complete, summary.rendered, summary.mended) == (True, 3, [])
    assert stored(out) == stored(whole)


@pytest.mark.parametrize("damage", [cut, flip_a_member])
def test_damage_in_a_folder_of_the_version_before_is_found(
    half: Path, whole: Path, copy: Callable[[Path], Path], damage: Callable[[Path], None]
):
    out = copy(half)
    as_before(out)
    damage(waiting(out)[0].waiting_tar)
    assert render(out).rendered == 4
    assert stored(out) == stored(whole)


def test_a_bad_row_of_the_version_before_blocks_nothing(half: Path, copy: Callable[[Path], Path]):
    out = copy(half)
    as_before(out)
    bad = waiting(out)[0].waiting_rows
    bad.write_text(bad.read_text().replace('"index":', '"index":"one","was":'))
    assert len(open_dataset(out)) == 2
    assert render(out).complete


def test_work_files_that_change_at_the_last_moment_do_not_get_into_a_shard(
    half: Path, copy: Callable[[Path], Path]
):
    out = copy(half)
    folder = DatasetFolder(out)
    shard = next(s for s in publish.stored_plan(out).shards("multiview") if s.name == SHARD)
    damaged = waiting(out)[0]
    flip(damaged.waiting_tar, 5000)
    assert commit.commit_shard(folder, shard) == [damaged.waiting_tar.stem]
    assert not folder.shard(SHARD).tar.exists()
    assert ledger.record_of(folder, SHARD) is None
    assert len(waiting(out)) == 1


def test_a_run_renders_again_what_changes_at_the_last_moment(
    tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
):
    real, spoilt = run.commit_shard, []

    def spoil(folder: DatasetFolder, shard: Any) -> list[str]:
        if not spoilt:
            spoilt.append(next(folder.waiting(shard.subset).glob("*.tar")))
            cut(spoilt[0])
        return real(folder, shard)

    monkeypatch.setattr(run, "commit_shard", spoil)
    summary = render(tmp_path / "out")
    assert (summary.complete, summary.rendered, summary.failed) == (True, 6, [])
    assert stored(tmp_path / "out") == stored(whole)


def test_a_damaged_panorama_is_made_again(half: Path, whole: Path, copy: Callable[[Path], Path]):
    out = copy(half)
    city, night = (out / "environments" / f"{name}.exr" for name in ("city", "night"))
    cut(city)
    flip(night, night.stat().st_size - 1000)
    summary = render(out)
    assert summary.mended[:2] == [
        "environments/city.exr: was damaged; made again",
        "environments/night.exr: was damaged; made again",
    ]
    assert stored(out) == stored(whole)


def test_a_panorama_that_is_made_otherwise_now_is_refused(
    half: Path, copy: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch
):
    out = copy(half)
    (out / "environments" / "city.exr").unlink()
    monkeypatch.setattr(
        "synthgen.farm.local.write_pool",
        lambda specs, folder: [(folder / f"{s.id}.exr").write_bytes(b"other") for s in specs],
    )
    with pytest.raises(StorageError, match=r"city\.exr: cannot be made again") as error:
        render(out)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("member", [0, -1])
def test_one_damaged_subject_of_a_shard_is_rendered_again(
    whole: Path, copy: Callable[[Path], Path], member: int
):
    out = copy(whole)
    tar = out / "data" / SHARD
    with tarfile.open(tar) as archive:
        inside = archive.getmembers()[member].offset_data
    flip(tar, inside + 10)
    assert len(verify(out)) > 0
    summary = render(out)
    assert (summary.complete, summary.rendered, len(summary.mended)) == (True, 1, 1)
    assert tree(out) == tree(whole)


# ---------------------------------------------------------------- repair


def test_repair_of_a_sound_dataset_changes_nothing(whole: Path, copy: Callable[[Path], Path]):
    out = copy(whole)
    summary = mend(out)
    assert (summary.rendered, summary.mended) == (0, [])
    assert tree(out) == tree(whole)


REPAIRS: dict[str, tuple[Callable[[Path], object], int]] = {
    "shard cut": (lambda out: cut(out / "data" / SHARD), 2),
    "record lost": (lambda out: DatasetFolder(out).shard(SHARD).record.unlink(), 0),
    "record changed": (
        lambda out: (path := DatasetFolder(out).shard(SHARD).record).write_text(
            path.read_text().replace('"shots":', '"shots":1')
        ),
        0,
    ),
    "rows lost": (lambda out: DatasetFolder(out).shard(SHARD).rows.unlink(), 0),
    "mesh changed": (lambda out: flip(out / "subjects/multiview/s000000.glb", 2), 1),
    "parameters lost": (lambda out: (out / "subjects/multiview/s000000.json").unlink(), 1),
    "panorama lost": (lambda out: (out / "environments/city.exr").unlink(), 0),
    "panoramas exchanged": (
        lambda out: exchange(out / "environments/city.exr", out / "environments/night.exr"),
        0,
    ),
    "stale manifest": (lambda out: cut(out / "manifest/multiview.parquet"), 0),
    "card changed": (lambda out: flip(out / "README.md", 100), 0),
    "dataset.json lost": (lambda out: (out / "dataset.json").unlink(), 0),
    "dataset.json changed": (lambda out: flip(out / "dataset.json", 400), 0),
    "list lost": (lambda out: (out / "SHA256SUMS").unlink(), 0),
    "rows and manifest lost": (
        lambda out: (
            DatasetFolder(out).shard(SHARD).rows.unlink(),
            (out / "manifest/multiview.parquet").unlink(),
        ),
        0,
    ),
}


@pytest.mark.parametrize("name", REPAIRS)
def test_repair_makes_again_what_is_damaged_and_no_more(
    whole: Path, copy: Callable[[Path], Path], name: str
):
    damage, rendered = REPAIRS[name]
    out = copy(whole)
    damage(out)
    summary = mend(out)
    assert summary.mended
    assert summary.rendered in range(min(rendered, 1), rendered + 1)
    assert verify(out) == []
    if name != "rows and manifest lost":  # what rendering cost is in neither tar nor record
        assert tree(out) == tree(whole)
    assert stored(out) == stored(whole)


def test_a_note_of_a_failure_is_restored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "out"
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": "raise"}))
    assert render(out).complete
    note = out / "ledger/failed/multiview/s000001.json"
    note.write_bytes(b"{")
    assert any("s000001.json: changed" in problem for problem in verify(out))
    assert mend(out).rendered == 0
    assert verify(out) == []
    assert ledger.status(out).failures[0].reason == "RuntimeError: no hair left"


def test_repair_runs_no_renderer_that_a_dataset_names(whole: Path, copy: Callable[[Path], Path]):
    out = copy(whole)
    with pytest.raises(StorageError, match="was rendered by 'fake_renderer:render_subject', not"):
        repair(out)


def test_repair_by_another_version_is_refused(whole: Path, copy: Callable[[Path], Path]):
    out = copy(whole)
    for path in (out / "dataset.json", out / "ledger/dataset.json"):
        info = json.loads(path.read_bytes())
        info["code"]["version"] = "0.0.1"
        path.write_text(json.dumps(info))
    with pytest.raises(StorageError, match=r"begun by synthgen 0\.0\.1"):
        mend(out)


# ---------------------------------------------------------------- one bad subject


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("index", "gate: s000001_p01: index in its metadata is 'one', not 1"),
        ("pose", "gate: s000001_p01: the manifest's pose must be INTEGER, not '1099511627776'"),
        ("surrogate", "RuntimeError: no ? left"),
    ],
)
def test_one_bad_subject_blocks_no_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, reason: str
):
    out = tmp_path / "out"
    monkeypatch.setenv("TROUBLE", json.dumps({"s000001": kind}))
    summary = render(out)
    assert summary.complete
    assert [(f.key, f.reason) for f in summary.failed] == [("s000001", reason)]
    assert len(open_dataset(out)) == 8
    assert verify(out) == []


def test_words_that_no_file_can_hold_are_read_from_older_notes(tmp_path: Path):
    out = tmp_path / "out"
    render(out, limit=1)
    note = out / "ledger/failed/multiview/s000001.json"
    note.parent.mkdir(parents=True)
    entry = {"subset": "multiview", "key": "s000001", "attempts": 3, "reason": "\ud800", "log": ""}
    note.write_text(json.dumps(entry))
    assert render(out).complete
    assert read_description(out).quarantined[0].reason == "?"


# ---------------------------------------------------------------- folders called so


@pytest.mark.parametrize("name", ["a[1]", "a*", "a?b", "seed=3", "[ab]*{c}", "it's"])
def test_a_folder_may_have_any_name(tmp_path: Path, whole: Path, name: str):
    shutil.copytree(whole, tmp_path / "ab")
    for other in ("a1", "aab", "ac"):
        shutil.copytree(whole, tmp_path / other)
    out = tmp_path / name
    assert not render(out, limit=2).complete
    assert len(open_dataset(out)) == 4
    assert render(out).complete
    assert [r["key"] for r in manifest.query(out, "SELECT key FROM manifest").to_pylist()] == [
        r["key"] for r in manifest.query(whole, "SELECT key FROM manifest").to_pylist()
    ]
    assert [len(s.meta) for s in open_dataset(out)] == [len(s.meta) for s in open_dataset(whole)]
    assert verify(out) == []
    assert stored(out) == stored(whole)


# ---------------------------------------------------------------- litter


def test_a_worker_leaves_nothing_in_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    system, out = tmp_path / "system", tmp_path / "out"
    system.mkdir()
    monkeypatch.setenv("TMPDIR", str(system))
    monkeypatch.setenv("TROUBLE", json.dumps(dict.fromkeys(["s000000", "s000001"], "litter")))
    render(out, limit=3)
    assert list(system.iterdir()) == []
    assert not DatasetFolder(out).temporary.exists()


def test_what_killed_workers_left_is_removed_by_the_next_run(tmp_path: Path):
    out = tmp_path / "out"
    render(out, limit=1)
    folder = DatasetFolder(out)
    for name in ("1-of-1_worker_x", "2-of-3_worker_y"):
        (folder.temporary / name / "blender_x").mkdir(parents=True)
    with ledger.slice_lock(folder, (2, 3)):
        render(out, limit=1, shard=(1, 3))
        assert [p.name for p in folder.temporary.iterdir()] == ["2-of-3_worker_y"]
    render(out, limit=1)
    assert not folder.temporary.exists()


def leave_one() -> str:
    return tempfile.mkdtemp(prefix="blender_")


def test_an_isolated_process_leaves_nothing_in_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert not Path(isolated(leave_one, time_limit=60)).exists()
    assert list(tmp_path.iterdir()) == []


def test_temporary_folders_of_killed_processes_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    child = os.fork()
    if not child:
        with temporary.temporary_folder():
            (tmp_path / "ready").touch()
            time.sleep(60)
        os._exit(1)
    while not (tmp_path / "ready").exists():
        time.sleep(0.01)
    with temporary.temporary_folder() as own:
        assert len(list(tmp_path.glob("synthgen-*"))) == 2, "one in use is left alone"
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        with temporary.temporary_folder() as another:
            assert set(tmp_path.glob("synthgen-*")) == {own, another}
    assert not list(tmp_path.glob("synthgen-*"))
