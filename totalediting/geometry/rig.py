"""From a tracking to what the model takes: the control points of the bust, and a camera.

Symbols: B batch, V vertices of the skin in the order of the dataset's `control_points`, J bones.
Space: model space, metres, world axes, the origin at `space.head_centre` of the canonical bust;
the tracked identity's own origin is its neutral head's, a fraction of a millimetre away.

Both functions run on the tracking's device, batched and without gradients. Inside they are in
double precision, which neither autocast nor TF32 touches. Results are float32.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.nn import functional

from assets_procedural.body.head import BONES, HEAD_SHARES, LIDS, HeadModel
from assets_procedural.body.landmarks import skin_weights
from assets_procedural.body.regions import fields
from assets_procedural.conventions.camera import SENSOR_MM
from assets_procedural.motion.poses import ARKIT_NAMES, Pose, lid_following
from totalediting.geometry.field import Control
from totalediting.geometry.identity import IdentityBasis, identity_basis
from totalediting.geometry.space import ORIGIN_LANDMARKS
from totalediting.geometry.tracking import FILL, SIZES, Tracking

_SMALL = 1e-3  # radians: a gaze that no lid is fully turned by


@torch.no_grad()
def control_of(tracking: Tracking) -> Control:
    """The tracked bust (B, V, 3), posed and with neck and head at rest, with unit normals.

    What `body.head.Identity.pose` makes of the tracked identity, expression, gaze and
    head; the canonical bust has the same identity, expression and gaze.

    Raises:
        ValueError: a field has another shape than a batch of `HeadTracker`'s.
    """
    rig, tracking = _rig_of(tracking)
    posed, canonical = _busts(rig, tracking)
    points = (posed, canonical, _normals(posed, rig.quads), _normals(canonical, rig.quads))
    return Control(*(array.float() for array in points))


@torch.no_grad()
def camera_of(tracking: Tracking, side: int) -> tuple[Tensor, Tensor]:
    """`camera_to_world` (B, 4, 4) in model space and `intrinsics` (B, 3, 3) in pixels of `side`.

    The camera looks at the middle of the posed head's box from chin to crown, from so far that
    the box's height fills `fill` of the frame at the middle's depth; `shift` moves it sideways.
    So a dataset's multi-view shots are framed; `reframed` says so of its videos.

    Raises:
        ValueError: a field has another shape than a batch of `HeadTracker`'s; a side below 1.
    """
    if side < 1:
        raise ValueError(f"side must be at least 1, got {side}")
    rig, tracking = _rig_of(tracking)
    axes = _axes(tracking)
    right, up, away = axes
    position = _position(_box(rig, tracking), axes, tracking)

    camera_to_world = torch.eye(4).to(position).repeat(len(position), 1, 1)
    camera_to_world[:, :3] = torch.stack([right, up, away, position], -1)
    intrinsics = torch.eye(3).to(position).repeat(len(position), 1, 1)
    intrinsics[:, :2, :2] *= (tracking.focal_mm / SENSOR_MM * side)[..., None]
    intrinsics[:, :2, 2] = side / 2
    return camera_to_world.float(), intrinsics.float()


@torch.no_grad()
def reframed(tracking: Tracking) -> Tracking:
    """`fill` and `shift` that are about the head at rest, as of a video's shots, about the posed
    one; the camera is the same.

    Raises:
        ValueError: a field has another shape than a batch of `HeadTracker`'s.
    """
    rig, exact = _rig_of(tracking)
    axes = _axes(exact)
    still = {
        name: torch.zeros_like(getattr(exact, name)) for name in ("expression", "gaze", "head")
    }
    rest = _box(rig, exact._replace(**still))
    return _framed(rig, exact, _position(rest, axes, exact), tracking)


@torch.no_grad()
def framed(tracking: Tracking, position: Tensor) -> Tracking:
    """`fill` and `shift` of a camera that stands at `position` (B, 3) in model space; the rest as
    it is.

    Raises:
        ValueError: a field has another shape than a batch of `HeadTracker`'s.
    """
    rig, exact = _rig_of(tracking)
    return _framed(rig, exact, position.double(), tracking)


def constants(device: torch.device | None = None) -> _Rig:
    """What moves the skin's vertices, on a device, the CPU by default."""
    return _rig(device or torch.device("cpu"))


def _framed(rig: _Rig, exact: Tracking, position: Tensor, tracking: Tracking) -> Tracking:
    """`tracking` with `fill` and `shift` of a camera at `position`; `exact` is in doubles."""
    right, up, away = _axes(exact)
    middle, height = _box(rig, exact)
    off = position - middle
    frame = (off * away).sum(-1, keepdim=True) * SENSOR_MM / exact.focal_mm
    shift = torch.cat([(off * axis).sum(-1, keepdim=True) for axis in (right, up)], -1)
    return tracking._replace(
        log_fill=(height / frame / FILL).log().float(), shift=(-shift / frame).float()
    )


