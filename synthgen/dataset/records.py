"""What a dataset writes down about itself as JSON: dataset.json, and the records of the ledger."""

from __future__ import annotations

import json
from types import ModuleType
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from assets_procedural.conventions import colour, first_curve
from assets_procedural.conventions.errors import one_line
from assets_procedural.conventions.files import read_regular
from synthgen.dataset.folder import NAME, DatasetFolder, Place, StorageError, not_a_name

LARGEST_RECORD = 256 << 20
"""Bytes of a record that is read."""
FORMAT = 2
"""Of the datasets that are written, see docs/dataset.md."""
FORMATS = (1, FORMAT)
"""Of the datasets that are read."""


def curve(format: int) -> ModuleType:
    """The module whose `display` and `undisplay` the pictures of a format were made with."""
    return first_curve if format == 1 else colour


def averaged(format: int) -> bool:
    """Whether albedo and normals are means over the pixel, premultiplied by coverage.

    Else they are of one point of it, and 0 where `parts` is.
    """
    return format != 1


def storable(text: Any) -> Any:
    """A text without lone surrogates, which no file can hold."""
    return text.encode("utf-8", "replace").decode() if isinstance(text, str) else text


Words = Annotated[str, BeforeValidator(storable)]
"""Text that comes from somewhere else, such as an error's message."""


class Record(BaseModel):
    """Base of all records: they never change, and keys of other versions are passed through."""

    model_config = ConfigDict(frozen=True, strict=True, extra="allow")

    @classmethod
    def parse(cls, content: bytes, where: object) -> Self:
        """Read JSON; `StorageError` with one line, `where` first, if it is no such record.

        Texts may hold lone surrogates, which pydantic's own JSON reader refuses.
        """
        try:
            return cls.model_validate(json.loads(content))
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(map(str, first["loc"]))
            reason = ": ".join(part for part in (field, first["msg"]) if part)
            raise StorageError(f"{where}: unusable: {' '.join(reason.split())[:200]}") from None
        except (ValueError, RecursionError) as error:
            raise StorageError(f"{where}: not valid JSON ({error})") from None

    def to_json(self) -> dict[str, Any]:
        """What is stored: the fields that were given, in the order of the class."""
        return self.model_dump(exclude_unset=True)


# ---------------------------------------------------------------- dataset.json


class PlannedSubset(Record):
    """What the job asks of a subset."""

    kind: str
    subjects: int = Field(ge=0, le=10**9)
    shots_per_subject: int = Field(ge=1, le=10**6)
    frames_per_subject: int = Field(ge=0, le=10**9)

    @property
    def environments(self) -> int:
        """Environments of each subject."""
        return self.frames_per_subject // self.shots_per_subject


class Counts(Record):
    """What a split of a subset holds."""

    subjects: int = 0
    shots: int = 0
    frames: int = 0


class ShardSeal(Record):
    """A shard as dataset.json lists it: path in the folder, size, checksum."""

    tar: str
    bytes: int
    sha256: str


class Quarantined(Record):
    """A subject that was given up."""

    subset: str
    key: str
    reason: Words = ""


class Selection(Record):
    """What a dataset that was taken from another has of it.

    `source` is the sha256 of the other's dataset.json; the rest is what was asked of it, as
    `open_dataset` takes it.
    """

    source: str
    where: str = ""
    subset: str = ""
    split: str = ""
    tags: list[str] = []


class Description(Record):
    """dataset.json: what the dataset is and where it comes from.

    `job` is the validated job and `environments` the provenance of each panorama, as they were
    given. `files` holds sha256 by path: of panoramas from the start, of manifests too when the
    dataset is complete. From `counts` on, only a complete dataset has the fields; `counts` is by
    subset and split, `checksums` names the list of all its files.

    `selections`, in the order in which they were made, say that only some shots of the job are
    here. Such a dataset is complete as it is, and nothing is rendered into it.
    """

    format: int | None = None
    name: str = ""
    complete: bool = False
    job: dict[str, Any] = {}
    renderer: str = ""
    environments: list[dict[str, Any]] = []
    plan: dict[str, PlannedSubset]
    code: dict[str, str] = {}
    created: str = ""
    licences: list[dict[str, str]] = []
    files: dict[str, str] = {}
    counts: dict[str, dict[str, Counts]] = {}
    quarantined: list[Quarantined] = []
    shards: list[ShardSeal] = []
    checksums: str = ""
    selections: list[Selection] = []

    @model_validator(mode="after")
    def _named(self) -> Self:
        """Subsets and environments are parts of paths: they are looked at once, here."""
        names = [("subset", name) for name in self.plan]
        names += [("environment", entry["id"]) for entry in self.environments if "id" in entry]
        for what, name in names:
            if not isinstance(name, str) or not NAME.fullmatch(name):
                raise ValueError(not_a_name(str(name), what))
        return self


def read_description(out: Place) -> Description:
    """dataset.json; `StorageError` with one line if the folder is no dataset or it is damaged."""
    folder = DatasetFolder(out)
    return Description.parse(_description_bytes(folder), folder.description)


def description_json(folder: DatasetFolder) -> Any:
    """dataset.json as it is, whatever it holds; `StorageError` if there is none, or no JSON."""
    try:
        return json.loads(_description_bytes(folder))
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{folder.description}: not valid JSON ({error})") from None


def _description_bytes(folder: DatasetFolder) -> bytes:
    try:
        return read_regular(folder.description, LARGEST_RECORD)
    except FileNotFoundError:
        raise StorageError(f"{folder}: no dataset here (no dataset.json)") from None
    except NotADirectoryError:
        raise StorageError(f"{folder}: is a file, not a dataset folder") from None
    except OSError as error:  # a pipe, a folder, links in a circle
        raise StorageError(one_line(error)) from None


# ---------------------------------------------------------------- ledger


class ShardRecord(Record):
    """A committed shard: its subjects, those that failed, what it holds, its checksums.

    `subject_sha256` are of the bytes of each subject in the tar, `files` of their meshes and
    parameters by path; records of older versions lack both. A shard none of whose subjects could be
    rendered has a record, but no files and no checksums.
    """

    tar: str
    subjects: list[str]
    failed: list[str] = []
    shots: int
    frames: int
    bytes: int
    sha256: str = ""
    part_sha256: str = ""
    subject_sha256: list[str] = []
    files: dict[str, str] = {}

    @model_validator(mode="after")
    def _sealed(self) -> Self:
        if self.subjects and not (self.sha256 and self.part_sha256):
            raise ValueError("no checksums")
        if self.subject_sha256 and len(self.subject_sha256) != len(self.subjects):
            raise ValueError("not one checksum for each subject")
        return self


class Seal(Record):
    """What vouches for a subject that waits for its shard: size and sha256 of its tar entries,
    sha256 of its rows of the manifest as they are stored, and of its parameters."""

    bytes: int
    sha256: str
    rows_sha256: str
    parameters_sha256: str


class Failure(Record):
    """A subject that failed: how often it was tried, why it failed last, the log in the folder."""

    subset: str
    key: str
    attempts: int
    reason: Words
    log: Words


class RunNote(Record):
    """What a run tells `synthgen status`: times are seconds since the epoch.

    `running` lists (subset, key, start) of the subjects that are being rendered.
    """

    pid: int
    started: float
    workers: int
    frames: int
    running: list[Annotated[tuple[str, str, float], Field(strict=False)]]
