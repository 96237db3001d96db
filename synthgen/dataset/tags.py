"""Tags of shots: stars, rejects and words of one's own, kept outside of the dataset.

What a person says of a dataset is a file, `<folder>/<identity>/<person>.jsonl`, a change a line:

    {"add": "star", "shots": ["multiview/s000003_p01"]}
    {"remove": "star", "shots": ["multiview/s000003_p01"]}
    {"undo": true}

A line names only shots that it changes, so that each can be undone. Several people's tags are
their files side by side: a shot has a tag if anybody gives it.
"""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from assets_procedural.conventions.errors import one_line
from assets_procedural.conventions.files import data_folder, read_regular, write_atomically
from synthgen.dataset.folder import NAME, Place, StorageError, brief
from synthgen.dataset.records import Description, read_description

STAR, REJECT = "star", "reject"
TAG = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}")
MOST_SHOTS = 100_000
"""Shots of one change."""
_LARGEST = 256 << 20  # bytes of a person's file


def identity(info: Description) -> str:
    """A name for a dataset that says which shots its keys mean, 16 hex digits.

    The same for a dataset that has grown, for a copy, and for a selection (`synthgen subset`).
    """
    job = {name: value for name, value in info.job.items() if name != "subsets"}
    pool = [(e.get("id"), e.get("sha256")) for e in info.environments]
    essence = json.dumps([job, info.renderer, info.code, pool], sort_keys=True)
    return hashlib.sha256(essence.encode()).hexdigest()[:16]


def tags_folder() -> Path:
    """Where tags are kept unless another folder is given."""
    return data_folder() / "tags"


@dataclass
class Tags:
    """What people say of the shots of a dataset: person -> tag -> "subset/key"."""

    by_person: dict[str, dict[str, set[str]]] = field(default_factory=dict)

    def shots(self, tag: str) -> set[str]:
        """The shots that anybody gives a tag."""
        return set().union(*(tags.get(tag, ()) for tags in self.by_person.values()))

    def names(self) -> list[str]:
        """All tags that a shot has: star and reject first, then by name."""
        names = {t for tags in self.by_person.values() for t, shots in tags.items() if shots}
        return sorted(names, key=lambda tag: (tag not in (STAR, REJECT), tag == REJECT, tag))

    def people(self, tag: str) -> dict[str, int]:
        """How many shots each person gives a tag."""
        counts = Counter({p: len(tags.get(tag, ())) for p, tags in self.by_person.items()})
        return dict(+counts)


def files(place: Path, info: Description) -> list[Path]:
    """The people's files of a dataset, by name."""
    folder = place / identity(info)
    with contextlib.suppress(OSError):
        return sorted(p for p in folder.iterdir() if p.suffix == ".jsonl" and TAG.fullmatch(p.stem))
    return []


def read(place: Path, info: Description) -> Tags:
    """Everybody's tags of a dataset; raises `StorageError` for a file that is none of tags."""
    return Tags({path.stem: state(changes(path)) for path in files(place, info)})


def take(path: Path, place: Path, info: Description) -> Path:
    """Put another person's file beside those of `place`; returns where it is.

    Raises `StorageError` if it makes no sense, or would replace one that says what it does not.
    """
    book = Book(place, info, path.stem)
    here, there = changes(book.path), changes(path)
    if not path.exists():
        raise StorageError(f"{path}: no such file")
    if here[: len(there)] != there and there[: len(here)] != here:
        raise StorageError(
            f"{path}: {book.path} has other changes by {path.stem}; rename one of them"
        )
    if len(there) > len(here):
        write_atomically(book.path, path.read_bytes())
    return book.path


def user() -> str:
    """The user's name as that of a file; "me" where it is none."""
    try:
        name = getpass.getuser()
    except (OSError, KeyError, ImportError):
        name = ""
    return name if TAG.fullmatch(name) else "me"


def choose(dataset: Place, tags: Sequence[str], place: Place | None = None) -> Iterator[set[str]]:
    """The shots of each tag asked for, in order; raises `StorageError` for an unknown tag.

    A tag that begins with "-" asks for the shots without it, but gives the same set.
    """
    info = read_description(dataset)
    known = read(Path(place) if place is not None else tags_folder(), info)
    for tag in map(bare, tags):
        if tag not in (STAR, REJECT) and tag not in known.names():
            names = ", ".join(known.names()) or "none"
            raise StorageError(f"tags: no shot of {dataset} is tagged {brief(tag)}; tags: {names}")
        yield known.shots(tag)


