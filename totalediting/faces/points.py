"""The bust at a few points: where landmarks lie on it, and how all that is fitted moves them.

Symbols: B pictures, N points (those of a face's landmarks, then both pupils), K = 32 identity
coefficients, E = 52 expression coefficients, J bones. It is `geometry.rig` at these points, in
numpy and in double precision, with derivatives. Space: model space without its last step, the
origin of the neutral head.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.body.head import BONES, HEAD_SHARES, HeadModel
from totalediting.faces.correspondences import Correspondences
from totalediting.geometry.identity import identity_basis
from totalediting.geometry.rig import constants
from totalediting.geometry.tracking import EXPRESSIONS, IDENTITY

_PUPIL = 0.855  # of the way from an eyeball's centre to its front, as `body.landmarks` has it
_ANGLES = 5  # of gaze and head
_STEP = 1e-6  # radians, of the differences that give derivatives by angles


class Pose(NamedTuple):
    """What moves the points, of B pictures."""

    identity: np.ndarray
    """(B, 32)."""
    expression: np.ndarray
    """(B, 52), whose `eyeLook…` follow the gaze, whatever they are."""
    gaze: np.ndarray
    """(B, 2) radians."""
    head: np.ndarray
    """(B, 3) radians."""


class Moved(NamedTuple):
    """Points and their derivatives."""

    points: np.ndarray
    """(B, N, 3) posed."""
    by_shape: np.ndarray
    """(B, N, 3, 84) by identity, then expression."""
    by_turn: np.ndarray
    """(B, N, 3, 5) by gaze, then head."""
    rotations: np.ndarray
    """(B, N, 3, 3) of a point's surroundings."""


