"""Strands in numpy: roots on the skin, growth over the head, guides to children, and posing.

Symbols: V vertices, N strands, G guides, K points a strand, R roots or points. Metres, the frame
of `head`. "Template space" is that of `HeadModel.template`: regions such as a hairline are defined
there once and so fit every subject.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.head import Bust, HeadModel, Identity

# Length scale of the plane that stands for the skin around its nearest vertex.
_SKIN_REACH = 0.03
# A turn of the head fades from the head to the trunk over this height below the chin.
_DRAPE_HEIGHT = 0.09
_DRAPE_CHAIN = ("trunk", "neck01", "neck02", "neck03", "head")
_DRAPE_STEPS = 128


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) at length 1; null vectors stay null."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def smoothstep(low: Any, high: Any, value: np.ndarray) -> np.ndarray:
    """Hermite step from 0 at `low` to 1 at `high`."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


@dataclass(frozen=True, eq=False)
class Roots:
    """Points on triangles of the model: `triangle` (R, 3) vertex ids, `barycentric` (R, 3)."""

    triangle: np.ndarray
    barycentric: np.ndarray

    def __len__(self) -> int:
        return len(self.triangle)

    def __getitem__(self, index: np.ndarray) -> Roots:
        return Roots(self.triangle[index], self.barycentric[index])

    def of(self, values: np.ndarray) -> np.ndarray:
        """Interpolate per-vertex `values` (V, ...) to (R, ...)."""
        return np.einsum("rk,rk...->r...", self.barycentric, values[self.triangle])

    def frames(self, vertices: np.ndarray) -> np.ndarray:
        """(R, 3, 3) rotations of the triangles; the columns are tangent, bitangent and normal."""
        a, b, c = vertices[self.triangle].transpose(1, 0, 2)
        tangent = unit(b - a)
        normal = unit(np.cross(b - a, c - a))
        return np.stack([tangent, np.cross(normal, tangent), normal], axis=-1)


def sample_roots(
    identity: Identity,
    density: Callable[[np.ndarray, Roots], np.ndarray],
    count: int,
    rng: np.random.Generator,
    faces: np.ndarray | None = None,
) -> Roots:
    """Draw `count` roots on the rest skin, or fewer where nothing may grow.

    Args:
        density: (template points (R, 3), their roots) → relative density (R,) in [0, 1].
        faces: (F, 4) quads to draw from; the whole skin by default.
    """
    model = identity.model
    quads = model.faces["skin"] if faces is None else faces
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    # The corners and the centre tell where a triangle can carry anything at all.
    probes = np.vstack([np.eye(3) * 0.94 + 0.02, np.full((1, 3), 1 / 3)])
    chance = np.zeros(len(triangles))
    for probe in probes:
        roots = Roots(triangles, np.broadcast_to(probe, (len(triangles), 3)))
        chance = np.maximum(chance, density(roots.of(model.template), roots))
    triangles = triangles[chance > 0]
    if len(triangles) == 0 or count == 0:
        return Roots(np.zeros((0, 3), int), np.zeros((0, 3)))
    a, b, c = identity.rest[triangles].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    edges = np.cumsum(area) / area.sum()
    found: list[Roots] = []
    total, batch = 0, int(1.6 * count) + 64
    for _ in range(12):
        # A stratified draw over the area keeps roots from leaving bald gaps.
        u = (rng.permutation(batch) + rng.random(batch)) / batch
        chosen = np.minimum(np.searchsorted(edges, u), len(triangles) - 1)
        r1, r2 = np.sqrt(rng.random(batch)), rng.random(batch)
        roots = Roots(triangles[chosen], np.stack([1 - r1, r1 * (1 - r2), r1 * r2], axis=1))
        kept = rng.random(batch) < density(roots.of(model.template), roots)
        found.append(roots[kept])
        total += int(kept.sum())
        if total >= count:
            break
    triangle = np.concatenate([r.triangle for r in found])[:count]
    return Roots(triangle, np.concatenate([r.barycentric for r in found])[:count])


@dataclass(frozen=True, eq=False)
class Surface:
    """What strands collide with: points (R, 3) and unit normals (R, 3) of a skin."""

    points: np.ndarray
    normals: np.ndarray

    @staticmethod
    def of(bust: Bust, without_ears: bool = True) -> Surface:
        """The skin of a bust; ears are left out since strands would get caught in their folds."""
        index = bust.model.groups["skin"]
        if without_ears:
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
class HeadFrame:
    """The affine map from template space to a subject's rest space, fitted to the skull."""

    matrix: np.ndarray
    offset: np.ndarray

    @staticmethod
    def of(identity: Identity) -> HeadFrame:
        template = identity.model.template
        index = identity.model.groups["skin"]
        index = index[template[index, 2] > 0.64]
        source = np.column_stack([template[index], np.ones(len(index))])
        solution, *_ = np.linalg.lstsq(source, identity.rest[index], rcond=None)
        return HeadFrame(solution[:3].T, solution[3])

    def to_rest(self, points: np.ndarray) -> np.ndarray:
        return points @ self.matrix.T + self.offset

    def to_template(self, points: np.ndarray) -> np.ndarray:
        return (points - self.offset) @ np.linalg.inv(self.matrix).T


