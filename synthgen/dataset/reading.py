"""Reading a dataset: shots decoded to numpy, lazily, by subset, split and SQL filter.

    for shot in open_dataset("out/demo", subset="multiview", split="train"):
        shot.rgb, shot.depth, shot.meta["camera"]

Needs neither Blender nor torch. Of a dataset that is still being rendered, it reads what is done.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from assets_procedural.conventions.errors import one_line
from assets_procedural.conventions.files import read_regular
from synthgen.dataset import database, manifest
from synthgen.dataset import tags as marks
from synthgen.dataset.codecs import LARGEST, decode_exr
from synthgen.dataset.folder import (
    DamageError,
    DatasetFolder,
    Place,
    StorageError,
    brief,
    is_sample,
    subset_of,
)
from synthgen.dataset.records import Description, read_description
from synthgen.dataset.samples import Samples
from synthgen.dataset.shards import MEMBER_OF, decode, decode_fields, read_sample
from synthgen.dataset.shot import Shot

_PICTURE = re.compile(r"(rgb|hdr)_\d{2,}")
_PLACES = 'SELECT "key"::VARCHAR, shard::VARCHAR, "offset"::BIGINT, "size"::BIGINT FROM manifest'
_GONE = (FileNotFoundError, NotADirectoryError, IsADirectoryError)


class UnknownEnvironment(StorageError, KeyError):
    """No environment of that id; the message is one line for the user."""

    __str__ = Exception.__str__  # not that of KeyError, which quotes


@dataclass(frozen=True)
class Index:
    """Where N shots lie: `key` (N,) str, `offset` and `size` (N,) bytes in `shards[shard]`."""

    key: np.ndarray
    shard: np.ndarray
    offset: np.ndarray
    size: np.ndarray
    shards: tuple[str, ...]

    def subset(self, position: int) -> str:
        return subset_of(self.shards[self.shard[position]])


class Dataset:
    """Shots of a dataset in manifest order; made by `open_dataset`.

    `len(dataset)`, `dataset[3]`, `dataset["s000123_p04"]`, `for shot in dataset`. Only the index
    (some 50 bytes a shot) is kept in memory; files are opened per access, so instances may be sent
    to other processes.
    """

    def __init__(self, folder: DatasetFolder, description: Description, index: Index) -> None:
        self.folder = folder
        self.description = description
        self.index = index

    def __len__(self) -> int:
        return len(self.index.key)

    def __iter__(self) -> Iterator[Shot]:
        for position in range(len(self)):
            yield self[position]

    def __getitem__(self, which: int | str) -> Shot:
        """A shot by position or by key ("s000123_p04", or "multiview/s000123_p04").

        Raises `IndexError` or `KeyError` if there is none, `KeyError` if a key is ambiguous,
        `DamageError`, a `ValueError`, if its bytes are missing or damaged.
        """
        position = self.position(which)
        with self._telling_of_damage(position):
            shot = decode(str(self.index.key[position]), self._members(position))
            self._check_meta(position, shot.meta)
            return shot

    def find(self, key: str) -> Shot:
        """`dataset[key]` for a key that a user typed: raises `StorageError` with one line."""
        try:
            return self[key]
        except KeyError as error:
            raise StorageError(f"{self.folder}: {error.args[0]}") from None

    def read(self, which: int | str, fields: tuple[str, ...]) -> dict[str, Any]:
        """Decode some fields only: `rgb_00`, `hdr_00`, `albedo`, `normal`, `depth`, `meta`, …

        Raises as `dataset[which]` does, and `KeyError` for a field that the shot does not have.
        """
        for field in fields:
            if field not in MEMBER_OF and not _PICTURE.fullmatch(field):
                raise KeyError(f"no field {field}")
        wanted = {MEMBER_OF.get(f, f + (".exr" if f.startswith("hdr") else ".png")) for f in fields}
        position = self.position(which)
        with self._telling_of_damage(position):
            decoded = decode_fields(self._members(position, wanted))
            if "meta" in decoded:
                self._check_meta(position, decoded["meta"])
        return {name: decoded[name] for name in fields}

    def samples(self, fields: tuple[str, ...] | list[str]) -> Samples:
        """The chosen fields of every shot as arrays, for training; see `Samples`.

        Raises `StorageError` for a field that not all shots have.
        """
        return Samples(self, tuple(fields))

    def lights(self) -> int:
        """Environments that every shot has at least; 0 if there is no shot."""
        subsets = {subset_of(shard) for shard in self.index.shards}
        return min((self.description.plan[s].environments for s in subsets), default=0)

    def keys(self) -> list[str]:
        """ "<subset>/<key>" of all shots in order."""
        return [f"{self.index.subset(i)}/{key}" for i, key in enumerate(self.index.key)]

    def subjects(self) -> dict[tuple[str, str], list[int]]:
        """(subset, subject) -> positions of its shots, in order."""
        grouped: dict[tuple[str, str], list[int]] = {}
        for position, key in enumerate(self.index.key):
            subject = (self.index.subset(position), str(key).split("_")[0])
            grouped.setdefault(subject, []).append(position)
        return grouped

    def environment(self, identifier: str) -> np.ndarray:
        """A panorama, (H, 2H, 3) float32, linear Rec.709 radiance.

        Raises `UnknownEnvironment`, a `KeyError`, if the dataset has none of that id, `DamageError`
        if its file is missing, damaged, or changed since it was stored.
        """
        path = self.folder.environment(identifier)
        if not path.exists():
            known = {str(e.get("id")) for e in self.description.environments}
            if identifier not in known:
                raise UnknownEnvironment(f"{self.folder}: no environment {brief(identifier)}")
            raise DamageError(self.folder, f"{path}: is missing")
        try:
            content = read_regular(path, LARGEST)
            recorded = self.description.files.get(self.folder.relative(path))
            if recorded not in (None, hashlib.sha256(content).hexdigest()):
                raise DamageError(self.folder, f"{path}: changed since it was written")
            planes = decode_exr(content)
            return np.stack([planes[c] for c in "RGB"], -1).astype(np.float32)
        except DamageError:
            raise
        except Exception as error:  # OpenEXR raises what it likes on damaged bytes
            reason = f"{path}: does not decode: {one_line(error)[:160]}"
            raise DamageError(self.folder, reason) from error

    def position(self, which: int | str) -> int:
        """The place of a shot given by place or key; raises as `dataset[which]` does."""
        if not isinstance(which, str):
            if not -len(self) <= which < len(self):
                raise IndexError(f"{len(self)} shots, no number {which}")
            return int(which) % len(self)
        subset, _, name = which.rpartition("/")
        found = [int(i) for i in np.flatnonzero(self.index.key == name)]
        if subset:
            found = [i for i in found if self.index.subset(i) == subset]
        if not found:
            example = f"; keys look like {self.keys()[0]}" if len(self) else ""
            raise KeyError(f"no shot {which}{example}")
        if len(found) > 1:
            options = " or ".join(f"{self.index.subset(i)}/{name}" for i in found)
            raise KeyError(f"{which} is ambiguous: say {options}")
        return found[0]

    @contextlib.contextmanager
    def _telling_of_damage(self, position: int) -> Iterator[None]:
        """Whatever goes wrong while a shot is read, as the one line that says which shot it is."""
        try:
            yield
        except (ValueError, KeyError, StorageError, *_GONE) as error:
            reason = (
                f"{error.args[0]} is missing" if isinstance(error, KeyError) else one_line(error)
            )
            where = f"{self.index.subset(position)}/{self.index.key[position]}"
            raise DamageError(self.folder, f"{self.folder}: {where}: {reason}") from error

    def _members(self, position: int, wanted: set[str] | None = None) -> dict[str, bytes]:
        try:
            return self._read(position, wanted)
        except (OSError, ValueError):
            if not self._found_again():
                raise
        return self._read(position, wanted)

    def _read(self, position: int, wanted: set[str] | None) -> dict[str, bytes]:
        index = self.index
        path = self.folder.inside(index.shards[index.shard[position]])
        place = int(index.offset[position]), int(index.size[position])
        return read_sample(path, *place, str(index.key[position]), wanted)

    def _check_meta(self, position: int, meta: dict[str, Any]) -> None:
        there = f"{meta.get('subset')}/{meta.get('key')}"
        wanted = f"{self.index.subset(position)}/{self.index.key[position]}"
        if there != wanted:
            raise ValueError(f"meta.json of {wanted} is that of {there[:80]}")

    def _found_again(self) -> bool:
        """Look up where the shots are now; whether any of them has moved.

        While a dataset is rendered, subjects move from work files into their shard.
        """
        with contextlib.suppress(StorageError):
            if self.description.complete and read_description(self.folder) == self.description:
                return False
        with manifest.connect(self.folder) as connection:
            now = _index(self.folder, self.description, connection.execute(_PLACES))
        places = {(now.subset(i), str(key)): i for i, key in enumerate(now.key)}
        before, count = self.index, len(self)
        at = np.array(
            [places.get((before.subset(i), str(before.key[i])), -1) for i in range(count)], int
        )
        # Those that are gone stay where they were.
        self.index = Index(
            before.key,
            np.where(at < 0, before.shard + len(now.shards), now.shard[at]).astype(np.int32),
            np.where(at < 0, before.offset, now.offset[at]),
            np.where(at < 0, before.size, now.size[at]),
            now.shards + before.shards,
        )
        return any(
            before.shards[before.shard[i]] != self.index.shards[self.index.shard[i]]
            or before.offset[i] != self.index.offset[i]
            for i in range(count)
        )


def open_dataset(
    folder: Place,
    subset: str | None = None,
    split: str | None = None,
    where: str | None = None,
    tags: Sequence[str] = (),
    tags_in: Place | None = None,
) -> Dataset:
    """Open a dataset folder; `where` is an SQL condition on the manifest's columns.

    Of `tags`, such as ["star", "-reject"], a shot has every one, and none that begins with "-".
    They are read from the user's data folder, or from `tags_in`; see `synthgen.dataset.tags`.

    Raises `StorageError` if the folder is no dataset, has no such subset, split or tag, or the
    condition is wrong.
    """
    import duckdb

    folder = DatasetFolder(folder)
    description = read_description(folder)
    if subset is not None and subset not in description.plan:
        known = ", ".join(description.plan)
        raise StorageError(f"{folder}: no subset {subset}; it has {known}")
    if split not in (None, "train", "validation", "test"):
        raise StorageError(f"split {split!r}: must be train, validation or test")
    conditions = [f"({where}\n)"] if where else []
    values = []
    for name, value in (("subset", subset), ("split", split)):
        if value is not None:
            conditions.append(f"{name} = ?")
            values.append(value)
    clause = f" WHERE {' AND '.join(conditions)}" if conditions else ""
    sql = f"{_PLACES}{clause}"
    with manifest.connect(folder) as connection:
        try:
            if not database.only_reads(connection, sql):
                raise StorageError("where: must be a single condition, not several statements")
            index = database.interruptible(
                connection, lambda: _index(folder, description, connection.execute(sql, values))
            )
        except duckdb.Error as error:
            if where is None:
                reason = f"{folder}: the manifest cannot be read: {one_line(error)[:200]}"
                raise DamageError(folder, reason) from None
            raise StorageError(f"where: {' '.join(str(error).split())}") from None
    if tags:
        index = _tagged(folder, index, tags, tags_in)
    return Dataset(folder, description, index)


def _tagged(folder: DatasetFolder, index: Index, tags: Sequence[str], place: Place | None) -> Index:
    keys = [f"{index.subset(i)}/{key}" for i, key in enumerate(index.key)]
    kept = np.ones(len(keys), bool)
    for tag, shots in zip(tags, marks.choose(folder, tags, place), strict=True):
        has = np.fromiter((key in shots for key in keys), bool, len(keys))
        kept &= ~has if tag.startswith("-") else has
    used, shard = np.unique(index.shard[kept], return_inverse=True)
    shards = tuple(index.shards[number] for number in used)
    key, offset, size = index.key[kept], index.offset[kept], index.size[kept]
    return Index(key, shard.astype(np.int32), offset, size, shards)


def _index(folder: DatasetFolder, description: Description, rows: Any) -> Index:
    codes: dict[str, int] = {}
    keys, shards, places = [np.empty(0, "U1")], [np.empty(0, np.int32)], [np.empty((0, 2), int)]
    while chunk := rows.fetchmany(20_000):
        for key, shard, *place in chunk:
            if (
                None in (key, shard, *place)
                or not is_sample(shard, key)
                or subset_of(shard) not in description.plan
            ):
                named = f"{brief(str(shard))}, {brief(str(key))}"
                raise StorageError(f"{folder}: its manifest names no shot of it: {named}")
        keys.append(np.array([row[0] for row in chunk]))
        shards.append(np.array([codes.setdefault(row[1], len(codes)) for row in chunk], np.int32))
        places.append(np.array([row[2:] for row in chunk], np.int64))
    offset, size = np.concatenate(places).T
    return Index(np.concatenate(keys), np.concatenate(shards), offset, size, tuple(codes))
