"""`verify` passes what is sound and names every kind of damage."""

from __future__ import annotations

import copy
import dataclasses
import io
import json
import shutil
import subprocess
import tarfile
from collections.abc import Callable
from pathlib import Path

import duckdb
import numpy as np
import pytest

from assets_procedural.conventions.files import sha256
from assets_procedural.motion.poses import ARKIT_NAMES
from synthgen.dataset import manifest, open_dataset
from synthgen.dataset.folder import DatasetFolder, StorageError
from synthgen.dataset.shards import decode, encode, tar_entry
from synthgen.farm.rerender import Difference, compare
from synthgen.publish import checksums
from synthgen.publish.verify import verify

TAR = "data/multiview/train-000000.tar"


@pytest.fixture
def out(small_dataset: Path, tmp_path: Path) -> Path:
    """A copy that may be damaged."""
    shutil.copytree(small_dataset, tmp_path / "out")
    return tmp_path / "out"


def edit_json(path: Path, change: Callable[[dict], object]) -> None:
    data = json.loads(path.read_bytes())
    change(data)
    path.write_text(json.dumps(data))


def record_of(out: Path) -> Path:
    return DatasetFolder(out).shard("multiview/train-000000.tar").record


def rewrite(out: Path, change: Callable[[dict[str, bytes]], dict[str, bytes]], seal: bool) -> None:
    """Change the first sample of a shard; with `seal`, forge all checksums to agree with it."""
    path = out / TAR
    with tarfile.open(path) as archive:
        members = {m.name: archive.extractfile(m).read() for m in archive}  # type: ignore[union-attr]
    key = next(iter(members)).split(".")[0]
    own = {n.split(".", 1)[1]: d for n, d in members.items() if n.startswith(f"{key}.")}
    entries = [tar_entry(f"{key}.{n}", d) for n, d in change(own).items()]
    entries += [tar_entry(n, d) for n, d in members.items() if not n.startswith(f"{key}.")]
    data = b"".join(entries) + bytes(1024)
    path.write_bytes(data + bytes(-len(data) % tarfile.RECORDSIZE))
    if seal:
        record = record_of(out)
        seals = {"bytes": path.stat().st_size, "sha256": sha256(path)}
        edit_json(record, lambda r: r.update(seals))


def edit_parquet(path: Path, sql: str, more: str = "") -> None:
    """Keep `SELECT {sql}` of a table, and add the rows of the query `more` over it."""
    other = path.with_suffix(".new")
    added = f"UNION ALL {more} FROM '{path}'" if more else ""
    duckdb.sql(f"COPY (SELECT {sql} FROM '{path}' {added}) TO '{other}' (FORMAT parquet)")
    other.replace(path)


def change_shot(change: Callable) -> Callable[[dict[str, bytes]], dict[str, bytes]]:
    def apply(members: dict[str, bytes]) -> dict[str, bytes]:
        shot = decode("k", members)
        change(shot)
        return encode(shot)

    return apply


def poison(shot) -> None:
    shot.depth = np.array(shot.depth)
    shot.depth[20, 20] = np.nan


def without(name: str) -> Callable[[dict[str, bytes]], dict[str, bytes]]:
    return lambda members: {n: d for n, d in members.items() if n != name}


def flip(path: Path, position: int) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 0x10
    path.write_bytes(data)


def truncate(path: Path, by: int) -> None:
    path.write_bytes(path.read_bytes()[:-by])


def forge_manifest(out: Path, sql: str, more: str = "") -> None:
    """An edit of the manifest with its checksum: the shards' content still gives it away."""
    path = out / "manifest/multiview.parquet"
    edit_parquet(path, sql, more)
    digest = sha256(path)
    edit_json(
        out / "dataset.json", lambda d: d["files"].update({"manifest/multiview.parquet": digest})
    )


def lids_at_rest(shot) -> None:
    """What the pose says before the lids follow the gaze."""
    shot.meta["expression"] |= {n: 0.0 for n in ARKIT_NAMES if n.startswith("eyeLook")}


def brighter(shot) -> None:
    shot.meta["exposures"] = [2 * factor for factor in shot.meta["exposures"]]


def other_person(shot) -> None:
    shot.meta["person"]["age_years"] += 3


def without_meta(*names: str) -> Callable[[Path], object]:
    """Sealed samples whose meta.json lacks an entry, given by the path of keys to it."""

    def change(members: dict[str, bytes]) -> dict[str, bytes]:
        meta = json.loads(members["meta.json"])
        table = meta
        for name in names[:-1]:
            table = table[name]
        del table[names[-1]]
        return members | {"meta.json": json.dumps(meta).encode()}

    return lambda out: rewrite(out, change, seal=True)


