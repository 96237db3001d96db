"""What was stored and is no longer as it was: found by its hashes, and opened to be rendered again.

Nothing is trusted for being there. What is undamaged is kept.
"""

from __future__ import annotations

import contextlib
import tarfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from typing import Any

from assets_procedural.conventions import console
from assets_procedural.conventions.files import sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.columns import row
from synthgen.dataset.folder import DatasetFolder, ShardFiles, StorageError
from synthgen.dataset.gate import inspect
from synthgen.dataset.records import ShardRecord, read_description
from synthgen.dataset.shards import decode
from synthgen.farm.commit import digest, read_waiting, unpack_shard, without_gaps
from synthgen.planning.plan import ShardPlan, subject_key

_AT_ONCE = 4


@dataclass
class Damage:
    """Committed shards, and waiting subjects (subset, key), that are not as they were stored."""

    shards: list[ShardPlan] = field(default_factory=list)
    waiting: list[tuple[str, str]] = field(default_factory=list)


def find_damage(folder: DatasetFolder, shards: Iterable[ShardPlan]) -> Damage:
    """Read everything that is stored of these shards, and compare it with its hashes."""
    committed: list[ShardPlan] = []
    waiting: list[tuple[str, str]] = []
    for shard in shards:
        if ledger.record_of(folder, shard.name) is not None:
            committed.append(shard)
            continue
        keys = map(subject_key, shard.subjects)
        waiting += [(shard.subset, k) for k in keys if ledger.waiting(folder, shard.subset, k)]
    checks = [partial(is_sound, folder, shard) for shard in committed]
    checks += [partial(_is_waiting_sound, folder, *subject) for subject in waiting]
    if not checks:
        return Damage()
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        found = threads.map(lambda check: check(), checks)
        sound = list(console.track(found, "checking what is stored", len(checks)))
    return Damage(
        [shard for shard, fine in zip(committed, sound, strict=False) if not fine],
        [one for one, fine in zip(waiting, sound[len(committed) :], strict=True) if not fine],
    )


def is_sound(folder: DatasetFolder, shard: ShardPlan) -> bool:
    """Whether a committed shard, its rows, and what its subjects have outside of it are as its
    record says, and the record names the subjects of the plan."""
    files, record = folder.shard(shard.name), ledger.record_of(folder, shard.name)
    if record is None or not _lists_its_subjects(record, shard):
        return False
    if not record.subjects:
        return not files.tar.exists()
    hashes = {files.tar: record.sha256, files.rows: record.part_sha256}
    with contextlib.suppress(StorageError):
        hashes |= {folder.inside(name): each for name, each in record.files.items()}
        return all(digest(path) == each for path, each in hashes.items())
    return False


def mend_shard(folder: DatasetFolder, shard: ShardPlan) -> list[str]:
    """Open a damaged shard: its sound subjects wait again for their shard.

    Returns the keys of the others. If only its rows were damaged they are written again, and the
    shard stays as it is.
    """
    files, record = folder.shard(shard.name), ledger.record_of(folder, shard.name)
    keys = [subject_key(index) for index in shard.subjects]
    if record is None or not record.subjects or not _lists_its_subjects(record, shard):
        files.record.unlink(missing_ok=True)
        return keys
    record = _with_rows(folder, shard, files, record)
    return [] if is_sound(folder, shard) else unpack_shard(folder, shard, record)


def _lists_its_subjects(record: ShardRecord, shard: ShardPlan) -> bool:
    return sorted(record.subjects + record.failed) == [subject_key(i) for i in shard.subjects]


def _is_waiting_sound(folder: DatasetFolder, subset: str, key: str) -> bool:
    try:
        read_waiting(folder, subset, key)
    except (OSError, ValueError, KeyError):
        return False
    return True


# ---------------------------------------------------------------- rows


def _with_rows(
    folder: DatasetFolder, shard: ShardPlan, files: ShardFiles, record: ShardRecord
) -> ShardRecord:
    """Write the rows of a shard again if they are damaged; the record as it is then."""
    if digest(files.rows) == record.part_sha256:
        return record
    rows = rows_in_manifest(folder, shard)
    if rows is None and digest(files.tar) == record.sha256:
        rows = rows_in_tar(folder, shard)
    if rows is None:
        return record
    manifest.write_part(files.rows, rows)
    mended = record.model_copy(update={"part_sha256": sha256(files.rows)})
    if mended != record:
        write_atomically(files.record, encode_json(mended.to_json()))
    return mended


def rows_in_manifest(folder: DatasetFolder, shard: ShardPlan) -> list[dict[str, Any]] | None:
    """A shard's rows from the merged manifest; None if that is damaged or lacks them."""
    path = folder.manifest(shard.subset)
    recorded = read_description(folder).files.get(folder.relative(path))
    if recorded is None or digest(path) != recorded:
        return None
    rows = manifest.read_rows(path, folder.relative(folder.shard(shard.name).tar))
    return [without_gaps(each) for each in rows] or None


def rows_in_tar(folder: DatasetFolder, shard: ShardPlan) -> list[dict[str, Any]] | None:
    """A sound shard's rows from its samples, without what they cost; None if one has no mesh."""
    tar = folder.shard(shard.name).tar
    rows = []
    for key, members, places in _samples(tar):
        shot = decode(key, members)
        subject = folder.subject(shard.subset, shot.meta["subject"])
        mesh = digest(subject.mesh)
        if mesh is None:
            return None
        last = places[-1]["offset"] + places[-1]["size"]
        start = places[0]["offset"] - tarfile.BLOCKSIZE
        place = {
            "shard": folder.relative(tar),
            "offset": start,
            "size": last + (-last % tarfile.BLOCKSIZE) - start,
            "members": places,
            "mesh": folder.relative(subject.mesh),
            "mesh_sha256": mesh,
        }
        rows.append(row(shot.meta, inspect(shot)[1], {}, place))
    return rows


def _samples(tar: Any) -> Iterator[tuple[str, dict[str, bytes], list[dict[str, Any]]]]:
    """Key, members and their places of each sample."""
    with tarfile.open(tar) as archive:
        for key, infos in groupby(archive, lambda info: info.name.partition(".")[0]):
            members, places = {}, []
            for info in infos:
                name = info.name.partition(".")[2]
                file = archive.extractfile(info)
                members[name] = b"" if file is None else file.read()
                places.append({"name": name, "offset": info.offset_data, "size": info.size})
            yield key, members, places
