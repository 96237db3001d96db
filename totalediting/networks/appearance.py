"""The appearance encoder E_app: a picture to a coarse global and a fine detail map.

    F_app = E_app(I_app)                                            (paper, section 3.2)

Symbols: B batch, S side of the picture. Pictures are display-referred RGB in [0, 1]; the branches
see them in [-1, 1] together with x and y of each pixel. The design is that of the paper's baseline
(Portrait4D, Deng et al. 2024, after Lp3D, Trevithick et al. 2023): a ResNet-34 with the dilations
and the atrous pyramid of DeepLabv3 (Chen et al. 2017) sees what is where, five convolutions at half
the side keep what is fine. The norms are over groups, not over the batch.

Where we depart from it: the fine branch does not see the picture itself but the picture laid onto
the bust (`frontal`), and that mirrored, which shows what the pose hides; so detail lies where the
planes hold it. The global branch sees all three.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry.frontal import CHANNELS, LAID, both_sides
from totalediting.networks.blocks import ResidualBlock, conv, conv_norm, coordinates, norm
from totalediting.presets import Preset

_FINE = LAID + 2  # channels that the fine branch sees: laid, mirrored, x and y
_SEEN = _FINE + 3  # and the global branch, which sees the picture as well
_DEPTHS = (3, 4, 6, 3)  # blocks in the stages of ResNet-34, for pictures of _SIDE
_SIDE = 512


class Appearance(NamedTuple):
    """The appearance of I_app."""

    global_: Tensor
    """(B, global_channels, S / 8, S / 8): what is where."""
    detail: Tensor
    """(B, detail_channels, S / 2, S / 2): texture and edges, on the bust's front."""


class AppearanceEncoder(nn.Module):
    """E_app: pictures (B, 3, S, S) in [0, 1], as they are and laid onto the bust, to
    `Appearance`."""

    xy: Tensor

    def __init__(self, preset: Preset) -> None:
        """Build for pictures of side `preset.image`.

        Raises:
            ValueError: that side is not a multiple of 16, or `global_channels` is not one of 4.
        """
        super().__init__()
        if preset.image % 16 or preset.global_channels % 4:
            raise ValueError(
                f"image {preset.image} must be a multiple of 16, "
                f"global_channels {preset.global_channels} of 4"
            )
        self.register_buffer("xy", coordinates(preset.image, preset.image), persistent=False)
        self.trunk = _trunk(preset)
        self.pyramid = _AtrousPyramid(2 * preset.global_channels, preset)
        self.detail = _detail(preset.detail_channels)

    def forward(self, image: Tensor, frontal: Tensor) -> Appearance:
        """Encode pictures (B, 3, S, S) in [0, 1]; `frontal` is what `frontalise` makes of them.

        Raises:
            ValueError: other shapes than (B, 3, S, S) and (B, 6, S, S).
        """
        side = self.xy.shape[-1]
        for name, x, channels in (("image", image, 3), ("frontal", frontal, CHANNELS)):
            if x.ndim != 4 or x.shape[1:] != (channels, side, side):
                wanted = f"(B, {channels}, {side}, {side})"
                raise ValueError(f"{name} must be {wanted}, got {tuple(x.shape)}")
        xy = self.xy.to(image).expand(len(image), -1, -1, -1)
        laid = torch.cat([both_sides(frontal), xy], 1)
        seen = torch.cat([2 * image - 1, laid], 1)
        return Appearance(self.pyramid(self.trunk(seen)), self.detail(laid))


def _trunk(preset: Preset) -> nn.Sequential:
    """(B, 15, S, S) -> (B, 2 global_channels, S / 8, S / 8): ResNet-34 with an output stride of 8.

    Widths are ResNet-34's where global_channels is 256. A picture of half the side gets half the
    blocks, so that a feature sees about the same share of it.
    """
    width = preset.global_channels // 4
    layers = [conv(_SEEN, width, 7, 2), norm(width), nn.ReLU(), nn.MaxPool2d(3, 2, 1)]
    widths = (width, width, 2 * width, 4 * width, 8 * width)
    strides, dilations = (1, 2, 1, 1), (1, 1, 2, 4)
    for depth, (channels, out), stride, dilation in zip(
        _DEPTHS, pairwise(widths), strides, dilations, strict=True
    ):
        layers.append(ResidualBlock(channels, out, stride, dilation))
        more = max(1, round(depth * preset.image / _SIDE)) - 1
        layers += [ResidualBlock(out, out, 1, dilation) for _ in range(more)]
    return nn.Sequential(*layers)


def _detail(out: int) -> nn.Sequential:
    """(B, 12, S, S) -> (B, out, S / 2, S / 2): five convolutions, without norms, as in Lp3D."""
    layers: list[nn.Module] = [conv(_FINE, out, 7, 2)]
    for _ in range(4):
        layers += [nn.LeakyReLU(0.01), conv(out, out)]
    return nn.Sequential(*layers)


class _AtrousPyramid(nn.Module):
    """DeepLabv3's head: (B, C, h, h) -> (B, global_channels, h, h).

    3x3 convolutions at three dilations, a 1x1 convolution and the mean of the map are joined. The
    dilations are DeepLabv3's 12, 24 and 36 on a map of side 64, and in proportion on smaller ones.
    """

    def __init__(self, channels: int, preset: Preset) -> None:
        super().__init__()
        out = preset.global_channels
        self.point = nn.Sequential(conv(channels, out, 1), norm(out), nn.ReLU())
        rates = (max(1, round(rate * preset.image / _SIDE)) for rate in (12, 24, 36))
        self.rings = nn.ModuleList(conv_norm(channels, out, 1, rate) for rate in rates)
        # No norm: on a map of one pixel it would take the mean's magnitude away.
        self.mean = nn.Sequential(nn.AdaptiveAvgPool2d(1), conv(channels, out, 1), nn.ReLU())
        self.join = nn.Sequential(
            conv(5 * out, out, 1), norm(out), nn.ReLU(), conv_norm(out, out), conv(out, out, 1)
        )

    def forward(self, x: Tensor) -> Tensor:
        parts = [self.point(x), *(ring(x) for ring in self.rings)]
        mean = functional.interpolate(self.mean(x), size=x.shape[-2:])
        return self.join(torch.cat([*parts, mean], 1))
