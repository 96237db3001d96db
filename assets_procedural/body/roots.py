"""Where strands are rooted: points on triangles of the skin, sampled by density, that move with it.

"Template space" is that of `HeadModel.template`: regions such as a hairline are defined there once
and so fit every subject. Symbols: V vertices, N strands, K points a strand, R roots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.body.head import Bust, Identity
from assets_procedural.mesh.vectors import unit


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
    # The corners and the centre show whether anything can grow on a triangle at all.
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
        # Stratified sampling over the area avoids bald gaps.
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


@dataclass(frozen=True, eq=False)
class SkinBound:
    """Strands that move with the triangle of their root, for facial hair.

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

    def __getitem__(self, index: np.ndarray) -> SkinBound:
        return SkinBound(self.roots[index], self.local[index])

    def __call__(self, bust: Bust) -> np.ndarray:
        frames = self.roots.frames(bust.vertices).astype(np.float32)
        roots = self.roots.of(bust.vertices).astype(np.float32)
        return np.matmul(self.local, frames.transpose(0, 2, 1)) + roots[:, None]
