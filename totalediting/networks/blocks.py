"""Generic pieces of the networks: convolutions, residual blocks, attention, position embeddings.

Symbols: B batch, C channels, H, W rows and columns, T tokens, K tokens of a context, D width of a
token. Feature maps are channel-first (B, C, H, W), tokens (B, T, D). A square grid of tokens is
stored row by row: token t is row t // side, column t % side (`to_tokens`, `to_grid`). Parameters
are drawn at construction from torch's global generator, under the caller's `torch.manual_seed`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional


def conv(
    channels: int, out: int, kernel: int = 3, stride: int = 1, dilation: int = 1, groups: int = 1
) -> nn.Conv2d:
    """Convolution that keeps the size at stride 1 (odd kernels), He-initialised, with zero bias."""
    layer = nn.Conv2d(
        channels, out, kernel, stride, dilation * (kernel // 2), dilation=dilation, groups=groups
    )
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    nn.init.zeros_(layer.bias)  # pyright: ignore[reportArgumentType]
    return layer


def linear(features: int, out: int) -> nn.Linear:
    """Linear layer that keeps the variance of its input (LeCun initialisation), with zero bias."""
    layer = nn.Linear(features, out)
    nn.init.normal_(layer.weight, std=features**-0.5)
    nn.init.zeros_(layer.bias)
    return layer


def norm(channels: int) -> nn.GroupNorm:
    """Group normalisation: groups of eight channels or so, at most 32 groups.

    It needs no statistics over the batch, so that small batches do no harm and a picture's features
    do not depend on the others in its batch.
    """
    return nn.GroupNorm(math.gcd(channels, max(1, min(32, channels // 8))), channels)


def conv_norm(channels: int, out: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """3x3 convolution, norm and ReLU."""
    return nn.Sequential(conv(channels, out, 3, stride, dilation), norm(out), nn.ReLU())


class ResidualBlock(nn.Module):
    """(B, C, H, W) -> (B, out, H / stride, W / stride): ReLU(body(x) + shortcut(x)).

    The body is 3x3 convolution, norm, ReLU, 3x3 convolution, norm (He et al. 2016); the first
    convolution has the stride. The shortcut is the identity, or a 1x1 convolution and a norm where
    the shape changes.
    """

    def __init__(self, channels: int, out: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *conv_norm(channels, out, stride, dilation),
            conv(out, out, 3, 1, dilation),
            norm(out),
        )
        self.shortcut = nn.Identity()
        if channels != out or stride != 1:
            self.shortcut = nn.Sequential(conv(channels, out, 1, stride), norm(out))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.body(x) + self.shortcut(x))


class Attention(nn.Module):
    """Multi-head attention of tokens (B, T, D) to a context (B, K, D), or to themselves.

    `zero` initialises the output projection with zeros: a fresh layer then returns zeros, and the
    first optimiser step reaches that projection alone.
    """

    def __init__(self, dim: int, heads: int, zero: bool = False) -> None:
        super().__init__()
        if dim % heads:
            raise ValueError(f"{heads} heads do not divide a width of {dim}")
        self.heads = heads
        self.query, self.key_value = linear(dim, dim), linear(dim, 2 * dim)
        self.out = linear(dim, dim)
        if zero:
            nn.init.zeros_(self.out.weight)

    def forward(self, tokens: Tensor, context: Tensor | None = None) -> Tensor:
        key, value = self.key_value(tokens if context is None else context).chunk(2, -1)
        query, key, value = (
            x.unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for x in (self.query(tokens), key, value)
        )
        attended = functional.scaled_dot_product_attention(query, key, value)
        return self.out(attended.transpose(1, 2).flatten(2))


class FeedForward(nn.Module):
    """Tokens (B, T, D) -> (B, T, D) by 4 D hidden units and a GELU.

    With `conv`, a 3x3 depthwise convolution over the square grid of tokens precedes the GELU, as in
    SegFormer's Mix-FFN (Xie et al. 2021).
    """

    def __init__(self, dim: int, conv: bool = False) -> None:
        super().__init__()
        self.inner, self.outer = linear(dim, 4 * dim), linear(4 * dim, dim)
        self.mix = _depthwise(4 * dim) if conv else None

    def forward(self, tokens: Tensor) -> Tensor:
        hidden = self.inner(tokens)
        if self.mix is not None:
            hidden = to_tokens(self.mix(to_grid(hidden)))
        return self.outer(functional.gelu(hidden))


class TransformerBlock(nn.Module):
    """Pre-norm Transformer block on tokens (B, T, D): [cross-attention,] self-attention, MLP x4.

    With `cross`, tokens first attend to a context (B, K, D); the output projection of that is
    zero-initialised, so that a fresh block ignores the context. With `conv`, the MLP holds a 3x3
    depthwise convolution, and T must be a square.
    """

    def __init__(self, dim: int, heads: int, cross: bool = False, conv: bool = False) -> None:
        super().__init__()
        self.cross = Attention(dim, heads, zero=True) if cross else None
        if cross:
            self.norm_cross, self.norm_context = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.norm_self, self.attention = nn.LayerNorm(dim), Attention(dim, heads)
        self.norm_mlp, self.mlp = nn.LayerNorm(dim), FeedForward(dim, conv)

    def forward(self, tokens: Tensor, context: Tensor | None = None) -> Tensor:
        """(B, T, D) from tokens (B, T, D) and, in a block with `cross`, a context (B, K, D).

        Raises:
            ValueError: a context is missing, or given to a block without cross-attention.
        """
        if (context is None) != (self.cross is None):
            raise ValueError("a block takes a context if, and only if, it was built with cross")
        if self.cross is not None:
            tokens = tokens + self.cross(self.norm_cross(tokens), self.norm_context(context))
        tokens = tokens + self.attention(self.norm_self(tokens))
        return tokens + self.mlp(self.norm_mlp(tokens))


def to_tokens(grid: Tensor) -> Tensor:
    """(B, D, H, W) -> (B, H W, D), row by row."""
    return grid.flatten(2).mT


def to_grid(tokens: Tensor) -> Tensor:
    """(B, T, D) -> (B, D, side, side), the inverse of `to_tokens` for a square grid.

    Raises:
        ValueError: T is not a square.
    """
    side = math.isqrt(tokens.shape[-2])
    if side * side != tokens.shape[-2]:
        raise ValueError(f"tokens {tuple(tokens.shape)} do not fill a square grid")
    return tokens.mT.unflatten(-1, (side, side))


def position_grid(side: int, dim: int) -> Tensor:
    """Fixed 2D sine-cosine position embedding (side^2, dim) of a square grid, as tokens.

    A quarter of the width each for sin and cos of the column, sin and cos of the row (both counted
    from 0), at wavelengths from 2 pi to 2 pi 10^4 tokens in geometric progression, without the last
    (Vaswani et al. 2017, in two dimensions as MAE, He et al. 2022).

    Raises:
        ValueError: dim is not a multiple of 4.
    """
    if dim % 4:
        raise ValueError(f"the width of a position must be a multiple of 4, got {dim}")
    rate = 10000.0 ** -(torch.arange(dim // 4) / (dim // 4))
    angle = torch.arange(side)[:, None] * rate
    wave = torch.cat([angle.sin(), angle.cos()], -1)
    column = wave[None].expand(side, -1, -1)
    return torch.cat([column, column.transpose(0, 1)], -1).reshape(side * side, dim)


def coordinates(height: int, width: int) -> Tensor:
    """(2, height, width): x to the right, y down, of pixel centres; the frame spans [-1, 1]."""
    x = (2 * torch.arange(width) + 1) / width - 1
    y = (2 * torch.arange(height) + 1) / height - 1
    return torch.stack([x.expand(height, width), y[:, None].expand(height, width)])


def _depthwise(channels: int) -> nn.Conv2d:
    """3x3 convolution of each channel by itself; it starts as the identity."""
    layer = conv(channels, channels, groups=channels)
    nn.init.dirac_(layer.weight, groups=channels)
    return layer
