"""How fast a dataset's samples come, beside the bare reading of its tars.

    python benchmarks/loading.py DATASET [--preset small] [--split train] [--samples 64]

Prints a table: samples a second of training pairs (with and without a second light) and of
single portraits, by the loader in this process and with 1 and 2 workers, after 8 samples that warm
caches and workers up; then the same number of pairs as bare bytes, and decoded to numpy without any
resizing. Reading goes by the operating system's cache: what is measured is the work, not the disk.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import report
import torch

from synthgen.dataset import open_dataset
from totalediting.data.endless import EndlessDataset, loader
from totalediting.data.pairs import PortraitPairs
from totalediting.data.portraits import Portraits
from totalediting.presets import PRESETS

WARM = 8  # samples


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--preset", choices=PRESETS, default="small")
    parser.add_argument("--split", default="train")
    parser.add_argument("--samples", type=int, default=64)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    folder, preset = arguments.dataset, PRESETS[arguments.preset]

    kinds: dict[str, EndlessDataset] = {
        "pairs": PortraitPairs(folder, preset, arguments.split),
        "pairs, relit": PortraitPairs(folder, preset, arguments.split, relit=True),
        "portraits": Portraits(folder, preset, arguments.split),
    }

    def rows() -> Iterator[list[str]]:
        for name, samples in kinds.items():
            loaders = (iter(loader(samples, 1, workers)) for workers in (0, 1, 2))
            yield [name, *(f"{rate(samples, arguments.samples):.1f}" for samples in loaders)]
        for name, read in (("bytes of the tars", bytes_of), ("decoded, at full size", decoded)):
            yield [name, f"{rate(read(folder, arguments.split), arguments.samples):.1f}", "", ""]

    report.table(["what", "this process", "1 worker", "2 workers"], rows())


def rate(samples: Iterator[object], count: int) -> float:
    """Samples a second."""
    for _ in islice(samples, WARM):
        pass
    with report.clock() as took:
        taken = sum(1 for _ in islice(samples, count))
    return taken / took.seconds


def pairs_of(
    folder: Path, split: str, read: Callable[[int, tuple[str, ...]], object]
) -> Iterator[object]:
    """What `read` gives of the members that a pair takes, over and over."""
    dataset = open_dataset(folder, split=split)
    labels = ("rgb_00", "albedo", "normal", "depth", "alpha", "parts", "geometry", "meta")
    while True:
        for position in range(len(dataset)):
            read((position + 1) % len(dataset), ("rgb_00", "meta"))
            yield read(position, labels)


def bytes_of(folder: Path, split: str) -> Iterator[object]:
    index = open_dataset(folder, split=split).index

    def read(position: int, _: tuple[str, ...]) -> bytes:
        with (folder / index.shards[index.shard[position]]).open("rb") as file:
            file.seek(int(index.offset[position]))
            return file.read(int(index.size[position]))

    return pairs_of(folder, split, read)


def decoded(folder: Path, split: str) -> Iterator[object]:
    return pairs_of(folder, split, open_dataset(folder, split=split).read)


if __name__ == "__main__":
    main()