class _Rig(NamedTuple):
    """The head model's constants on a device: what moves V skin vertices, float64."""

    basis: IdentityBasis
    skin: Tensor
    """(V,) of the bust's vertices."""
    shapes: Tensor
    """(52, V, 3) metres, in the order of `ARKIT_NAMES`."""
    blinks: tuple[tuple[int, int, int, float], ...]
    """Expression, vertices of the upper and lower lid, and how far it closes them, metres."""
    following: Tensor
    """(4, 52) expression per radian of gaze to the left, to the right, up and down."""
    weights: Tensor
    """(V, J) of the bones."""
    quads: Tensor
    """(F, 4) of the V."""
    head: Tensor
    """Those of the V above the neck."""
    origin: Tensor
    """(V,) weights whose sum over the canonical bust is the origin."""


def _rig_of(tracking: Tracking) -> tuple[_Rig, Tracking]:
    """The constants for a tracking, and it in double precision."""
    for name, field, size in zip(Tracking._fields, tracking, SIZES, strict=True):
        if field.shape != (len(tracking.expression), size):
            raise ValueError(f"{name} must be (B, {size}), got {tuple(field.shape)}")
    return _rig(tracking.expression.device), Tracking(*(field.double() for field in tracking))


@lru_cache(maxsize=4)
def _rig(device: torch.device) -> _Rig:
    model = HeadModel.load()
    skin = model.groups["skin"]
    place = np.full(len(model.template), -1)  # of a vertex among the skin's
    place[skin] = np.arange(len(skin))
    shapes = model.action_shapes
    by_name = [shapes[model.expression_names.index(name)][skin] for name in ARKIT_NAMES]
    blinks = []
    for name, lids in LIDS.items():
        number = ARKIT_NAMES.index(name)
        upper, lower = place[model.from_base(lids)].tolist()
        reach = float(by_name[number][lower, 2] - by_name[number][upper, 2])
        blinks.append((number, upper, lower, reach))
    implied = [
        lid_following(Pose(gaze=gaze))
        for gaze in ((_SMALL, 0.0), (-_SMALL, 0.0), (0.0, _SMALL), (0.0, -_SMALL))
    ]
    following = [[of.get(name, 0.0) / _SMALL for name in ARKIT_NAMES] for of in implied]
    neck = fields(model)["neck"][skin]
    origin = skin_weights(model)[list(ORIGIN_LANDMARKS)].toarray().mean(0)[skin]

    def constant(array: ArrayLike) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float64, device=device)

    def index(array: np.ndarray) -> Tensor:
        return torch.tensor(array, dtype=torch.long, device=device)

    return _Rig(
        basis=IdentityBasis(*map(constant, vars(identity_basis()).values())),
        skin=index(skin),
        shapes=constant(by_name),
        blinks=tuple(blinks),
        following=constant(following),
        weights=constant(model.weights[skin]),
        quads=index(place[model.faces["skin"]]),
        head=index(np.flatnonzero(neck < 0.5)),
        origin=constant(origin),
    )


def _box(rig: _Rig, tracking: Tracking) -> tuple[Tensor, Tensor]:
    """Middle (B, 3) and height (B, 1) of the box of the posed head, from chin to crown."""
    head = _busts(rig, tracking)[0][:, rig.head]
    low, high = head.amin(1), head.amax(1)
    return (low + high) / 2, (high - low)[:, 2:]


def _axes(tracking: Tracking) -> tuple[Tensor, Tensor, Tensor]:
    """The camera's axes (B, 3): right, up, and away from what it looks at."""
    yaw, pitch, roll = tracking.camera_yaw_pitch_roll.split(1, -1)
    away = torch.cat([yaw.sin() * pitch.cos(), -yaw.cos() * pitch.cos(), pitch.sin()], -1)
    level = torch.cat([yaw.cos(), yaw.sin(), torch.zeros_like(yaw)], -1)
    above = torch.linalg.cross(away, level)
    right = roll.cos() * level + roll.sin() * above
    return right, roll.cos() * above - roll.sin() * level, away


def _position(
    box: tuple[Tensor, Tensor], axes: tuple[Tensor, Tensor, Tensor], tracking: Tracking
) -> Tensor:
    """(B, 3) position of the camera that frames a box this way."""
    middle, height = box
    right, up, away = axes
    frame = height / tracking.fill
    shift = frame * tracking.shift
    position = middle + tracking.focal_mm / SENSOR_MM * frame * away
    return position - shift[:, :1] * right - shift[:, 1:] * up


