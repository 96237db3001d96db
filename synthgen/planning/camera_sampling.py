"""Cameras drawn from the ranges of a job."""

from __future__ import annotations

import math

import numpy as np

from assets_procedural.conventions.camera import CameraSample
from synthgen.planning.job import CameraSettings


def sample_camera(rng: np.random.Generator, settings: CameraSettings) -> CameraSample:
    """Draw one camera from the ranges of a job."""
    low, high = settings.focal_mm
    return CameraSample(
        yaw=math.radians(rng.uniform(*settings.yaw)),
        pitch=math.radians(rng.uniform(*settings.pitch)),
        roll=math.radians(rng.uniform(*settings.roll)),
        focal_mm=math.exp(rng.uniform(math.log(low), math.log(high))),
        fill=rng.uniform(*settings.fill),
        shift=(rng.uniform(*settings.shift), rng.uniform(*settings.shift)),
    )
