"""Fits the bust to landmarks: identity, expression, gaze, head and camera, by least squares.

Every unknown has a prior (a Gaussian over people, poses and cameras; for the expression about what
the blendshapes say), and every landmark a deviation, so that the sum that is minimised is the
negative logarithm of a posterior. A face alone does not tell a turn of the head from one of the
camera: the priors divide it. Levenberg-Marquardt (Marquardt 1963) on batches of small systems,
with landmarks that stray reweighted (Cauchy), those that face away left out, and coefficients kept
in [0, 1].

Symbols: B pictures, N points, P = 96 unknowns of a picture. In a picture (right, up), in frames
from its middle, a point y of the camera's axes with its origin at the head lies at
(s y + c) / (1 - s z / F): s frames per metre, c the head's place, F the focal length in frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from assets_procedural.conventions.camera import SENSOR_MM
from totalediting.faces.cameras import camera_angles, camera_axes, similarity
from totalediting.faces.correspondences import Correspondences
from totalediting.faces.framing import five_points
from totalediting.faces.landmarker import LEFT_IRIS, RIGHT_IRIS
from totalediting.faces.points import PointModel, Pose, point_model
from totalediting.geometry.rig import framed
from totalediting.geometry.tracking import EXPRESSIONS, FOCAL_MM, IDENTITY, Tracking

_SIZES = {"identity": IDENTITY, "expression": EXPRESSIONS, "gaze": 2, "head": 3, "camera": 3}
_SIZES |= {"log_focal": 1, "log_scale": 1, "centre": 2}
_ENDS = np.cumsum(list(_SIZES.values()))
_PLACES = {
    name: slice(int(end) - size, int(end))
    for (name, size), end in zip(_SIZES.items(), _ENDS, strict=True)
}
_UNKNOWNS = int(_ENDS[-1])
_OF_PERSON = ("identity", "camera", "log_focal")
"""What all pictures of a clip have in common."""
MOVING = np.arange(_PLACES["expression"].start, _PLACES["head"].stop)
MOVING = np.append(MOVING, np.arange(_PLACES["log_scale"].start, _UNKNOWNS))
"""Of a state, what differs from frame to frame."""
_STRAY = 3.0  # deviations from which a landmark counts less
_FACING = (0.0, 0.3)  # cosine between which a landmark begins to count
_INDEPENDENT = 0.1  # share of the landmarks that err independently of each other
_OUTER_LIPS = (
    *(61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0, 267, 269, 270, 409),
)
_INNER_LIPS = (
    *(78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415),
)
# Lips part by what the face's other landmarks do not tell, and an iris stands for itself.
_MORE_INDEPENDENT = (
    (_OUTER_LIPS, 0.4),
    (_INNER_LIPS, 1.0),
    ((RIGHT_IRIS[0], LEFT_IRIS[0]), 1.0),
)
_SAME_ERROR = 4  # pictures, beyond which those of a person tell nothing more about it
_STEP = 1e-6
_COLD, _WARM = 6, 3  # iterations


@dataclass(frozen=True, eq=False)
class Fits:
    """Busts fitted to B pictures."""

    tracking: Tracking
    """In the square that the landmarks are given in; `face` is that of the landmarks."""
    residual: np.ndarray
    """(B,) mean distance of landmarks that count from the bust's, in frames."""
    state: np.ndarray
    """(B, 96), to start the next picture from."""


class _Seen(NamedTuple):
    """What the fit explains, of B pictures."""

    points: np.ndarray
    """(B, N, 2) frames, right and up, from the middle."""
    scale: np.ndarray
    """(B, 1) frames per metre, roughly: makes metres of distances in a picture."""
    expected: np.ndarray
    """(B, 96) means of the priors."""


