"""How a selection is spread over the values of every column.

The counts of a column leave its own choice out: they say what another choice there would show.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from synthgen.browse.fields import Column
from synthgen.browse.folder import Refused
from synthgen.browse.sandbox import quoted
from synthgen.browse.selection import Selection
from synthgen.browse.shots import plain
from synthgen.browse.snapshot import Snapshot

BINS = 32
_VALUES = 200  # of a facet, the most frequent


def count(
    snapshot: Snapshot, selection: Selection, names: Iterable[str] | None = None
) -> dict[str, Any]:
    """Facets as {column: [[value, count], …]} and histograms as {column: {edges, counts}}.

    Of all columns with values or a scale, or of those in `names`. Bins are the same for every
    selection, so that bars can be compared; the last one includes its upper edge.
    """
    chosen = _columns(snapshot, names)
    facets: dict[str, Any] = {}
    histograms: dict[str, Any] = {}
    for column in chosen:
        condition, values = selection.condition(without=column.name)
        if column.kind == "facet":
            facets[column.name] = _facet(snapshot, column, condition, values)
        else:
            histograms[column.name] = _histogram(snapshot, column, condition, values)
    return {"facets": facets, "histograms": histograms}


def _columns(snapshot: Snapshot, names: Iterable[str] | None) -> list[Column]:
    if names is None:
        return [c for c in snapshot.columns.values() if c.kind in ("facet", "range")]
    wanted = list(dict.fromkeys(names))
    for name in wanted:
        if name not in snapshot.columns or snapshot.columns[name].kind == "other":
            raise Refused(f"columns: nothing to count in {name[:80]!r}", 400)
    return [snapshot.columns[name] for name in wanted]


def _facet(
    snapshot: Snapshot, column: Column, condition: str, values: list[Any]
) -> list[list[Any]]:
    name = quoted(column.name)
    source = f"SELECT {f'unnest({name})' if column.listed else name} AS v FROM manifest"
    rows = snapshot.sandbox.ask(
        f"SELECT v, count(*) AS n FROM ({source} WHERE {condition}) "
        f"GROUP BY v ORDER BY n DESC, v LIMIT {_VALUES}",
        values,
    )
    return [[plain(v), n] for v, n in rows]


def _histogram(
    snapshot: Snapshot, column: Column, condition: str, values: list[Any]
) -> dict[str, Any]:
    name = quoted(column.name)
    ((low, high),) = snapshot.sandbox.ask(
        f"SELECT min({name}), max({name}) FROM manifest WHERE isfinite({name}::DOUBLE)"
    )
    if low is None:
        return {"edges": [], "counts": []}
    bins = BINS if high > low else 1
    step = (high - low) / bins or 1.0
    rows = snapshot.sandbox.ask(
        f"SELECT least(floor(({name} - ?) / ?), {bins - 1})::INTEGER AS bin, count(*) "
        f"FROM manifest WHERE isfinite({name}::DOUBLE) AND {condition} GROUP BY bin",
        [low, step, *values],
    )
    counts = [0] * bins
    for bin_, n in rows:
        counts[bin_] = n
    return {"edges": [low + i * step for i in range(bins)] + [high], "counts": counts}