def bare(tag: str) -> str:
    """The name of the tag in "star" or "-star"; `StorageError` if it is none."""
    name = tag.removeprefix("-")
    if not TAG.fullmatch(name):
        raise StorageError(f"tags: {brief(tag)}: use letters, digits, _, - and . only")
    return name


# ---------------------------------------------------------------- a person's file


@dataclass(frozen=True)
class Change:
    """A tag that was given to shots, or taken from them."""

    added: bool
    tag: str
    shots: tuple[str, ...]


def changes(path: Path) -> list[Change]:
    """What a person has changed and not undone; `StorageError` if the file makes no sense."""
    try:
        content = read_regular(path, _LARGEST)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StorageError(one_line(error)) from None
    found: list[Change] = []
    for number, line in enumerate(content.splitlines(), 1):
        try:
            entry = json.loads(line)
            if entry == {"undo": True}:
                found.pop()
            else:
                found.append(_change(entry))
        except (ValueError, IndexError, RecursionError) as error:
            reason = one_line(error)[:160]
            raise StorageError(f"{path}: line {number}: is no change of tags ({reason})") from None
    return found


def _change(entry: Any) -> Change:
    if not isinstance(entry, dict):
        raise ValueError("it is no object")
    action = "add" if "add" in entry else "remove"
    tag, shots = entry.get(action), entry.get("shots")
    if not isinstance(tag, str) or not TAG.fullmatch(tag):
        raise ValueError("its tag is no name")
    return Change(action == "add", tag, tuple(_checked(shots)))


def _checked(shots: Any) -> list[str]:
    if not isinstance(shots, list) or len(shots) > MOST_SHOTS:
        raise ValueError(f"give a list of at most {MOST_SHOTS:,} shots")
    for shot in shots:
        parts = shot.split("/") if isinstance(shot, str) else []
        if len(parts) != 2 or not all(map(NAME.fullmatch, parts)):
            raise ValueError(f"{brief(str(shot))} is no shot")
    return shots


def state(changes: Iterable[Change]) -> dict[str, set[str]]:
    """Tag -> shots after changes."""
    found: dict[str, set[str]] = {}
    for change in changes:
        shots = found.setdefault(change.tag, set())
        if change.added:
            shots.update(change.shots)
        else:
            shots.difference_update(change.shots)
    return found


class Book:
    """A person's file, to be written: each change is appended at once, or not at all."""

    def __init__(self, place: Path, info: Description, person: str) -> None:
        if not TAG.fullmatch(person):
            raise StorageError(
                f"tags: {brief(person)} is no name of a file; give another: letters, digits, _, - "
                "and . only"
            )
        self.person = person
        self.path = place / identity(info) / f"{person}.jsonl"

    def change(self, added: bool, tag: str, shots: Sequence[str]) -> int:
        """Give or take a tag; returns how many shots that changes.

        Raises `StorageError` for what is no tag or no shot, or if the file cannot be written.
        """
        tag = bare(tag)
        try:
            wanted = dict.fromkeys(_checked(list(shots)))
        except ValueError as error:
            raise StorageError(f"tags: {error}") from None
        with self._locked():
            has = state(changes(self.path)).get(tag, set())
            changed = [shot for shot in wanted if (shot in has) != added]
            if changed:
                self._append({"add" if added else "remove": tag, "shots": changed})
        return len(changed)

    def undo(self) -> Change | None:
        """Take the last change back; None if there is none left."""
        with self._locked():
            found = changes(self.path)
            if found:
                self._append({"undo": True})
        return found[-1] if found else None

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        import fcntl

        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.with_suffix(".lock").open("a") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                yield
        except OSError as error:
            raise StorageError(f"tags cannot be written: {one_line(error)}") from None

    def _append(self, entry: dict[str, Any]) -> None:
        line = json.dumps(entry, separators=(",", ":")).encode() + b"\n"
        with self.path.open("ab") as file:
            if file.write(line) != len(line):
                raise OSError("the disk is full")
