"""Faces as a landmarker would find them, of busts that are known: no network is needed."""

from __future__ import annotations

import numpy as np
import torch

from totalediting.faces.correspondences import Correspondences
from totalediting.faces.landmarker import LANDMARKS, LEFT_IRIS, RIGHT_IRIS, Face
from totalediting.faces.points import Pose, point_model
from totalediting.geometry.rig import camera_of, control_of
from totalediting.geometry.tracking import SIZES, Tracking


def a_tracking(rng: np.random.Generator, count: int) -> Tracking:
    """Random people before random cameras, whose eyelids are as their gaze implies."""

    def normal(field: str, deviation: float) -> torch.Tensor:
        size = int(getattr(SIZES, field))
        return torch.from_numpy(rng.normal(0, deviation, (count, size))).float()

    actions = rng.uniform(0, 0.5, (count, 52)) * (rng.random((count, 52)) < 0.2)
    tracking = Tracking(
        expression=torch.from_numpy(actions).float(),
        gaze=normal("gaze", 0.1),
        head=normal("head", 0.1),
        identity=normal("identity", 0.7),
        camera_yaw_pitch_roll=normal("camera_yaw_pitch_roll", 0.15),
        log_focal=normal("log_focal", 0.1),
        log_fill=0.15 + normal("log_fill", 0.05),
        shift=normal("shift", 0.02),
        face=torch.zeros(count, 10),
    )
    return tracking


def faces_of(tracking: Tracking, found: Correspondences, side: float) -> list[Face]:
    """What a flawless landmarker finds in pictures of `side`; other landmarks are at the middle."""
    control = control_of(tracking)
    frames, lenses = (array.double().numpy() for array in camera_of(tracking, 1))
    skin = control.posed.double().numpy()
    points = np.einsum("bnkc,nk->bnc", skin[:, found.corners], found.shares)
    model = point_model(found)
    pose = Pose(*(getattr(tracking, name).double().numpy() for name in Pose._fields))
    pupils = model.moved(pose).points[:, -3:-1] - model.origin(pose)[:, None]
    points = np.concatenate([points, pupils], 1)
    own = (points - frames[:, None, :3, 3]) @ frames[:, :3, :3]
    depth = np.negative(own[..., 2:])
    size = lenses[:, None, :1, 0]
    flat = 0.5 + size * own[..., :2] * [1, -1] / depth
    middle = np.mean(depth, axis=1, keepdims=True)
    near = size * (depth - middle) / middle
    landmarks = np.full((len(points), LANDMARKS, 3), [0.5, 0.5, 0.0])
    numbers = np.append(found.landmarks, [RIGHT_IRIS[0], LEFT_IRIS[0]])
    landmarks[:, numbers] = np.concatenate([flat, near], -1)
    blendshapes = tracking.expression.numpy()
    return [
        Face((side * landmarks[k]).astype(np.float32), blendshapes[k], 1.0)
        for k in range(len(points))
    ]
