"""A selection to take along: as SQL for Python and the command line, as keys, CSV or Parquet."""

from __future__ import annotations

import csv
import io
import shlex
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from synthgen.browse.folder import Refused
from synthgen.browse.table.selection import Selection
from synthgen.browse.table.snapshot import Snapshot
from synthgen.dataset.database import literal, quoted
from synthgen.dataset.manifest import Answer
from synthgen.publish import answers

MOST_PARQUET = 200_000
"""Rows of a Parquet file, which is made on disk before it is sent; CSV has no limit."""
MOST_NAMED = 500
"""Shots that a condition names by their keys."""
_CHUNK = 5_000


def describe(place: str, selection: Selection, tags_in: str | None = None) -> dict[str, str]:
    """What chooses the same shots elsewhere: `where`, a line of Python, a command.

    `place` is the folder as the user may see it, `tags_in` that of tags where it is another than
    the user's own.
    """
    where = selection.sql()
    arguments = f"{place!r}" + (f", where={where!r}" if where else "")
    option = f" --where {_shell(where)}" if where else ""
    if selection.tags:
        arguments += f", tags={list(selection.tags)!r}"
        option += f" --tags={','.join(selection.tags)}"
    if selection.tags and tags_in is not None:
        arguments += f", tags_in={tags_in!r}"
        option += f" --tags-in {_shell(tags_in)}"
    return {
        "where": where,
        "python": f"open_dataset({arguments})",
        "command": f"synthgen subset {_shell(place)}{option} --out NEW_DIR",
    }


def by_key(snapshot: Snapshot, selection: Selection) -> Selection:
    """The same shots by their keys; `Refused` for more than a line of SQL should hold."""
    found = b"".join(keys(snapshot, selection)).decode().split()
    if len(found) > MOST_NAMED:
        raise Refused(
            f"{len(found):,} shots cannot be named one by one, and errors of a run are columns of "
            f"this page alone; choose at most {MOST_NAMED}, or tag them",
            413,
        )
    named = ", ".join(map(literal, found))
    return Selection(where=f"subset || '/' || key IN ({named})" if found else "false")


def _shell(text: str) -> str:
    """A word for a shell: in double quotes where they read better and are safe."""
    return f'"{text}"' if "'" in text and not set(text) & set('"$`\\!') else shlex.quote(text)


def keys(snapshot: Snapshot, selection: Selection) -> Iterator[bytes]:
    """ "subset/key" of every shot on a line of its own, in the order of the selection."""
    chosen = rows(snapshot, selection)
    return (
        "".join(f"{subset}/{key}\n" for subset, key, failed in chunk if not failed).encode()
        for chunk in _chunks(snapshot, chosen, ["subset", "key", "failed"])
    )


def as_csv(snapshot: Snapshot, selection: Selection) -> Iterator[bytes]:
    """The rows with all columns of the page, as `synthgen query` writes them."""
    names = list(snapshot.columns)
    chosen = rows(snapshot, selection)

    def pieces() -> Iterator[bytes]:
        buffer = io.StringIO(newline="")
        lines = csv.writer(buffer, lineterminator="\n")
        lines.writerow(names)
        for chunk in _chunks(snapshot, chosen, names):
            lines.writerows([answers.cell(v) for v in row] for row in chunk)
            yield buffer.getvalue().encode(errors="backslashreplace")
            buffer.seek(0)
            buffer.truncate()

    return pieces()


def as_parquet(snapshot: Snapshot, selection: Selection) -> tempfile.TemporaryDirectory[str]:
    """A temporary folder with the rows as `rows.parquet`; raises `Refused` for too many."""
    chosen = rows(snapshot, selection)
    if len(chosen) > MOST_PARQUET:
        raise Refused(
            f"{len(chosen):,} rows are more than the {MOST_PARQUET:,} of a Parquet file from here; "
            "choose fewer, take CSV, or use synthgen query",
            413,
        )
    kinds = dict(snapshot.sandbox.ask("SELECT column_name, column_type FROM (DESCRIBE manifest)"))
    names = list(snapshot.columns)
    answer = Answer(names, [str(kinds[n]) for n in names], _chunks(snapshot, chosen, names))
    folder = tempfile.TemporaryDirectory()
    try:
        answers.write(answer, "parquet", Path(folder.name) / "rows.parquet")
    except BaseException:
        folder.cleanup()
        raise
    return folder


def rows(snapshot: Snapshot, selection: Selection) -> np.ndarray:
    """The numbers of the rows in the order of the page; `Refused` while they have none."""
    if not snapshot.in_memory:
        raise Refused("the dataset is being indexed; try again in a moment", 503)
    found = selection.rows(snapshot, ordered=True)
    return np.arange(snapshot.shots + snapshot.failures) if found is None else found


def _chunks(
    snapshot: Snapshot, rows: np.ndarray, names: list[str]
) -> Iterator[list[tuple[Any, ...]]]:
    columns = ", ".join(map(quoted, names))
    for start in range(0, len(rows), _CHUNK):
        wanted = rows[start : start + _CHUNK].tolist()
        place = {number: i for i, number in enumerate(wanted)}
        found = snapshot.sandbox.ask(
            f"SELECT rowid, {columns} FROM manifest WHERE rowid IN (SELECT unnest(?::BIGINT[]))",
            [wanted],
        )
        yield [row[1:] for row in sorted(found, key=lambda row: place[row[0]])]
