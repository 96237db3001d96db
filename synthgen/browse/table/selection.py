"""A selection of rows: parsed from the query string, turned into SQL.

    facets={"subset": ["multiview"], "environments": ["city"]}  any of the values; null is a value
    ranges={"camera_yaw": [-0.5, 0.5], "cost_beauty": [10, null]}  ends included; null is open
    tags=["star", "-reject"]  all of them; - for shots without
    where=person_age_years > 60 AND person_hair_style = 'bob'
    sort=person_age_years  descending=1

Values never become SQL, they are bound to it; columns must be the manifest's.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synthgen.browse.folder import Refused
from synthgen.browse.table.fields import Column
from synthgen.browse.table.snapshot import Snapshot
from synthgen.dataset.database import literal, quoted
from synthgen.dataset.folder import StorageError
from synthgen.dataset.tags import bare

_MOST = 500  # values of all facets together
_FEW = 8
_PLAIN = re.compile(
    r"(subset|split|key|(camera|head|gaze|person|expression|quality|cost)_[a-z0-9_]+)"
)
_OF_FAILURES = {"failed": False, "reason": None}  # columns of the page alone, and shots' values


@dataclass(frozen=True)
class Selection:
    """Conditions by column, a checked SQL condition, tags, and an order.

    `kept` (N,) bool has the rows that `tags` leave, once `Tagging.kept` has looked at them.
    """

    facets: dict[str, list[Any]] = field(default_factory=dict)
    ranges: dict[str, tuple[float | None, float | None]] = field(default_factory=dict)
    where: str = ""
    sort: str = ""
    descending: bool = False
    tags: tuple[str, ...] = ()
    kept: np.ndarray | None = field(default=None, compare=False)

    def rows(
        self, snapshot: Snapshot, without: str = "", ordered: bool = False
    ) -> np.ndarray | None:
        """(N,) numbers of the rows, in order if asked; None for all of them as stored.

        `without` leaves one column's choice out.
        """
        condition, values = self.condition(without)
        order = self.order() if ordered else ""
        if condition == "true" and not order:
            return None if self.kept is None else np.flatnonzero(self.kept)
        found = snapshot.matches.rows(condition, values, order)
        return found if self.kept is None else found[self.kept[found]]

    def condition(self, without: str = "") -> tuple[str, list[Any]]:
        """An SQL condition and the values bound to it; `without` leaves one column's choice out."""
        values: list[Any] = []

        def bound(value: Any) -> str:
            values.append(value)
            return "?"

        return " AND ".join(self._terms(bound, without)) or "true", values

    def sql(self) -> str:
        """The condition as one text for `open_dataset` and `synthgen`; "" chooses everything.

        They know no subjects that failed.
        """
        terms = list(self._terms(_literal, shots_alone=True))
        return self.where if terms == [f"({self.where})"] else " AND ".join(terms)

    def _terms(
        self, value: Callable[[Any], str], without: str = "", shots_alone: bool = False
    ) -> Iterator[str]:
        """The conditions, all of which must hold; `value` is how a value is written."""
        for name, chosen in self.facets.items():
            if shots_alone and name in _OF_FAILURES:
                if _OF_FAILURES[name] not in chosen:
                    yield "false"
            elif name != without:
                yield _facet(name, chosen, value)
        for name, ends in self.ranges.items():
            for sign, end in zip((">=", "<="), ends, strict=True):
                if name != without and end is not None:
                    yield f"{_name(name)} {sign} {value(end)}"
        if self.where:
            yield f"({self.where}\n)" if "--" in self.where else f"({self.where})"

    def order(self) -> str:
        """An ORDER BY clause: the manifest's own order where nothing else is said."""
        if not self.sort:
            return ""
        way = "DESC" if self.descending else "ASC"
        return f"ORDER BY {quoted(self.sort)} {way} NULLS LAST"

    def constrained(self) -> list[str]:
        """The columns of facets and ranges."""
        return list(self.facets | self.ranges)


