"""Deenactor and reenactor: expression taken out of an appearance, and another put in.

    F = F_re(F_de(F_app, e_app), e_mot)                             (paper, section 3.2)

Symbols: B batch, t = preset.tokens side of the grid of tokens, D = preset.token_dim their width,
K = preset.motion_tokens. e (B, 54) is a code of motion: 52 ARKit coefficients in [0, 1] in the
order of `motion.poses.ARKIT_NAMES`, then gaze (yaw, pitch) in radians. Both modules are
Transformers whose blocks attend to the code's tokens, then to each other, then pass an MLP with a
depthwise convolution (after Portrait4D, Deng et al. 2024). Cross-attention is zero-initialised:
fresh modules know nothing of the code, so that a static reconstruction can be learnt first.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry.tracking import CODE
from totalediting.networks.blocks import (
    TransformerBlock,
    conv,
    linear,
    position_grid,
    to_grid,
    to_tokens,
)
from totalediting.presets import Preset


class Deenactor(nn.Module):
    """F_de: the global map of E_app and its own code to neutral tokens (B, D, t, t)."""

    position: Tensor

    def __init__(self, preset: Preset) -> None:
        """Build for global maps of side `preset.image` / 8.

        Raises:
            ValueError: `preset.tokens` does not divide that side.
        """
        super().__init__()
        self.shape = (preset.global_channels, preset.image // 8, preset.image // 8)
        if self.shape[1] % preset.tokens:
            raise ValueError(f"{preset.tokens} tokens do not divide a map of side {self.shape[1]}")
        self.embed = conv(
            preset.global_channels, preset.token_dim, 3, self.shape[1] // preset.tokens
        )
        position = position_grid(preset.tokens, preset.token_dim)
        self.register_buffer("position", position, persistent=False)
        self.motion = MotionTokens(preset)
        self.blocks = _blocks(preset, preset.deenact_blocks)

    def forward(self, appearance: Tensor, code: Tensor) -> Tensor:
        """Neutral tokens (B, D, t, t) of a global map (B, global_channels, S / 8, S / 8).

        `code` (B, 54) is e_app, the motion that the picture itself shows.

        Raises:
            ValueError: shapes that do not fit.
        """
        if appearance.ndim != 4 or appearance.shape[1:] != self.shape:
            raise ValueError(
                f"appearance must be {('B', *self.shape)}, got {tuple(appearance.shape)}"
            )
        motion = self.motion(code, len(appearance))
        tokens = to_tokens(self.embed(appearance)) + self.position.to(appearance)
        for block in self.blocks:
            tokens = block(tokens, motion)
        return to_grid(tokens)


class Reenactor(nn.Module):
    """F_re: neutral tokens and a code of motion to the fused feature F (B, D, t, t).

    Positions come with the tokens. F is normalised per token, by a LayerNorm.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.shape = (preset.token_dim, preset.tokens, preset.tokens)
        self.motion = MotionTokens(preset)
        self.blocks = _blocks(preset, preset.reenact_blocks)
        self.norm = nn.LayerNorm(preset.token_dim)

    def forward(self, neutral: Tensor, code: Tensor) -> Tensor:
        """F (B, D, t, t) from the deenactor's tokens (B, D, t, t) and e_mot, `code` (B, 54).

        Raises:
            ValueError: shapes that do not fit.
        """
        if neutral.ndim != 4 or neutral.shape[1:] != self.shape:
            raise ValueError(f"neutral must be {('B', *self.shape)}, got {tuple(neutral.shape)}")
        motion = self.motion(code, len(neutral))
        tokens = to_tokens(neutral)
        for block in self.blocks:
            tokens = block(tokens, motion)
        return to_grid(self.norm(tokens))


class MotionTokens(nn.Module):
    """A code (B, 54) to K tokens (B, K, D), by an MLP of one hidden layer.

    Every token has a first layer of its own; the second is shared, and a learnt embedding tells
    the tokens apart also where the face is at rest.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        count, dim = preset.motion_tokens, preset.token_dim
        self.inner, self.outer = linear(CODE, count * dim), linear(dim, dim)
        # Of a code few coefficients are away from 0; their squares add up to about 1.
        nn.init.normal_(self.inner.weight)
        self.embedding = nn.Parameter(torch.randn(count, dim))

    def forward(self, code: Tensor, batch: int) -> Tensor:
        """(B, K, D) from a code (B, 54), of which there must be `batch`.

        Raises:
            ValueError: another shape.
        """
        if code.shape != (batch, CODE):
            raise ValueError(f"code must be ({batch}, {CODE}), got {tuple(code.shape)}")
        hidden = functional.gelu(self.inner(code)).unflatten(-1, self.embedding.shape)
        return self.outer(hidden) + self.embedding


def fuse(
    deenactor: Deenactor, reenactor: Reenactor, appearance: Tensor, e_app: Tensor, e_mot: Tensor
) -> Tensor:
    """F = F_re(F_de(F_app, e_app), e_mot), (B, D, t, t).

    Args:
        deenactor: F_de.
        reenactor: F_re.
        appearance: (B, global_channels, S / 8, S / 8), the global map of I_app.
        e_app: (B, 54), the motion in I_app.
        e_mot: (B, 54), the motion to show.

    Raises:
        ValueError: shapes that do not fit.
    """
    return reenactor(deenactor(appearance, e_app), e_mot)


def _blocks(preset: Preset, count: int) -> nn.ModuleList:
    return nn.ModuleList(
        TransformerBlock(preset.token_dim, preset.heads, cross=True, conv=True)
        for _ in range(count)
    )