class BustFitter:
    """Fits the bust; holds the model at the landmarks, and the priors."""

    def __init__(self, correspondences: Correspondences) -> None:
        self.found = correspondences
        self.model: PointModel = point_model(correspondences)
        self.landmarks = np.append(correspondences.landmarks, [RIGHT_IRIS[0], LEFT_IRIS[0]])
        deviation = np.full(_UNKNOWNS, np.inf)
        self._mean = np.zeros(_UNKNOWNS)
        for name, (mean, spread) in correspondences.priors.items():
            self._mean[_PLACES[name]], deviation[_PLACES[name]] = mean, spread
        deviation[_PLACES["identity"]] = 1.0
        deviation[_PLACES["expression"]] = correspondences.scatter
        self._precision = deviation**-2
        self._counts = np.full(len(self.landmarks), _INDEPENDENT)
        for numbers, share in _MORE_INDEPENDENT:
            self._counts[np.isin(self.landmarks, numbers)] = share
        self._free = np.ones(_UNKNOWNS, bool)
        self._free[_PLACES["expression"]] = self.model.implied == 0

    def fit(self, landmarks: np.ndarray, blendshapes: np.ndarray, side: float) -> Fits:
        """Each of B pictures by itself: landmarks (B, 478, 3) pixels of a square of `side`."""
        seen, start = self._start(landmarks, blendshapes, side)
        return self._fits(seen, self._solve(seen, start, self._free, _COLD), landmarks / side)

    def fit_person(self, landmarks: np.ndarray, blendshapes: np.ndarray, side: float) -> Fits:
        """B pictures of one person before one camera, who does not move but for neck and head."""
        seen, start = self._start(landmarks, blendshapes, side)
        state = self._solve(seen, start, self._free, _COLD)
        shared = np.zeros(_UNKNOWNS, bool)
        for name in _OF_PERSON:
            shared[_PLACES[name]] = True
        state[:, shared] = np.median(state[:, shared], axis=0)
        state = self._solve(seen, state, self._free, _COLD, shared)
        return self._fits(seen, state, landmarks / side)

    def follow(
        self, landmarks: np.ndarray, blendshapes: np.ndarray, side: float, last: np.ndarray
    ) -> np.ndarray:
        """States (B, 96) of pictures of a clip from others close to theirs, whose person is
        known."""
        seen, _ = self._start(landmarks, blendshapes, side)
        free = self._free.copy()
        for name in _OF_PERSON:
            free[_PLACES[name]] = False
        return self._solve(seen, last, free, _WARM)

    def fits_of(
        self, landmarks: np.ndarray, blendshapes: np.ndarray, side: float, state: np.ndarray
    ) -> Fits:
        """The busts that states (B, 96) stand for, and how well they fit."""
        seen, _ = self._start(landmarks, blendshapes, side)
        return self._fits(seen, state, landmarks / side)

    def _start(
        self, landmarks: np.ndarray, blendshapes: np.ndarray, side: float
    ) -> tuple[_Seen, np.ndarray]:
        """What is seen, and a first guess: the mean face turned as the landmarks' depths say."""
        points = landmarks[:, self.landmarks].astype(np.float64) / side - [0.5, 0.5, 0]
        points *= [1, -1, -1]
        state = np.tile(self._mean, (len(points), 1))
        state[:, _PLACES["expression"]] = self.found.shown(blendshapes)
        state[:, _PLACES["gaze"]] = self.found.looking(blendshapes)
        expected = state.copy()
        scales = np.empty((len(points), 1))
        mean = self.model.mean[:-1]
        for k, seen in enumerate(points):
            rotation, scale, shift = similarity(mean, seen)
            state[k, _PLACES["camera"]] = camera_angles(rotation.T)
            state[k, _PLACES["head"]] = 0
            state[k, _PLACES["log_scale"]] = np.log(scale)
            state[k, _PLACES["centre"]] = shift[:2]
            scales[k] = scale
        return _Seen(points[..., :2], scales, expected), state

    def _solve(
        self,
        seen: _Seen,
        state: np.ndarray,
        free: np.ndarray,
        iterations: int,
        shared: np.ndarray | None = None,
    ) -> np.ndarray:
        """States (B, 96) that minimise the sum; `shared` ones stay equal over the pictures."""
        state = state.copy()
        damping = np.full((len(state), 1), 1e-3)
        gradient, hessian, cost = self._system(seen, state, shared)
        for _ in range(iterations):
            step = _step(gradient, hessian, damping, self._movable(state, gradient, free), shared)
            tried = state + step
            tried[:, _PLACES["expression"]] = tried[:, _PLACES["expression"]].clip(0, 1)
            new_gradient, new_hessian, new_cost = self._system(seen, tried, shared)
            better = new_cost < cost
            if shared is not None:
                better[:] = new_cost.sum() < cost.sum()
            state[better], cost[better] = tried[better], new_cost[better]
            gradient[better], hessian[better] = new_gradient[better], new_hessian[better]
            damping = np.where(better[:, None], damping / 4, damping * 8).clip(1e-7, 1e4)
        return state

    def _movable(self, state: np.ndarray, gradient: np.ndarray, free: np.ndarray) -> np.ndarray:
        """(B, 96) what a step may change: not coefficients that it would take out of [0, 1]."""
        movable = np.tile(free, (len(state), 1))
        here = _PLACES["expression"]
        values, slope = state[:, here], gradient[:, here]
        movable[:, here] &= ~((values <= 0) & (slope > 0)) & ~((values >= 1) & (slope < 0))
        return movable

    def _system(
        self, seen: _Seen, state: np.ndarray, shared: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gradient (B, 96), approximate Hessian (B, 96, 96) and cost (B,) at states."""
        predicted, jacobian, facing = self._project(state)
        # Metres, in deviations.
        unit = seen.scale[..., None] * self.found.deviations[:, None]
        off = (predicted - seen.points) / unit
        squared = (off**2).sum(-1)
        counts = self._counts * facing
        cost = (counts * _STRAY**2 * np.log1p(squared / _STRAY**2)).sum(1)
        weight = np.sqrt(counts / (1 + squared / _STRAY**2))
        jacobian *= (weight[..., None] / unit)[..., None]
        off *= weight[..., None]
        flat = jacobian.reshape(len(state), -1, _UNKNOWNS)
        gradient = (off.reshape(len(state), 1, -1) @ flat)[:, 0]
        hessian = flat.swapaxes(1, 2) @ flat

        precision = self._precision.copy()
        if shared is not None:  # a prior counts once, and the pictures as so many
            precision[shared] *= max(1.0, len(state) / _SAME_ERROR) / len(state)
        from_prior = state - seen.expected
        gradient += precision * from_prior
        hessian[:, np.arange(_UNKNOWNS), np.arange(_UNKNOWNS)] += precision
        return gradient, hessian, cost + (precision * from_prior**2).sum(1)

    def _project(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (B, N, 2), their derivative (B, N, 2, 96), and how far they face the camera."""
        parts = {name: state[:, place] for name, place in _PLACES.items()}
        pose = Pose(*(parts[name] for name in Pose._fields))
        moved = self.model.moved(pose)
        n = len(self.landmarks)
        axes = camera_axes(parts["camera"])
        own = moved.points[:, :n] @ axes
        scale, focal = np.exp(parts["log_scale"])[..., None], _frames(parts["log_focal"])[..., None]
        depth = scale * own[..., 2:] / focal
        beside = scale * own[..., :2]
        predicted = (beside + parts["centre"][:, None]) / (1 - depth)

        # (B, N, 2, 3): by the point in the camera's axes.
        by_point = np.zeros((*predicted.shape, 3))
        by_point[..., 0, 0] = by_point[..., 1, 1] = (scale / (1 - depth))[..., 0]
        by_point[..., 2] = predicted * (scale / focal / (1 - depth))
        by_world = by_point @ axes.swapaxes(1, 2)[:, None]
        jacobian = np.empty((*predicted.shape, _UNKNOWNS))
        jacobian[..., : IDENTITY + EXPRESSIONS] = by_world @ moved.by_shape[:, :n]
        turns = slice(_PLACES["gaze"].start, _PLACES["head"].stop)
        jacobian[..., turns] = by_world @ moved.by_turn[:, :n]
        for k in range(3):
            nudged = parts["camera"].copy()
            nudged[:, k] += _STEP
            change = (camera_axes(nudged) - axes) / _STEP
            by_angle = (moved.points[:, :n] @ change)[..., None]
            jacobian[..., _PLACES["camera"].start + k] = (by_point @ by_angle)[..., 0]
        by_depth = predicted * depth / (1 - depth)
        jacobian[..., _PLACES["log_focal"].start] = -by_depth
        jacobian[..., _PLACES["log_scale"].start] = beside / (1 - depth) + by_depth
        jacobian[..., _PLACES["centre"]] = np.eye(2) / (1 - depth)[..., None]

        normals = (moved.rotations[:, :n] @ self.model.normals[:n, :, None])[..., 0]
        low, high = _FACING
        facing = (((normals * axes[:, None, :, 2]).sum(-1) - low) / (high - low)).clip(0, 1)
        return predicted, jacobian, facing

    def _fits(self, seen: _Seen, state: np.ndarray, shares: np.ndarray) -> Fits:
        predicted, _, facing = self._project(state)
        distance = np.linalg.norm(predicted - seen.points, axis=-1)
        residual = (distance * facing).sum(1) / facing.sum(1).clip(1e-9)
        return Fits(self._tracking(state, shares), residual, state)

    def _tracking(self, state: np.ndarray, shares: np.ndarray) -> Tracking:
        parts = {name: state[:, place] for name, place in _PLACES.items()}
        pose = Pose(*(parts[name] for name in Pose._fields))
        scale = np.exp(parts["log_scale"])
        axes, distance = camera_axes(parts["camera"]), _frames(parts["log_focal"]) / scale
        place = np.concatenate([-parts["centre"] / scale, distance], 1)
        position = (axes @ place[..., None])[..., 0] - self.model.origin(pose)

        def tensor(values: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values, np.float32))

        tracking = Tracking(
            expression=tensor(self.model.actions(pose)),
            gaze=tensor(pose.gaze),
            head=tensor(pose.head),
            identity=tensor(pose.identity),
            camera_yaw_pitch_roll=tensor(parts["camera"]),
            log_focal=tensor(parts["log_focal"]),
            log_fill=torch.zeros(len(state), 1),
            shift=torch.zeros(len(state), 2),
            face=tensor(five_points(shares)),
        )
        return framed(tracking, torch.from_numpy(position))


