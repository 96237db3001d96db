"""Rows for the grid: a page of a selection, and the rows of one shot or subject."""

from __future__ import annotations

import math
from typing import Any

from synthgen.browse.fields import GRID
from synthgen.browse.folder import Refused
from synthgen.browse.sandbox import quoted
from synthgen.browse.selection import Selection
from synthgen.browse.snapshot import Snapshot

_EXACT = 2**53  # what a number of JavaScript holds exactly


def page(snapshot: Snapshot, selection: Selection, offset: int, limit: int) -> list[dict[str, Any]]:
    """Rows `offset` to `offset + limit` of a selection: the columns of the grid, and of the sort.

    Rows that are equal in the sorted column come in the manifest's order.
    """
    names = [n for n in GRID if n in snapshot.columns]
    # Where the sample lies, to tell whether its shard is whole.
    names += [n for n in ("shard", "offset", "size") if n in snapshot.columns]
    if selection.sort and selection.sort not in names:
        names.append(selection.sort)
    condition, values = selection.condition()
    columns = ", ".join(map(quoted, names))
    if snapshot.in_memory:
        order = selection.order()
        order = f"{order}, rowid" if order else "ORDER BY rowid"
        # Of the rows that are not shown, only what is asked about is read.
        inner = (
            f"SELECT rowid FROM manifest WHERE {condition} {order} LIMIT {limit} OFFSET {offset}"
        )
        rows = snapshot.sandbox.ask(
            f"SELECT {columns} FROM manifest WHERE rowid IN ({inner}) {order}", values
        )
    else:
        rows = snapshot.sandbox.ask(
            f"SELECT {columns} FROM manifest WHERE {condition} {selection.order()} "
            f"LIMIT {limit} OFFSET {offset}",
            values,
        )
    return [dict(zip(names, map(plain, row), strict=True)) for row in rows]


def total(snapshot: Snapshot, selection: Selection) -> int:
    """How many rows a selection has."""
    condition, values = selection.condition()
    return snapshot.sandbox.ask(f"SELECT count(*) FROM manifest WHERE {condition}", values)[0][0]


def row(snapshot: Snapshot, subset: str, key: str) -> dict[str, Any]:
    """All columns of one shot, or of a subject that failed. Raises `Refused` if there is none."""
    names = list(snapshot.columns)
    rows = snapshot.sandbox.ask(
        f"SELECT {', '.join(map(quoted, names))} FROM manifest "
        'WHERE subset = ? AND "key" = ? LIMIT 1',
        [subset, key],
    )
    if not rows:
        raise Refused(f"no shot {subset}/{key} in this dataset")
    return dict(zip(names, map(plain, rows[0]), strict=True))


def plain(value: Any) -> Any:
    """A value of a row as JSON holds it: no NaN, and large integers as text."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _EXACT:
        return str(value)
    if isinstance(value, list):
        return [plain(v) for v in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
