"""What a stranger wrote into a dataset: nothing gets out, in, or stuck, and one line says so."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import fake_renderer
import numpy as np
import pytest
from answer import Answer

from synthgen.cli import main
from synthgen.dataset import manifest, metadata, open_dataset
from synthgen.dataset.codecs import encode_json, encode_png
from synthgen.dataset.folder import StorageError
from synthgen.dataset.shards import read_members, read_sample, tar_entry
from synthgen.farm.rerender import rerender
from synthgen.pictures.sheet import sheet
from synthgen.publish.export import nerfstudio
from synthgen.publish.verify import verify

SHOT = "multiview/s000002_p01"


@pytest.fixture
def copy(small_dataset: Path, tmp_path: Path) -> Path:
    (tmp_path / "secret.txt").write_text("secret")
    return shutil.copytree(small_dataset, tmp_path / "copy")


@pytest.fixture
def run(run_main: Callable[..., Answer]) -> Callable[..., Answer]:
    return lambda *arguments: run_main(main, *arguments)


def describe(out: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    path = out / "dataset.json"
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))


def rewrite(out: Path, columns: str) -> None:
    path = out / "manifest" / "multiview.parquet"
    with duckdb.connect() as connection:
        connection.execute(
            f"COPY (SELECT {columns} FROM '{path}') TO '{path}.new' (FORMAT parquet)"
        )
    Path(f"{path}.new").rename(path)


def replace(out: Path, **changes: bytes) -> None:
    """Members of `SHOT`."""
    dataset = open_dataset(out)
    index, position = dataset.index, dataset.position(SHOT)
    place = int(index.offset[position]), int(index.size[position])
    members = read_sample(out / index.shards[index.shard[position]], *place, "s000002_p01") | {
        name.replace("__", "."): content for name, content in changes.items()
    }
    content = b"".join(tar_entry(f"s000002_p01.{n}", c) for n, c in members.items())
    (out / "data" / "multiview" / "hostile.tar").write_bytes(content)
    values = {"shard": "'data/multiview/hostile.tar'", '"offset"': "0", "size": str(len(content))}
    changes_ = (
        f"CASE WHEN key = 's000002_p01' THEN {value} ELSE {name} END AS {name}"
        for name, value in values.items()
    )
    rewrite(out, f"* REPLACE ({', '.join(changes_)})")


def meta_of(out: Path) -> dict[str, Any]:
    return open_dataset(out)[SHOT].meta


# ---------------------------------------------------------------- names


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", "\x1b[2J", 'x" AS SELECT 1; --', 3])
def test_names_of_the_description_are_looked_at_once(copy: Path, name: Any):
    describe(copy, lambda info: info["environments"][0].update(id=name))
    with pytest.raises(StorageError, match="use letters, digits") as error:
        open_dataset(copy)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "column",
    [
        *("'../secret.txt' AS shard", "'/etc/passwd' AS shard", "'data/../../x' AS shard"),
        *("NULL AS shard", "3 AS shard", "'data/audio/x.tar' AS shard", "NULL AS key"),
        *("'../../x' AS key", "chr(27) || 'x' AS key", "repeat('x', 1000000) AS key"),
        *("NULL AS size", "'x' AS \"offset\""),
    ],
)
def test_a_manifest_names_shots_of_its_dataset_alone(copy: Path, column: str):
    rewrite(copy, f"* REPLACE ({column})")
    with pytest.raises(StorageError, match=r"names no shot of it|cannot be read") as error:
        open_dataset(copy)
    assert "\n" not in str(error.value) and "\x1b" not in str(error.value)


@pytest.mark.parametrize("name", ["../../../secret", "/tmp/x", "..", "a/b", ""])
def test_an_export_stays_in_its_folder(copy: Path, tmp_path: Path, name: str):
    meta = json.loads(encode_json(meta_of(copy)))
    meta["person"] = json.dumps(meta["person"])
    meta["environments"][0]["id"] = name
    replace(copy, meta__json=json.dumps(meta).encode())
    before = sorted(tmp_path.iterdir())
    with pytest.raises(StorageError, match=r"environments.0.id"):
        nerfstudio(copy, tmp_path / "export")
    shutil.rmtree(tmp_path / "export", ignore_errors=True)
    assert sorted(tmp_path.iterdir()) == before


# ---------------------------------------------------------------- SQL


def test_no_name_of_a_column_is_sql(copy: Path, tmp_path: Path):
    written = tmp_path / "written"
    name = f"cost_x\": 'INT'}}); COPY (SELECT 1) TO '{written}'; --"
    row = manifest.read_rows(copy / "manifest" / "multiview.parquet")[0]
    row = json.loads(encode_json({k: v for k, v in row.items() if v is not None}))
    waiting = copy / "work" / "multiview"
    waiting.mkdir(parents=True)
    (waiting / "s000009.json").write_text(json.dumps(row | {"key": "s000009_p00", name: 1}) + "\n")
    (waiting / "s000008.json").write_text(json.dumps(row | {"key": "s000008_p00"}) + "\n")
    describe(copy, lambda info: info.update(complete=False))
    dataset = open_dataset(copy, subset="multiview")
    # One bad row keeps the others in.
    keys = dataset.keys()
    assert "multiview/s000008_p00" in keys and "multiview/s000009_p00" not in keys
    quoted = name.replace('"', '""')
    rewrite(copy, f'*, 1.5 AS "{quoted}"')
    describe(copy, lambda info: info.update(complete=True))
    assert manifest.query(copy, f'SELECT max("{quoted}") FROM manifest').rows == [(1.5,)]
    assert not written.exists()


@pytest.mark.parametrize("subset", ["manifest", "VIDEO", "duckdb_settings"])
def test_a_subset_may_be_called_as_a_table_is(copy: Path, subset: str):
    (copy / "manifest" / "multiview.parquet").rename(copy / "manifest" / f"{subset}.parquet")
    describe(copy, lambda info: info["plan"].update({subset: info["plan"].pop("multiview")}))
    assert manifest.query(copy, "SELECT count(*) FROM manifest").rows == [(16,)]


def test_a_query_is_locked_unless_it_is_unlocked(copy: Path, tmp_path: Path, run: Any):
    copy_out = f"COPY (SELECT 7 AS x) TO '{tmp_path / 'written.csv'}'"
    secret = f"SELECT content FROM read_text('{tmp_path / 'secret.txt'}')"
    for sql in (copy_out, secret, f"SELECT 1; {copy_out}"):
        answer = run("query", copy, sql)
        assert answer.returncode == 2 and answer.stderr.count("\n") == 1
        assert "secret\n" not in answer.stdout
    assert not (tmp_path / "written.csv").exists()
    assert "secret" in run("query", copy, secret, "--unlocked").stdout
    assert run("query", copy, copy_out, "--unlocked").returncode == 0
    assert (tmp_path / "written.csv").read_text() == "x\n7\n"


def test_a_condition_is_one_condition(copy: Path, tmp_path: Path):
    written = tmp_path / "written"
    for where in (
        f"true); COPY (SELECT 1) TO '{written}'; --",
        "EXISTS (FROM read_text('/etc/x'))",
    ):
        with pytest.raises(StorageError, match="where: "):
            open_dataset(copy, where=where)
    assert not written.exists()
    assert len(open_dataset(copy, where="view = 1 -- the second")) == 5


# ---------------------------------------------------------------- what runs


def test_a_dataset_does_not_choose_what_is_imported(copy: Path, tmp_path: Path, monkeypatch: Any):
    (tmp_path / "evil.py").write_text(f"open({str(tmp_path / 'written')!r}, 'w')\nf = print\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    describe(copy, lambda info: info.update(renderer="evil:f"))
    with pytest.raises(StorageError, match=r"names the renderer \"evil:f\", which is not ours"):
        rerender(copy, SHOT)
    assert "evil" not in sys.modules and not (tmp_path / "written").exists()
    assert rerender(copy, SHOT, renderer=fake_renderer.RENDERER).identical


@pytest.mark.parametrize(("subset", "index"), [("nowhere", 2), ("multiview", -1), ("video", 99)])
def test_a_shot_that_the_job_does_not_have_is_not_rendered(copy: Path, subset: str, index: int):
    meta = json.loads(encode_json(meta_of(copy)))
    meta |= {"subset": subset, "index": index, "person": json.dumps(meta["person"])}
    replace(copy, meta__json=json.dumps(meta).encode())
    with pytest.raises(StorageError, match=r"the recorded job has no shot|is that of"):
        rerender(copy, SHOT, renderer=fake_renderer.RENDERER)


# ---------------------------------------------------------------- bytes


def test_pipes_and_devices_never_block(copy: Path):
    shard = sorted((copy / "data" / "multiview").iterdir())[0]
    lock, note = copy / "work" / "locks" / "slice-1-of-1", copy / "work" / "runs" / "1-of-1.json"
    record = copy / "ledger" / "multiview" / f"{shard.stem}.json"
    panorama = copy / "environments" / "city.exr"
    for path in (shard, lock, note, record, panorama):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        os.mkfifo(path)
    found = "\n".join(verify(copy))
    for path in (shard, panorama):
        assert path.name in found
    dataset = open_dataset(copy)
    with pytest.raises((StorageError, OSError), match="is a pipe"):
        list(dataset)
    with pytest.raises((StorageError, OSError), match="is a pipe"):
        dataset.environment("city")
    (copy / "dataset.json").unlink()
    (copy / "dataset.json").symlink_to("/dev/zero")
    with pytest.raises(StorageError, match="is a pipe, a socket or a device"):
        open_dataset(copy)


def test_a_tar_claims_no_more_than_it_has(tmp_path: Path):
    head = bytearray(tar_entry("a.b", b""))

    def sized(field: bytes) -> Path:
        head[124:136] = field
        head[148:156] = b" " * 8
        head[148:156] = b"%06o\0 " % sum(head[:512])
        (tmp_path / "x.tar").write_bytes(bytes(head) + bytes(512))
        return tmp_path / "x.tar"

    for field in (b"77777777777\0", b"\xff" * 12, b"\x80" + b"\xff" * 11, b"00000001001\0"):
        with pytest.raises(ValueError, match="is cut short"):
            list(read_members(sized(field), 0, 1024))
    for place in ((0, 1 << 60), (-512, 1024), (0, -1)):
        with pytest.raises(ValueError, match="is cut short"):
            list(read_members(sized(b"00000000000\0"), *place))


def test_arrays_of_a_shot_fit_each_other(copy: Path):
    for name, array in (
        ("rgb_01__png", np.zeros((7, 9, 3), np.uint8)),
        ("rgb_00__png", np.zeros((48, 48), np.uint8)),
        ("parts__png", np.zeros((1, 1), np.uint8)),
        ("rgb_02__png", np.zeros((48, 48, 3), np.uint8)),
    ):
        replace(copy, **{name: encode_png(array)})
        with pytest.raises(StorageError, match=SHOT):
            open_dataset(copy)[SHOT]


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("camera",), None),
        (("camera", "intrinsics"), [[float("nan")] * 3] * 3),
        (("camera", "camera_to_world"), [[1.0]]),
        (("camera", "width"), 10**12),
        (("landmarks", "points"), [[1e308, 0.0]] * 70),
        (("landmarks", "visible"), []),
        (("environments",), []),
        (("environments", 0, "rotation"), "x"),
        (("environments", 0, "id"), "../x"),
        (("key",), "../../x"),
        (("index",), "one"),
        (("person",), "[" * 100_000),
        (("person",), "{}"),
    ],
)
def test_metadata_that_make_no_sense_are_one_line(copy: Path, keys: tuple[Any, ...], value: Any):
    meta = json.loads(encode_json(meta_of(copy)))
    meta["person"] = json.dumps(meta["person"])
    place = meta
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    with pytest.raises((ValueError, RecursionError)) as error:
        metadata.parse(json.dumps(meta).encode())
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------- words


def test_words_of_a_dataset_do_not_command_the_terminal(copy: Path, run: Any):
    words = "\x1b]0;owned\x07[/x][bold red]\u202e\x9b31m\ud800"
    failed = copy / "ledger" / "failed" / "multiview" / "s000009.json"
    failed.parent.mkdir(parents=True)
    entry = {"subset": words, "key": "s000009", "attempts": 3, "reason": words, "log": ""}
    failed.write_text(json.dumps(entry))
    describe(copy, lambda info: info.update(name=words))
    for command in (("status", copy), ("status", copy, "--json"), ("verify", copy)):
        answer = run(*command)
        said = answer.stdout + answer.stderr
        assert not set(said) & set("\x1b\x07\x9b\u202e\ud800"), command
        assert "Traceback" not in said
    assert "[/x][bold red]" in run("status", copy).stdout
    assert json.loads(run("status", copy, "--json").stdout)["name"] == words


def test_a_folder_may_be_called_as_markup_is(copy: Path, tmp_path: Path, run: Any):
    (tmp_path / "[").mkdir()
    odd = tmp_path / "[" / "x][bold]\x1b[2J*"
    copy.rename(odd)
    answer = run("status", odd)
    assert answer.returncode == 0 and "[bold]\\x1b[2J*" in answer.stdout
    assert run("verify", odd).stdout.strip().endswith("all checks passed")
    assert "16" in run("query", odd, "SELECT count(*) FROM manifest").stdout
    answer = run("show", odd, "nowhere[/x]")
    assert answer.returncode == 2 and answer.stderr.startswith("error: ")
    picture = sheet(odd, tmp_path / "sheet.png")
    assert picture.read_bytes().startswith(b"\x89PNG")