def _busts(rig: _Rig, tracking: Tracking) -> tuple[Tensor, Tensor]:
    """Skin (B, V, 3), posed and canonical, in model space."""
    rest = rig.basis.vertices(tracking.identity)[:, rig.skin]
    joints = rig.basis.joints(tracking.identity)
    vertices = _expressed(rig, rest, tracking)
    posed, canonical = (
        _skinned(vertices, rig.weights, _bones(joints, head, tracking.gaze))
        for head in (tracking.head, torch.zeros_like(tracking.head))
    )
    origin = torch.einsum("v,bvi->bi", rig.origin, canonical)[:, None]
    return posed - origin, canonical - origin


def _expressed(rig: _Rig, rest: Tensor, tracking: Tracking) -> Tensor:
    """Rest vertices (B, V, 3) with the expression, lids after the gaze; as `Identity.pose`."""
    gaze = torch.stack([tracking.gaze, -tracking.gaze], -1).flatten(1).clamp_min(0)
    implied = (gaze @ rig.following).clamp_max(1)
    values = torch.where(implied > 0, implied, tracking.expression)
    blinks = [blink[0] for blink in rig.blinks]
    share = values[:, blinks]
    values = values.index_fill(1, torch.tensor(blinks, device=values.device), 0.0)
    vertices = rest + torch.einsum("ba,avi->bvi", values, rig.shapes)
    # A blink is a share of what the rest has left open.
    for k, (name, upper, lower, reach) in enumerate(rig.blinks):
        aperture = (vertices[:, upper, 2] - vertices[:, lower, 2]).clamp_min(0)
        closed = share[:, k] * aperture / reach
        vertices = vertices + closed[:, None, None] * rig.shapes[name]
    return vertices


def _bones(joints: Tensor, head: Tensor, gaze: Tensor) -> Tensor:
    """Motions (B, J, 4, 4) from rest of the bones, in the order of `head.BONES`."""
    joint: dict[str, Tensor] = dict(zip(BONES[1:], joints.unbind(1), strict=True))
    turn = _rotation_vector(head)
    bones = {"trunk": torch.eye(4).to(joints).expand(len(joints), 4, 4)}
    parent = bones["trunk"]
    for name, share in HEAD_SHARES.items():
        parent = parent @ _about(joint[name], _rotation(share * turn))
        bones[name] = parent
    yaw, pitch = gaze.unbind(-1)
    zero = torch.zeros_like(yaw)
    sideways = _rotation(torch.stack([zero, zero, yaw], -1))
    looking = sideways @ _rotation(torch.stack([-pitch, zero, zero], -1))
    for name in ("eye_left", "eye_right"):
        bones[name] = bones["head"] @ _about(joint[name], looking)
    return torch.stack([bones[name] for name in BONES], 1)


def _skinned(vertices: Tensor, weights: Tensor, bones: Tensor) -> Tensor:
    """Linear blend skinning of (B, V, 3)."""
    motion = torch.einsum("vj,bjik->bvik", weights, bones[..., :3, :])
    return (motion[..., :3] @ vertices[..., None])[..., 0] + motion[..., 3]


def _rotation_vector(head: Tensor) -> Tensor:
    """Axis times angle (B, 3) of Rz(yaw) Ry(roll) Rx(pitch), by way of the quaternion."""
    (cx, cy, cz), (sx, sy, sz) = (part.unbind(-1) for part in ((head / 2).cos(), (head / 2).sin()))
    w = cx * cy * cz + sx * sy * sz
    x = sx * cy * cz - cx * sy * sz
    y = cx * sy * cz + sx * cy * sz
    z = cx * cy * sz - sx * sy * cz
    axis = torch.where(w < 0, -1.0, 1.0)[:, None] * torch.stack([x, y, z], -1)
    sine = axis.norm(dim=-1, keepdim=True)
    return 2 * torch.atan2(sine, w.abs()[:, None]) * axis / sine.clamp_min(1e-30)


def _rotation(vector: Tensor) -> Tensor:
    """(B, 3, 3) of axis times angle (B, 3)."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1)
    return torch.linalg.matrix_exp(cross.unflatten(-1, (3, 3)))


def _about(centre: Tensor, rotation: Tensor) -> Tensor:
    """(B, 4, 4) rotations (B, 3, 3) about points (B, 3)."""
    motion = torch.eye(4).to(centre).repeat(len(centre), 1, 1)
    motion[:, :3, :3] = rotation
    motion[:, :3, 3] = centre - (rotation @ centre[..., None])[..., 0]
    return motion


def _normals(vertices: Tensor, quads: Tensor) -> Tensor:
    """(B, V, 3) unit normals, weighted by the quads' area; as `head.vertex_normals`."""
    corners = vertices[:, quads]
    area = torch.linalg.cross(
        corners[:, :, 2] - corners[:, :, 0], corners[:, :, 3] - corners[:, :, 1]
    )
    total = torch.zeros_like(vertices)
    for corner in quads.unbind(-1):
        total.index_add_(1, corner, area)
    return functional.normalize(total, dim=-1)
