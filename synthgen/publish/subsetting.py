"""A selection of a finished dataset as a dataset of its own: `synthgen subset`.

Files that are kept whole are hard links to those of the other dataset (copies where that cannot
be); of a shard that is kept in part, whole samples are copied byte for byte. Nothing is decoded.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from assets_procedural.conventions import console
from assets_procedural.conventions.files import (
    check_regular,
    open_regular,
    replacing,
    sha256,
    write_atomically,
)
from synthgen.dataset import database, ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.folder import DamageError, DatasetFolder, Place, ShardFiles, StorageError
from synthgen.dataset.reading import Dataset
from synthgen.dataset.records import Selection, ShardRecord
from synthgen.dataset.shards import BLOCK
from synthgen.publish import publish

_PIECE = 1 << 22


@dataclass(frozen=True)
class Taken:
    """What a selection has become: its folder, what is in it, bytes that were copied for it."""

    folder: Path
    subjects: int
    shots: int
    copied: int


def take(chosen: Dataset, out: Place, asked: Selection) -> Taken:
    """Write the shots that `open_dataset` chose as a complete dataset, whole or not at all.

    `asked` is what was asked of it, for dataset.json; its `source` is filled in.

    Raises `StorageError` if `out` exists, the dataset is not complete, or no shot is chosen,
    `DamageError` if what is to be copied is not as it was stored; then nothing is left.
    """
    target, source = Path(out), chosen.folder
    if os.path.lexists(target):
        raise StorageError(f"{target}: exists; give a new folder with --out")
    if not chosen.description.complete:
        raise StorageError(f"{source}: is not complete; finish it with `synthgen render` first")
    if not len(chosen):
        raise StorageError(f"{source}: no shot is chosen; ask for others")
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    temporary.mkdir(parents=True)
    try:
        taking = _Taking(source, DatasetFolder(temporary))
        subjects = taking.fill(chosen, asked)
        temporary.rename(target)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return Taken(target, subjects, len(chosen), taking.copied)


class _Taking:
    """Filling one folder from another."""

    def __init__(self, source: DatasetFolder, folder: DatasetFolder) -> None:
        self.source, self.folder = source, folder
        self.root = source.root.resolve()
        self.copied = 0
        self.lights: set[str] = set()  # panoramas of the shots

    def fill(self, chosen: Dataset, asked: Selection) -> int:
        info, index = chosen.description, chosen.index
        subjects = 0
        order = np.argsort(index.shard, kind="stable")
        ends = np.searchsorted(index.shard[order], np.arange(len(index.shards) + 1))
        for number in console.track(range(len(index.shards)), "writing shards"):
            keys = {str(k) for k in index.key[order[ends[number] : ends[number + 1]]]}
            _, subset, file = index.shards[number].split("/")
            subjects += self._shard(f"{subset}/{file}", keys)
        described = sha256(self.source.description)
        selection = asked.model_copy(update={"source": described})
        panoramas = {}
        for identifier in sorted(self.lights):
            panorama = self.source.environment(identifier)
            name = self.source.relative(panorama)
            self._link(panorama, self.folder.environment(identifier))
            panoramas[name] = info.files.get(name) or sha256(panorama)
        publish.write_description(
            self.folder,
            info.model_copy(
                update={
                    "complete": False,
                    "files": panoramas,
                    "selections": [*info.selections, selection],
                }
            ),
        )
        assert publish.complete(self.folder)
        return subjects

    def _shard(self, name: str, keys: set[str]) -> int:
        """Take the shots `keys` of a shard; returns how many subjects they are of."""
        files, taken = self.source.shard(name), self.folder.shard(name)
        record = ledger.shard_record(self.source, name)
        if record is None or sha256(files.rows) != record.part_sha256:
            raise DamageError(self.source, f"{files.tar}: it, its rows or its record is damaged")
        samples = _samples(files)
        there = [sample for sample in samples if sample.key in keys]
        if len(there) != len(keys):
            raise DamageError(self.source, f"{files.rows}: lacks shots of the manifest")
        subjects = list(dict.fromkeys(sample.subject for sample in there))
        self.lights.update(light for sample in there for light in sample.lights)
        if len(there) == len(samples):
            self._link(files.tar, taken.tar)
            self._link(files.rows, taken.rows)
        else:
            record = self._copy(files, taken, record, samples, there)
        beside = {}
        for key in subjects:
            own, mine = (f.subject(name.split("/")[0], key) for f in (self.source, self.folder))
            for path, target in ((own.mesh, mine.mesh), (own.parameters, mine.parameters)):
                self._link(path, target)
                relative = self.source.relative(path)
                beside[relative] = record.files.get(relative) or sha256(path)
        record = record.model_copy(update={"failed": [], "files": beside})
        write_atomically(taken.record, encode_json(record.to_json()))
        return len(subjects)

    def _copy(
        self,
        files: ShardFiles,
        taken: ShardFiles,
        record: ShardRecord,
        samples: list[_Sample],
        there: list[_Sample],
    ) -> ShardRecord:
        """Write a shard of some samples, and their rows; its record, but for `files`."""
        self._inside(files.tar)
        _check(self.source, files, record, samples, {sample.subject for sample in there})
        whole, own, places = hashlib.sha256(), {}, {}
        position = 0
        with open_regular(files.tar) as file, replacing(taken.tar) as written:
            for sample in there:
                places[sample.key] = position
                for piece in _pieces(file, sample.offset, sample.size):
                    written.write(piece)
                    whole.update(piece)
                    own.setdefault(sample.subject, hashlib.sha256()).update(piece)
                position += sample.size
            tail = 2 * BLOCK
            tail += -(position + tail) % tarfile.RECORDSIZE
            written.write(bytes(tail))
            whole.update(bytes(tail))
        self.copied += position
        _write_rows(taken.rows, files.rows, places)
        return record.model_copy(
            update={
                "subjects": list(own),
                "shots": len(there),
                "frames": sum(len(sample.lights) for sample in there),
                "bytes": position + tail,
                "sha256": whole.hexdigest(),
                "part_sha256": sha256(taken.rows),
                "subject_sha256": [digest.hexdigest() for digest in own.values()],
            }
        )

    def _link(self, path: Path, target: Path) -> None:
        self._inside(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, target)
        except OSError:  # another disk, or one without links
            shutil.copyfile(path, target)
            self.copied += target.stat().st_size

    def _inside(self, path: Path) -> None:
        """A stranger's dataset must not put files of this machine into a folder to be shared."""
        try:
            check_regular(path)
        except OSError as error:
            raise DamageError(self.source, f"{path}: {error.strerror}") from None
        if self.root not in path.resolve().parents:
            raise StorageError(f"{path}: is a link that leads out of the dataset")


