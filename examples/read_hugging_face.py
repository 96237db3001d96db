"""Read a dataset with Hugging Face `datasets`, streamed: no package of this project is imported.

    python examples/read_hugging_face.py out/demo multiview

`load_dataset(folder, subset)` without streaming knows subsets and splits from the card as well.
"""

from __future__ import annotations

import sys

import numpy as np
from datasets import load_dataset


def main(folder: str, subset: str) -> None:
    files = {"train": f"{folder}/data/{subset}/train-*.tar"}
    for row in load_dataset("webdataset", data_files=files, split="train", streaming=True):
        picture = row["rgb_00.png"]  # a PIL image
        landmarks = np.asarray(row["geometry.npz"]["landmarks"])  # (70, 3), metres
        print(f"{row['__key__']}: {picture.size}, head at {landmarks.mean(0).round(2)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