def record_without(name: str) -> Callable[[Path], object]:
    return lambda out: edit_json(record_of(out), lambda record: record.pop(name))


def give_up(record: dict) -> None:
    """As if a subject had failed, of which dataset.json knows nothing."""
    record["failed"].append(record["subjects"].pop())
    record["subject_sha256"].pop()


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "truncated tar": (lambda o: truncate(o / TAR, 20_000), "truncated or overwritten"),
    "flipped byte": (lambda o: flip(o / TAR, 5000), "changed since it was written"),
    "flipped byte in the padding": (lambda o: flip(o / TAR, -1), "changed since it was written"),
    "missing shard": (lambda o: (o / TAR).unlink(), f"{TAR}: missing"),
    "missing shard and record": (
        lambda o: ((o / TAR).unlink(), record_of(o).unlink()),
        f"{TAR}: missing",
    ),
    "NaN under forged checksums": (
        lambda o: rewrite(o, change_shot(poison), seal=True),
        "depth has 1 NaN",
    ),
    "missing member": (
        lambda o: rewrite(o, without("alpha.png"), seal=True),
        "alpha.png is missing",
    ),
    "missing picture": (
        lambda o: rewrite(o, without("rgb_01.png"), seal=True),
        "1 pictures of 2 environments",
    ),
    "empty tar": (lambda o: (o / TAR).write_bytes(b""), "0 bytes instead of"),
    "other person": (
        lambda o: rewrite(o, change_shot(other_person), seal=True),
        "person in meta.json is not what the job plans",
    ),
    "lids that do not follow the gaze": (
        lambda o: rewrite(o, change_shot(lids_at_rest), seal=True),
        "expression in meta.json is not what the job plans",
    ),
    "other exposures": (
        lambda o: rewrite(o, change_shot(brighter), seal=True),
        "levels off its linear light",
    ),
    "edited manifest": (
        lambda o: edit_parquet(o / "manifest/multiview.parquet", "* REPLACE (0 AS pose)"),
        "manifest/multiview.parquet: changed since",
    ),
    "edited manifest under forged checksums": (
        lambda o: forge_manifest(o, "* REPLACE (person_age_years + 1 AS person_age_years)"),
        "the manifest's person_age_years",
    ),
    "renamed manifest rows under forged checksums": (
        lambda o: forge_manifest(o, "* REPLACE ('x' || key AS key)"),
        "not in the manifest",
    ),
    "missing manifest": (
        lambda o: (o / "manifest/video.parquet").unlink(),
        "manifest/video.parquet: missing",
    ),
    "missing environment": (
        lambda o: (o / "environments/night.exr").unlink(),
        "environments/night.exr: missing",
    ),
    "damaged environment": (
        lambda o: flip(o / "environments/city.exr", 90_000),
        "environments/city.exr: changed",
    ),
    "wrong counts": (
        lambda o: edit_json(
            o / "dataset.json", lambda d: d["counts"]["video"]["train"].update(frames=7)
        ),
        "dataset.json: counts 7 frames",
    ),
    "other seed": (
        lambda o: edit_json(o / "dataset.json", lambda d: d["job"].update(seed=4)),
        "does not list the subjects that the plan puts there",
    ),
    "invalid job": (
        lambda o: edit_json(o / "dataset.json", lambda d: d["job"].update(samples=-1)),
        "unusable job",
    ),
    "missing mesh": (
        lambda o: next((o / "subjects/video").glob("*.glb")).unlink(),
        ".glb is missing",
    ),
    "changed mesh": (
        lambda o: next((o / "subjects/video").glob("*.glb")).write_bytes(b"glTF"),
        ".glb changed since it was written",
    ),
    "missing card": (lambda o: (o / "README.md").unlink(), "README.md: missing"),
    "broken croissant": (
        lambda o: (o / "croissant.json").write_text("{"),
        "croissant.json: not valid JSON",
    ),
    "unknown shard": (
        lambda o: shutil.copy(o / TAR, o / "data/multiview/train-000009.tar"),
        "a shard that the job does not have",
    ),
    "incomplete": (
        lambda o: edit_json(o / "dataset.json", lambda d: d.update(complete=False)),
        "not complete",
    ),
    "swapped shards": (
        lambda o: shutil.copy(o / "data/multiview/train-000001.tar", o / TAR),
        "multiview/train-000000.tar",
    ),
    "no pose of the camera": (
        without_meta("camera", "camera_to_world"),
        f"{TAR}: s000000_p00: meta.json does not decode: camera.camera_to_world: Field required",
    ),
    "no seeds": (without_meta("seeds"), "seeds in meta.json is not what the job plans"),
    "no expression": (without_meta("expression"), "meta.json does not decode: expression: Field"),
    "no exposures": (without_meta("exposures"), "meta.json does not decode: exposures: Field"),
    "record without subjects": (
        record_without("subjects"),
        f"{TAR}: cannot be checked (StorageError: ledger/multiview/train-000000.json: unusable: "
        "subjects: Field required)",
    ),
    "record without checksum": (record_without("sha256"), f"{TAR}: cannot be checked"),
    "record that is a list": (
        lambda o: record_of(o).write_text("[]"),
        f"{TAR}: cannot be checked",
    ),
    "dataset.json without a version": (
        lambda o: edit_json(o / "dataset.json", lambda d: (d.pop("code"), d.update(counts=[]))),
        "dataset.json: unusable: counts: Input should be a valid dictionary",
    ),
    "dataset.json with other panoramas": (
        lambda o: edit_json(o / "dataset.json", lambda d: d.update(environments=["city"])),
        "dataset.json: unusable",
    ),
    "manifest without a column": (
        lambda o: forge_manifest(o, "* EXCLUDE (camera_yaw)"),
        "manifest/multiview.parquet: lacks the columns camera_yaw",
    ),
    "manifest without a figure of the gate": (
        lambda o: forge_manifest(o, "* EXCLUDE (quality_mask_fraction)"),
        "the manifest's quality_mask_fraction is None",
    ),
    "manifest without keys": (
        lambda o: forge_manifest(o, "* EXCLUDE (key)"),
        "manifest/multiview.parquet: cannot be checked",
    ),
    "manifest with rows of an unknown shard": (
        lambda o: forge_manifest(o, "*", "SELECT * REPLACE ('x' || key AS key, 'y' AS shard)"),
        "rows of y, a shard that is not there",
    ),
    "manifest with repeated rows": (
        lambda o: forge_manifest(o, "*", "SELECT *"),
        "with the key of another",
    ),
    "changed parameters of a subject": (
        lambda o: flip(next((o / "subjects/video").glob("*.json")), 3),
        ".json: changed since it was written (sha256 differs from SHA256SUMS)",
    ),
    "changed card": (lambda o: flip(o / "README.md", 50), "README.md: changed since"),
    "changed croissant": (
        lambda o: edit_json(o / "croissant.json", lambda d: d.update(name="x")),
        "croissant.json: changed since",
    ),
    "exchanged panoramas": (
        lambda o: (
            shutil.copy(o / "environments/city.exr", o / "city"),
            shutil.copy(o / "environments/night.exr", o / "environments/city.exr"),
            (o / "city").replace(o / "environments/night.exr"),
        ),
        "environments/night.exr: changed since",
    ),
    "exchanged keys of the manifest under forged checksums": (
        lambda o: forge_manifest(
            o,
            "* REPLACE (CASE key WHEN 's000000_p00' THEN 's000000_p01' "
            "WHEN 's000000_p01' THEN 's000000_p00' ELSE key END AS key)",
        ),
        "s000000_p00: the manifest's",
    ),
    "key in meta.json under forged checksums": (
        lambda o: rewrite(
            o,
            lambda m: (
                m | {"meta.json": m["meta.json"].replace(b'"s000000_p00"', b'"s000000_p01"', 1)}
            ),
            seal=True,
        ),
        "its meta.json is of s000000_p01",
    ),
    "size of a shard in dataset.json": (
        lambda o: edit_json(o / "dataset.json", lambda d: d["shards"][0].update(bytes=1)),
        "dataset.json: bytes and sha256 of data/multiview/train-000000.tar are not those",
    ),
    "sha256 of a shard in dataset.json": (
        lambda o: edit_json(o / "dataset.json", lambda d: d["shards"][0].update(sha256="0" * 64)),
        "dataset.json: bytes and sha256 of data/multiview/train-000000.tar are not those",
    ),
    "repeated shard in dataset.json": (
        lambda o: edit_json(o / "dataset.json", lambda d: d["shards"].append(d["shards"][0])),
        "dataset.json: shards repeats a shard",
    ),
    "planned frames": (
        lambda o: edit_json(
            o / "dataset.json", lambda d: d["plan"]["video"].update(frames_per_subject=9)
        ),
        "dataset.json: plan of video does not agree with its job",
    ),
    "changed dataset.json": (
        lambda o: edit_json(o / "dataset.json", lambda d: d.update(created="2000-01-01")),
        "dataset.json: changed since",
    ),
    "changed list": (lambda o: flip(o / "SHA256SUMS", 5), "SHA256SUMS: changed since"),
    "missing list": (lambda o: (o / "SHA256SUMS").unlink(), "SHA256SUMS: missing"),
    "unknown panorama": (
        lambda o: shutil.copy(o / "environments/city.exr", o / "environments/more.exr"),
        "environments/more.exr: a file that the dataset does not have",
    ),
    "unknown file": (
        lambda o: (o / "data/notes.txt").write_text("?"),
        "data/notes.txt: a file that the job does not have",
    ),
    "failed subject that is not quarantined": (
        lambda o: edit_json(record_of(o), give_up),
        "dataset.json: quarantined lacks multiview/s00000",
    ),
    "quarantined subject that is there": (
        lambda o: edit_json(
            o / "dataset.json",
            lambda d: d["quarantined"].append({"subset": "video", "key": "s000000"}),
        ),
        "dataset.json: quarantined names video/s000000",
    ),
}


