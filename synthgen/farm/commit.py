"""What is finished gets onto the disk: a rendered subject as work files, whole shards as tars."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path
from typing import Any

from assets_procedural.conventions.files import replacing, sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import row
from synthgen.dataset.gate import inspect
from synthgen.dataset.shards import BLOCK, concatenate, encode, tar_entry
from synthgen.dataset.shot import RenderedSubject
from synthgen.planning.plan import Plan, ShardPlan, SubjectPlan, subject_key


class GateError(RuntimeError):
    """A shot broke a promise of the dataset contract."""


def commit_subject(
    out: Path, subject: SubjectPlan, rendered: RenderedSubject, seconds: float
) -> None:
    """Gate every shot, then commit mesh, parameters and tar entries, and last the manifest rows.

    `seconds` is what rendering took. Raises `GateError` naming shot and promise.
    """
    keys = [shot.key for shot in rendered.shots]
    expected = [shot.key for shot in subject.shots]
    if keys != expected:
        raise GateError(f"the renderer returned {len(keys)} shots instead of {len(expected)}")
    folder = out / "subjects" / subject.subset
    mesh = folder / f"{subject.key}.glb"
    tar = ledger.work_file(out, subject.subset, subject.key, ".tar")
    rows, position, fields = [], 0, None
    with replacing(tar) as file:
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
                "shard": tar.relative_to(out).as_posix(),
                "offset": entry,
                "size": position - entry,
                "members": members,
                "mesh": mesh.relative_to(out).as_posix(),
                "mesh_sha256": hashlib.sha256(rendered.mesh_glb).hexdigest(),
            }
            rows.append(row(shot.meta, figures, cost, place))
        write_atomically(mesh, rendered.mesh_glb)
        write_atomically(mesh.with_suffix(".json"), encode_json(rendered.parameters))
    write_atomically(tar.with_suffix(".json"), manifest.encode_rows(rows))


def commit_shard(out: Path, shard: ShardPlan) -> dict[str, Any]:
    """Make a shard of its finished subjects: tar, then manifest part, then the record."""
    stem = Path(shard.name).stem
    keys = [subject_key(index) for index in shard.subjects]
    present = [key for key in keys if ledger.subject_done(out, shard.subset, key)]
    tar = out / "data" / shard.name
    record: dict[str, Any] = {
        "tar": tar.relative_to(out).as_posix(),
        "subjects": present,
        "failed": [key for key in keys if key not in set(present)],
        "shots": 0,
        "frames": 0,
        "bytes": 0,
    }
    if present:
        parts = [ledger.work_file(out, shard.subset, key, ".tar") for key in present]
        starts, record["bytes"], record["sha256"] = concatenate(parts, tar)
        rows = []
        for key, start in zip(present, starts, strict=True):
            path = ledger.work_file(out, shard.subset, key, ".json")
            rows += [_moved(r, record["tar"], start) for r in manifest.decode_rows(path)]
        part = ledger.part_file(out, shard.subset, stem)
        manifest.write_part(part, rows)
        record["part_sha256"] = sha256(part)
        record["shots"] = len(rows)
        record["frames"] = sum(len(r["environments"]) for r in rows)
    write_atomically(ledger.record_file(out, shard.subset, stem), encode_json(record))
    return record


def unpack_shard(out: Path, shard: ShardPlan) -> None:
    """The reverse of `commit_shard`, so that a missing subject can be added."""
    stem = Path(shard.name).stem
    record = ledger.shard_record(out, shard.subset, stem)
    if record is None:
        return
    if record["subjects"]:
        rows = manifest.read_rows(ledger.part_file(out, shard.subset, stem))
        tar = out / record["tar"]
        for key in record["subjects"]:
            own = [r for r in rows if r["subject"] == key]
            start = own[0]["offset"]
            size = own[-1]["offset"] + own[-1]["size"] - start
            work_tar = ledger.work_file(out, shard.subset, key, ".tar")
            with tar.open("rb") as file:
                file.seek(start)
                write_atomically(work_tar, file.read(size))
            place = work_tar.relative_to(out).as_posix()
            content = manifest.encode_rows([_moved(r, place, -start) for r in own])
            write_atomically(work_tar.with_suffix(".json"), content)
    ledger.record_file(out, shard.subset, stem).unlink()


def _moved(row: dict[str, Any], shard: str, by: int) -> dict[str, Any]:
    members = [{**m, "offset": m["offset"] + by} for m in row["members"]]
    return {**row, "shard": shard, "offset": row["offset"] + by, "members": members}


def clean_temporary(out: Path, shards: list[ShardPlan]) -> None:
    """Remove what killed processes of this slice left under temporary names.

    Other slices may be writing beside it, so that only its own names are touched.
    """
    mine = {s.name for s in shards}
    own = {(s.subset, subject_key(i)) for s in shards for i in s.subjects}
    for subset in {s.subset for s in shards}:
        for folder in ("data", "work", "subjects", "ledger", "ledger/failed"):
            for path in (out / folder / subset).glob(".*.tmp"):
                stem = path.name[1:].split(".", 1)[0]
                if f"{subset}/{stem}.tar" in mine or (subset, stem) in own:
                    path.unlink(missing_ok=True)


def clean_shared(out: Path) -> None:
    """The same for what is written by whoever holds `ledger.door`; only for its holder."""
    for folder in (out, out / "manifest", out / "environments"):
        for path in folder.glob(".*.[0-9]*.tmp"):
            path.unlink(missing_ok=True)


def frames_done(out: Path, the_plan: Plan, shards: list[ShardPlan]) -> int:
    """Frames of these shards that are on disk."""
    done = 0
    for shard in shards:
        spec = the_plan.job.subsets[shard.subset]
        record = ledger.shard_record(out, shard.subset, Path(shard.name).stem)
        if record is not None:
            done += record["frames"]
            continue
        waiting = sum(
            ledger.subject_done(out, shard.subset, subject_key(i)) for i in shard.subjects
        )
        done += waiting * spec.shots * spec.environments
    return done
