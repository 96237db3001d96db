"""From the volume-rendered picture to the final one, and what lies behind the subject.

Detail finer than the volume-rendered picture comes from shading every pixel's surface once more:
`fine_structure`.

Symbols: B batch, S = preset.image, h = preset.neural, F = preset.features. Pictures are
display-referred RGB in [0, 1]; features are any numbers, as the shading decoder gives them.

Super-resolution is EG3D's (Chan et al. 2022): two blocks of StyleGAN2 on colour and features, each
of which adds to a picture that bilinear upsampling carries from the raw one. EG3D gives them a
constant style and no noise; modulation by a constant is a scale of weights, so that plain
convolutions remain. StyleGAN's learning rate of 2e-3 on unit weights is, on ours of size
1 / sqrt(fan-in), one of about 1e-4: what the rest of the network is trained with.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.light.phong import display, undisplay
from totalediting.networks.blocks import ResidualBlock, conv
from totalediting.presets import Preset

SLOPE = 0.2
"""Of leaky ReLU below 0, as in StyleGAN."""
_LEAST, _MOST = 0.5, 1.6  # factors of fine structure
_DARK = 0.05  # of colours that it is the ratio of


class SuperResolution(nn.Module):
    """Raw picture (B, 3, h, h) and features (B, F, h, h) to a picture (B, 3, S, S).

    All is local: a window of a picture, h smaller than the preset's, gives that window of the
    result but for its rim. A fresh network gives the raw picture, bilinearly upsampled, exactly. In
    training the result is not bounded, so that what overshoots still has a gradient; in evaluation
    it is clamped to [0, 1].
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        ups = _doublings(preset.neural, preset.image)
        if ups > 2:
            raise ValueError(
                f"two blocks cannot take {preset.neural} pixels to {preset.image}, at most fourfold"
            )
        width = preset.upsample_channels
        self.features = preset.features
        # The last `ups` blocks double the size.
        self.first = _Upsample(3 + preset.features, width, twice=ups > 1)
        self.second = _Upsample(width, width // 2, twice=ups > 0)

    def forward(self, raw: Tensor, features: Tensor) -> Tensor:
        """Raises ValueError where a shape does not fit."""
        size = raw.shape[2:]
        _check("raw", raw, (len(raw), 3, *size))
        _check("features", features, (len(raw), self.features, *size))
        x, picture = self.first(torch.cat([raw, features], 1), raw)
        _, picture = self.second(x, picture)
        return picture if self.training else picture.clamp(0.0, 1.0)


def fine_structure(shaded: Tensor, opacity: Tensor, scale: int) -> Tensor:
    """Factors (B, 3, S, S) by which the fine structure of shaded surfaces changes a picture.

    The ratio of `shaded` (B, 3, S, S), each pixel's surface in the light to show, display-referred,
    to what is left of it in a rendered picture, whose pixels are `scale` of these: the detail that
    that cannot hold. 1 where nothing is seen, by `opacity` (B, 1, S, S). Ours: deferred
    shading of what is looked up in the source.
    """
    shaded, opacity = shaded.float(), opacity.float()
    rendered = functional.avg_pool2d(shaded, scale)
    around = functional.interpolate(rendered, scale_factor=float(scale), mode="bilinear")
    factor = ((shaded + _DARK) / (around + _DARK)).clamp(_LEAST, _MOST)
    return torch.lerp(torch.ones_like(factor), factor, opacity)


class Background(nn.Module):
    """A U-Net from a portrait (B, 3, S, S) to what is behind the subject, (B, 3 + F, h, h).

    The first three channels are colour in [0, 1]. At an eighth of h, features see past a head.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        width, shrinks = preset.upsample_channels, _doublings(preset.neural, preset.image)
        stem = [conv(3, width, stride=2 if shrinks else 1), nn.LeakyReLU(SLOPE)]
        for _ in range(shrinks - 1):
            stem += [conv(width, width, stride=2), nn.LeakyReLU(SLOPE)]
        self.stem = nn.Sequential(*stem)
        widths = (width, width, 2 * width, 2 * width)
        steps = list(pairwise(widths))
        self.down = nn.ModuleList(ResidualBlock(a, b, stride=2) for a, b in steps)
        self.up = nn.ModuleList(ResidualBlock(a + b, a) for a, b in reversed(steps))
        self.out = conv(width, 3 + preset.features, kernel=1)
        nn.init.normal_(self.out.weight, std=0.01)
        self.side = preset.image

    def forward(self, image: Tensor) -> Tensor:
        """Raises ValueError where the shape does not fit."""
        _check("image", image, (len(image), 3, self.side, self.side))
        x = self.stem(2.0 * image - 1.0)
        levels = []
        for block in self.down:
            levels.append(x)
            x = block(x)
        for block in self.up:
            x = block(torch.cat([levels.pop(), _double(x)], 1))
        colour, features = self.out(x).tensor_split((3,), 1)
        return torch.cat([torch.sigmoid(colour), features], 1)


def over(
    light: Tensor, features: Tensor, opacity: Tensor, background: Tensor, linear: bool
) -> tuple[Tensor, Tensor]:
    """The subject in front of a background: raw picture (B, 3, h, h), features (B, F, h, h).

    `light` (B, 3, h, h) and `features` (B, F, h, h) are premultiplied by `opacity` (B, 1, h, h); to
    both, (1 - opacity) `background` (B, 3 + F, h, h) is added, whose colour is display-referred.
    Light adds up before it is shown, D(alpha c + (1 - alpha) b), where it is `linear`; else it is
    display-referred as well, and added as it is.

    Raises:
        ValueError: a shape does not fit.
    """
    batch, channels, *size = features.shape
    _check("light", light, (batch, 3, *size))
    _check("opacity", opacity, (batch, 1, *size))
    _check("background", background, (batch, 3 + channels, *size))
    behind, more = background.tensor_split((3,), 1)
    empty = 1.0 - opacity
    raw = display(light + empty * undisplay(behind, 1), 1) if linear else light + empty * behind
    return raw, features + empty * more


class _Upsample(nn.Module):
    """StyleGAN2's synthesis block with skip connection, of twice the size or of the same."""

    def __init__(self, channels: int, out: int, twice: bool) -> None:
        super().__init__()
        self.twice = twice
        self.convs = nn.Sequential(
            conv(channels, out), nn.LeakyReLU(SLOPE), conv(out, out), nn.LeakyReLU(SLOPE)
        )
        self.to_rgb = conv(out, 3, kernel=1)
        nn.init.zeros_(self.to_rgb.weight)

    def forward(self, x: Tensor, picture: Tensor) -> tuple[Tensor, Tensor]:
        if self.twice:
            x, picture = _double(x), _double(picture)
        x = self.convs(x)
        return x, picture + self.to_rgb(x)


def _double(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def _doublings(small: int, large: int) -> int:
    """How often `small` doubles until it is `large`."""
    times = (large // small).bit_length() - 1
    if times < 0 or small << times != large:
        raise ValueError(f"{large} pixels are not {small} doubled a whole number of times")
    return times


def _check(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != shape:
        raise ValueError(f"{name} must be {shape}, got {tuple(tensor.shape)}")
