"""The whole bust of a tracking: skin, eyeballs, teeth and tongue, as the generator poses it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel, Identity, vertex_normals
from assets_procedural.body.landmarks import skin_weights
from assets_procedural.motion.poses import ARKIT_NAMES, Pose
from totalediting.editing.raster import Raster, rasterise
from totalediting.geometry.identity import identity_basis
from totalediting.geometry.rig import camera_of
from totalediting.geometry.space import ORIGIN_LANDMARKS
from totalediting.geometry.tracking import Tracking

GROUPS = ("skin", "eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue")


@dataclass(frozen=True, eq=False)
class View:
    """A camera with its principal point in the middle of a square picture."""

    frame: np.ndarray
    """(4, 4) camera to model space."""
    focal: float
    """In sides of the picture."""

    def project(self, points: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and depths (...) of points (..., 3)."""
        own = (points - self.frame[:3, 3]) @ self.frame[:3, :3]
        depth = -own[..., 2]
        flat = self.focal * own[..., :2] * [1, -1] / np.where(depth > 1e-6, depth, 1e-6)[..., None]
        return side * (0.5 + flat), depth

    def unproject(self, pixels: np.ndarray, depth: np.ndarray, side: int) -> np.ndarray:
        """Points (..., 3) of pixels (..., 2) and depths (...)."""
        flat = (pixels / side - 0.5) * [1, -1] / self.focal
        own = np.concatenate([flat, np.full((*flat.shape[:-1], 1), -1.0)], -1) * depth[..., None]
        return own @ self.frame[:3, :3].T + self.frame[:3, 3]


@dataclass(frozen=True, eq=False)
class WholeBust:
    """Posed vertices (V, 3) in model space, of the head model's whole bust."""

    vertices: np.ndarray

    @cached_property
    def normals(self) -> np.ndarray:
        """(V, 3) unit."""
        return vertex_normals(self.vertices, triangles())

    @property
    def skin(self) -> np.ndarray:
        """(S,) vertices of the skin."""
        return head_model().groups["skin"]

    def raster(self, view: View, side: int) -> Raster:
        """What of it is seen."""
        places, depth = view.project(self.vertices, side)
        return rasterise(places, depth, triangles(), side, side)


def bust_of(tracking: Tracking) -> WholeBust:
    """The bust of a tracking (1, …)."""
    model, basis = head_model(), identity_basis()
    identity = tracking.identity[0].cpu()
    rest, joints = (of(identity).double().numpy() for of in (basis.vertices, basis.joints))
    values = tracking.expression[0].double().clamp(0, 1).tolist()
    pose = Pose(
        expression=dict(zip(ARKIT_NAMES, values, strict=True)),
        gaze=tuple(tracking.gaze[0].tolist()),
        head=tuple(tracking.head[0].tolist()),
    )
    bust = Identity(model, rest, joints).pose(pose)
    weights = skin_weights(model)[list(ORIGIN_LANDMARKS)]
    origin = (weights @ bust.canonical.vertices).mean(0)
    return WholeBust(bust.vertices - origin)


def view_of(tracking: Tracking) -> View:
    """The camera of a tracking (1, …)."""
    frame, lens = camera_of(tracking, 1)
    return View(frame[0].double().numpy(), float(lens[0, 0, 0]))


@lru_cache(maxsize=1)
def head_model() -> HeadModel:
    return HeadModel.load()


@lru_cache(maxsize=1)
def triangles() -> np.ndarray:
    """(F, 3) of all `GROUPS`, counter-clockwise seen from outside."""
    quads = np.concatenate([head_model().faces[name] for name in GROUPS])
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


@lru_cache(maxsize=1)
def group_of_triangle() -> np.ndarray:
    """(F,) number of its group in `GROUPS`."""
    counts = [len(head_model().faces[name]) for name in GROUPS]
    return np.tile(np.repeat(np.arange(len(GROUPS)), counts), 2)


@lru_cache(maxsize=1)
def opposite() -> np.ndarray:
    """(V,) each vertex' counterpart on the other side of the face."""
    template = head_model().template
    return np.asarray(KDTree(template).query(template * [-1, 1, 1])[1])
