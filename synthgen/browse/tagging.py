"""Tags on the page: who gives which, which rows have them, and the addresses that change them.

    /api/tags            GET: {person, writable, tags: [[name, shots]], people, problems}
                         POST {"add" | "remove": tag, "shots": [...] | "selection": query string},
                         answers that and `changed`, and `marks` with the tags of the shots
    /api/tags/undo       POST: takes the person's last change back

Tags change while a snapshot does not: they are masks over its rows, made anew for every change.
"""

from __future__ import annotations

import contextlib
import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from synthgen.browse.access.uploads import Uploads
from synthgen.browse.folder import Refused
from synthgen.browse.table import exports, selection
from synthgen.browse.table.selection import Selection
from synthgen.browse.table.snapshot import Library, Snapshot
from synthgen.dataset import tags as marks
from synthgen.dataset.folder import StorageError
from synthgen.dataset.records import Description, read_description
from synthgen.dataset.tags import Book, Tags

LARGEST_CHANGE = 8 << 20
"""Bytes of a request that changes tags."""


class Tagging:
    """The tags of a served dataset; may be used by several threads.

    `place` is the folder that they are kept in, `person` who changes them; None only reads.
    """

    def __init__(self, library: Library, place: Path, person: str | None) -> None:
        self.library, self.place = library, place
        self.problems: list[str] = []
        try:
            self.info = read_description(library.folder.layout)
        except StorageError:  # the page shows what it can of a damaged dataset
            self.info, person = Description(plan={}), None
        self.book = None if person is None else Book(place, self.info, person)
        self._lock = threading.Lock()
        self._seen: list[tuple[str, int, int]] | None = None
        self._tags = Tags()
        self._rows: tuple[Snapshot | None, dict[str, int]] = (None, {})
        self._masks: dict[str, np.ndarray] = {}

    def tags(self) -> Tags:
        """Everybody's tags as they are now; a file that makes no sense is one of `problems`."""
        with self._lock:
            return self._read()

    def kept(self, snapshot: Snapshot, chosen: Selection) -> Selection:
        """The selection with its tags resolved to the rows that have them."""
        if not chosen.tags:
            return chosen
        kept = np.ones(snapshot.shots + snapshot.failures, bool)
        for tag in chosen.tags:
            mask = self.mask(snapshot, tag.removeprefix("-"))
            kept &= ~mask if tag.startswith("-") else mask
        return replace(chosen, kept=kept)

    def mask(self, snapshot: Snapshot, tag: str) -> np.ndarray:
        """(N,) bool, the rows of a snapshot with a tag; `Refused` while they have no numbers."""
        if not snapshot.in_memory:
            raise Refused("the dataset is being indexed; try again in a moment", 503)
        with self._lock:
            tags = self._read()
            if self._rows[0] is not snapshot:
                self._rows, self._masks = (snapshot, {}), {}
            if tag not in self._masks:
                mask = np.zeros(snapshot.shots + snapshot.failures, bool)
                mask[self._numbers(snapshot, tags.shots(tag))] = True
                self._masks[tag] = mask
            return self._masks[tag]

    def count(self, snapshot: Snapshot, rows: np.ndarray | None) -> list[list[Any]]:
        """[[tag, how many of these rows have it], …], of all tags that there are."""
        found = []
        for tag in self.tags().names():
            mask = self.mask(snapshot, tag)
            found.append([tag, int(np.count_nonzero(mask if rows is None else mask[rows]))])
        return found

    def mark(self, rows: list[dict[str, Any]]) -> None:
        """Put `tags` into rows for the page, and `mine`, those that the person gives."""
        tags = self.tags()
        names = tags.names()
        sets = {name: tags.shots(name) for name in names}
        own = tags.by_person.get(self.book.person, {}) if self.book else {}
        for row in rows:
            key = f"{row.get('subset')}/{row.get('key')}"
            row["tags"] = [name for name in names if key in sets[name]]
            row["mine"] = [name for name in row["tags"] if key in own.get(name, ())]

    def describe(self) -> dict[str, Any]:
        """What the page needs to know: who tags, and what there is."""
        tags = self.tags()
        return {
            "person": self.book.person if self.book else None,
            "writable": self.book is not None,
            "tags": [[name, len(tags.shots(name))] for name in tags.names()],
            "people": [] if self.library.folder.hidden else sorted(tags.by_person),
            "problems": [] if self.library.folder.hidden else self.problems,
        }

    async def change(self, request: Request, uploads: Uploads) -> dict[str, Any]:
        """Do what the body of a request asks for; raises `Refused` for what cannot be."""
        book = self._writing(request)
        try:
            asked = json.loads(await uploads.read(request, LARGEST_CHANGE))
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict) or ("add" in asked) == ("remove" in asked):
            raise Refused(
                'give JSON such as {"add": "star", "shots": ["multiview/s000000_p00"]}', 400
            )
        added = "add" in asked
        tag = asked["add" if added else "remove"]
        if not isinstance(tag, str):
            raise Refused("tags: a tag is a text", 400)
        return await run_in_threadpool(self._change, book, added, tag, asked)

    async def undo(self, request: Request) -> dict[str, Any]:
        """Take the person's last change back; raises `Refused` if there is none."""
        book = self._writing(request)
        change = await run_in_threadpool(book.undo)
        if change is None:
            raise Refused("there is nothing to undo", 409)
        undone = {"added": change.added, "tag": change.tag, "shots": len(change.shots)}
        return self.describe() | {"undone": undone}

    def _writing(self, request: Request) -> Book:
        if self.book is None:
            raise Refused("tags are read-only here", 403)
        # A form of another site cannot send this type.
        if request.headers.get("content-type", "").split(";")[0].strip() != "application/json":
            raise Refused("send application/json", 415)
        return self.book

    def _change(self, book: Book, added: bool, tag: str, asked: dict[str, Any]) -> dict[str, Any]:
        shots = asked.get("shots")
        if isinstance(asked.get("selection"), str):
            snapshot = self.library.snapshot()
            query = dict(parse_qsl(asked["selection"].removeprefix("?")))
            chosen = self.kept(snapshot, selection.parse(query, snapshot))
            count = len(exports.rows(snapshot, chosen))
            if count > marks.MOST_SHOTS:
                raise Refused(
                    f"{count:,} shots are more than the {marks.MOST_SHOTS:,} that are tagged at "
                    "once; choose fewer",
                    413,
                )
            shots = b"".join(exports.keys(snapshot, chosen)).decode().split()
        if not isinstance(shots, list):
            raise Refused("tags: give shots or a selection", 400)
        try:
            changed = book.change(added, tag, shots)
        except StorageError as error:
            raise Refused(str(error), 400) from None
        answer = self.describe() | {"changed": changed}
        if "selection" not in asked:
            rows: list[dict[str, Any]] = []
            for shot in shots:
                subset, key = shot.split("/")
                rows.append({"subset": subset, "key": key})
            self.mark(rows)
            answer["marks"] = {
                shot: {"tags": row["tags"], "mine": row["mine"]}
                for shot, row in zip(shots, rows, strict=True)
            }
        return answer

    def _read(self) -> Tags:
        seen = []
        found = marks.files(self.place, self.info)
        for path in found:
            with contextlib.suppress(OSError):
                stat = path.stat()
                seen.append((path.name, stat.st_mtime_ns, stat.st_size))
        if seen != self._seen:
            tags, problems = Tags(), []
            for path in found:
                try:
                    tags.by_person[path.stem] = marks.state(marks.changes(path))
                except StorageError as error:
                    problems.append(str(error).replace(f"{path.parent}/", ""))
            self._tags, self.problems, self._seen, self._masks = tags, problems, seen, {}
        return self._tags

    def _numbers(self, snapshot: Snapshot, shots: set[str]) -> list[int]:
        """The rows of shots, looked up once each."""
        known = self._rows[1]
        if new := [shot.split("/") for shot in shots if shot not in known]:
            subsets, keys = map(list, zip(*new, strict=True))
            found = snapshot.sandbox.ask(
                'SELECT m.rowid, m.subset, m."key" FROM manifest m '
                "JOIN (SELECT unnest(?::VARCHAR[]) AS subset, unnest(?::VARCHAR[]) AS k) t "
                'ON m.subset = t.subset AND m."key" = t.k WHERE NOT m.failed',
                [subsets, keys],
            )
            known |= dict.fromkeys(shots - known.keys(), -1)
            known |= {f"{subset}/{key}": number for number, subset, key in found}
        return [number for shot in shots if (number := known[shot]) >= 0]
