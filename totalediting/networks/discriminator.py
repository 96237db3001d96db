"""The adversary: is a picture real, and does its volume rendering belong to it?

Symbols: B batch, S = preset.image, h = preset.neural. A dual discriminator after EG3D (Chan et al.
2022) and Portrait4D (Deng et al. 2024) sees the final picture beside the raw one, so that
super-resolution cannot change the subject, and beside canonical coordinates and opacity, so that
every place of a head must look like that place. Of real pictures, the raw one is the real one made
small, and canonical coordinates are the dataset's or a tracker's.

StyleGAN2's residual network (Karras et al. 2020), conditioned on the camera by projection (Miyato
and Koyama 2018). Logits: above 0 means real.
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.networks.blocks import conv, linear
from totalediting.networks.superresolution import SLOPE
from totalediting.presets import Preset

CHANNELS = 10
"""Final picture 3, raw picture 3, canonical coordinates 3, opacity 1."""
CAMERA = 16
"""Length of a camera's code: its pose, 3 x 4, and fx, fy, cx, cy as shares of the picture."""
EXTENT = 0.3
"""Metres that canonical coordinates are divided by: half the side of the box."""

_LAST = 4  # side of the last feature map
_GROUP = 4  # pictures that minibatch deviation compares


class Discriminator(nn.Module):
    """(B, 10, S, S) pictures by `stack` and (B, 16) cameras by `camera_code` to logits (B,).

    Channels start at half of preset.upsample_channels and double with every halving of the side,
    to at most 8 times of them, 512 in the full preset as in StyleGAN2.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        halvings = (preset.image // _LAST).bit_length() - 1
        if _LAST << halvings != preset.image:
            raise ValueError(f"image must be {_LAST} times a power of two, got {preset.image}")
        most = 4 * preset.upsample_channels
        widths = [min(preset.upsample_channels << k, 2 * most) // 2 for k in range(halvings + 1)]
        self.side, last = preset.image, widths[-1]
        self.from_pictures = nn.Sequential(conv(CHANNELS, widths[0], kernel=1), _act())
        self.blocks = nn.Sequential(*(_Downsample(a, b) for a, b in pairwise(widths)))
        self.mix = nn.Sequential(conv(last + 1, last), _act())
        self.flat = nn.Sequential(linear(last * _LAST * _LAST, last), _act())
        self.out = linear(last, last)
        self.camera = nn.Sequential(linear(CAMERA, last), _act(), linear(last, last), _act())
        self.project = linear(last, last)

    def forward(self, pictures: Tensor, camera: Tensor) -> Tensor:
        """Raises ValueError where a shape does not fit."""
        expected = (len(pictures), CHANNELS, self.side, self.side)
        if tuple(pictures.shape) != expected:
            raise ValueError(f"pictures must be {expected}, got {tuple(pictures.shape)}")
        if camera.shape != (len(pictures), CAMERA):
            raise ValueError(f"camera must be {(len(pictures), CAMERA)}, got {tuple(camera.shape)}")
        x = self.blocks(self.from_pictures(pictures))
        x = self.mix(torch.cat([x, _deviation(x)], 1))
        found = self.out(self.flat(x.flatten(1)))
        wanted = functional.normalize(self.project(self.camera(camera)), dim=-1)
        return (found * wanted).sum(-1)


def stack(picture: Tensor, raw: Tensor, canonical: Tensor, opacity: Tensor) -> Tensor:
    """(B, 10, S, S) for the discriminator.

    `picture` (B, 3, S, S) and `raw` (B, 3, h, h) in [0, 1], scaled to [-1, 1]; `canonical`
    (B, 3, h, h) metres, premultiplied by `opacity` (B, 1, h, h), as rendered. What is smaller than
    `picture` is upsampled bilinearly.

    Raises:
        ValueError: a shape does not fit.
    """
    batch, size = len(picture), raw.shape[-2:]
    for name, tensor, channels, wanted in (
        ("picture", picture, 3, picture.shape[-2:]),
        ("raw", raw, 3, size),
        ("canonical", canonical, 3, size),
        ("opacity", opacity, 1, size),
    ):
        if tuple(tensor.shape) != (batch, channels, *wanted):
            shape = (batch, channels, *wanted)
            raise ValueError(f"{name} must be {shape}, got {tuple(tensor.shape)}")
    small = torch.cat([2.0 * raw - 1.0, canonical / EXTENT, opacity], 1)
    large = functional.interpolate(small, picture.shape[-2:], mode="bilinear", align_corners=False)
    return torch.cat([2.0 * picture - 1.0, large], 1)


def camera_code(camera_to_world: Tensor, intrinsics: Tensor, side: int) -> Tensor:
    """(B, 16) of cameras (B, 4, 4) into model space, intrinsics (B, 3, 3) for `side` pixels."""
    if camera_to_world.shape[1:] != (4, 4) or intrinsics.shape != (len(camera_to_world), 3, 3):
        raise ValueError(
            "camera_to_world and intrinsics must be (B, 4, 4) and (B, 3, 3), got "
            f"{tuple(camera_to_world.shape)} and {tuple(intrinsics.shape)}"
        )
    lens = intrinsics[:, (0, 1, 0, 1), (0, 1, 2, 2)] / side
    return torch.cat([camera_to_world[:, :3].flatten(1), lens], 1)


def generator_loss(fake: Tensor) -> Tensor:
    """Non-saturating loss (Goodfellow et al. 2014) of logits (B,) of generated pictures."""
    return functional.softplus(-fake).mean()


def discriminator_loss(real: Tensor, fake: Tensor) -> Tensor:
    """Logistic loss of logits (B,) of real and of generated (detached) pictures."""
    return functional.softplus(-real).mean() + functional.softplus(fake).mean()


def r1_penalty(discriminator: Discriminator, real: Tensor, camera: Tensor) -> Tensor:
    """Mean of |d logit / d pictures|^2 at `real` (B, 10, S, S): R1 of Mescheder et al. 2018.

    Without its factor gamma / 2, nor that of lazy regularisation. Differentiable in parameters.
    """
    with torch.enable_grad():
        real = real.detach().requires_grad_()
        logits = discriminator(real, camera)
        (gradient,) = torch.autograd.grad(logits.sum(), real, create_graph=True)
        return gradient.square().sum((1, 2, 3)).mean()


class _Downsample(nn.Module):
    """StyleGAN2's residual block to half the side; a mean of 2x2 pixels is its low-pass."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            conv(channels, channels), _act(), nn.AvgPool2d(2), conv(channels, out), _act()
        )
        self.skip = nn.Sequential(nn.AvgPool2d(2), conv(channels, out, kernel=1))

    def forward(self, x: Tensor) -> Tensor:
        return (self.body(x) + self.skip(x)) * math.sqrt(0.5)


def _act() -> nn.LeakyReLU:
    return nn.LeakyReLU(SLOPE)


def _deviation(x: Tensor) -> Tensor:
    """(B, 1, H, W): how much the pictures of a group differ, the mean over all of a map.

    Groups are the largest that divide the batch, of at most `_GROUP` (Karras et al. 2018).
    """
    size = max(n for n in range(1, _GROUP + 1) if len(x) % n == 0)
    groups = x.unflatten(0, (size, -1))
    spread = (groups.var(0, unbiased=False) + 1e-8).sqrt().mean((1, 2, 3))
    return spread.repeat(size)[:, None, None, None].expand(-1, 1, *x.shape[2:])