def _step(
    gradient: np.ndarray,
    hessian: np.ndarray,
    damping: np.ndarray,
    movable: np.ndarray,
    shared: np.ndarray | None,
) -> np.ndarray:
    """(B, 96) the damped step, 0 for what is not `movable`."""
    count = np.arange(_UNKNOWNS)
    system = hessian * (movable[:, :, None] & movable[:, None])
    diagonal = system[:, count, count]
    system[:, count, count] = np.where(movable, diagonal * (1 + damping) + 1e-9, 1.0)
    right = np.where(movable, -gradient, 0.0)
    if shared is None:
        return np.linalg.solve(system, right[..., None])[..., 0]
    # Schur complement: each picture's own unknowns are eliminated first.
    own = ~shared
    across = system[:, own][:, :, shared]
    solved = np.linalg.solve(
        system[:, own][:, :, own], np.concatenate([across, right[:, own, None]], -1)
    )
    reduced = (system[:, shared][:, :, shared] - across.swapaxes(1, 2) @ solved[..., :-1]).sum(0)
    rest = (right[:, shared] - (across.swapaxes(1, 2) @ solved[..., -1:])[..., 0]).sum(0)
    step = np.empty_like(gradient)
    step[:, shared] = np.linalg.solve(reduced, rest)
    step[:, own] = solved[..., -1] - solved[..., :-1] @ step[0, shared]
    return step


def _frames(log_focal: np.ndarray) -> np.ndarray:
    """Focal length, in frames."""
    return FOCAL_MM / SENSOR_MM * np.exp(log_focal)