def test_a_sound_dataset_has_no_problem(small_dataset: Path):
    assert verify(small_dataset) == []


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_caught(out: Path, name: str):
    damage, message = DAMAGE[name]
    damage(out)
    problems = verify(out)
    assert any(message in problem for problem in problems), problems
    assert all("\n" not in problem for problem in problems)


def test_a_dataset_without_a_list_is_verified_as_before(out: Path):
    for name in ("SHA256SUMS", "ledger/dataset.json"):
        (out / name).unlink()
    edit_json(out / "dataset.json", lambda d: d.pop("checksums"))
    for path in out.glob("ledger/*/*.json"):
        edit_json(path, lambda record: (record.pop("files"), record.pop("subject_sha256")))
    assert verify(out) == []
    (out / "notes.txt").write_text("mine")
    assert verify(out) == []
    flip(out / "environments/city.exr", 90_000)
    assert any("environments/city.exr: changed" in problem for problem in verify(out))


def test_sha256sum_reads_the_list(out: Path):
    command = ["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"]
    assert subprocess.run(command, cwd=out, check=False).returncode == 0
    listed = checksums.read(out / "SHA256SUMS")
    files = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert set(listed) == files - {"SHA256SUMS"}


def test_every_byte_of_the_list_is_covered(out: Path):
    path = out / "SHA256SUMS"
    for position in range(path.stat().st_size):
        flip(path, position)
        with pytest.raises(ValueError, match="changed since"):
            checksums.read(path)
        flip(path, position)


