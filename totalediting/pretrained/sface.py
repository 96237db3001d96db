"""Identity of faces: features of the face recogniser SFace, differentiable.

SFace (Zhong et al. 2021; OpenCV Zoo, 2021-12) is a MobileFaceNet: a convolution and 13 pairs of
depthwise and pointwise ones, each with batch normalisation and PReLU, then one linear layer. It
looks at RGB pictures of 112 x 112 in which eyes, nose and mouth lie at fixed places. Its file holds
integers with a scale per 64; here they are floating point, with every normalisation folded in.

Pixel coordinates are the dataset's: x right, y down, the centre of the upper left pixel at
(0.5, 0.5). Left and right are the subject's. Points of a face are five: right eye, left eye, tip
of the nose, right and left corner of the mouth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from totalediting.pretrained.fetch import NetworkError, describe, fetch
from totalediting.pretrained.files import read_onnx

SIDE = 112
"""Side of an aligned picture."""
TEMPLATE = (
    (38.7946, 52.1963),
    (74.0318, 52.0014),
    (56.5252, 72.2366),
    (42.0493, 92.8655),
    (71.2299, 92.7041),
)
"""Where the five points go: ArcFace's template (Deng et al. 2019), half a pixel further, as it
counts from the centre of the upper left pixel."""
_STRIDED = (3, 5, 7, 13)  # numbers of the depthwise convolutions of stride 2
_BLOCKS = 14


class Recognition(nn.Module):
    """SFace, frozen: gradients reach the pictures, never the weights.

    `description` says which network it is, for reports.
    """

    def __init__(self, path: Path | str | None = None) -> None:
        """Fetches the weights on first use, or reads the local ONNX file `path` of that graph.

        Raises:
            NetworkError: the weights cannot be had, or the file has other tensors.
        """
        super().__init__()
        self.description = describe("sface", path)
        file = fetch("sface", path)
        stored = read_onnx(file)
        names = ["conv_1"]
        for k in range(2, _BLOCKS + 1):
            names += [f"conv_{k}_dw", f"conv_{k}"]
        try:
            self.layers = nn.Sequential(*(m for name in names for m in _convolution(stored, name)))
            self.linear = _linear(stored)
        except (KeyError, ValueError, IndexError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise NetworkError(f"{file}: not the SFace of OpenCV's zoo: {reason}") from None
        self.requires_grad_(False)

    def forward(self, aligned: Tensor) -> Tensor:
        """Features (B, 128), of any length, of aligned pictures (B, 3, 112, 112) in [0, 1].

        Two pictures are as alike as the cosine of their features, `similarity`.

        Raises:
            ValueError: the pictures have another shape.
        """
        if aligned.ndim != 4 or aligned.shape[1:] != (3, SIDE, SIDE):
            raise ValueError(f"aligned must be (B, 3, {SIDE}, {SIDE}), not {tuple(aligned.shape)}")
        return self.linear(self.layers((255.0 * aligned - 127.5) / 128.0).flatten(1))

    def features(self, picture: Tensor, points: Tensor) -> Tensor:
        """Features (B, 128) of the faces with five `points` (B, 5, 2) in pictures (B, 3, H, W)."""
        return self(align(picture, points))


def similarity(a: Tensor, b: Tensor) -> Tensor:
    """CSIM (...) in [-1, 1]: cosine of features (..., C). Above .363 OpenCV calls it one person."""
    return F.cosine_similarity(a, b, dim=-1)


def five_points(landmarks: Tensor) -> Tensor:
    """The five points (..., 5, 2) of landmarks (..., 68 or 70, 2) in iBUG's order.

    An eye is the mean of its six contour points, which gaze does not move.

    Raises:
        ValueError: the landmarks have another shape.
    """
    if landmarks.ndim < 2 or landmarks.shape[-2] not in (68, 70) or landmarks.shape[-1] != 2:
        raise ValueError(f"landmarks must be (..., 68 or 70, 2), not {tuple(landmarks.shape)}")
    right, left = landmarks[..., 36:42, :].mean(-2), landmarks[..., 42:48, :].mean(-2)
    return torch.stack([right, left, *landmarks[..., (30, 48, 54), :].unbind(-2)], dim=-2)


def align(picture: Tensor, points: Tensor) -> Tensor:
    """Pictures (B, 3, H, W) moved, turned and scaled so that `points` (B, 5, 2) lie right.

    The similarity is the best by least squares (Umeyama 1991, without mirroring), as OpenCV's; the
    result (B, 3, 112, 112) is bilinear, 0 outside of the picture, differentiable in the picture.

    Raises:
        ValueError: other shapes, or points that coincide or are not finite.
    """
    if picture.ndim != 4 or picture.shape[1] != 3 or points.shape != (len(picture), 5, 2):
        raise ValueError(
            f"picture and points must be (B, 3, H, W) and (B, 5, 2), "
            f"not {tuple(picture.shape)} and {tuple(points.shape)}"
        )
    # Plane points as complex numbers z: the similarity is t = s (z - mean z) + mean t, and the
    # least squares over s give conj(s) = sum conj(t) z / sum |z|^2. Undone, template to picture.
    # In double precision, which not every device has.
    z = torch.view_as_complex(points.detach().cpu().double().contiguous())
    template = torch.view_as_complex(torch.tensor(TEMPLATE, dtype=torch.float64))
    middle = z.mean(1, keepdim=True)
    size = (z - middle).abs().square().sum(1, keepdim=True)
    forward = ((z - middle).conj() * (template - template.mean())).sum(1, keepdim=True)
    if not (size.min() > 1e-9 and forward.abs().min() > 1e-9):
        raise ValueError("the points of a face coincide or are not finite")
    ticks = torch.arange(SIDE, dtype=torch.float64) + 0.5
    pixels = torch.complex(ticks.repeat(SIDE), ticks.repeat_interleave(SIDE))
    source = torch.view_as_real((pixels - template.mean()) * (size / forward) + middle)
    extent = torch.tensor([picture.shape[3], picture.shape[2]])
    grid = (
        (2.0 * source / extent - 1.0).unflatten(1, (SIDE, SIDE)).to(picture.device, picture.dtype)
    )
    return F.grid_sample(picture, grid, padding_mode="zeros", align_corners=False)


def _convolution(stored: dict[str, np.ndarray], name: str) -> tuple[nn.Conv2d, nn.PReLU]:
    """A convolution without bias, its batch normalisation folded in, and a PReLU."""
    shape = [int(n) for n in stored[f"{name}_conv2d_weight_shape"]]
    weight = _dequantised(stored, f"{name}_conv2d_weight").reshape(shape)
    scale, offset = _normalisation(stored, f"{name}_batchnorm", 1e-3)
    channels, inputs, kernel, _ = shape
    depthwise = name.endswith("_dw")
    layer = nn.Conv2d(
        channels if depthwise else inputs,
        channels,
        kernel,
        stride=2 if depthwise and int(name.split("_")[1]) in _STRIDED else 1,
        padding=kernel // 2,
        groups=channels if depthwise else 1,
    )
    slope = nn.PReLU(channels)
    _fill(layer, weight * scale[:, None, None, None], offset)
    _copy(slope.weight, stored[f"{name}_relu_gamma"].reshape(channels))
    return layer, slope


def _linear(stored: dict[str, np.ndarray]) -> nn.Linear:
    """The last layer, with the normalisations before and after it folded in."""
    weight = _dequantised(stored, "pre_fc1_weight")
    bias = _dequantised(stored, "pre_fc1_bias", axis=0)
    before, shift = (
        np.repeat(values, weight.shape[1] // len(values))
        for values in _normalisation(stored, "bn1", 2e-5)
    )
    after, offset = _normalisation(stored, "fc1", 2e-5)
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    _fill(layer, weight * before * after[:, None], (weight @ shift + bias) * after + offset)
    return layer


def _normalisation(
    stored: dict[str, np.ndarray], name: str, epsilon: float
) -> tuple[np.ndarray, np.ndarray]:
    """Factor and summand, by channel, that a batch normalisation comes to."""
    gamma, beta, mean, variance = (
        stored[f"{name}_{part}"].astype(np.float64)
        for part in ("gamma", "beta", "moving_mean", "moving_var")
    )
    factor = gamma / np.sqrt(variance + epsilon)
    return factor, beta - mean * factor


def _dequantised(stored: dict[str, np.ndarray], name: str, axis: int = 1) -> np.ndarray:
    """(q - zero) scale, each scale standing for an equal run along `axis` (DequantizeLinear)."""
    quantised = stored[f"{name}_quantized"].astype(np.float64)
    scale, zero = stored[f"{name}_scales"], stored[f"{name}_zero_point"]
    run = quantised.shape[axis] // scale.shape[axis]
    return (quantised - np.repeat(zero, run, axis)) * np.repeat(scale, run, axis)


def _fill(layer: nn.Conv2d | nn.Linear, weight: np.ndarray, bias: np.ndarray) -> None:
    assert layer.bias is not None
    _copy(layer.weight, weight)
    _copy(layer.bias, bias)


def _copy(parameter: Tensor, values: np.ndarray) -> None:
    if tuple(parameter.shape) != values.shape:
        raise ValueError(f"a weight is {values.shape}, not {tuple(parameter.shape)}")
    with torch.no_grad():
        parameter.copy_(torch.from_numpy(np.array(values)))
