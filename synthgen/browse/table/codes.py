"""Columns encoded as small integers, one per row: an index of a value, or a histogram's bin.

Counting a selection then means counting small integers at its rows, a millisecond a column for a
million rows, where SQL would read the values themselves again.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from synthgen.browse.table.fields import Column
from synthgen.browse.table.sandbox import Sandbox
from synthgen.dataset.database import quoted

BINS = 32
"""Bins of a histogram, from a column's smallest to its largest finite value."""
VALUES = 200
"""Values of a facet that are told apart: the most frequent ones."""
_LONGEST = 16  # elements of a list that are looked at


@dataclass(frozen=True)
class Coded:
    """A column in codes: `codes` (N, L) with L = 1 but for lists, and what code k stands for.

    A facet has `values`, a histogram `edges`, one more than it has bins. The code after the last
    stands for all else: rarer values, no number, no element.
    """

    codes: np.ndarray
    values: list[Any]
    edges: list[float]

    def count(self, rows: np.ndarray | None) -> np.ndarray:
        """How often each code occurs in these rows, or in all of them."""
        size = len(self.values) or max(len(self.edges) - 1, 0)
        if not size:
            return np.zeros(0, int)
        chosen = self.codes if rows is None else self.codes[rows]
        return np.bincount(chosen.ravel(), minlength=size + 1)[:size]


class Codes:
    """Codes of columns, made when they are first asked for. May be used by several threads."""

    def __init__(self, sandbox: Sandbox) -> None:
        self.sandbox = sandbox
        self._lock = threading.Lock()
        self._made: dict[str, Coded] = {}
        self._making: dict[str, threading.Lock] = {}

    def of(self, column: Column) -> Coded:
        """The codes of a column of kind `facet` or `range`."""
        if made := self._made.get(column.name):
            return made
        with self._lock:
            turn = self._making.setdefault(column.name, threading.Lock())
        with turn:
            if column.name not in self._made:
                make = self._range if column.kind == "range" else self._facet
                self._made[column.name] = make(column)
            return self._made[column.name]

    def _facet(self, column: Column) -> Coded:
        name = quoted(column.name)
        element = f"unnest({name})" if column.listed else name
        found = self.sandbox.ask(
            f"SELECT v FROM (SELECT {element} AS v FROM manifest) "
            f"GROUP BY v ORDER BY count(*) DESC, v LIMIT {VALUES}"
        )
        values = [v for (v,) in found]
        if not values:
            return Coded(np.empty((0, 1), np.uint16), [], [])
        # NULL is a value of its own, which a list of values does not find.
        known = [str(v) for v in values if v is not None]
        places = [name]
        if column.listed:
            ((length,),) = self.sandbox.ask(f"SELECT max(len({name})) FROM manifest")
            places = [f"{name}[{i + 1}]" for i in range(min(int(length or 0), _LONGEST))]
        terms = [
            f"coalesce(list_position(?, {p}::VARCHAR), 0)::USMALLINT AS c{i}"
            for i, p in enumerate(places)
        ]
        order = [i for i, v in enumerate(values) if v is not None]
        none = len(values)
        if None in values and not column.listed:
            terms.append(f"({name} IS NULL)::USMALLINT AS missing")
        answer = self._arrays(terms, [known] * len(places))
        table = np.array([none, *order], np.uint16)
        codes = [table[answer[f"c{i}"]] for i in range(len(places))]
        if "missing" in answer:
            codes[0] = np.where(answer["missing"] > 0, values.index(None), codes[0])
        return Coded(np.stack(codes, 1).astype(np.uint16), values, [])

    def _range(self, column: Column) -> Coded:
        name = f"{quoted(column.name)}::DOUBLE"
        ((low, high),) = self.sandbox.ask(
            f"SELECT min({name}), max({name}) FROM manifest WHERE isfinite({name})"
        )
        if low is None:
            return Coded(np.empty((0, 1), np.uint8), [], [])
        bins = BINS if high > low else 1
        step = (high - low) / bins or 1.0
        bin_ = f"least(greatest(floor(({name} - ?) / ?), 0), {bins - 1})::UTINYINT"
        answer = self._arrays(
            [f"CASE WHEN isfinite({name}) THEN {bin_} ELSE {bins} END::UTINYINT AS c"], [low, step]
        )
        edges = [low + i * step for i in range(bins)] + [high]
        return Coded(answer["c"][:, None], [], edges)

    def _arrays(self, terms: list[str], values: list[Any]) -> dict[str, np.ndarray]:
        answer = self.sandbox.arrays(f"SELECT {', '.join(terms)} FROM manifest", values)
        return {name: np.asarray(array) for name, array in answer.items()}
