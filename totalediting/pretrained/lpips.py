"""LPIPS: the learned perceptual distance of Zhang et al. 2018, version 0.1.

Pictures a, b are (B, 3, H, W) display-referred RGB in [0, 1]. With y_l the unit-length activations
(over channels) of layer l of a network trained on ImageNet, and learnt weights w_l >= 0,

    d(a, b) = sum_l mean_hw sum_c w_lc (y_lc(a) - y_lc(b))^2

Evaluation commonly takes AlexNet, training VGG16.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from totalediting.pretrained.fetch import NetworkError, describe, fetch
from totalediting.pretrained.files import read_pickle


class _Layer(NamedTuple):
    """A convolution and ReLU. `pool`: side of the maximum (stride 2) before it, 0 for none."""

    channels: int
    kernel: int
    stride: int
    pool: int
    tap: bool


def _vgg() -> tuple[_Layer, ...]:
    blocks = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))
    return tuple(
        _Layer(channels, 3, 1, 2 if k == 0 and block > 0 else 0, k == count - 1)
        for block, (channels, count) in enumerate(blocks)
        for k in range(count)
    )


_NETWORKS = {
    "alex": (
        "AlexNet_0",
        (
            _Layer(64, 11, 4, 0, True),
            _Layer(192, 5, 1, 3, True),
            _Layer(384, 3, 1, 3, True),
            _Layer(256, 3, 1, 0, True),
            _Layer(256, 3, 1, 0, True),
        ),
    ),
    "vgg": ("VGG16_0", _vgg()),
}
_SMALLEST = {"alex": 31, "vgg": 16}  # of smaller pictures the poolings leave nothing
# ImageNet's mean and deviation as LPIPS scales pictures in [-1, 1].
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class Lpips(nn.Module):
    """The distance, frozen: gradients reach the pictures, never the weights.

    `description` says which network it is, for reports.
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, kind: Literal["alex", "vgg"], path: Path | str | None = None) -> None:
        """Fetches the weights on first use, or reads the local file `path` of the same layout.

        Raises:
            ValueError: no network of that `kind`.
            NetworkError: the weights cannot be had, or have other arrays.
        """
        super().__init__()
        if kind not in _NETWORKS:
            raise ValueError(f"kind must be one of {', '.join(_NETWORKS)}, not {kind!r}")
        self.kind = kind
        self.description = describe(f"lpips_{kind}", path)
        prefix, layers = _NETWORKS[kind]
        file = fetch(f"lpips_{kind}", path)
        stored = read_pickle(file)
        self.layers = layers
        self.convolutions = nn.ModuleList()
        linear, incoming = [], 3
        for k, layer in enumerate(layers):
            convolution = nn.Conv2d(
                incoming, layer.channels, layer.kernel, layer.stride, _padding(layer)
            )
            for parameter, name in ((convolution.weight, "kernel"), (convolution.bias, "bias")):
                _load(parameter, stored, f"{prefix}/Conv_{k}/{name}", file)
            self.convolutions.append(convolution)
            if layer.tap:
                weight = nn.Parameter(torch.empty(1, layer.channels, 1, 1))
                _load(weight, stored, f"NetLinLayer_{len(linear)}/Conv_0/kernel", file)
                linear.append(weight)
            incoming = layer.channels
        self.linear = nn.ParameterList(linear)
        self.register_buffer("shift", torch.tensor(_SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(_SCALE)[:, None, None])
        self.requires_grad_(False)

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Distances (B,), >= 0, of pictures (B, 3, H, W) in [0, 1]; 0 for equal ones.

        Raises:
            ValueError: the shapes differ, are no pictures, or are too small for the network.
        """
        smallest = _SMALLEST[self.kind]
        if a.shape != b.shape or a.ndim != 4 or a.shape[1] != 3 or min(a.shape[2:]) < smallest:
            raise ValueError(
                f"a and b must both be (B, 3, H, W) with sides of at least {smallest}, "
                f"not {tuple(a.shape)} and {tuple(b.shape)}"
            )
        # Apart, so that nothing is kept for the gradient of a picture that needs none.
        pairs = zip(self._activations(a), self._activations(b), self.linear, strict=True)
        parts = [(weight * (y - z).square()).sum(1).mean((1, 2)) for y, z, weight in pairs]
        return torch.stack(parts).sum(0)

    def _activations(self, picture: Tensor) -> list[Tensor]:
        x = (2.0 * picture - 1.0 - self.shift) / self.scale
        found = []
        for layer, convolution in zip(self.layers, self.convolutions, strict=True):
            if layer.pool:
                x = F.max_pool2d(x, layer.pool, 2)
            x = F.relu(convolution(x))
            if layer.tap:
                found.append(_unit(x))
        return found


def _padding(layer: _Layer) -> int:
    return 2 if layer.kernel > 3 else 1


def _unit(x: Tensor) -> Tensor:
    """Each pixel's channels scaled to unit length, in float32; 0 stays 0, with a gradient of 0."""
    x = x.float()
    return x * x.square().sum(1, keepdim=True).clamp_min(1e-20).rsqrt()


def _load(parameter: Tensor | None, stored: dict, name: str, file: Path) -> None:
    """Fill a parameter with the array `name`, kernels from (H, W, in, out) to (out, in, H, W)."""
    assert parameter is not None
    if name not in stored:
        raise NetworkError(f"{file}: holds no array {name}")
    values = torch.from_numpy(stored[name].copy())
    if values.ndim == 4:
        values = values.permute(3, 2, 0, 1)
    if values.shape != parameter.shape:
        raise NetworkError(
            f"{file}: {name} gives a weight of {tuple(values.shape)}, not {tuple(parameter.shape)}"
        )
    with torch.no_grad():
        parameter.copy_(values)
