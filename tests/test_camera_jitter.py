"""A rolled and scaled picture is that of the camera that its tracking tells of."""

from __future__ import annotations

import math

import numpy as np
import torch

from synthgen.camera import CameraSample, resolve
from totalediting.camera_jitter import jittered
from totalediting.motion import FILL, FOCAL_MM, Tracking

SIDE = 96


def test_a_jittered_picture_is_that_of_the_camera_told() -> None:
    drawn = CameraSample(yaw=0.4, pitch=0.1, roll=0.1, focal_mm=80, fill=0.5, shift=(0.06, -0.04))
    truth = Tracking(
        torch.zeros(1, 52), torch.zeros(1, 2), torch.zeros(1, 3), torch.zeros(1, 32),
        torch.tensor([[drawn.yaw, drawn.pitch, drawn.roll]]),
        torch.tensor([[math.log(drawn.focal_mm / FOCAL_MM)]]),
        torch.tensor([[math.log(drawn.fill / FILL)]]),
        torch.tensor([drawn.shift]),
    )  # fmt: skip
    centre, points = np.array([0.0, -0.1, 1.6]), np.array([[0.05, -0.1, 1.6], [-0.03, -0.05, 1.68]])
    image = torch.zeros(1, 3, SIDE, SIDE)
    before, _ = resolve(drawn, centre, 0.25, SIDE).project(points)
    for channel, (x, y) in enumerate(before):  # a soft dot for each point
        rows, columns = torch.meshgrid(*2 * [torch.arange(SIDE) + 0.5], indexing="ij")
        image[0, channel] = torch.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 8)
    picture, told = jittered(image, truth, torch.tensor([0.3]), torch.tensor([-0.15]))
    yaw, pitch, roll = told.camera_yaw_pitch_roll[0].tolist()
    right, up = told.shift[0].tolist()
    found = CameraSample(
        yaw=yaw, pitch=pitch, roll=roll, focal_mm=told.focal_mm.item(), fill=told.fill.item(),
        shift=(right, up),
    )  # fmt: skip
    wanted, _ = resolve(found, centre, 0.25, SIDE).project(points)
    rows, columns = torch.meshgrid(*2 * [torch.arange(SIDE) + 0.5], indexing="ij")
    for channel, (x, y) in enumerate(wanted):
        dot = picture[0, channel] / picture[0, channel].sum()
        assert abs(float((dot * columns).sum()) - x) < 0.1
        assert abs(float((dot * rows).sum()) - y) < 0.1
    assert np.abs(wanted - before).max() > 3