def resample(strands: np.ndarray, stop: np.ndarray, count: int) -> np.ndarray:
    """Strands (N, K, 3) cut at the fraction `stop` (N,) of their length → (N, count, 3)."""
    last = strands.shape[1] - 1
    place = stop[:, None] * np.linspace(0, last, count)
    low = np.clip(place.astype(int), 0, last - 1)
    share = (place - low)[..., None]
    row = np.arange(len(strands))[:, None]
    return strands[row, low] * (1 - share) + strands[row, low + 1] * share


def spread(
    guides: np.ndarray,
    guide_side: np.ndarray,
    roots: np.ndarray,
    side: np.ndarray,
    neighbours: int = 3,
) -> tuple[np.ndarray, np.ndarray]:
    """Which guides each child mixes: (ids (N, neighbours), weights (N, neighbours)).

    `guides` (G, 3) and `roots` (N, 3) are root positions; a child only mixes guides of its own
    `side`, so that nothing bridges a parting.
    """
    ids = np.zeros((len(roots), neighbours), int)
    weights = np.full((len(roots), neighbours), 1 / neighbours)
    for value in np.unique(side):
        mine = np.flatnonzero(side == value)
        pool = np.flatnonzero(guide_side == value)
        if len(pool) == 0:
            pool = np.arange(len(guides))
        k = min(neighbours, len(pool))
        distance, index = KDTree(guides[pool]).query(roots[mine], k=k)
        distance, index = distance.reshape(len(mine), k), index.reshape(len(mine), k)
        weight = 1 / (distance + 1e-4) ** 2
        ids[mine[:, None], np.arange(k)] = pool[index]
        weights[mine] = 0
        weights[mine[:, None], np.arange(k)] = weight / weight.sum(axis=1, keepdims=True)
    return ids, weights


