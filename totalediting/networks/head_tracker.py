"""The head tracker: motion, identity and camera of a picture, which E_mot and the deformation need.

    e_app = E_mot(I_app),  e_mot = E_mot(I_mot)                     (paper, section 3.2)

Symbols: B batch, S side of the picture. The paper takes its codes from a pre-trained encoder; ours
is learnt from true labels. Angles are in radians, with the signs of docs/conventions.md: gaze (yaw,
pitch) of the eyes in the head, head (pitch, roll, yaw) against the trunk, camera (yaw, pitch, roll)
about the head. A camera is described as a dataset's: its angles, its focal length on a sensor of
36 mm, `fill` = height of the head / height of the frame, and `shift`, where the head's centre
appears, as a share of the frame from its middle (right, up).

Expression and gaze, which are small in a picture, are read from the face alone, straightened by
five points found in the picture; the head's pose is read from the face and the whole picture.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry.tracking import (
    SIZES,
    Tracking,
)
from totalediting.networks.blocks import ResidualBlock, conv, conv_norm, coordinates, norm
from totalediting.presets import Preset
from totalediting.pretrained import sface

_SIDE = 128  # pixels that the network sees along a side
_WIDTHS = (32, 64, 128, 256)
_FINE, _COARSE = 16, 4  # cells along a side of the maps: points are found on the fine ones
_FACE = 64  # pixels along a side of the straightened face
_FACE_WIDTHS = (24, 24, 48, 96)
_FACE_FEATURES = 128
_SOURCES = {  # what a field is read from: the whole picture, the straightened face, or both
    "expression": ("face",),
    "gaze": ("face",),
    "head": ("picture", "face"),
    "identity": ("picture",),
    "camera_yaw_pitch_roll": ("picture", "face"),
    "log_focal": ("picture",),
    "log_fill": ("picture",),
    "shift": ("picture",),
}
_REST = 0.05  # an untrained tracker's expression coefficients

WEIGHTS = {
    "expression": 50.0,
    "gaze": 8.0,
    "head": 8.0,
    "identity": 0.6,
    "camera_yaw_pitch_roll": 4.0,
    "log_focal": 3.0,
    "log_fill": 14.0,
    "shift": 70.0,
    "face": 35.0,
}
"""Weight of each field's error in `tracking_loss`: the mean absolute one, for the expression the
mean square, as most coefficients are 0 most of the time and a median would be content with that.

