"""Read a dataset with Hugging Face `datasets`, streamed, through PyTorch's DataLoader.

    python examples/read_hugging_face.py out/demo multiview

`load_dataset(folder, subset)` without streaming knows subsets and splits from the card as well.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from datasets import load_dataset
from torch.utils.data import DataLoader, default_collate

from synthgen.dataset import decoder


def chosen(row: dict[str, Any]) -> dict[str, Any]:
    """What to learn from, as arrays."""
    return {
        "key": str(row["__key__"]),
        "picture": np.array(row["rgb_00.png"]),  # a copy, for torch: `datasets` may keep its own
        "parts": np.array(row["parts.png"]),
        "landmarks": row["geometry.npz"]["landmarks"],  # (70, 3), metres
        "depth": decoder("aov.exr", row["aov.exr"])["depth"],  # `datasets` reads no EXR
    }


def main(folder: str, subset: str) -> None:
    files = {"train": f"{folder}/data/{subset}/train-*.tar"}
    rows = load_dataset("webdataset", data_files=files, split="train", streaming=True)
    # Without the format, pictures are PIL images and the arrays of geometry.npz lists of lists.
    rows = rows.with_format("numpy")
    # Chosen here and not by `rows.map`, which would store the arrays as lists again.
    loader = DataLoader(
        rows,  # pyright: ignore[reportArgumentType]
        batch_size=4,
        num_workers=2,  # each reads shards of its own
        collate_fn=lambda batch: default_collate([chosen(row) for row in batch]),
    )
    for batch in loader:
        heads = batch["landmarks"].mean(1)  # (N, 3)
        for key, picture, head in zip(batch["key"], batch["picture"], heads, strict=True):
            print(f"{key}: {tuple(picture.shape)}, head at {head.numpy().round(2)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
