"""Read a dataset's shards with webdataset: no package of this project is imported.

python examples/read_webdataset.py out/demo
"""

from __future__ import annotations

import sys
from pathlib import Path

from webdataset import WebDataset  # pyright: ignore[reportAttributeAccessIssue]


def main(folder: str) -> None:
    shards = sorted(str(path) for path in Path(folder, "data").glob("*/train-*.tar"))
    samples = (
        WebDataset(shards, shardshuffle=len(shards))
        .shuffle(100)
        .decode("rgb8")
        .to_tuple("rgb_00.png", "albedo.png", "meta.json")
    )
    for picture, albedo, meta in samples:
        print(f"{meta['key']}: {picture.shape}, mean albedo {albedo.mean():.0f} of 255")


if __name__ == "__main__":
    main(*sys.argv[1:])
