"""Where every file of a dataset lies; nothing else knows.

    dataset.json, README.md, croissant.json
    SHA256SUMS                               the hash of every published file
    manifest/<subset>.parquet                a row per shot
    environments/<id>.exr                    panoramas
    tracks/*.parquet                         recorded motions, of a job that has them
    data/<subset>/<split>-000000.tar         shards
    subjects/<subset>/<key>.glb, .json       canonical mesh, identity parameters
    ledger/<subset>/<split>-000000.json      the record that marks a shard as committed
    ledger/<subset>/<split>-000000.parquet   the shard's rows of the manifest
    ledger/failed/<subset>/<key>.json        attempts of a subject that failed, and the last reason
    ledger/dataset.json                      a copy of dataset.json, to mend it from
    work/<subset>/<key>.tar, .json           a finished subject that waits for its shard
    work/runs/<i>-of-<n>.json                what a running slice is busy with
    work/logs/<i>-of-<n>-worker-<k>.log      what its workers printed
    work/locks/                              see `synthgen.dataset.ledger`
    work/.temporary/<i>-of-<n>-…/            temporary files of a worker

Names come from jobs, from manifests and from whoever wrote a dataset: every one is checked here,
so that no path leads out of the folder.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from assets_procedural.conventions.errors import UserError

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,249}")
"""Subsets, keys, environments, splits: a name, never a path, and short enough for a file."""


Place = str | os.PathLike[str]
"""A dataset's folder as users give it; a `DatasetFolder` is one, too."""


class StorageError(UserError, RuntimeError):
    """A dataset folder that cannot be used as asked; the message is one line for the user."""


class DamageError(StorageError, ValueError):
    """A file of a dataset that is missing or damaged; the message says how to find out more."""

    def __init__(self, folder: object, what: str) -> None:
        super().__init__(f"{what}; `synthgen verify {folder}` lists what is damaged")


@dataclass(frozen=True)
class ShardFiles:
    """A shard: its tar, the record that marks it as committed, its rows of the manifest."""

    tar: Path
    record: Path
    rows: Path


@dataclass(frozen=True)
class SubjectFiles:
    """A subject: its mesh and parameters, what waits for its shard, and the note of its failures.

    `waiting_tar` holds its tar entries and `waiting_rows` its rows of the manifest; the subject is
    done when the latter is there.
    """

    mesh: Path
    parameters: Path
    waiting_tar: Path
    waiting_rows: Path
    failure: Path


