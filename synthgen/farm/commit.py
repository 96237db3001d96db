"""What is finished gets onto the disk: a rendered subject as work files, whole shards as tars.

All of it holds the hashes of what it consists of. `synthgen.farm.mend` compares them when a run
begins, and `commit_shard` once more when it joins work files to a shard.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from pathlib import Path
from typing import Any

from assets_procedural.conventions.files import replacing, sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import misfits, row
from synthgen.dataset.folder import DatasetFolder
from synthgen.dataset.gate import inspect
from synthgen.dataset.records import Seal, ShardRecord
from synthgen.dataset.shards import (
    BLOCK,
    Changed,
    concatenate,
    decode,
    encode,
    read_sample,
    tar_entry,
)
from synthgen.dataset.shot import RenderedSubject, Shot
from synthgen.planning.plan import Plan, ShardPlan, SubjectPlan, subject_key


class GateError(RuntimeError):
    """A shot broke a promise of the dataset contract."""


def commit_subject(
    folder: DatasetFolder, subject: SubjectPlan, rendered: RenderedSubject, seconds: float
) -> None:
    """Gate every shot, then commit mesh, parameters and tar entries, and last the manifest rows.

    `seconds` is what rendering took. Raises `GateError` naming shot and promise.
    """
    keys = [shot.key for shot in rendered.shots]
    expected = [shot.key for shot in subject.shots]
    if keys != expected:
        raise GateError(f"the renderer returned {len(keys)} shots instead of {len(expected)}")
    files = folder.subject(subject.subset, subject.key)
    rows, position, fields, hashed = [], 0, None, hashlib.sha256()
    with replacing(files.waiting_tar) as file:
        for shot in rendered.shots:
            start = time.perf_counter()
            problems, figures = inspect(shot)
            if problems:
                raise GateError(f"{shot.key}: {'; '.join(problems)}")
            _check_identity(subject, shot)
            members, entry = [], position
            for name, content in encode(shot).items():
                entry_bytes = tar_entry(f"{shot.key}.{name}", content)
                members.append({"name": name, "offset": position + BLOCK, "size": len(content)})
                file.write(entry_bytes)
                hashed.update(entry_bytes)
                position += len(entry_bytes)
            names = [m["name"] for m in members]
            if fields not in (None, names):
                raise GateError(f"{shot.key}: other members than the first shot's")
            fields = names
            cost = {
                **shot.cost,
                "store": time.perf_counter() - start,
                "subject": seconds,
            }
            place = {
                "shard": folder.relative(files.waiting_tar),
                "offset": entry,
                "size": position - entry,
                "members": members,
                "mesh": folder.relative(files.mesh),
                "mesh_sha256": hashlib.sha256(rendered.mesh_glb).hexdigest(),
            }
            rows.append(_storable(shot.key, row(shot.meta, figures, cost, place)))
        write_atomically(files.mesh, rendered.mesh_glb)
        parameters = encode_json(rendered.parameters)
        write_atomically(files.parameters, parameters)
    seal = Seal(
        bytes=position,
        sha256=hashed.hexdigest(),
        rows_sha256="",
        parameters_sha256=hashlib.sha256(parameters).hexdigest(),
    )
    write_atomically(files.waiting_rows, manifest.encode_waiting(rows, seal))


def _check_identity(subject: SubjectPlan, shot: Shot) -> None:
    """The metadata must name the shot that was asked for."""
    planned = {name: getattr(subject, name) for name in ("subset", "kind", "index", "split")}
    for name, value in ({"key": shot.key, "subject": subject.key} | planned).items():
        found = shot.meta.get(name)
        if found != value or type(found) is not type(value):
            raise GateError(f"{shot.key}: {name} in its metadata is {found!r:.40}, not {value!r}")


def _storable(key: str, one: dict[str, Any]) -> dict[str, Any]:
    """A row as it is read back. It must fit the manifest: one that does not blocks all others."""
    stored = json.loads(encode_json(one))
    if problems := misfits(stored):
        raise GateError(f"{key}: {problems[0]}")
    return stored


def read_waiting(folder: DatasetFolder, subset: str, key: str) -> tuple[list[dict[str, Any]], Seal]:
    """The rows of a subject that waits for its shard, and the seal of its files, all compared.

    Raises `ValueError` or `OSError` if one of them is not as it was written. Older versions wrote
    no seal: then every sample must decode.
    """
    files = folder.subject(subset, key)
    rows, seal = manifest.decode_waiting(files.waiting_rows)
    if {(r["subset"], r["subject"]) for r in rows} != {(subset, key)}:
        raise ValueError(f"{files.waiting_rows}: holds another subject")
    if sha256(files.mesh) != rows[0]["mesh_sha256"]:
        raise ValueError(f"{files.mesh}: changed since it was written")
    size = files.waiting_tar.stat().st_size
    found = Seal(
        bytes=size,
        sha256=sha256(files.waiting_tar),
        rows_sha256="" if seal is None else seal.rows_sha256,
        parameters_sha256=sha256(files.parameters),
    )
    if seal is None:
        if size != rows[-1]["offset"] + rows[-1]["size"]:
            raise ValueError(f"{files.waiting_tar}: has another length than its samples")
        for each in rows:
            place = each["offset"], each["size"], each["key"]
            decode(each["key"], read_sample(files.waiting_tar, *place))
        json.loads(files.parameters.read_bytes())
    elif found != seal:
        raise ValueError(
            f"{files.waiting_tar}: it or its parameters changed since they were written"
        )
    return rows, found


def drop_waiting(folder: DatasetFolder, subset: str, key: str) -> None:
    """Forget the work files of a subject: the file that says that it is done goes first."""
    files = folder.subject(subset, key)
    files.waiting_rows.unlink(missing_ok=True)
    files.waiting_tar.unlink(missing_ok=True)


def commit_shard(folder: DatasetFolder, shard: ShardPlan) -> list[str]:
    """Make a shard of its finished subjects: tar, then manifest part, then the record.

    Returns the keys of subjects whose work files are damaged. If there are any, they are removed
    and nothing is committed: these subjects must be rendered again.
    """
    files = folder.shard(shard.name)
    keys = [subject_key(index) for index in shard.subjects]
    present = [w for key in keys if (w := ledger.waiting(folder, shard.subset, key))]
    seals: dict[str, Seal] = {}
    rows: dict[str, list[dict[str, Any]]] = {}
    damaged = []
    for waiting in present:
        try:
            rows[waiting.key], seal = manifest.decode_waiting(waiting.rows)
            if seal is None:
                seal = read_waiting(folder, shard.subset, waiting.key)[1]
            seals[waiting.key] = seal
        except (OSError, ValueError, KeyError):
            damaged.append(waiting.key)
    contents: dict[str, Any] = {"shots": 0, "frames": 0, "bytes": 0}
    tar = folder.relative(files.tar)
    if present and not damaged:
        try:
            starts, size, whole, each = concatenate(
                [w.tar for w in present], files.tar, [seals[w.key].sha256 for w in present]
            )
        except Changed as error:
            damaged.append(present[error.place].key)
        else:
            moved = [
                _moved(one, tar, start)
                for waiting, start in zip(present, starts, strict=True)
                for one in rows[waiting.key]
            ]
            manifest.write_part(files.rows, _with_first_costs(files.rows, moved))
            contents = {
                "shots": len(moved),
                "frames": sum(len(r["environments"]) for r in moved),
                "bytes": size,
                "sha256": whole,
                "part_sha256": sha256(files.rows),
                "subject_sha256": each,
                "files": _beside(folder, shard.subset, rows, seals),
            }
    for key in damaged:
        drop_waiting(folder, shard.subset, key)
    if not damaged:
        done = [w.key for w in present]
        failed = [key for key in keys if key not in done]
        record = ShardRecord(tar=tar, subjects=done, failed=failed, **contents)
        write_atomically(files.record, encode_json(record.to_json()))
    return damaged


def _beside(
    folder: DatasetFolder,
    subset: str,
    rows: dict[str, list[dict[str, Any]]],
    seals: dict[str, Seal],
) -> dict[str, str]:
    """Path -> sha256 of what a shard's subjects have outside of it."""
    found = {}
    for key, seal in seals.items():
        files = folder.subject(subset, key)
        found[folder.relative(files.mesh)] = rows[key][0]["mesh_sha256"]
        found[folder.relative(files.parameters)] = seal.parameters_sha256
    return found


