from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic_faces import a_tracking, faces_of

from totalediting.faces import correspondences
from totalediting.faces.clips import fit_clip
from totalediting.faces.fitting import BustFitter
from totalediting.geometry.rig import camera_of, control_of
from totalediting.geometry.tracking import Tracking

SIDE = 256.0


@pytest.fixture(scope="module")
def exact():
    """What ships, but blendshapes are read as they are shown, and landmarks do not stray."""
    found = correspondences.load()
    return replace(
        found,
        blendshapes=np.tile(found.levels, (52, 1)),
        scatter=np.full(52, 0.02),
        deviations=np.full_like(found.deviations, 2e-4),
    )


@pytest.fixture(scope="module")
def fitter(exact):
    return BustFitter(exact)


def fitted(fitter, faces):
    landmarks = np.stack([face.landmarks for face in faces])
    return fitter.fit(landmarks, np.stack([face.blendshapes for face in faces]), SIDE)


def turn(tracking: Tracking) -> np.ndarray:
    """(B, V, 3) in the camera's axes, about their middle: shape and turn of the head."""
    axes = camera_of(tracking, 1)[0][:, :3, :3].double()
    own = control_of(tracking).posed.double() @ axes
    return (own - own.mean(1, keepdim=True)).numpy()


def test_a_known_bust_is_recovered(exact, fitter):
    truth = a_tracking(np.random.default_rng(1), 3)
    found = fitted(fitter, faces_of(truth, exact, SIDE))
    assert (found.residual < 5e-4).all()  # an eighth of a pixel
    gaze = (found.tracking.gaze - truth.gaze).abs().max()
    assert gaze < np.radians(2)
    free = fitter.model.implied == 0
    off = (found.tracking.expression - truth.expression).abs()[:, free]
    assert off.mean() < 0.01 and off.max() < 0.15
    focal = (found.tracking.log_focal - truth.log_focal).abs().max()
    assert focal < 0.3
    fill = (found.tracking.log_fill - truth.log_fill).abs().max()
    assert fill < 0.1


def test_the_fitted_bust_lies_where_the_true_one_is(exact, fitter):
    truth = a_tracking(np.random.default_rng(2), 2)
    found = fitted(fitter, faces_of(truth, exact, SIDE)).tracking
    numbers = exact.corners.ravel()
    off = (turn(found) - turn(truth))[:, numbers]
    off -= off.mean(1, keepdims=True)
    assert np.linalg.norm(off, axis=-1).mean() < 4e-3  # metres; depth is seen by perspective alone


def test_landmarks_that_stray_count_little(exact, fitter):
    truth = a_tracking(np.random.default_rng(3), 1)
    (face,) = faces_of(truth, exact, SIDE)
    astray = face.landmarks.copy()
    astray[exact.landmarks[::20], :2] += 40
    clean, found = (
        fitted(fitter, [replace(face, landmarks=points)]).tracking
        for points in (face.landmarks, astray)
    )
    assert (clean.camera_yaw_pitch_roll - found.camera_yaw_pitch_roll).abs().max() < 0.02


def test_coefficients_stay_within_bounds(fitter, exact):
    truth = a_tracking(np.random.default_rng(4), 2)
    truth = truth._replace(expression=truth.expression.clamp(0, 1).round())
    expression = fitted(fitter, faces_of(truth, exact, SIDE)).tracking.expression
    assert expression.min() >= 0 and expression.max() <= 1


def test_a_picture_gives_the_same_in_any_company(fitter, exact):
    faces = faces_of(a_tracking(np.random.default_rng(5), 3), exact, SIDE)
    together, alone = fitted(fitter, faces).tracking, fitted(fitter, faces[1:2]).tracking
    for ours, theirs in zip(together, alone, strict=True):
        assert (ours[1:2] - theirs).abs().max() < 1e-4


def test_a_clip_has_one_person_and_one_camera(fitter, exact):
    rng = np.random.default_rng(6)
    truth = a_tracking(rng, 12)
    same = {name: getattr(truth, name)[:1].expand(12, -1) for name in ("identity", "log_focal")}
    same["camera_yaw_pitch_roll"] = 0 * truth.camera_yaw_pitch_roll
    turning = 0.3 * torch.sin(torch.arange(12) / 2)[:, None]
    truth = truth._replace(**same, head=torch.cat([0 * turning, 0 * turning, turning], 1))
    square, found = fit_clip(fitter, faces_of(truth, exact, SIDE), [k / 25 for k in range(12)])
    assert square.shape == (3,)
    for name in ("identity", "camera_yaw_pitch_roll", "log_focal"):
        field = getattr(found.tracking, name)
        assert (field == field[:1]).all(), name
    yaw = found.tracking.head[:, 2].numpy()
    assert np.corrcoef(yaw, truth.head[:, 2].numpy())[0, 1] > 0.95  # smoothed