def mix(values: np.ndarray, ids: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Mix guide values (G, ...) to children (N, ...)."""
    result = np.zeros((len(ids), *values.shape[1:]), values.dtype)
    shape = (-1,) + (1,) * (values.ndim - 1)
    for column in range(ids.shape[1]):
        result += weights[:, column].astype(values.dtype).reshape(shape) * values[ids[:, column]]
    return result


def locks(roots: np.ndarray, side: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    """The leading strand (N,) of every strand's lock, locks holding about `size` strands."""
    count = max(int(len(roots) / size), 1)
    centres = rng.permutation(len(roots))[:count]
    ids, _ = spread(roots[centres], side[centres], roots, side, neighbours=1)
    return centres[ids[:, 0]]


def clump(strands: np.ndarray, leader: np.ndarray, strength: np.ndarray | float) -> np.ndarray:
    """Pull strands (N, K, 3) towards their lock's leader, more so towards the tips.

    A strand moves by a third of its length at most, so that short hair does not bare the skin.
    """
    along = np.linspace(0, 1, strands.shape[1])
    profile = along**1.3 * (1 - 0.25 * along)
    pull = np.broadcast_to(np.asarray(strength), (len(strands),))[:, None] * profile
    offset = (strands[leader] - strands) * np.minimum(pull, 0.96)[..., None]
    reach = np.linalg.norm(np.diff(strands, axis=1), axis=2).sum(axis=1)
    moved = np.linalg.norm(offset[:, -1], axis=1)
    return strands + offset * np.minimum(1, 0.33 * reach / np.maximum(moved, 1e-9))[:, None, None]


def sideways(strands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit fields (N, K, 3) across the strands, stable along each strand."""
    tangent = unit(np.gradient(strands, axis=1))
    reference = unit(np.cross(unit(strands[:, -1] - strands[:, 0]), [0.3, 0.9, 0.2]))[:, None]
    across = unit(reference - tangent * (tangent * reference).sum(-1, keepdims=True))
    return across, np.cross(tangent, across)


def wander(
    strands: np.ndarray, amplitude: np.ndarray | float, rng: np.random.Generator
) -> np.ndarray:
    """Add a smooth random drift to strands (N, K, 3); `amplitude` metres at the tips."""
    count, points = strands.shape[:2]
    along = np.linspace(0, 1, points)
    across, other = sideways(strands)
    drift = np.zeros((2, count, points))
    for order in (1, 2, 3):
        wave = rng.normal(size=(2, count, 1)) / order
        phase = rng.random((2, count, 1)) * 2 * np.pi
        drift += wave * (np.sin(np.pi * order * along + phase) - np.sin(phase))
    scale = np.broadcast_to(np.asarray(amplitude), (count,))[:, None] * along
    return strands + (drift[0] * scale)[..., None] * across + (drift[1] * scale)[..., None] * other


def coil(
    strands: np.ndarray,
    amplitude: np.ndarray,
    turns: np.ndarray,
    phase: np.ndarray,
    flat: float = 0.0,
    onset: float = 0.25,
) -> np.ndarray:
    """Wind strands (N, K, 3) into helices; `flat` 1 makes plane waves of them.

    `amplitude` (N,) metres, `turns` (N,) per strand, `phase` (N,) radians; the coil grows to its
    full width over the first `onset` of the strand.
    """
    along = np.linspace(0, 1, strands.shape[1])
    across, other = sideways(strands)
    angle = 2 * np.pi * turns[:, None] * along + phase[:, None]
    width = amplitude[:, None] * smoothstep(0, onset, along)
    first = (np.cos(angle) - np.cos(phase)[:, None] * (1 - along)) * width
    second = (np.sin(angle) - np.sin(phase)[:, None] * (1 - along)) * width * (1 - flat)
    return strands + first[..., None] * across + second[..., None] * other


def tapered(
    count: int, points: int, root: float, tip: float, rng: np.random.Generator
) -> np.ndarray:
    """Radii (count, points) in metres from `root` to `tip`, hairs differing by a fifth."""
    along = np.linspace(0, 1, points)
    profile = tip + (root - tip) * (1 - along**2.5)
    return (profile * rng.uniform(0.8, 1.2, (count, 1))).astype(np.float32)


def colouring(
    melanin: float,
    redness: float,
    grey: np.ndarray | float,
    count: int,
    rng: np.random.Generator,
    roughness: float = 0.3,
) -> dict[str, Any]:
    """Shading inputs of `count` strands.

    Grey hair is a mix of white and pigmented strands: a strand is white where its `strand_random`
    (N,) in [0, 1) is below `grey`. Where `grey` is local, (N,), the random numbers are stretched
    so that the mean share gives each place its own.
    """
    share = np.broadcast_to(np.asarray(grey, float), (count,))
    mean = float(share.mean()) if count else 0.0
    random = rng.random(count)
    white = random < share
    low = random * mean / np.maximum(share, 1e-9)
    high = mean + (random - share) * (1 - mean) / np.maximum(1 - share, 1e-9)
    return {
        "melanin": float(melanin),
        "redness": float(redness),
        "grey": mean,
        "roughness": roughness,
        "radial_roughness": 0.35,
        "strand_random": np.where(white, low, high).astype(np.float32),
    }


@dataclass(frozen=True, eq=False)
class SkinBound:
    """Strands that ride on the triangle of their root, for hair of the face.

    `local` (N, K, 3) are the points in the frame of the root's triangle.
    """

    roots: Roots
    local: np.ndarray

    @staticmethod
    def at_rest(identity: Identity, roots: Roots, strands: np.ndarray) -> SkinBound:
        """Bind strands (N, K, 3) given on the neutral rest shape."""
        rest = identity.rest
        offset = strands - roots.of(rest)[:, None]
        local = np.einsum("nji,nkj->nki", roots.frames(rest), offset)
        return SkinBound(roots, local.astype(np.float32))

    def __call__(self, bust: Bust) -> np.ndarray:
        frames = self.roots.frames(bust.vertices).astype(np.float32)
        roots = self.roots.of(bust.vertices).astype(np.float32)
        return np.matmul(self.local, frames.transpose(0, 2, 1)) + roots[:, None]


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

    @cached_property
    def _low(self) -> np.ndarray:
        """Children that reach below the chin."""
        return np.flatnonzero(self.strands[..., 2].min(axis=1) < self.chin)

    @cached_property
    def _low_guides(self) -> np.ndarray:
        return np.flatnonzero(self.guides[..., 2].min(axis=1) < self.chin)

    def __call__(self, bust: Bust) -> np.ndarray:
        head = bust.bones["head"].astype(np.float32)
        result = self.strands @ head[:3, :3].T + head[:3, 3]
        if len(self._low) == 0:
            return result
        chain = np.stack([bust.bones[name][:3] for name in _DRAPE_CHAIN])
        low, guides = self._low, self._low_guides
        result[low] = _bend(self.strands[low], self.chin, chain)
        posed = _bend(self.guides[guides], self.chin, chain)
        surface = Surface.of(bust)
        moved = surface.push_out(surface.push_out(posed, self.margin), self.margin) - posed
        # The rest shape already clears the skin: the first points need no help.
        moved[:, :2] = 0
        correction = np.zeros(self.guides.shape, np.float32)
        correction[guides] = moved
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
    moved = motion[..., 0] * x + motion[..., 1] * y + motion[..., 2] * z + motion[..., 3]
    return moved.astype(np.float32)


def chin_height(identity: Identity) -> float:
    """Height of the chin's underside at rest."""
    model: HeadModel = identity.model
    skin = model.groups["skin"]
    near = model.template[skin]
    chin = skin[(np.abs(near[:, 0]) < 0.01) & (near[:, 1] < -0.12) & (near[:, 2] > 0.6)]
    return float(identity.rest[chin, 2].min())
