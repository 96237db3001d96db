"""A trained run beside a dataset: its pictures, and the errors of held-out shots as columns.

The package of the model registers a module with `open_run` in the group `synthgen.runs`; nothing
here knows a network. Errors are measured before the page is served, of `MOST` held-out shots at
most, spread evenly, and kept in the cache: a run is measured once.
"""

from __future__ import annotations

import hashlib
import json
import math
import threading
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from assets_procedural.conventions import console
from assets_procedural.conventions.errors import UserError
from assets_procedural.conventions.files import cache_folder, read_regular, write_atomically
from synthgen.browse.folder import Refused
from synthgen.dataset import open_dataset
from synthgen.dataset.database import literal
from synthgen.dataset.folder import Place
from synthgen.errors import JobError

ENTRY_POINTS = "synthgen.runs"
"""The group of entry points that open runs."""
MOST = 500
"""Shots whose errors are measured."""
PREFIX = "run_"
"""Of the columns of errors."""
_LARGEST = 16 << 20  # bytes of measured errors


class OpenRun(Protocol):
    """What `open_run(run, data)` of an entry point returns; see `totalediting.training.beside`."""

    name: str
    pictures: tuple[str, ...]
    figures: dict[str, str]

    def measure(self, key: str, split: str) -> dict[str, float]:
        """Figures of a shot by name; raises `UserError`."""
        ...

    def picture(self, key: str, split: str, name: str) -> np.ndarray:
        """One of `pictures`, (H, W, 3) uint8; raises `UserError`."""
        ...


class Beside:
    """A run and a dataset. May be used by several threads, one of which the model works for."""

    def __init__(self, run: OpenRun) -> None:
        self.run = run
        self.errors: dict[str, dict[str, float | None]] = {}
        self._lock = threading.Lock()

    def measure(self, dataset: Place) -> None:
        """Measure the held-out shots, or read what was measured before."""
        wanted = _held_out(dataset)
        essence = json.dumps([self.run.name, list(self.run.figures), wanted])
        digest = hashlib.sha256(essence.encode()).hexdigest()[:24]
        kept = cache_folder() / "runs" / f"{digest}.json"
        try:
            self.errors = json.loads(read_regular(kept, _LARGEST))
            return
        except (OSError, ValueError):
            pass
        for key, split in console.track(wanted, "measuring the run", len(wanted)):
            try:
                figures = self.run.measure(key, split)
            except UserError:
                continue  # the shot's own page says why
            self.errors[key] = {
                name: round(value, 4) if math.isfinite(value) else None
                for name, value in figures.items()
            }
        write_atomically(kept, json.dumps(self.errors).encode())

    def columns(self) -> dict[str, str]:
        """SQL expressions by column, of a manifest with `subset` and `key`."""
        if not self.errors:
            return {}
        place = f"list_position([{', '.join(map(literal, self.errors))}], subset || '/' || \"key\")"
        return {
            f"{PREFIX}{name}": f"([{_list(e.get(name) for e in self.errors.values())}]::DOUBLE[])"
            f"[{place}]"
            for name in self.run.figures
        }

    def of(self, key: str) -> dict[str, float | None]:
        """How a shot's errors are called, and what they are; {} if they were not measured."""
        found = self.errors.get(key, {})
        return {title: found.get(name) for name, title in self.run.figures.items() if found}

    def picture(self, key: str, split: str, name: str) -> np.ndarray:
        """A picture of the run, (H, W, 3) uint8; raises `Refused`."""
        if name not in self.run.pictures:
            raise Refused(f"no picture {name[:40]} of a run: {', '.join(self.run.pictures)}")
        with self._lock:
            try:
                return self.run.picture(key, split, name)
            except UserError as error:
                raise Refused(str(error), 422) from None


def open_beside(run: Path, dataset: Place) -> Beside:
    """Open a run by whatever package can, and measure it.

    Raises `JobError` if none is installed, and what that package raises, in one line.
    """
    missing = "a package that opens runs"
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            module = entry.load()
        except ModuleNotFoundError as error:
            missing = str(error.name)
            continue
        beside = Beside(module.open_run(run, Path(dataset)))
        beside.measure(dataset)
        return beside
    raise JobError("--run", "", str(run), f"needs {missing}: pip install 'totalediting[train]'")


def _held_out(dataset: Place) -> list[tuple[str, str]]:
    """("subset/key", split) of the shots to measure."""
    found = []
    for split in ("test", "validation"):
        keys = open_dataset(dataset, split=split).keys()
        found += [(key, split) for key in keys]
    if len(found) <= MOST:
        return found
    return [found[i * len(found) // MOST] for i in range(MOST)]


def _list(values: Iterable[Any]) -> str:
    return ", ".join("NULL" if value is None else repr(float(value)) for value in values)
