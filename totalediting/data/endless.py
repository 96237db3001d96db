"""Endless shuffled samples by number, the same for any number of workers and ranks.

Sample n belongs to epoch n // L and is the (n mod L)-th of it, L = items of the dataset. Order and
draws follow from (seed, epoch, place) alone. So the state of a training run's data is one number,
the samples taken so far; ranks take every world-th number and workers are dealt whole batches.

An item that cannot be read is replaced by the next in the epoch's order: by a rule, so that it does
not matter which process found the damage first. Such an item is logged once, see
`EndlessDataset.skipped`.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from assets_procedural.conventions.command_line import set_up_logging
from totalediting.errors import InputError

log = logging.getLogger(__name__)
Item = TypeVar("Item")

_REASONS, _REASON_BYTES = 64, 240  # how many reasons are kept for all processes to see


class Unreadable(Exception):
    """Item number `item` cannot be used; the message says why."""

    def __init__(self, item: int, reason: str) -> None:
        super().__init__(reason)
        self.item, self.reason = item, reason


class EndlessDataset(Dataset[Item], ABC, Generic[Item]):
    """A map-style dataset of samples 0, 1, 2, … without end; `len` is the size of an epoch.

    Subclasses implement `make`.
    """

    def __init__(self, keys: list[str], seed: int) -> None:
        self.keys, self.seed = keys, seed
        # Shared, so that what a worker process finds is known to all.
        self._broken = torch.zeros(len(keys), dtype=torch.bool).share_memory_()
        self._reasons = torch.zeros(_REASONS, _REASON_BYTES, dtype=torch.uint8).share_memory_()

    @abstractmethod
    def make(self, item: int, rng: np.random.Generator) -> Item:
        """Make the sample of an item, drawing from `rng`; raises `Unreadable`."""

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, number: int) -> Item:
        """Sample `number` >= 0.

        Raises:
            IndexError: a negative number.
            InputError: not one item can be read.
        """
        if number < 0:
            raise IndexError(f"samples are numbered from 0, there is no {number}")
        epoch, place = divmod(int(number), len(self))
        order = _order(self.seed, epoch, len(self))
        for attempt in range(len(self)):
            rng = np.random.default_rng([self.seed, epoch, place, attempt])
            item = int(order[(place + attempt) % len(self)])
            try:
                return self.make(item, rng)
            except Unreadable as error:
                self.skip(error.item, error.reason)
        first, why = next(iter(self.skipped.items()))
        raise InputError(f"none of {len(self)} samples can be read; {first}: {why}")

    def skip(self, item: int, reason: str) -> None:
        """Note that an item was left out, and log it the first time."""
        if self._broken[item]:
            return
        slot = int(self._broken.sum())
        self._broken[item] = True
        if slot < _REASONS:
            text = f"{item} {reason}".encode()[:_REASON_BYTES].ljust(_REASON_BYTES, b"\0")
            self._reasons[slot] = torch.frombuffer(bytearray(text), dtype=torch.uint8)
        log.warning("skipped %s: %s", self.keys[item], reason)

    @property
    def skipped(self) -> dict[str, str]:
        """Key → reason of every item left out, found by this process or by a worker of it.

        Reasons are kept of the first 64; later ones are in the log alone, and "" here.
        """
        found = {self.keys[item]: "" for item in self._broken.nonzero()[:, 0].tolist()}
        for row in self._reasons.numpy():
            if text := row.tobytes().rstrip(b"\0").decode(errors="ignore"):
                item, _, reason = text.partition(" ")
                found[self.keys[int(item)]] = reason
        return found


class Stream(Sampler[int]):
    """The numbers that one of `world` ranks takes: start + rank, + world, + world, … below `stop`.

    To resume, `start` is the number of samples that all ranks took before.
    """

    def __init__(
        self, start: int = 0, stop: int | None = None, rank: int = 0, world: int = 1
    ) -> None:
        if start < 0 or not 0 <= rank < world:
            raise ValueError(f"start {start} must be >= 0, rank {rank} in [0, world {world})")
        self.start, self.stop, self.rank, self.world = start, stop, rank, world

    def __iter__(self) -> Iterator[int]:
        number = self.start + self.rank
        while self.stop is None or number < self.stop:
            yield number
            number += self.world


def loader(
    samples: EndlessDataset[Any],
    batch: int,
    workers: int = 0,
    start: int = 0,
    stop: int | None = None,
    rank: int = 0,
    world: int = 1,
) -> DataLoader[Any]:
    """Batches of `batch` samples for one rank, in the order of `Stream`, by `workers` processes.

    Without `stop` it never ends; with it, the last batch may be smaller. After k batches the next
    run starts at start + k · batch · world. Every iteration starts again at `start`.
    """
    return DataLoader(
        samples,
        batch_size=batch,
        sampler=Stream(start, stop, rank, world),
        num_workers=workers,
        collate_fn=collate,
        pin_memory=torch.cuda.is_available(),
        worker_init_fn=_begin_worker,
    )


def _begin_worker(number: int) -> None:
    """In a process that reads data: messages, unless they are set up as in a forked one."""
    if not logging.getLogger().handlers:
        set_up_logging()


def collate(samples: list[Any]) -> Any:
    """Named tuples of tensors, strings, None and further named tuples to one with a batch axis.

    Strings become lists; where one sample has None, all must.
    """
    first = samples[0]
    if isinstance(first, Tensor):
        return torch.stack(samples)
    if isinstance(first, tuple):
        return type(first)(*(collate(list(parts)) for parts in zip(*samples, strict=True)))
    return None if first is None else samples


def to_device(batch: Any, device: torch.device | str) -> Any:
    """A sample or batch with all its tensors on `device`."""
    if isinstance(batch, Tensor):
        return batch.to(device, non_blocking=True)
    if isinstance(batch, tuple):
        return type(batch)(*(to_device(part, device) for part in batch))
    return batch


@lru_cache(maxsize=4)
def _order(seed: int, epoch: int, count: int) -> np.ndarray:
    return np.random.default_rng([seed, epoch]).permutation(count)
