"""A picture plane for the face: azimuth and elevation about a point inside the template's head.

Seen from that point, face, underside of the chin and throat do not hide each other. Texels span
about 0.4 by 0.33 mm. Positions are template positions ("rest"), metres; rows of pictures run
downwards.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates, zoom

from assets_procedural.body.head import HeadModel
from assets_procedural.body.regions import fields
from assets_procedural.mesh.subdivision import catmull_clark
from assets_procedural.mesh.vectors import arctan2, smoothstep

WIDTH, HEIGHT = 1024, 896
_CENTRE = np.array([0.0, 0.0, 0.700])
_AZIMUTH = np.radians(78.0)
_ELEVATION = np.radians([-66.0, 46.0])
TEXEL = 0.33e-3
"""Height of a texel on the middle of the face, metres; it is a fifth wider."""
COARSE = 4
"""Texels of the picture to one cell of `zones`."""
_PER_QUAD = 6
_FRONT = np.array([[-0.09, 0.56], [0.09, 0.82]])
_FRONT_CELL = 0.8e-3
_ZONES = ("lips", "nose", "cheeks", "chin", "forehead", "neck")
# Where the chart ends at the back of the head: far below the picture, so that faces across the
# seam do not show the whole of it.
_OUTSIDE = (0.5, -10.0)


def project(points: np.ndarray) -> np.ndarray:
    """Texture coordinates (..., 2) in [0, 1], right and up, of template positions (..., 3)."""
    x, y, z = np.moveaxis(points - _CENTRE, -1, 0)
    azimuth = arctan2(x, -y)
    elevation = arctan2(z, np.hypot(x, y))
    low, high = _ELEVATION
    u = azimuth / (2 * _AZIMUTH) + 0.5
    v = (elevation - low) / (high - low)
    inside = (u > 0) & (u < 1) & (v > 0) & (v < 1)
    return np.where(inside[..., None], np.stack([u, v], axis=-1), _OUTSIDE)


def pixels(points: np.ndarray) -> np.ndarray:
    """Columns and rows (..., 2), fractional, of template positions (..., 3)."""
    u, v = np.moveaxis(project(points), -1, 0)
    return np.stack([u * WIDTH - 0.5, (1 - v) * HEIGHT - 0.5], axis=-1)


@lru_cache(maxsize=2)
def surface(model: HeadModel) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) float32 template position of every texel; lids and lips closed."""
    points, _ = _samples(model)
    radius = _gathered(model, np.linalg.norm(points - _CENTRE, axis=1))
    radius = zoom(radius, COARSE, order=1, grid_mode=True, mode="nearest")
    low, high = _ELEVATION
    elevation = (high + (low - high) * (0.5 + np.arange(HEIGHT)) / HEIGHT)[:, None]
    azimuth = (((0.5 + np.arange(WIDTH)) / WIDTH - 0.5) * 2 * _AZIMUTH)[None]
    direction = np.stack(
        [
            np.cos(elevation) * np.sin(azimuth),
            -np.cos(elevation) * np.cos(azimuth),
            np.sin(elevation) + 0 * azimuth,
        ],
        axis=-1,
    )
    result = (_CENTRE + radius[..., None] * direction).astype(np.float32)
    result.setflags(write=False)
    return result


@lru_cache(maxsize=2)
def zones(model: HeadModel) -> dict[str, np.ndarray]:
    """`body.regions.fields` over the picture: (HEIGHT / COARSE, WIDTH / COARSE) each."""
    _, table = _samples(model)
    return {name: _gathered(model, table[:, k]) for k, name in enumerate(_ZONES)}


def lift(model: HeadModel, front: np.ndarray) -> np.ndarray:
    """Template positions (N, 3) of points (N, 2) given as seen from in front: x and z."""
    at = (front - _FRONT[0]) / _FRONT_CELL - 0.5
    depth = map_coordinates(_front(model), at.T, order=1, mode="nearest")
    return np.stack([front[:, 0], depth, front[:, 1]], axis=1)


@lru_cache(maxsize=1)
def border() -> np.ndarray:
    """(HEIGHT, WIDTH) float32: 1 inside, fading to 0 towards the ends of the chart."""
    row, column = np.linspace(0, 1, HEIGHT), np.linspace(0, 1, WIDTH)
    fade = [smoothstep(0.005, 0.06, np.minimum(at, 1 - at)) for at in (row, column)]
    return np.outer(*fade).astype(np.float32)


@lru_cache(maxsize=2)
def _samples(model: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) all over the skin that the chart shows, and `_ZONES` there (N, K)."""
    zone = fields(model)
    hidden = zone["mouth_interior"] + zone["eye_socket"] + zone["ears"]
    quads = model.faces["skin"]
    refined = catmull_clark(quads, len(model.template))
    table = np.stack([*model.template.T, hidden, *(zone[name] for name in _ZONES)], axis=1)
    table = (refined.matrix @ table)[refined.faces]
    table = table[(table[..., 3] < 0.3).all(axis=1)]
    table = table[(project(table[..., :3])[..., 1] > 0).all(axis=1)]
    at = (0.5 + np.arange(_PER_QUAD)) / _PER_QUAD
    a, b = (grid.ravel() for grid in np.meshgrid(at, at))
    corners = np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=1)
    everywhere = np.einsum("sk,qkc->qsc", corners, table).reshape(-1, table.shape[-1])
    return everywhere[:, :3], everywhere[:, 4:]


def _gathered(model: HeadModel, values: np.ndarray) -> np.ndarray:
    """Means (HEIGHT / COARSE, WIDTH / COARSE) of what the samples hold, nearest where none is."""
    points, _ = _samples(model)
    columns, rows = ((pixels(points) + 0.5) / COARSE).astype(int).T
    shape = (HEIGHT // COARSE, WIDTH // COARSE)
    cell = np.ravel_multi_index((rows, columns), shape, mode="clip")
    size = shape[0] * shape[1]
    count = np.bincount(cell, minlength=size).reshape(shape)
    total = np.bincount(cell, values, minlength=size).reshape(shape)
    return _filled(total / np.maximum(count, 1), count > 0)


@lru_cache(maxsize=2)
def _front(model: HeadModel) -> np.ndarray:
    """Depth y of the first surface seen from in front, over cells of x and z from `_FRONT`."""
    points, _ = _samples(model)
    low, high = _FRONT
    shape = tuple(np.ceil((high - low) / _FRONT_CELL).astype(int))
    cell = np.floor((points[:, [0, 2]] - low) / _FRONT_CELL).astype(int)
    inside = ((cell >= 0) & (cell < shape)).all(axis=1)
    first = np.full(shape, np.inf)
    np.minimum.at(first, tuple(cell[inside].T), points[inside, 1])
    return gaussian_filter(_filled(first, np.isfinite(first)), 0.7)


def _filled(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    _, nearest = distance_transform_edt(~known, return_indices=True)  # type: ignore[misc]
    return values[tuple(nearest)]
