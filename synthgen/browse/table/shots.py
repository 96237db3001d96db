"""Rows for the grid: a page of a selection, and the rows of one shot or subject."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

from synthgen.browse.folder import Refused
from synthgen.browse.table.fields import GRID
from synthgen.browse.table.selection import Selection
from synthgen.browse.table.snapshot import Snapshot
from synthgen.dataset.database import quoted

PLACE = ("key", "shard", "offset", "size", "failed", "reason")
"""Columns that say where the bytes of a shot lie."""
_EXACT = 2**53  # what a number of JavaScript holds exactly


def page(
    snapshot: Snapshot, selection: Selection, offset: int, limit: int
) -> tuple[int, list[dict[str, Any]]]:
    """How many rows a selection has, and those from `offset` on, `limit` at most.

    A row has the columns of the grid, of the sort, and of the place of its bytes. Rows that are
    equal in the sorted column come in the manifest's order.
    """
    names = [n for n in dict.fromkeys((*GRID, *PLACE)) if n in snapshot.columns]
    if selection.sort and selection.sort not in names:
        names.append(selection.sort)
    columns = ", ".join(map(quoted, names))
    condition, values = selection.condition()
    if snapshot.in_memory:
        found = snapshot.matches.rows(condition, values, selection.order())
        if selection.kept is not None:
            found = found[selection.kept[found]]
        wanted = found[offset : offset + limit].tolist()
        rows = snapshot.sandbox.ask(
            f"SELECT rowid, {columns} FROM manifest WHERE rowid IN (SELECT unnest(?::BIGINT[]))",
            [wanted],
        )
        place = {number: i for i, number in enumerate(wanted)}
        rows = [row[1:] for row in sorted(rows, key=lambda row: place[row[0]])]
        total = len(found)
    else:
        rows = snapshot.sandbox.ask(
            f"SELECT {columns} FROM manifest WHERE {condition} {selection.order()} "
            f"LIMIT {limit} OFFSET {offset}",
            values,
        )
        total = snapshot.shots + snapshot.failures
        if condition != "true":
            ((total,),) = snapshot.sandbox.ask(
                f"SELECT count(*) FROM manifest WHERE {condition}", values
            )
    return total, [dict(zip(names, map(plain, row), strict=True)) for row in rows]


def row(snapshot: Snapshot, subset: str, key: str, wanted: tuple[str, ...] = ()) -> dict[str, Any]:
    """One shot, or a subject that failed: all of its columns, or those `wanted` that there are.

    Raises `Refused` if there is none.
    """
    names = [n for n in wanted or snapshot.columns if n in snapshot.columns]
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
    if isinstance(value, Decimal):
        value = float(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _EXACT:
        return str(value)
    if isinstance(value, list):
        return [plain(v) for v in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