The inverse of each field's mean deviation from its median in a job of default settings (gaze 0.12,
head 0.13, camera 0.24, log focal length 0.18, log fill 0.07, shift 0.015), of the expression that
of its mean variance, 0.02, so that all start near 1; half of it for the focal length, which little
of a picture tells, and for identity (of unit variance), of which much cannot be seen. The face's
points (0.06) count double, as everything read from the face depends on them.
"""


class HeadTracker(nn.Module):
    """Pictures (B, 3, S, S) in [0, 1] to `Tracking`: a ResNet that finds the face, and a small one
    that reads it.

    Pictures are resized to 128 x 128 first, so that the weights do not depend on the preset: one
    tracker serves all. A fresh one finds a nearly neutral face before a neutral camera everywhere.
    """

    xy: Tensor
    cells: Tensor
    template: Tensor

    def __init__(self, preset: Preset) -> None:
        """Build for pictures of side `preset.image`, all that the preset decides here."""
        super().__init__()
        self.image = preset.image
        self.register_buffer("xy", coordinates(_SIDE, _SIDE), persistent=False)
        first, second, third, fourth = _WIDTHS
        self.fine = nn.Sequential(
            conv(5, first, 7, 2),
            norm(first),
            nn.ReLU(),
            *_halving(first, first),
            *_halving(first, second),
        )
        self.coarse = nn.Sequential(*_halving(second, third), *_halving(third, fourth))
        self.place = nn.Sequential(ResidualBlock(second + fourth, second), conv(second, 5, 1))
        self.register_buffer("cells", coordinates(_FINE, _FINE).flatten(1), persistent=False)
        widths, cells = _FACE_WIDTHS, _FACE // 8
        self.face = nn.Sequential(
            *conv_norm(3, widths[0]),
            *(ResidualBlock(*pair, 2) for pair in pairwise(widths)),
            nn.Flatten(),
            nn.Linear(widths[-1] * cells**2, _FACE_FEATURES),
            nn.ReLU(),
        )
        # ArcFace's places of the five points, as shares of half a face from its middle, downwards.
        template = 2 * torch.tensor(sface.TEMPLATE) / sface.SIDE - 1
        self.register_buffer("template", template, persistent=False)
        features = {"face": _FACE_FEATURES, "picture": fourth * _COARSE**2}
        self.heads = nn.ModuleDict(
            {
                name: _head(sum(features[source] for source in sources), getattr(SIZES, name))
                for name, sources in _SOURCES.items()
            }
        )
        expression = self.heads["expression"]
        assert isinstance(expression, nn.Linear)
        nn.init.constant_(expression.bias, _REST)

    def forward(self, image: Tensor, face: Tensor | None = None) -> Tracking:
        """Track pictures (B, 3, S, S) in [0, 1]; each by itself, without what came before.

        With `face`, as of `Tracking`, the face is read there and not where it is found.

        Raises:
            ValueError: another shape.
        """
        if image.ndim != 4 or image.shape[1:] != (3, self.image, self.image):
            raise ValueError(
                f"image must be (B, 3, {self.image}, {self.image}), got {tuple(image.shape)}"
            )
        small = functional.interpolate(image, (_SIDE, _SIDE), mode="bilinear", antialias=True)
        seen = torch.cat([2 * small - 1, self.xy.to(image).expand(len(image), -1, -1, -1)], 1)
        last = torch.channels_last  # a step takes a seventh less time on a CPU
        fine = self.fine(seen.contiguous(memory_format=last))
        coarse = self.coarse(fine)
        found = self._place(fine, coarse)
        face = found.detach() if face is None else face
        laid = self.lay_out(small, face).contiguous(memory_format=last)
        features = {"face": self.face(laid), "picture": coarse.flatten(1)}
        fields = {
            name: head(torch.cat([features[source] for source in _SOURCES[name]], -1))
            for name, head in self.heads.items()
        }
        if not self.training:  # what overshoots still has a gradient in training
            fields["expression"] = fields["expression"].clamp(0, 1)
        return Tracking(**fields, face=found)

    def lay_out(self, image: Tensor, face: Tensor) -> Tensor:
        """Faces (B, 3, 64, 64) in [-1, 1], turned and scaled so that the points `face` (B, 10) of
        pictures (B, 3, H, H) in [0, 1] lie where ArcFace has them; beyond the border, its pixels
        are repeated.

        The similarity from face to picture is the best by least squares. With complex numbers t of
        the template about its mean and z of the points, it is sum conj(t) z / sum |t|^2. Unlike
        `sface.align`, it takes points that coincide, as those of a fresh tracker may.
        """
        points = 2 * face.float().unflatten(-1, (5, 2)) * face.new_tensor([1, -1])
        middle, centre = points.mean(1), self.template.mean(0)
        (tx, ty), (x, y) = (
            (p - p.mean(-2, keepdim=True)).unbind(-1) for p in (self.template, points)
        )
        size = (tx**2 + ty**2).sum()
        a, b = (tx * x + ty * y).sum(-1) / size, (tx * y - ty * x).sum(-1) / size
        turn = torch.stack([a, -b, b, a], -1).unflatten(-1, (2, 2))
        affine = torch.cat([turn, (middle - turn @ centre)[..., None]], -1)
        grid = functional.affine_grid(affine, [len(image), 3, _FACE, _FACE], align_corners=False)
        laid = functional.grid_sample(
            image, grid.to(image), padding_mode="border", align_corners=False
        )
        return 2 * laid - 1

    def _place(self, fine: Tensor, coarse: Tensor) -> Tensor:
        """(B, 10) of the five points: the mean place of a map of probability each."""
        around = functional.interpolate(coarse, (_FINE, _FINE), mode="bilinear")
        share = self.place(torch.cat([fine, around], 1)).float().flatten(2).softmax(-1)
        place = share @ self.cells.mT  # in [-1, 1], right and down
        return (place * place.new_tensor([0.5, -0.5])).flatten(1)


def tracking_errors(predicted: Tracking, truth: Tracking) -> dict[str, Tensor]:
    """Mean absolute error of each field, over pictures and coefficients; scalars.

    Of `expression` it is the paper's AED, of `head`, in radians, its APD (supplement).

    Raises:
        ValueError: a field's shapes differ.
    """
    errors = {}
    for name, ours, theirs in zip(Tracking._fields, predicted, truth, strict=True):
        if ours.shape != theirs.shape:
            raise ValueError(f"{name} is {tuple(ours.shape)}, but in truth {tuple(theirs.shape)}")
        errors[name] = functional.l1_loss(ours, theirs)
    return errors


def tracking_loss(predicted: Tracking, truth: Tracking) -> Tensor:
    """Sum of the fields' errors, each times its one of `WEIGHTS`; a scalar.

    Raises:
        ValueError: a field's shapes differ.
    """
    errors = tracking_errors(predicted, truth)
    errors["expression"] = functional.mse_loss(predicted.expression, truth.expression)
    return torch.stack([WEIGHTS[name] * error for name, error in errors.items()]).sum()


def _halving(channels: int, out: int) -> tuple[ResidualBlock, ResidualBlock]:
    return ResidualBlock(channels, out, 2), ResidualBlock(out, out)


def _head(features: int, size: int) -> nn.Linear:
    """A linear layer whose outputs start near 0."""
    layer = nn.Linear(features, size)
    nn.init.normal_(layer.weight, std=0.03 * features**-0.5)
    nn.init.zeros_(layer.bias)
    return layer