class DatasetFolder:
    """The folder of a dataset, by the names of what lies in it.

    It stands for its path (`os.PathLike`, `str()`), which must be text: DuckDB takes no other.
    Methods raise `StorageError` with one line for a name that is not one; nothing is read or
    written.
    """

    def __init__(self, root: Place) -> None:
        self.root = Path(root)
        if not _is_text(str(self.root)):
            shown = json.dumps(str(self.root))
            raise StorageError(f"{shown}: the path is no UTF-8 text; rename the folder")
        self.description = self.root / "dataset.json"
        self.card = self.root / "README.md"
        self.croissant = self.root / "croissant.json"
        self.checksums = self.root / "SHA256SUMS"
        self.manifests = self.root / "manifest"
        self.environments = self.root / "environments"
        self.tracks = self.root / "tracks"
        self.data = self.root / "data"
        self.subjects = self.root / "subjects"
        self.ledger = self.root / "ledger"
        self.description_copy = self.ledger / "dataset.json"
        self.work = self.root / "work"
        self.logs = self.work / "logs"
        self.locks = self.work / "locks"
        self.temporary = self.work / ".temporary"

    def __fspath__(self) -> str:
        return str(self.root)

    def __str__(self) -> str:
        return str(self.root)

    def __repr__(self) -> str:
        return f"DatasetFolder({str(self.root)!r})"

    # ------------------------------------------------------------ by name

    def manifest(self, subset: str) -> Path:
        """The merged manifest of a subset."""
        return self.manifests / f"{self._name(subset, 'subset')}.parquet"

    def environment(self, identifier: str) -> Path:
        """A panorama."""
        return self.environments / f"{self._name(identifier, 'environment')}.exr"

    def shard(self, name: str) -> ShardFiles:
        """The files of the shard "<subset>/<split>-000000.tar", as plans name it."""
        subset, _, file = name.partition("/")
        stem, dot, ending = self._name(file, "shard").rpartition(".")
        if not dot or ending != "tar":
            raise StorageError(f"{self}: shard {brief(name)}: must be <subset>/<name>.tar")
        ledger = self.records(subset)
        return ShardFiles(
            tar=self.data / subset / file,
            record=ledger / f"{stem}.json",
            rows=ledger / f"{stem}.parquet",
        )

    def subject(self, subset: str, key: str) -> SubjectFiles:
        """The files of a subject by its key, such as "s000123"."""
        self._name(key, "key")
        waiting = self.waiting(subset)
        return SubjectFiles(
            mesh=self.subjects / subset / f"{key}.glb",
            parameters=self.subjects / subset / f"{key}.json",
            waiting_tar=waiting / f"{key}.tar",
            waiting_rows=waiting / f"{key}.json",
            failure=self.failed(subset) / f"{key}.json",
        )

    def log(self, run: str, worker: int) -> Path:
        """What a worker of the run "<i>-of-<n>" printed."""
        return self.logs / f"{self._name(run, 'run')}-worker-{worker}.log"

    def run_note(self, run: str) -> Path:
        """What the run "<i>-of-<n>" is busy with; there while it lasts."""
        return self.work / "runs" / f"{self._name(run, 'run')}.json"

    # ------------------------------------------------------------ by subset

    def records(self, subset: str) -> Path:
        """The folder of a subset's shard records, and of their rows."""
        return self.ledger / self._name(subset, "subset")

    def waiting(self, subset: str) -> Path:
        """The folder of a subset's finished subjects that wait for their shard."""
        return self.work / self._name(subset, "subset")

    def failed(self, subset: str) -> Path:
        """The folder of the notes about a subset's failed subjects."""
        return self.ledger / "failed" / self._name(subset, "subset")

    def committed(self, subset: str) -> Iterator[ShardFiles]:
        """The shards of a subset that have a record, by name."""
        for path in sorted(self.records(subset).glob("*.json")):
            if NAME.fullmatch(path.name):
                yield self.shard(f"{subset}/{path.stem}.tar")

    def folders(self, subset: str) -> tuple[Path, ...]:
        """All folders that hold files of a subset alone."""
        records, waiting, failed = self.records(subset), self.waiting(subset), self.failed(subset)
        return self.data / subset, self.subjects / subset, records, waiting, failed

    # ------------------------------------------------------------ all there are

    def failure_notes(self) -> list[Path]:
        """Notes about failed subjects, in order."""
        return sorted((self.ledger / "failed").glob("*/*.json"))

    def run_notes(self) -> list[Path]:
        """Notes of runs, in order."""
        return sorted((self.work / "runs").glob("*.json"))

    def published(self) -> Iterator[Path]:
        """Every file that a finished dataset is made of but `checksums` itself, in order.

        Beside the folders that a dataset owns, others may lie in its root: they are not its own.
        """
        yield from (p for p in (self.card, self.croissant, self.description) if p.is_file())
        for owned in (
            *(self.data, self.environments, self.ledger, self.manifests, self.subjects),
            self.tracks,
        ):
            for path in sorted(owned.rglob("*")):
                temporary = path.name.startswith(".") and path.suffix == ".tmp"
                if not temporary and (path.is_symlink() or not path.is_dir()):
                    yield path

    def has_results(self) -> bool:
        """Whether anything was rendered: a shard's record, a failure, or a subject that waits."""
        patterns = ("ledger/*/*.json", "ledger/failed/*/*.json", "work/*/s*.json")
        return any(True for pattern in patterns for _ in self.root.glob(pattern))

    # ------------------------------------------------------------ as records name them

    def relative(self, path: Path) -> str:
        """How manifests and records name a file of the folder: with slashes, from its root."""
        return path.relative_to(self.root).as_posix()

    def panoramas_pattern(self) -> str:
        """A glob of all panoramas, relative to the folder."""
        return f"{self.relative(self.environments)}/*.exr"

    def shards_pattern(self, subset: str, split: str = "") -> str:
        """A glob of the shards of a subset or of one of its splits, relative to the folder."""
        folder = self.relative(self.data / self._name(subset, "subset"))
        return f"{folder}/{split}-*.tar" if split else f"{folder}/*.tar"

    def inside(self, name: str) -> Path:
        """The inverse of `relative`; `StorageError` for a name that leads out of the folder."""
        parts = name.split("/")
        if "\0" in name or "\\" in name or any(p in ("", ".", "..") for p in parts):
            raise StorageError(f"{brief(name)}: lies outside the dataset")
        return self.root.joinpath(*parts)

    def _name(self, name: str, what: str) -> str:
        # What records hold may be of any type.
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise StorageError(f"{self}: {not_a_name(str(name), what)}")
        return name


def _is_text(path: str) -> bool:
    """Whether a path can be told to other programs: no null byte, none that is not UTF-8."""
    return "\0" not in path and not any("\ud800" <= character <= "\udfff" for character in path)


def subset_of(relative: str) -> str:
    """The subset of a shard, or of a subject that waits for one, as manifests name its file."""
    return relative.split("/")[1]


def not_a_name(text: str, what: str) -> str:
    """What a user is told about a name that is none."""
    return f"{what} {brief(text)}: use letters, digits, _, - and . only"


def brief(text: str) -> str:
    """Words of somebody else, quoted and shortened for a line."""
    return json.dumps(text if len(text) <= 80 else text[:77] + "...", ensure_ascii=False)


def is_sample(name: str, key: str) -> bool:
    """Whether a manifest's row names a shot by a name, in a file of two names, such as a shard."""
    parts = name.split("/")
    return len(parts) == 3 and all(map(NAME.fullmatch, (*parts, key)))
