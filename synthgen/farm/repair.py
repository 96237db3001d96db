"""`verify --repair`: what is damaged or missing of a dataset is made again, and nothing else.

Records and descriptions are restored from what says the same elsewhere; everything else is a case
for `render_job`, which compares what is stored with its hashes.
"""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path
from typing import Any

from assets_procedural.conventions.files import sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import Description, Failure, ShardRecord, read_description
from synthgen.farm import DEFAULT_RENDERER, Device
from synthgen.farm.commit import digest
from synthgen.farm.local import render_job
from synthgen.farm.mend import rows_in_manifest
from synthgen.farm.run import Summary
from synthgen.planning.plan import Plan, ShardPlan, subject_key
from synthgen.publish import checksums, publish


def repair(
    out: Place,
    workers: int | None = None,
    threads: int = 1,
    device: Device = "cpu",
    renderer: str = DEFAULT_RENDERER,
) -> Summary:
    """Render again exactly what is damaged or missing, and write again what follows from it.

    `Summary.mended` has a line for each thing that was done. Files that the dataset does not have
    are left alone. Raises `StorageError` if another version of the code, or a renderer other than
    `renderer`, made the dataset, and as `render_job`.
    """
    folder = DatasetFolder(out)
    with ledger.slice_lock(folder, (1, 1)):
        hashes = _hashes(folder)
        lines = _restore_description(folder, hashes)
        info = read_description(folder)
        publish.check_whole(folder, info)
        if info.renderer != renderer:
            raise StorageError(f"{folder}: was rendered by {info.renderer!r}, not by {renderer}")
        publish.check_code(folder, info)
        plan = publish.stored_plan(folder)
        if info.complete:
            lines += _restore_ledger(folder, info, plan, hashes)
    before = _written_at_the_end(folder, plan)
    summary = render_job(
        plan.job,
        folder,
        workers=workers,
        threads=threads,
        device=device,
        renderer=renderer,
    )
    after = _written_at_the_end(folder, plan)
    written = [f"{name}: written again" for name in after if after[name] != before.get(name)]
    summary.mended = lines + summary.mended + written
    return summary


def _hashes(folder: DatasetFolder) -> dict[str, str]:
    """The dataset's list of hashes; empty if there is none, or it is damaged."""
    with contextlib.suppress(OSError, ValueError):
        return checksums.read(folder.checksums)
    return {}


def _written_at_the_end(folder: DatasetFolder, plan: Plan) -> dict[str, str | None]:
    paths = [folder.card, folder.croissant, folder.description, folder.description_copy]
    paths += [folder.manifest(subset) for subset in plan.job.subsets]
    return {folder.relative(path): digest(path) for path in [*paths, folder.checksums]}


def _restore_description(folder: DatasetFolder, hashes: dict[str, str]) -> list[str]:
    """dataset.json from its copy, if it is not as it was published or opened again."""
    copy, name = folder.description_copy, folder.relative(folder.description)
    recorded = hashes.get(name)
    with contextlib.suppress(OSError, StorageError):
        content = copy.read_bytes()
        published = Description.parse(content, copy)
        if recorded not in (None, hashlib.sha256(content).hexdigest()):
            return []
        with contextlib.suppress(StorageError):
            now = read_description(folder)
            opened = published.model_copy(update={"complete": False})
            if recorded is None or now == opened or digest(folder.description) == recorded:
                return []
        write_atomically(folder.description, content)
        return [f"{name}: restored from {folder.relative(copy)}"]
    return []


def _restore_ledger(
    folder: DatasetFolder, info: Description, plan: Plan, hashes: dict[str, str]
) -> list[str]:
    """Records of shards and of failures, from what says the same elsewhere.

    A record that cannot be restored is removed, so that its shard is rendered again.
    """
    lines = []
    for shard in (s for subset in plan.job.subsets for s in plan.shards(subset)):
        path = folder.shard(shard.name).record
        name = folder.relative(path)
        sound = ledger.record_of(folder, shard.name) is not None
        if not sound or digest(path) != hashes.get(name, digest(path)):
            restored = _record(folder, shard, info, hashes)
            if restored is None:
                path.unlink(missing_ok=True)
                lines.append(f"{name}: was damaged; rendering its shard again")
            else:
                write_atomically(path, encode_json(restored.to_json()))
                lines.append(f"{name}: restored")
    for entry in info.quarantined:
        path = folder.subject(entry.subset, entry.key).failure
        name = folder.relative(path)
        known = ledger.failure(folder, entry.subset, entry.key)
        if known is None or digest(path) != hashes.get(name, digest(path)):
            note = Failure(
                subset=entry.subset,
                key=entry.key,
                attempts=ledger.ATTEMPTS,
                reason=entry.reason,
                log="" if known is None else known.log,
            )
            write_atomically(path, encode_json(note.to_json()))
            lines.append(f"{name}: restored")
    return lines


def _record(
    folder: DatasetFolder, shard: ShardPlan, info: Description, hashes: dict[str, str]
) -> ShardRecord | None:
    """The record of a shard whose tar is as dataset.json says; None if it, or its rows, is not."""
    files = folder.shard(shard.name)
    tar = folder.relative(files.tar)
    keys = [subject_key(index) for index in shard.subjects]
    seal = next((s for s in info.shards if s.tar == tar), None)
    if seal is None:
        given_up = {e.key for e in info.quarantined if e.subset == shard.subset}
        if not given_up.issuperset(keys):
            return None
        return ShardRecord(tar=tar, subjects=[], failed=keys, shots=0, frames=0, bytes=0)
    if digest(files.tar) != seal.sha256:
        return None
    rows = _rows(folder, shard, hashes)
    subjects = list(dict.fromkeys(r["subject"] for r in rows))
    if not subjects or not set(subjects) <= set(keys):
        return None
    beside = [folder.subject(shard.subset, key) for key in subjects]
    paths = [path for subject in beside for path in (subject.mesh, subject.parameters)]
    names = [folder.relative(path) for path in paths]
    known = {n: hashes.get(n) or digest(p) for n, p in zip(names, paths, strict=True)}
    return ShardRecord(
        tar=tar,
        subjects=subjects,
        failed=[key for key in keys if key not in subjects],
        shots=len(rows),
        frames=sum(len(r["environments"]) for r in rows),
        bytes=seal.bytes,
        sha256=seal.sha256,
        part_sha256=sha256(files.rows),
        subject_sha256=[_range_sha256(files.tar, rows, key) for key in subjects],
        files={name: each for name, each in known.items() if each is not None},
    )


def _rows(folder: DatasetFolder, shard: ShardPlan, hashes: dict[str, str]) -> list[dict[str, Any]]:
    """The rows of a shard; its part of the manifest is written again if it is damaged."""
    path = folder.shard(shard.name).rows
    if digest(path) != hashes.get(folder.relative(path), ""):
        rows = rows_in_manifest(folder, shard)
        if rows is None:
            return []
        manifest.write_part(path, rows)
    return manifest.read_rows(path)


def _range_sha256(tar: Path, rows: list[dict[str, Any]], key: str) -> str:
    own = [r for r in rows if r["subject"] == key]
    start = own[0]["offset"]
    with tar.open("rb") as file:
        file.seek(start)
        return hashlib.sha256(file.read(own[-1]["offset"] + own[-1]["size"] - start)).hexdigest()
