"""Swept surfaces, ellipsoids, tubes and sheets with two sides: rims, pearls, brims."""

from __future__ import annotations

import numpy as np

from assets_procedural.mesh.vectors import unit


def sweep(
    path: np.ndarray, side: np.ndarray, profile: np.ndarray, closed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Carry a closed profile along a path: vertices (N * K, 3) and quads.

    `path` (N, 3); `side` (3,) or (N, 3) is the direction that the profile's first axis keeps as far
    as the path allows; `profile` (K, 2) or (N, K, 2) in metres. An open sweep's ends are closed by
    shrinking rings, so the ends look rounded.
    """
    steps = len(path)
    profile = np.broadcast_to(profile, (steps, *profile.shape[-2:])).copy()
    if closed:
        tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    else:
        tangent = np.gradient(path, axis=0)
    tangent = unit(tangent)
    side = np.broadcast_to(side, path.shape)
    first = unit(side - np.einsum("ni,ni->n", side, tangent)[:, None] * tangent)
    second = np.cross(tangent, first)
    if not closed:
        # Two more rings at each end, drawn together.
        extra = [0, 0, *range(steps), steps - 1, steps - 1]
        shrink = np.array([0.02, 0.7, *([1.0] * steps), 0.7, 0.02])[:, None, None]
        size = np.abs(profile).max()
        push = np.array([-0.5, -0.35, *([0.0] * steps), 0.35, 0.5])[:, None] * size
        path = path[extra] + push * tangent[extra]
        profile, first, second = profile[extra] * shrink, first[extra], second[extra]
    rings = path[:, None] + profile[..., :1] * first[:, None] + profile[..., 1:] * second[:, None]
    count = rings.shape[1]
    index = np.arange(len(rings) * count).reshape(-1, count)
    if closed:
        index = np.concatenate([index, index[:1]])
    return rings.reshape(-1, 3), tube_faces(index)


def rounded(width: float, depth: float, power: float = 4.0, points: int = 16) -> np.ndarray:
    """A closed superellipse profile (points, 2): power 2 is an ellipse, more is boxier."""
    angle = np.arange(points) * 2 * np.pi / points
    cos, sin = np.cos(angle), np.sin(angle)
    return 0.5 * np.stack(
        [
            width * np.sign(cos) * np.abs(cos) ** (2 / power),
            depth * np.sign(sin) * np.abs(sin) ** (2 / power),
        ],
        axis=1,
    )


def ellipsoid(centre: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and quads of an ellipsoid; `axes` (3, 3) holds its half axes as rows."""
    theta = np.linspace(0.02, np.pi - 0.02, 12)
    phi = np.arange(18) * 2 * np.pi / 18
    sphere = np.stack(
        np.broadcast_arrays(
            np.sin(theta)[:, None] * np.cos(phi),
            np.sin(theta)[:, None] * np.sin(phi),
            np.cos(theta)[:, None],
        ),
        axis=-1,
    )
    index = np.arange(12 * 18).reshape(12, 18)
    return centre + sphere.reshape(-1, 3) @ axes, tube_faces(index, flipped=True)


def tube_faces(index: np.ndarray, flipped: bool = False) -> np.ndarray:
    """Quads between rings of vertices, each ring closed: `index` (rings, around) to (F, 4)."""
    beside = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], beside[:-1], beside[1:], index[1:]], axis=-1)
    quads = quads.reshape(-1, 4).astype(np.int32)
    return quads[:, [0, 3, 2, 1]] if flipped else quads


def joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """One mesh from several (vertices, faces)."""
    starts = np.cumsum([0] + [len(v) for v, _ in parts])
    faces = [f + s for (_, f), s in zip(parts, starts, strict=False)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(faces).astype(np.int32)


def shell(
    grid: np.ndarray, thickness: float, closed: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """A sheet with two sides and a rim from a grid (N, K, 3): vertices (2 N K, 3) and quads.

    The second side lies `thickness` metres behind the first, whose normals are the cross product of
    steps along N and along K. `closed` joins the last row of N to the first. Vertex k of the grid
    is followed N K places later by its twin.
    """
    along = np.roll(grid, -1, 0) - np.roll(grid, 1, 0) if closed else np.gradient(grid, axis=0)
    normal = unit(np.cross(along, np.gradient(grid, axis=1)))
    points = np.concatenate([grid.reshape(-1, 3), (grid - thickness * normal).reshape(-1, 3)])
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    around = np.concatenate([index, index[:1]]) if closed else index
    front = np.stack([around[:-1, :-1], around[1:, :-1], around[1:, 1:], around[:-1, 1:]], -1)
    front = front.reshape(-1, 4)
    back = front[:, ::-1] + index.size
    if closed:
        rims = [around[::-1, 0], around[:, -1]]
    else:
        rims = [np.concatenate(
            [index[:, -1], index[-1, -2::-1], index[-2::-1, 0], index[0, 1:]]
        )]  # fmt: skip
    walls = [
        np.stack([rim[:-1], rim[1:], rim[1:] + index.size, rim[:-1] + index.size], axis=1)
        for rim in rims
    ]
    return points, np.concatenate([front, back, *walls]).astype(np.int32)