def _with_first_costs(path: Path, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a shard that is made again: where the samples are the same, so are the rows.

    So a shard that was damaged and mended leaves no trace. `path` are its rows until now, if any.
    """
    before: dict[str, dict[str, Any]] = {}
    with contextlib.suppress(Exception):  # DuckDB raises what it likes on a damaged file
        before = {r["key"]: r for r in manifest.read_rows(path)} if path.exists() else {}

    def essence(one: dict[str, Any]) -> dict[str, Any]:
        kept = {n: v for n, v in one.items() if v is not None and not n.startswith("cost_")}
        return json.loads(encode_json(kept))

    def first(one: dict[str, Any]) -> dict[str, Any]:
        old = before.get(one["key"])
        return old if old is not None and essence(old) == essence(one) else one

    return [first(one) for one in rows]


def unpack_shard(folder: DatasetFolder, shard: ShardPlan, record: ShardRecord) -> list[str]:
    """The reverse of `commit_shard`, so that a subject can be added or rendered again.

    Returns the keys of subjects that are left out, because their bytes, rows, mesh or parameters
    are not what `record` says. The rows stay where they are, for the shard's next commit.
    """
    files = folder.shard(shard.name)
    try:
        rows = manifest.read_rows(files.rows)
    except Exception:  # DuckDB raises what it likes on a damaged file
        rows = []
    left_out = []
    whole = digest(files.tar) == record.sha256
    for place, key in enumerate(record.subjects):
        own = [r for r in rows if r["subject"] == key]
        expected = record.subject_sha256[place] if record.subject_sha256 else None
        try:
            start = own[0]["offset"]
            size = own[-1]["offset"] + own[-1]["size"] - start
            subject = folder.subject(shard.subset, key)
            with files.tar.open("rb") as file:
                file.seek(start)
                content = file.read(size)
            found = hashlib.sha256(content).hexdigest()
            parameters = sha256(subject.parameters)
            if (not whole if expected is None else found != expected) or len(content) != size:
                raise ValueError("its bytes changed")
            known = record.files.get(folder.relative(subject.parameters), parameters)
            if parameters != known or sha256(subject.mesh) != own[0]["mesh_sha256"]:
                raise ValueError("its mesh or parameters changed")
        except (OSError, ValueError, LookupError):
            left_out.append(key)
            continue
        write_atomically(subject.waiting_tar, content)
        waiting = folder.relative(subject.waiting_tar)
        seal = Seal(bytes=size, sha256=found, rows_sha256="", parameters_sha256=parameters)
        moved = [without_gaps(_moved(r, waiting, -start)) for r in own]
        write_atomically(subject.waiting_rows, manifest.encode_waiting(moved, seal))
    files.record.unlink()
    return left_out


def without_gaps(one: dict[str, Any]) -> dict[str, Any]:
    """A row without the columns that it has no value for."""
    return {name: value for name, value in one.items() if value is not None}


def digest(path: Path) -> str | None:
    """A file's sha256; None if it cannot be read."""
    with contextlib.suppress(OSError):
        return sha256(path)
    return None


def _moved(one: dict[str, Any], shard: str, by: int) -> dict[str, Any]:
    members = [{**m, "offset": m["offset"] + by} for m in one["members"]]
    return {**one, "shard": shard, "offset": one["offset"] + by, "members": members}


def clean_temporary(folder: DatasetFolder, shards: list[ShardPlan]) -> None:
    """Remove what killed processes of this slice left under temporary names.

    Other slices may be writing beside it, so that only its own names are touched.
    """
    mine = {s.name for s in shards}
    own = {(s.subset, subject_key(i)) for s in shards for i in s.subjects}
    for subset in {s.subset for s in shards}:
        for place in folder.folders(subset):
            for path in place.glob(".*.tmp"):
                stem = path.name[1:].split(".", 1)[0]
                if f"{subset}/{stem}.tar" in mine or (subset, stem) in own:
                    path.unlink(missing_ok=True)


def clean_shared(folder: DatasetFolder) -> None:
    """The same for what all slices write; only for the holder of `ledger.shared_files_lock`."""
    for place in (folder.root, folder.manifests, folder.environments, folder.tracks):
        for path in place.glob(".*.[0-9]*.tmp"):
            path.unlink(missing_ok=True)


def frames_done(folder: DatasetFolder, the_plan: Plan, shards: list[ShardPlan]) -> int:
    """Frames of these shards that are on disk."""
    done = 0
    for shard in shards:
        spec = the_plan.job.subsets[shard.subset]
        record = ledger.shard_record(folder, shard.name)
        if record is not None:
            done += record.frames
            continue
        waiting = sum(
            ledger.waiting(folder, shard.subset, subject_key(i)) is not None for i in shard.subjects
        )
        done += waiting * spec.shots * spec.environments
    return done