@dataclass(frozen=True)
class _Sample:
    """A shot's bytes in its shard, and its environments."""

    key: str
    subject: str
    offset: int
    size: int
    lights: list[str]


def _samples(files: ShardFiles) -> list[_Sample]:
    """All samples of a shard, as they lie in it."""
    with database.locked([files.rows]) as connection:
        rows = connection.execute(
            'SELECT "key", subject, "offset", "size", environments '
            f'FROM {manifest.parquet_source([files.rows])} ORDER BY "offset"'
        ).fetchall()
    return [_Sample(*row) for row in rows]


def _check(
    folder: DatasetFolder,
    files: ShardFiles,
    record: ShardRecord,
    samples: list[_Sample],
    subjects: set[str],
) -> None:
    """Raise `DamageError` unless the bytes of these subjects are as they were stored."""
    if not record.subject_sha256:
        if sha256(files.tar) != record.sha256:
            raise DamageError(folder, f"{files.tar}: changed since it was written")
        return
    with open_regular(files.tar) as file:
        for key, expected in zip(record.subjects, record.subject_sha256, strict=True):
            own = [sample for sample in samples if sample.subject == key]
            if key not in subjects or not own:
                continue
            digest, end = hashlib.sha256(), own[-1].offset + own[-1].size
            for piece in _pieces(file, own[0].offset, end - own[0].offset):
                digest.update(piece)
            if digest.hexdigest() != expected:
                raise DamageError(folder, f"{files.tar}: {key} changed since it was written")


def _pieces(file: BinaryIO, offset: int, size: int) -> Iterator[bytes]:
    file.seek(offset)
    while size > 0 and (piece := file.read(min(size, _PIECE))):
        yield piece
        size -= len(piece)


def _write_rows(target: Path, source: Path, places: dict[str, int]) -> None:
    """The rows of these keys, whose samples lie elsewhere now: key -> first byte."""
    moved = ", ".join(f"({database.literal(key)}, {at})" for key, at in places.items())
    place = "{'name': m.name, 'offset': m.\"offset\" + p.place - r.\"offset\", 'size': m.\"size\"}"
    manifest.write_parquet(
        target,
        [source],
        f"""SELECT r.* REPLACE (
            p.place::BIGINT AS "offset", [{place} for m in r.members] AS members
        ) FROM {manifest.parquet_source([source])} r
        JOIN (VALUES {moved}) p("key", place) ON r."key" = p."key" ORDER BY p.place""",
    )
