"""Scalp hair on a posed bust: rigid on the skull, draped over neck and shoulders below the chin.

Symbols: N strands, G guides, K points a strand, R points. Metres, the frame of `head`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.body.head import Bust, HeadModel, Identity
from assets_procedural.hair.strands import mix
from assets_procedural.mesh.vectors import moved, smoothstep

# Length scale of the plane that stands for the skin around its nearest vertex.
_SKIN_REACH = 0.03
# A turn of the head fades from the head to the trunk over this height below the chin.
_DRAPE_HEIGHT = 0.09
_DRAPE_CHAIN = ("trunk", "neck01", "neck02", "neck03", "head")
_DRAPE_STEPS = 128


@dataclass(frozen=True, eq=False)
class Surface:
    """What strands collide with: points (R, 3) and unit normals (R, 3) of a skin."""

    points: np.ndarray
    normals: np.ndarray

    @staticmethod
    def of(bust: Bust) -> Surface:
        """The skin of a bust; ears are left out since strands would get caught in their folds."""
        index = bust.model.groups["skin"]
        index = index[bust.model.masks["ears"][index] < 0.5]
        inside = bust.model.masks["inside-mouth"][index] > 0.3
        index = index[~inside]
        return Surface(bust.vertices[index], bust.normals[index])

    @cached_property
    def tree(self) -> KDTree:
        return KDTree(self.points)

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (...,) of points (..., 3), positive outside, and its direction."""
        flat = points.reshape(-1, 3)
        away, index = self.tree.query(flat)
        offset = flat - self.points[index]
        normal = self.normals[index]
        signed = np.einsum("rk,rk->r", offset, normal)
        # Far away the plane means little: there the distance to the vertex does.
        far = away > _SKIN_REACH
        signed = np.where(far, np.where(signed < 0, -away, away), signed)
        return signed.reshape(points.shape[:-1]), normal.reshape(points.shape)

    def push_out(self, points: np.ndarray, margin: Any) -> np.ndarray:
        """Points (..., 3) moved to at least `margin` metres off the skin."""
        signed, normal = self.distance(points)
        lack = np.clip(margin - signed, 0, 0.06)
        return points + lack[..., None] * normal

    def pull_in(self, points: np.ndarray, most: np.ndarray) -> np.ndarray:
        """Points (..., 3) moved to at most `most` (...,) metres off the skin."""
        signed, normal = self.distance(points)
        return points - np.maximum(signed - most, 0)[..., None] * normal


@dataclass(frozen=True, eq=False)
class Draped:
    """Scalp strands: rigid with the head, and from the chin down ever more with the trunk.

    `strands` (N, K, 3) at rest. What hangs below the chin is kept out of the posed body by moving
    the guides `guides` (G, K, 3) out of it; children follow by `ids` and `weights` (N, 3).
    """

    strands: np.ndarray
    guides: np.ndarray
    ids: np.ndarray
    weights: np.ndarray
    chin: float
    margin: float

    def __getitem__(self, index: np.ndarray) -> Draped:
        return replace(
            self, strands=self.strands[index], ids=self.ids[index], weights=self.weights[index]
        )

    @cached_property
    def _low(self) -> np.ndarray:
        """Children that reach below the chin."""
        return np.flatnonzero(self.strands[..., 2].min(axis=1) < self.chin)

    @cached_property
    def _low_guides(self) -> np.ndarray:
        return np.flatnonzero(self.guides[..., 2].min(axis=1) < self.chin)

    def __call__(self, bust: Bust) -> np.ndarray:
        head = bust.bones["head"].astype(np.float32)
        result = moved(self.strands, head)
        if len(self._low) == 0:
            return result
        chain = np.stack([bust.bones[name][:3] for name in _DRAPE_CHAIN])
        low, guides = self._low, self._low_guides
        result[low] = _bend(self.strands[low], self.chin, chain)
        posed = _bend(self.guides[guides], self.chin, chain)
        surface = Surface.of(bust)
        pushed = surface.push_out(surface.push_out(posed, self.margin), self.margin) - posed
        # The rest shape already clears the skin: the first points need no help.
        pushed[:, :2] = 0
        correction = np.zeros(self.guides.shape, np.float32)
        correction[guides] = pushed
        result[low] += mix(correction, self.ids[low], self.weights[low])
        return result


def _bend(points: np.ndarray, chin: float, chain: np.ndarray) -> np.ndarray:
    """Move points (..., 3) with the (5, 3, 4) motions of the neck by height under the chin."""
    level = np.linspace(0, 1, _DRAPE_STEPS)
    knots = np.linspace(0, 1, len(chain))
    hats = np.stack([np.interp(level, knots, hat) for hat in np.eye(len(chain))], axis=1)
    table = np.tensordot(hats, chain, 1).astype(np.float32)
    share = smoothstep(chin - _DRAPE_HEIGHT, chin, points[..., 2])
    motion = table[np.round(share * (_DRAPE_STEPS - 1)).astype(int)]
    x, y, z = (points[..., k, None] for k in range(3))
    bent = motion[..., 0] * x + motion[..., 1] * y + motion[..., 2] * z + motion[..., 3]
    return bent.astype(np.float32)


def chin_height(identity: Identity) -> float:
    """Height of the chin's underside at rest."""
    model: HeadModel = identity.model
    skin = model.groups["skin"]
    near = model.template[skin]
    chin = skin[(np.abs(near[:, 0]) < 0.01) & (near[:, 1] < -0.12) & (near[:, 2] > 0.6)]
    return float(identity.rest[chin, 2].min())
