"""What is finished gets onto the disk: a rendered subject as work files, whole shards as tars."""

from __future__ import annotations

import hashlib
import time
from typing import Any

from assets_procedural.conventions.files import replacing, sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import row
from synthgen.dataset.folder import DatasetFolder
from synthgen.dataset.gate import inspect
from synthgen.dataset.records import ShardRecord
from synthgen.dataset.shards import BLOCK, concatenate, encode, tar_entry
from synthgen.dataset.shot import RenderedSubject
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
    rows, position, fields = [], 0, None
    with replacing(files.waiting_tar) as file:
        for shot in rendered.shots:
            start = time.perf_counter()
            problems, figures = inspect(shot)
            if problems:
                raise GateError(f"{shot.key}: {'; '.join(problems)}")
            members, entry = [], position
            for name, content in encode(shot).items():
                entry_bytes = tar_entry(f"{shot.key}.{name}", content)
                members.append({"name": name, "offset": position + BLOCK, "size": len(content)})
                file.write(entry_bytes)
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
            rows.append(row(shot.meta, figures, cost, place))
        write_atomically(files.mesh, rendered.mesh_glb)
        write_atomically(files.parameters, encode_json(rendered.parameters))
    write_atomically(files.waiting_rows, manifest.encode_rows(rows))


def commit_shard(folder: DatasetFolder, shard: ShardPlan) -> ShardRecord:
    """Make a shard of its finished subjects: tar, then manifest part, then the record."""
    files = folder.shard(shard.name)
    keys = [subject_key(index) for index in shard.subjects]
    present = [w for key in keys if (w := ledger.waiting(folder, shard.subset, key))]
    there = {w.key for w in present}
    contents: dict[str, Any] = {"shots": 0, "frames": 0, "bytes": 0}
    tar = folder.relative(files.tar)
    if present:
        starts, size, digest = concatenate([w.tar for w in present], files.tar)
        rows = []
        for waiting, start in zip(present, starts, strict=True):
            rows += [_moved(r, tar, start) for r in manifest.decode_rows(waiting.rows)]
        manifest.write_part(files.rows, rows)
        contents = {
            "shots": len(rows),
            "frames": sum(len(r["environments"]) for r in rows),
            "bytes": size,
            "sha256": digest,
            "part_sha256": sha256(files.rows),
        }
    record = ShardRecord(
        tar=tar,
        subjects=[w.key for w in present],
        failed=[key for key in keys if key not in there],
        **contents,
    )
    write_atomically(files.record, encode_json(record.to_json()))
    return record


def unpack_shard(folder: DatasetFolder, shard: ShardPlan) -> None:
    """The reverse of `commit_shard`, so that a missing subject can be added."""
    record = ledger.shard_record(folder, shard.name)
    if record is None:
        return
    files = folder.shard(shard.name)
    if record.subjects:
        rows = manifest.read_rows(files.rows)
        for key in record.subjects:
            own = [r for r in rows if r["subject"] == key]
            start = own[0]["offset"]
            size = own[-1]["offset"] + own[-1]["size"] - start
            subject = folder.subject(shard.subset, key)
            with files.tar.open("rb") as file:
                file.seek(start)
                write_atomically(subject.waiting_tar, file.read(size))
            place = folder.relative(subject.waiting_tar)
            content = manifest.encode_rows([_moved(r, place, -start) for r in own])
            write_atomically(subject.waiting_rows, content)
    files.record.unlink()


def _moved(row: dict[str, Any], shard: str, by: int) -> dict[str, Any]:
    members = [{**m, "offset": m["offset"] + by} for m in row["members"]]
    return {**row, "shard": shard, "offset": row["offset"] + by, "members": members}


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
    for place in (folder.root, folder.manifests, folder.environments):
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
