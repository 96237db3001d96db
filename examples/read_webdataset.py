"""Stream a dataset's shards with webdataset into PyTorch's DataLoader.

    python examples/read_webdataset.py out/demo

The shards open without this package too, but webdataset's own `.decode("rgb")` turns part ids into
floats and leaves aov.exr as it is; `decoder` makes every member the array that `Shot` has.
"""

from __future__ import annotations

import sys
from pathlib import Path

from torch.utils.data import DataLoader
from webdataset import WebDataset  # pyright: ignore[reportAttributeAccessIssue]

from synthgen.dataset import decoder


def main(folder: str) -> None:
    shards = sorted(str(path) for path in Path(folder, "data").glob("*/train-*.tar"))
    samples = (
        WebDataset(shards, shardshuffle=len(shards), empty_check=False)
        .shuffle(100)
        .decode(decoder)
        .to_tuple("__key__", "rgb_00.png", "parts.png", "aov.exr")
    )
    # Each worker reads shards of its own.
    for keys, picture, parts, aov in DataLoader(samples, batch_size=4, num_workers=2):
        print(
            f"{keys[0]} and {len(keys) - 1} more: {tuple(picture.shape[1:])}, "
            f"{len(parts.unique())} parts, up to {aov['depth'].max():.2f} m away"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
