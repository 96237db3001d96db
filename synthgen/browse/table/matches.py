"""The rows of a selection, in its order: found once, then shared by every page and count.

Rows are numbers, their places in the table in memory. A page of a grid, its total and the counts
beside it ask for the same rows, and so does every further page as one scrolls down.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numpy as np

from synthgen.browse.table.sandbox import Sandbox

_KEPT = 24


class Matches:
    """Rows by condition and order; remembers the last ones. May be used by several threads."""

    def __init__(self, sandbox: Sandbox, in_memory: bool) -> None:
        self.sandbox, self.in_memory = sandbox, in_memory
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[Any, ...], np.ndarray] = OrderedDict()
        self._finding: dict[tuple[Any, ...], threading.Lock] = {}

    def rows(self, condition: str, values: list[Any], order: str = "") -> np.ndarray:
        """(N,) int32 numbers of the rows that meet an SQL condition, in the given order.

        `order` is an ORDER BY clause, of a table in memory only; without it, and among equals, the
        manifest's own order holds.
        Raises `Refused` as `Sandbox.ask` does.
        """
        key = (condition, tuple(values), order)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            # Page and counts ask at the same time: the second waits for the first.
            turn = self._finding.setdefault(key, threading.Lock())
        with turn:
            with self._lock:
                if key in self._kept:
                    return self._kept[key]
            try:
                found = self._find(condition, values, order)
            finally:
                with self._lock:
                    self._finding.pop(key, None)
            with self._lock:
                self._kept[key] = found
                while len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
            return found

    def _find(self, condition: str, values: list[Any], order: str) -> np.ndarray:
        if not self.in_memory:
            # Rows of a view have no numbers, but come in their order.
            hits = self.sandbox.arrays(f"SELECT ({condition}) IS TRUE AS hit FROM manifest", values)
            return np.flatnonzero(np.asarray(hits["hit"])).astype(np.int32)
        ordered = f"{order}, rowid" if order else ""
        answer = self.sandbox.arrays(
            f"SELECT rowid AS number FROM manifest WHERE {condition} {ordered}", values
        )
        return np.asarray(answer["number"]).astype(np.int32)