def test_every_region_of_a_shard_is_covered(out: Path):
    path = out / TAR
    rng = np.random.default_rng(0)
    for position in rng.integers(path.stat().st_size, size=8):
        flip(path, int(position))
        assert verify(out), f"byte {position}"
        flip(path, int(position))
    assert verify(out) == []


def test_large_datasets_are_checked_by_processes(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("synthgen.publish.verify.PARALLEL_BYTES", 0)
    assert verify(small_dataset, workers=2) == []


def test_rerender_compares_every_field(small_dataset: Path):
    stored = open_dataset(small_dataset, subset="multiview")[0]

    def differing(**changes: object) -> dict[str, Difference]:
        again = dataclasses.replace(copy.deepcopy(stored), **changes)
        fields = compare(stored, again).fields
        assert {f"meta {name}" for name in stored.meta} <= fields.keys()
        return {name: d for name, d in fields.items() if d.share}

    assert differing() == {}
    assert differing(meta=stored.meta | {"joints": ("head",)}) == {}
    assert differing(meta=stored.meta | {"joints": ["neck"]}).keys() == {"meta joints"}
    other = differing(meta=stored.meta | {"head": {**stored.meta["head"], "yaw": 9.0}})
    assert other["meta head"].largest > 5
    assert differing(meta=stored.meta | {"new": 1}).keys() == {"meta new"}
    assert differing(hdr=None).keys() == {"hdr_00", "hdr_01"}
    assert differing(rgb=stored.rgb[:1]).keys() == {"rgb_01"}
    assert differing(geometry=stored.geometry | {"more": np.zeros(2)}).keys() == {"geometry more"}


def test_no_dataset_is_one_line(tmp_path: Path):
    with pytest.raises(StorageError, match="no dataset here"):
        verify(tmp_path)
    (tmp_path / "dataset.json").write_text('{"format": 99}')
    assert verify(tmp_path) == ["dataset.json: format 99, not 1 or 2"]


def test_io_is_what_the_manifest_says(small_dataset: Path):
    for row in manifest.query(small_dataset, "SELECT shard, members FROM manifest").to_pylist():
        with (small_dataset / row["shard"]).open("rb") as file:
            for member in row["members"]:
                file.seek(member["offset"])
                content = file.read(member["size"])
                if member["name"].endswith(".png"):
                    assert content.startswith(b"\x89PNG")
                elif member["name"].endswith(".npz"):
                    assert np.load(io.BytesIO(content))["landmarks"].shape == (70, 3)
