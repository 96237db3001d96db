"""What a tracker finds in a picture: motion, identity and camera, as a batch of numbers.

Angles are in radians, with the signs of docs/conventions.md. A camera is described as a dataset's:
its angles, its focal length on a sensor of 36 mm, `fill` = height of the head / height of the
frame, and `shift`, where the head's centre appears, as a share of the frame from its middle (right,
up).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

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


class Tracking(NamedTuple):
    """What a picture shows of head and camera, as floats."""

    expression: Tensor
    """(B, 52) in [0, 1], in the order of `motion.poses.ARKIT_NAMES`; not bounded in training."""
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
    face: Tensor
    """(B, 10) of both eyes, nose and corners of the mouth from the middle of the frame, right and
    up, in frames: `sface.five_points`, one after the other."""

    @property
    def code(self) -> Tensor:
        """e (B, 54), the code of motion: expression, then gaze."""
        return torch.cat([self.expression, self.gaze], -1)

    def points(self, side: int) -> Tensor:
        """(B, 5, 2) where the face's five points are in a picture of `side`, in its pixels."""
        return (self.face.unflatten(-1, (5, 2)) * self.face.new_tensor([1, -1]) + 0.5) * side

    @property
    def focal_mm(self) -> Tensor:
        """(B, 1) focal length in millimetres, on a sensor of 36 mm."""
        return FOCAL_MM * self.log_focal.exp()

    @property
    def fill(self) -> Tensor:
        """(B, 1) height of the head / height of the frame."""
        return FILL * self.log_fill.exp()


SIZES = Tracking(EXPRESSIONS, 2, 3, IDENTITY, 3, 1, 1, 2, 10)  # pyright: ignore[reportArgumentType]
"""Length of each field."""
