"""Feed a dataset to PyTorch: fields of its shots as a map-style dataset, and a DataLoader.

    python examples/read_torch.py out/demo

It learns nothing of use: one convolution, one pass over the data, from picture to albedo.
"""

from __future__ import annotations

import sys

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from synthgen import open_dataset


def picture(pixels: Tensor) -> Tensor:
    """(N, H, W, 3) of 8 bits as (N, 3, H, W) in [0, 1]."""
    return pixels.movedim(-1, 1) / 255


def main(folder: str) -> None:
    torch.manual_seed(0)
    # Holds an index alone, and decodes only these fields: workers may share it.
    samples = open_dataset(folder, split="train").samples(("rgb_00", "albedo", "parts", "camera"))
    # torch asks for no base class, whatever its types say.
    loader = DataLoader(samples, batch_size=4, shuffle=True, num_workers=2)  # pyright: ignore
    network = torch.nn.Conv2d(3, 3, kernel_size=5, padding=2)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-2)
    for batch in loader:
        source, albedo = picture(batch["rgb_00"]), picture(batch["albedo"])
        inside = (batch["parts"] > 0)[:, None]  # ids, (N, H, W)
        loss = ((network(source) - albedo).abs() * inside).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        focal = batch["camera"]["intrinsics"][:, 0, 0].mean()
        print(
            f"{len(source)} pictures of {tuple(source.shape[1:])}, "
            f"focal length {focal:.0f} pixels: loss {loss.item():.3f}"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
