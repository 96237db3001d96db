"""The appearance encoder E_app: a picture to a coarse global and a fine detail map.

    F_app = E_app(I_app)                                            (paper, section 3.2)

Symbols: B batch, S side of the picture. Pictures are display-referred RGB in [0, 1]; the branches
see them in [-1, 1] together with x and y of each pixel. The design is that of the paper's baseline
(Portrait4D, Deng et al. 2024, after Lp3D, Trevithick et al. 2023): a ResNet-34 with the dilations
and the atrous pyramid of DeepLabv3 (Chen et al. 2017) sees what is where, five convolutions at half
the side keep what is fine. The norms are over groups, not over the batch.

Where we depart from it: the fine branch also sees what of the source's light can be told from its
picture (`shown.Sheet`). Its features stay aligned with the picture's pixels, and are looked up
where canonical points appear: for the tri-planes on the front of the bust (`lay`), so that detail
lies where the planes hold it, and a few of them at every point that is shaded. The global branch
sees the picture and what was looked up on the front.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry import shown
from totalediting.geometry.shown import PIXEL, SIGHT, Sheet, Shown
from totalediting.networks.blocks import ResidualBlock, conv, conv_norm, coordinates, norm
from totalediting.presets import Preset

_FINE = PIXEL + 2  # channels that the fine branch sees: the source's pixels, x and y
_SEEN = PIXEL + 2 * SIGHT + 2  # and the global branch: both sides of the front as well
_DEPTHS = (3, 4, 6, 3)  # blocks in the stages of ResNet-34, for pictures of _SIDE
_SIDE = 512


class Appearance(NamedTuple):
    """The appearance of I_app."""

    global_: Tensor
    """(B, global_channels, S / 8, S / 8): what is where."""
    detail: Tensor
    """(B, detail_channels, S / 2, S / 2): texture and edges, on the bust's front."""
    shown: Shown
    """What decoders see of the source at points."""


class AppearanceEncoder(nn.Module):
    """E_app: sources with pictures of side S, as sheets, to `Appearance`."""

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
        self.align = conv(preset.detail_channels, preset.aligned_channels, 1)
        self.lay = conv(preset.detail_channels + 2 * SIGHT, preset.detail_channels)

    def forward(self, sheet: Sheet) -> Appearance:
        """Encode what sources show.

        Raises:
            ValueError: pixels of another shape than (B, 10, S, S).
        """
        side = self.xy.shape[-1]
        if sheet.pixels.ndim != 4 or sheet.pixels.shape[1:] != (PIXEL + 2, side, side):
            wanted = f"(B, {PIXEL + 2}, {side}, {side})"
            raise ValueError(f"pixels must be {wanted}, got {tuple(sheet.pixels.shape)}")
        xy = self.xy.to(sheet.pixels).expand(len(sheet.pixels), -1, -1, -1)
        detail = self.detail(torch.cat([sheet.seen, xy], 1))

        half = side // 2
        points = shown.on_front(sheet, half)
        sights, laid = shown.looked_up(sheet, detail.float(), points)
        sights, laid = (a.mT.unflatten(-1, (half, half)) for a in (sights, laid))
        front = functional.interpolate(sights, (side, side), mode="bilinear")
        seen = torch.cat([sheet.seen, front, xy], 1)
        return Appearance(
            self.pyramid(self.trunk(seen)),
            self.lay(torch.cat([laid, sights], 1)),
            Shown(sheet, self.align(detail).float()),
        )


def _trunk(preset: Preset) -> nn.Sequential:
    """(B, 30, S, S) -> (B, 2 global_channels, S / 8, S / 8): ResNet-34 with an output stride of 8.

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
    """(B, 10, S, S) -> (B, out, S / 2, S / 2): five convolutions, without norms, as in Lp3D."""
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
