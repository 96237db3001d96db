"""Deformations that are solved once: tables in half precision, in memory and on disk.

On a CPU solving takes a third of a step, and the same shots come again in every epoch. A table
is known by its control points and by how it was solved, so that another dataset or preset never
gets a wrong one. Half precision is 0.1 mm at most; it is what every use gets, the first included.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from assets_procedural.conventions.files import replacing
from totalediting.geometry.field import Control, Table

_ROOM = 1 << 28  # bytes in memory
_FORMAT = 2  # of the files; to be raised when fields change their numbers


class KeptTables:
    """Tables of single busts by their control points; on disk in `folder`, if there is one."""

    def __init__(self, folder: Path | None, solved: str) -> None:
        """`solved` tells how: what else the tables depend on."""
        self.folder, self.solved = folder, f"{solved} v{_FORMAT}"
        self._held: dict[str, Tensor] = {}

    def of(self, controls: list[Control], solve: Callable[[Control], Table]) -> list[Table]:
        """A table of each bust (V, 3); `solve` makes those of a batch (B, V, 3) that are missing.

        What has no memory or disk is solved again.
        """
        keys = [self._key(control) for control in controls]
        values = {key: found for key in set(keys) if (found := self._find(key)) is not None}
        missing = {key: k for k, key in enumerate(keys) if key not in values}
        if missing:
            chosen = [controls[k] for k in missing.values()]
            batch = Control(*(torch.stack(parts) for parts in zip(*chosen, strict=True)))
            solved = [table.values.half() for table in solve(batch).unstack()]
            for key, made in zip(missing, solved, strict=True):
                values[key] = made
                self._keep(key, made)
        return [Table(values[key].to(controls[0].posed), ()) for key in keys]

    def _key(self, control: Control) -> str:
        digest = hashlib.blake2b(self.solved.encode(), digest_size=16)
        for array in control:
            digest.update(array.detach().cpu().contiguous().numpy().tobytes())
        return digest.hexdigest()

    def _find(self, key: str) -> Tensor | None:
        if key in self._held:
            return self._held[key]
        if self.folder is None:
            return None
        # A file that is missing, foreign or damaged is made again.
        with contextlib.suppress(OSError, ValueError, EOFError):
            stored = np.load(self._path(key), allow_pickle=False)
            whole = (
                stored.ndim == 5 and stored.shape[:2] == (1, 7) and len(set(stored.shape[2:])) == 1
            )
            if whole and stored.dtype == np.float16 and np.isfinite(stored).all():
                found = torch.from_numpy(stored)
                self._hold(key, found)
                return found
        return None

    def _keep(self, key: str, values: Tensor) -> None:
        self._hold(key, values)
        if self.folder is None:
            return
        with contextlib.suppress(OSError):
            path = self._path(key)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as file:
                np.save(file, values.cpu().numpy())

    def _hold(self, key: str, values: Tensor) -> None:
        self._held[key] = values
        while len(self._held) * values.nbytes > _ROOM:
            del self._held[next(iter(self._held))]

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / key[:2] / f"{key}.npy"
