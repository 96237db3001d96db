"""The tri-plane encoders E_geo and E_shd: the fused feature to three planes of features.

    T_geo = E_geo(F),  T_shd = E_shd(F)                             (paper, section 3.2)

Symbols: B batch, t side of the grid of tokens, D their width, S side of pictures, P =
preset.plane_size side of a plane. After Lp3D (Trevithick et al. 2023): F is brought to the planes'
side and joined with the appearance's detail map, whose fine structure the tokens have lost; what
comes of it goes through a ViT on a coarser grid, where far parts of the picture can exchange what
lifting it into space takes, and is joined with the ViT's result. Which plane spans which axes is
settled where they are sampled, in `totalediting.geometry.volume`.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.networks.blocks import (
    TransformerBlock,
    conv,
    conv_norm,
    position_grid,
    to_grid,
    to_tokens,
)
from totalediting.presets import Preset

_TOKENS = 32  # at most, along a side of the ViT's grid


class TriplaneEncoder(nn.Module):
    """F (B, D, t, t) and detail (B, detail_channels, S / 2, S / 2) to tri-planes.

    E_geo and E_shd are two of these, with weights of their own.
    """

    position: Tensor

    def __init__(self, preset: Preset) -> None:
        """Build for the preset's sizes.

        Raises:
            ValueError: `plane_size` is not the sides of the two grids of tokens (`tokens`, and
                that of the ViT: a quarter of `plane_size`, at most 32) times a power of 2.
        """
        super().__init__()
        size, detail = preset.plane_size, preset.detail_channels
        self.feature = (preset.token_dim, preset.tokens, preset.tokens)
        self.detail = (detail, preset.image // 2, preset.image // 2)
        self.size = size

        dim, side = preset.token_dim // 2, min(_TOKENS, size // 4)
        self.raise_feature = _Raise(preset.token_dim, detail, preset.tokens, size)
        self.join_detail = nn.Sequential(conv_norm(2 * detail, detail), conv_norm(detail, detail))
        self.lower = _lower(detail, dim, size, side)
        self.register_buffer("position", position_grid(side, dim), persistent=False)
        # Half as wide as the reenactor's tokens, by half as many heads.
        heads = max(1, preset.heads // 2)
        self.blocks = nn.ModuleList(
            TransformerBlock(dim, heads, conv=True) for _ in range(preset.plane_blocks)
        )
        self.norm = nn.LayerNorm(dim)
        self.raise_tokens = _Raise(dim, detail, side, size)
        planes = 3 * preset.plane_channels
        self.out = nn.Sequential(conv_norm(2 * detail, planes), conv(planes, planes))

    def forward(self, feature: Tensor, detail: Tensor) -> Tensor:
        """Planes (B, 3, plane_channels, P, P).

        Args:
            feature: F (B, D, t, t), the reenactor's.
            detail: (B, detail_channels, S / 2, S / 2), the appearance encoder's.

        Raises:
            ValueError: shapes that do not fit.
        """
        for name, x, shape in (
            ("feature", feature, self.feature),
            ("detail", detail, self.detail),
        ):
            if x.ndim != 4 or x.shape[1:] != shape:
                raise ValueError(f"{name} must be {('B', *shape)}, got {tuple(x.shape)}")
        if detail.shape[-1] != self.size:
            detail = _resize(detail, self.size)
        fine = self.join_detail(torch.cat([self.raise_feature(feature), detail], 1))
        tokens = to_tokens(self.lower(fine)) + self.position.to(fine)
        for block in self.blocks:
            tokens = block(tokens)
        coarse = self.raise_tokens(to_grid(self.norm(tokens)))
        return self.out(torch.cat([coarse, fine], 1)).unflatten(1, (3, -1))


class _Raise(nn.Module):
    """(B, channels, side, side) -> (B, out, size, size), doubling the side until it is reached.

    Each doubling halves the channels, from a first 3x3 convolution on the small map. Enlarging
    is bilinear, with a convolution after it: transposed convolutions leave a checkerboard.
    """

    def __init__(self, channels: int, out: int, side: int, size: int) -> None:
        super().__init__()
        doublings = _doublings(side, size)
        widths = [min(channels, out << i) for i in range(doublings, -1, -1)]
        widths[-1] = out
        self.first = conv_norm(channels, widths[0])
        self.steps = nn.ModuleList(map(conv_norm, widths, widths[1:]))

    def forward(self, x: Tensor) -> Tensor:
        x = self.first(x)
        for step in self.steps:
            x = step(_resize(x, 2 * x.shape[-1]))
        return x


def _lower(channels: int, out: int, size: int, side: int) -> nn.Sequential:
    """(B, channels, size, size) -> (B, out, side, side) by strided convolutions."""
    doublings = _doublings(side, size)
    widths = [min(out, channels << i) for i in range(doublings)] + [out]
    layers = [conv_norm(a, b, 2) for a, b in pairwise(widths)]
    return nn.Sequential(*layers, conv(out, out, 1))


def _doublings(side: int, size: int) -> int:
    """How often `side` must be doubled to give `size`."""
    if side < 1 or size % side or (size // side).bit_count() != 1:
        raise ValueError(f"{size} is not {side} times a power of 2")
    return (size // side).bit_length() - 1


def _resize(x: Tensor, size: int) -> Tensor:
    return functional.interpolate(x, size=(size, size), mode="bilinear")
