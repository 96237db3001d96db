"""Facets and histograms: how many rows of a selection have which values.

A column's own filter is left out of its counts: they say what another choice would show.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from synthgen.browse.folder import Refused
from synthgen.browse.table.codes import Coded
from synthgen.browse.table.fields import Column
from synthgen.browse.table.selection import Selection
from synthgen.browse.table.shots import plain
from synthgen.browse.table.snapshot import Snapshot


def count(
    snapshot: Snapshot, selection: Selection, names: Iterable[str] | None = None
) -> dict[str, Any]:
    """Facets as {column: [[value, count], …]} and histograms as {column: {edges, counts}}.

    Of all columns with values or a scale, or of those in `names`. A facet lists its values by their
    frequency in the selection, those without a row left out. Bins are the same for every selection,
    so that bars can be compared; the last includes its upper edge. `total` is the number of rows.
    """
    facets: dict[str, Any] = {}
    histograms: dict[str, Any] = {}
    constrained = selection.constrained()
    for column in _columns(snapshot, names):
        rows = selection.rows(snapshot, column.name if column.name in constrained else "")
        coded = snapshot.codes.of(column)
        found = coded.count(rows).tolist()
        if column.kind == "range":
            edges = [plain(edge) for edge in coded.edges]
            histograms[column.name] = {"edges": edges, "counts": found}
        else:
            pairs = [[plain(v), n] for v, n in zip(coded.values, found, strict=True) if n]
            facets[column.name] = sorted(pairs, key=lambda pair: -pair[1])
    rows = selection.rows(snapshot)
    total = snapshot.shots + snapshot.failures if rows is None else len(rows)
    return {"total": total, "facets": facets, "histograms": histograms}


def pairs(snapshot: Snapshot, selection: Selection, wanted: Iterable[str]) -> list[dict[str, Any]]:
    """How a selection covers two columns together: {x, y, x_edges, y_edges, counts}, counts by row.

    `wanted` are names such as "camera_yaw:camera_pitch"; both choices are left out of the counts
    that they make. A bin is two of the histograms'.
    """
    found = []
    for pair in wanted:
        x, y = _columns(snapshot, pair.split(":", 1))
        if x.kind != "range" or y.kind != "range":
            raise Refused(f"pairs: {pair[:80]!r}: give two columns of numbers", 400)
        a, b = (_coarser(snapshot.codes.of(column)) for column in (x, y))
        wide, high = (max(len(coded.edges) - 1, 0) for coded in (a, b))
        if not wide or not high:
            continue
        free = replace(
            selection,
            ranges={n: ends for n, ends in selection.ranges.items() if n not in (x.name, y.name)},
        )
        rows = free.rows(snapshot)
        across, down = (c.codes[:, 0] if rows is None else c.codes[rows, 0] for c in (a, b))
        both = (across < wide) & (down < high)
        cells = down[both].astype(np.int32) * wide + across[both]
        found.append(
            {
                "x": x.name,
                "y": y.name,
                "x_edges": [plain(edge) for edge in a.edges],
                "y_edges": [plain(edge) for edge in b.edges],
                "counts": np.bincount(cells, minlength=wide * high).tolist(),
            }
        )
    return found


def _coarser(coded: Coded) -> Coded:
    """A histogram with half the bins: a map has many more of them than its sides."""
    if len(coded.edges) <= 2:
        return coded
    return Coded(coded.codes // 2, [], [*coded.edges[:-1:2], coded.edges[-1]])


def _columns(snapshot: Snapshot, names: Iterable[str] | None) -> list[Column]:
    if names is None:
        return [c for c in snapshot.columns.values() if c.kind in ("facet", "range")]
    wanted = list(dict.fromkeys(names))
    for name in wanted:
        if name not in snapshot.columns or snapshot.columns[name].kind == "other":
            raise Refused(f"columns: nothing to count in {name[:80]!r}", 400)
    return [snapshot.columns[name] for name in wanted]