def parse(query: Mapping[str, str], snapshot: Snapshot) -> Selection:
    """The selection of a query string; raises `Refused` (400) with one line where it is wrong."""
    facets = {
        name: _values(name, values, _column(snapshot, name, "facets"))
        for name, values in _object(query, "facets").items()
    }
    if sum(map(len, facets.values())) > _MOST:
        raise Refused(f"facets: more than {_MOST} values; use where instead", 400)
    ranges = {
        name: _ends(name, ends, _column(snapshot, name, "ranges"))
        for name, ends in _object(query, "ranges").items()
    }
    where = query.get("where", "").strip()
    if where:
        snapshot.sandbox.check(where)
    sort = query.get("sort", "")
    if sort and _column(snapshot, sort, "sort").listed:
        raise Refused(f"sort: {sort} holds lists; sort by another column", 400)
    descending = query.get("descending", "0") in ("1", "true")
    return Selection(facets, ranges, where, sort, descending, _tags(query))


def number(query: Mapping[str, str], name: str, default: int, low: int, high: int) -> int:
    """A whole number of a query string; raises `Refused` (400) unless it lies in [low, high]."""
    text = query.get(name, str(default))
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise Refused(f"{name} = {text[:40]}: give a whole number from {low} to {high}", 400)
    return value


def _facet(name: str, chosen: list[Any], value: Callable[[Any], str]) -> str:
    values = [v for v in chosen if v is not None]
    terms = [f"{_name(name)} IS NULL"] if None in chosen else []
    if values and isinstance(values[0], _Element):
        texts = [value(str(v)) for v in values]
        # For a few values a test of each takes a fifth of the time of `list_has_any`.
        if len(values) <= _FEW:
            terms += [f"list_contains({_name(name)}, {text})" for text in texts]
        else:
            terms.append(f"list_has_any({_name(name)}, [{', '.join(texts)}])")
    elif values:
        terms.append(f"{_name(name)} IN ({', '.join(map(value, values))})")
    if not terms:
        return "true"
    return terms[0] if len(terms) == 1 else f"({' OR '.join(terms)})"


def _name(name: str) -> str:
    """A column in SQL, with quotes only where it may need them: people read it."""
    return name if _PLAIN.fullmatch(name) else quoted(name)


def _literal(value: Any) -> str:
    return literal(value) if isinstance(value, str) else json.dumps(value)


class _Element(str):
    """A value that one of the elements of a list must have."""


def _tags(query: Mapping[str, str]) -> tuple[str, ...]:
    try:
        found = json.loads(query.get("tags") or "[]")
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, list) or not all(isinstance(tag, str) for tag in found):
        raise Refused('tags: must be JSON such as ["star", "-reject"]', 400)
    if len(found) > _FEW:
        raise Refused(f"tags: more than {_FEW} at once", 400)
    try:
        return tuple(dict.fromkeys(tag for tag in found if bare(tag)))
    except StorageError as error:
        raise Refused(str(error), 400) from None


def _column(snapshot: Snapshot, name: str, where: str) -> Column:
    if name not in snapshot.columns:
        raise Refused(f"{where}: the manifest has no column {name[:80]!r}", 400)
    return snapshot.columns[name]


def _object(query: Mapping[str, str], name: str) -> dict[str, Any]:
    text = query.get(name, "")
    if not text:
        return {}
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise Refused(f'{name}: must be JSON such as {{"column": [...]}}', 400)
    return value


def _values(name: str, values: Any, column: Column) -> list[Any]:
    types: dict[str, Any] = {"text": str, "boolean": bool, "number": (int, float)}
    wanted = types[column.type]
    if not isinstance(values, list) or not all(
        v is None
        or (isinstance(v, wanted) and (column.type != "number" or not isinstance(v, bool)))
        for v in values
    ):
        raise Refused(f"facets: {name}: give a list of values of type {column.type}", 400)
    return [_Element(v) if column.listed and isinstance(v, str) else v for v in values]


def _ends(name: str, ends: Any, column: Column) -> tuple[float | None, float | None]:
    if column.type != "number" or column.listed:
        raise Refused(f"ranges: {name} is not a numeric column; use facets or where", 400)
    right = isinstance(ends, list) and len(ends) == 2
    if not right or not all(
        e is None or (isinstance(e, int | float) and not isinstance(e, bool) and math.isfinite(e))
        for e in ends
    ):
        raise Refused(f"ranges: {name}: give [low, high]; null leaves an end open", 400)
    return ends[0], ends[1]