@dataclass(frozen=True, eq=False)
class PointModel:
    """Linear shapes, bones and lids of N points; the last point is the origin of model space."""

    mean: np.ndarray
    """(N, 3) metres."""
    shapes: np.ndarray
    """(84, N, 3) of identity, then of expression."""
    normals: np.ndarray
    """(N, 3) of the mean head's surface; of the pupils, ahead."""
    weights: np.ndarray
    """(N, J)."""
    joints: np.ndarray
    """(1 + 32, J - 1, 3) of the mean head, and by identity."""
    following: np.ndarray
    """(4, 52) expression per radian of gaze to the left, to the right, up and down."""
    blinks: tuple[int, int]
    """The expressions that close the lids."""
    aperture: np.ndarray
    """(2,) of the mean head's lids, in shares of what the blink closes."""
    aperture_by_shape: np.ndarray
    """(2, 84), 0 by blinks."""
    closing: np.ndarray
    """(2, N, 3, 84) by shape, how far a blink moves points for what the shape has opened."""

    def origin(self, pose: Pose) -> np.ndarray:
        """(B, 3) where model space has its origin."""
        shape = np.concatenate([pose.identity, self._actions(pose)[0]], 1)
        return self._vertices(shape)[0][:, -1]

    def moved(self, pose: Pose) -> Moved:
        """Points and derivatives of B pictures."""
        actions, by_gaze = self._actions(pose)
        vertices, by_shape = self._vertices(np.concatenate([pose.identity, actions], 1))
        joints = np.concatenate([np.ones((len(vertices), 1)), pose.identity], 1)
        joints = np.tensordot(joints, self.joints, 1)
        turns = np.concatenate([pose.gaze, pose.head], 1)
        # The pose itself, then each of its angles a little further, all at once.
        steps = np.concatenate([np.zeros((1, _ANGLES)), _STEP * np.eye(_ANGLES)])
        nudged = (turns + steps[:, None]).reshape(-1, _ANGLES)
        count = len(steps)
        bones = _turned(nudged)
        rotations, points = self._skinned(
            bones, np.tile(joints, (count, 1, 1)), np.tile(vertices, (count, 1, 1))
        )
        size = len(turns)
        rotations, points = rotations[:size], points.reshape(count, *vertices.shape)
        by_turn = np.moveaxis(points[1:] - points[0], 0, -1) / _STEP
        points = points[0]
        by_shape = rotations @ by_shape
        # Where a bone turns about moves with the identity; an offset is linear in that.
        still = [bone.first(size) for bone in bones]
        by_joint = np.tensordot(self.weights, _offsets(still, self.joints[1:, None]), (1, 2))
        by_shape[..., :IDENTITY] += by_joint.transpose(2, 0, 3, 1)
        # The lids follow the gaze.
        by_turn[..., :2] += by_shape[..., IDENTITY:] @ by_gaze[:, None]
        by_shape[..., IDENTITY:] *= 1.0 - self.implied
        return Moved(points, by_shape, by_turn, rotations)

    def actions(self, pose: Pose) -> np.ndarray:
        """(B, 52) the expression as shown: that which the gaze implies in place."""
        return self._actions(pose)[0]

    @property
    def implied(self) -> np.ndarray:
        """(52,) 1 for what the gaze gives, else 0."""
        return (self.following != 0).any(0).astype(np.float64)

    def _actions(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """(B, 52) expression with what the gaze implies, and its derivative (B, 52, 2)."""
        signs = np.array([[1.0, -1.0, 0, 0], [0, 0, 1.0, -1.0]])
        sides = np.clip(pose.gaze @ signs, 0, None)
        implied = sides @ self.following
        slope = np.einsum("gs,bs,se->beg", signs, sides > 0, self.following)
        slope[implied >= 1] = 0
        kept = pose.expression * (1.0 - self.implied)
        return kept + np.clip(implied, 0, 1), slope

    def _vertices(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points at rest (B, N, 3) of shapes (B, 84), and their derivative (B, N, 3, 84).

        A blink is a share of what the rest has left open; see `head.Identity.pose`.
        """
        columns = [IDENTITY + number for number in self.blinks]
        apertures = self.aperture + shape @ self.aperture_by_shape.T
        shares, blinks = shape[:, columns], self.shapes[columns]
        effective = shape.copy()
        effective[:, columns] *= np.clip(apertures, 0, None)
        by_shape = np.broadcast_to(
            self.shapes.transpose(1, 2, 0), (len(shape), *self.mean.shape, len(self.shapes))
        ).copy()
        for k, column in enumerate(columns):
            share = shares[:, k] * (apertures[:, k] > 0)
            by_shape += share[:, None, None, None] * self.closing[k]
            by_shape[..., column] = np.clip(apertures[:, k], 0, None)[:, None, None] * blinks[k]
        return self.mean + np.tensordot(effective, self.shapes, 1), by_shape

    def _skinned(
        self, bones: list[_Bone], joints: np.ndarray, vertices: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Blended rotations (B, N, 3, 3) of the bones, and posed points (B, N, 3)."""
        turns = np.stack([bone.parent @ bone.own for bone in bones], 1)
        rotations = np.tensordot(self.weights, turns, (1, 1)).swapaxes(0, 1)
        offsets = np.tensordot(self.weights, _offsets(bones, joints), (1, 1)).swapaxes(0, 1)
        return rotations, (rotations @ vertices[..., None])[..., 0] + offsets


class _Bone(NamedTuple):
    """Rotations (B, 3, 3) of a bone's parent and its own; about which joint, -1 for none."""

    parent: np.ndarray
    own: np.ndarray
    joint: int
    above: int
    """The parent, in the order of `BONES`."""

    def first(self, count: int) -> _Bone:
        """Of the first pictures."""
        return self._replace(parent=self.parent[:count], own=self.own[:count])


def _turned(turns: np.ndarray) -> list[_Bone]:
    """Bones in the order of `BONES`, of gaze and head (B, 5)."""
    still = np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    turn = Rotation.from_euler("xyz", turns[:, 2:]).as_rotvec()
    yaw, pitch = turns[:, 0], turns[:, 1]
    look = Rotation.from_euler("xyz", np.stack([-pitch, 0 * yaw, yaw], 1)).as_matrix()
    own = [still, *(Rotation.from_rotvec(s * turn).as_matrix() for s in HEAD_SHARES.values())]
    own += [look, look]
    bones = [_Bone(still, still, -1, 0)]
    for number in range(1, len(BONES)):
        above = min(number - 1, BONES.index("head"))  # a chain up to the head, which has the eyes
        parent = bones[above].parent @ bones[above].own
        bones.append(_Bone(parent, own[number], number - 1, above))
    return bones


def _offsets(bones: list[_Bone], joints: np.ndarray) -> np.ndarray:
    """(..., B, J, 3) of the bones' motions, with joints (..., B, J - 1, 3)."""
    found: list[np.ndarray] = []
    for bone in bones:
        if bone.joint < 0:
            found.append(
                np.zeros(np.broadcast_shapes(joints[..., 0, :].shape, bone.own[..., 0].shape))
            )
            continue
        centre = joints[..., bone.joint, :, None]
        shift = bone.parent @ (centre - bone.own @ centre)
        found.append(found[bone.above] + shift[..., 0])
    return np.stack(found, -2)


@lru_cache(maxsize=2)
def point_model(correspondences: Correspondences) -> PointModel:
    """The model at the landmarks of a face and at both pupils."""
    rig, head = constants(), HeadModel.load()
    skin = rig.skin.numpy()
    basis = identity_basis()
    mean, components = basis.mean.double().numpy(), basis.components.double().numpy()
    vertices = len(head.template)
    whole = np.zeros((EXPRESSIONS, vertices, 3))
    whole[:, skin] = rig.shapes.numpy()
    shapes = np.concatenate([components[:, :vertices], whole])

    corners, shares = skin[correspondences.corners], correspondences.shares

    def at(values: np.ndarray) -> np.ndarray:
        """(..., N, C) at the points, of values (..., V, C)."""
        on_skin = np.einsum("...nkc,nk->...nc", values[..., corners, :], shares)
        pupils = []
        for name in ("eye_right", "eye_left"):
            ball = head.groups[name]
            front = ball[mean[ball, 1].argmin()]
            middle = values[..., ball, :].mean(-2)
            pupils.append(middle + _PUPIL * (values[..., front, :] - middle))
        origin = np.einsum("v,...vc->...c", rig.origin.numpy(), values[..., skin, :])
        return np.concatenate([on_skin, np.stack([*pupils, origin], -2)], -2)

    rest = mean[:vertices]
    edges = rest[corners[:, 1:]] - rest[corners[:, :1]]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.concatenate([normals, [[0, -1.0, 0]] * 3])
    placed = at(shapes)
    weights = at(head.weights)
    weights[-1] = np.eye(len(BONES))[0]  # the origin stays with the trunk
    numbers = [blink[0] for blink in rig.blinks]
    apertures = [
        [
            (values[..., skin[upper], 2] - values[..., skin[lower], 2]) / reach
            for values in (rest, shapes)
        ]
        for _, upper, lower, reach in rig.blinks
    ]
    by_shape = np.stack([by for _, by in apertures])
    by_shape[:, [IDENTITY + number for number in numbers]] = 0
    joints = np.concatenate([mean[None, vertices:], components[:, vertices:]])
    return PointModel(
        mean=at(rest),
        shapes=placed,
        normals=normals,
        weights=weights,
        joints=joints,
        following=rig.following.numpy(),
        blinks=(numbers[0], numbers[1]),
        aperture=np.array([mean for mean, _ in apertures]),
        aperture_by_shape=by_shape,
        closing=np.einsum("ls,lni->lnis", by_shape, placed[[IDENTITY + n for n in numbers]]),
    )
