"""Feed a dataset to PyTorch: a Dataset that decodes only what it needs, and a DataLoader.

    python examples/read_torch.py out/demo

It learns nothing of use: one convolution, one pass over the data, from picture to albedo.
"""

from __future__ import annotations

import sys

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from synthgen import open_dataset


class Albedo(Dataset[tuple[Tensor, Tensor]]):
    """Pictures under their first light and their albedo, each (3, H, W) in [0, 1]."""

    def __init__(self, folder: str, split: str = "train") -> None:
        # Holds an index alone and opens files per access: workers may share it.
        self.shots = open_dataset(folder, split=split)

    def __len__(self) -> int:
        return len(self.shots)

    def __getitem__(self, position: int) -> tuple[Tensor, Tensor]:
        read = self.shots.read(position, ("rgb_00", "albedo"))
        return picture(read["rgb_00"]), picture(read["albedo"])


def picture(pixels: np.ndarray) -> Tensor:
    """(H, W, 3) of 8 bits as (3, H, W) in [0, 1]."""
    return torch.from_numpy(pixels.copy()).movedim(-1, 0) / 255


def main(folder: str) -> None:
    torch.manual_seed(0)
    loader = DataLoader(Albedo(folder), batch_size=4, shuffle=True, num_workers=2)
    network = torch.nn.Conv2d(3, 3, kernel_size=5, padding=2)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-2)
    for source, albedo in loader:
        loss = (network(source) - albedo).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        print(f"{len(source)} pictures of {tuple(source.shape[1:])}: loss {loss.item():.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
