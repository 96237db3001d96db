"""The head tracker: motion, identity and camera of a picture, which E_mot and the deformation need.

    e_app = E_mot(I_app),  e_mot = E_mot(I_mot)                     (paper, section 3.2)

Symbols: B batch, S side of the picture. The paper takes its codes from a pre-trained encoder; ours
is learnt from true labels. Angles are in radians, with the signs of docs/conventions.md: gaze (yaw,
pitch) of the eyes in the head, head (pitch, roll, yaw) against the trunk, camera (yaw, pitch, roll)
about the head. A camera is described as a dataset's: its angles, its focal length on a sensor of
36 mm, `fill` = height of the head / height of the frame, and `shift`, where the head's centre
appears, as a share of the frame from its middle (right, up).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.blocks import ResidualBlock, conv, coordinates, norm
from totalediting.presets import Preset

EXPRESSIONS = 52
"""ARKit coefficients."""
CODE = EXPRESSIONS + 2
"""Length of a code of motion e: the expression, then the gaze."""
IDENTITY = 32
"""Coefficients of the bust's linear shape basis."""
FOCAL_MM = 85.0
"""Focal length whose `log_focal` is 0."""
FILL = 0.5
"""Share of the frame's height whose `log_fill` is 0."""

_SIDE = 128  # pixels that the network sees along a side
_WIDTHS = (32, 64, 128, 256)
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
}
"""What a field's error counts in `tracking_loss`: the mean absolute one, for the expression the
mean square, as most coefficients are 0 most of the time and a median would be content with that.

The inverse of each field's mean deviation from its median in a job of default settings (gaze 0.12,
head 0.13, camera 0.24, log focal length 0.18, log fill 0.07, shift 0.015), of the expression that
of its mean variance, 0.02, so that all start near 1; half of it for the focal length, which little
of a picture tells, and for identity (of unit variance), of which much cannot be seen.
"""


class Tracking(NamedTuple):
    """What a picture shows of head and camera, as floats."""

    expression: Tensor
    """(B, 52) in [0, 1], in the order of `assets_procedural.motion.ARKIT_NAMES`; not bounded in
    training."""
    gaze: Tensor
    """(B, 2) yaw to the subject's left, pitch up; of both eyes in the head."""
    head: Tensor
    """(B, 3) pitch, roll, yaw of the head against the trunk."""
    identity: Tensor
    """(B, 32) coefficients of the bust's shape."""
    camera_yaw_pitch_roll: Tensor
    """(B, 3) about the head: 0 in front, to the subject's left, from above, counter-clockwise."""
    log_focal: Tensor
    """(B, 1) log(focal length / `FOCAL_MM`)."""
    log_fill: Tensor
    """(B, 1) log(fill / `FILL`)."""
    shift: Tensor
    """(B, 2) of the head's centre from the middle of the frame, right and up, in frames."""

    @property
    def code(self) -> Tensor:
        """e (B, 54), the code of motion: expression, then gaze."""
        return torch.cat([self.expression, self.gaze], -1)

    @property
    def focal_mm(self) -> Tensor:
        """(B, 1) focal length in millimetres, on a sensor of 36 mm."""
        return FOCAL_MM * self.log_focal.exp()

    @property
    def fill(self) -> Tensor:
        """(B, 1) height of the head / height of the frame."""
        return FILL * self.log_fill.exp()


_SIZES = Tracking(EXPRESSIONS, 2, 3, IDENTITY, 3, 1, 1, 2)  # pyright: ignore[reportArgumentType]


class HeadTracker(nn.Module):
    """Pictures (B, 3, S, S) in [0, 1] to `Tracking`: a ResNet, its mean, a linear layer per field.

    Pictures are brought to 128 x 128 first, so that the weights are of no preset: one tracker
    serves all. A fresh one sees a nearly neutral face in front of a neutral camera everywhere.
    """

    xy: Tensor

    def __init__(self, preset: Preset) -> None:
        """Build for pictures of side `preset.image`, the only thing that presets decide here."""
        super().__init__()
        self.image = preset.image
        self.register_buffer("xy", coordinates(_SIDE, _SIDE), persistent=False)
        layers: list[nn.Module] = [conv(5, _WIDTHS[0], 7, 2), norm(_WIDTHS[0]), nn.ReLU()]
        for channels, out in zip((_WIDTHS[0], *_WIDTHS), _WIDTHS, strict=False):
            layers += [ResidualBlock(channels, out, 2), ResidualBlock(out, out)]
        self.trunk = nn.Sequential(*layers)
        self.heads = nn.ModuleDict({name: _head(size) for name, size in _SIZES._asdict().items()})
        expression = self.heads["expression"]
        assert isinstance(expression, nn.Linear)
        nn.init.constant_(expression.bias, _REST)

    def forward(self, image: Tensor) -> Tracking:
        """Track pictures (B, 3, S, S) in [0, 1]; each by itself, without what came before.

        Raises:
            ValueError: another shape.
        """
        if image.ndim != 4 or image.shape[1:] != (3, self.image, self.image):
            raise ValueError(
                f"image must be (B, 3, {self.image}, {self.image}), got {tuple(image.shape)}"
            )
        small = functional.interpolate(image, (_SIDE, _SIDE), mode="bilinear", antialias=True)
        seen = torch.cat([2 * small - 1, self.xy.to(image).expand(len(image), -1, -1, -1)], 1)
        mean = self.trunk(seen).mean((-2, -1))
        fields = {name: head(mean) for name, head in self.heads.items()}
        if not self.training:  # what overshoots still has a gradient in training
            fields["expression"] = fields["expression"].clamp(0, 1)
        return Tracking(**fields)


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


def _head(size: int) -> nn.Linear:
    """A linear layer whose outputs start near 0."""
    layer = nn.Linear(_WIDTHS[-1], size)
    nn.init.normal_(layer.weight, std=0.002)
    nn.init.zeros_(layer.bias)
    return layer
