import numpy as np
import pytest
import torch
from synthetic_faces import a_tracking

from totalediting.faces import correspondences
from totalediting.faces.points import Pose, point_model
from totalediting.geometry.rig import control_of


@pytest.fixture(scope="module")
def found():
    return correspondences.load()


@pytest.fixture(scope="module")
def pose(found):
    tracking = a_tracking(np.random.default_rng(0), 2)
    actions = tracking.expression.double().numpy() * (1 - point_model(found).implied)
    fields = (getattr(tracking, name).double().numpy() for name in ("gaze", "head"))
    return Pose(tracking.identity.double().numpy(), actions, *fields)


def test_points_are_those_of_the_whole_bust(found, pose):
    model = point_model(found)
    tracking = a_tracking(np.random.default_rng(0), 2)
    tracking = tracking._replace(expression=torch.from_numpy(pose.expression).float())
    skin = control_of(tracking).posed.double().numpy()
    expected = np.einsum("bnkc,nk->bnc", skin[:, found.corners], found.shares)
    points = model.moved(pose).points[:, : len(found.landmarks)] - model.origin(pose)[:, None]
    assert np.abs(points - expected).max() < 5e-5  # metres


@pytest.mark.parametrize("field", Pose._fields)
def test_derivatives_are_those_of_small_steps(found, pose, field):
    model, step = point_model(found), 1e-6
    moved = model.moved(pose)
    derivative = np.concatenate([moved.by_shape, moved.by_turn], -1)
    first = {"identity": 0, "expression": 32, "gaze": 84, "head": 86}[field]
    for k in range(0, getattr(pose, field).shape[1], 5):
        values = getattr(pose, field).copy()
        values[:, k] += step
        change = (model.moved(pose._replace(**{field: values})).points - moved.points) / step
        assert np.abs(change - derivative[..., first + k]).max() < 1e-5
