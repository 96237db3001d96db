"""A picture plane for the face: azimuth and elevation about a point inside the template's head.

Seen from that point, face, underside of the chin and throat do not hide each other. Texels span
about 0.4 mm. Positions are template positions ("rest"), metres; rows of pictures run downwards.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import zoom

from assets_procedural.body.head import HeadModel
from assets_procedural.body.regions import fields
from assets_procedural.mesh.subdivision import catmull_clark
from assets_procedural.mesh.vectors import arctan2, smoothstep

WIDTH, HEIGHT = 1024, 896
_CENTRE = np.array([0.0, 0.0, 0.700])
_AZIMUTH = np.radians(78.0)
_ELEVATION = np.radians([-66.0, 46.0])
_COARSE = 8
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
    refined, shown = _outside(model)
    u, v = project(refined[shown]).T
    radius = np.linalg.norm(refined[shown] - _CENTRE, axis=1)
    rows, columns = HEIGHT // _COARSE + 1, WIDTH // _COARSE + 1
    at_v, at_u = np.meshgrid(np.linspace(1, 0, rows), np.linspace(0, 1, columns), indexing="ij")
    coarse = LinearNDInterpolator(np.stack([u, v], axis=1), radius)(at_u, at_v)
    coarse = np.where(np.isfinite(coarse), coarse, np.median(radius))
    fine = zoom(coarse, _COARSE, order=1, grid_mode=True, mode="nearest")
    row, column = (0.5 + np.arange(HEIGHT)) / HEIGHT, (0.5 + np.arange(WIDTH)) / WIDTH
    # `zoom` resamples the corners' grid; the last interval is only half seen.
    fine = fine[_COARSE // 2 :][:HEIGHT, _COARSE // 2 :][:, :WIDTH]
    low, high = _ELEVATION
    elevation = (high + (low - high) * row)[:, None]
    azimuth = ((column - 0.5) * 2 * _AZIMUTH)[None]
    direction = np.stack(
        [
            np.cos(elevation) * np.sin(azimuth),
            -np.cos(elevation) * np.cos(azimuth),
            np.sin(elevation) + 0 * azimuth,
        ],
        axis=-1,
    )
    result = (_CENTRE + fine[..., None] * direction).astype(np.float32)
    result.setflags(write=False)
    return result


def lift(model: HeadModel, front: np.ndarray) -> np.ndarray:
    """Template positions (N, 3) of points (N, 2) given as seen from in front: x and z."""
    depth = _front(model)(front)
    if not np.isfinite(depth).all():
        raise ValueError("a point lies beside the face")
    return np.stack([front[:, 0], depth, front[:, 1]], axis=1)


@lru_cache(maxsize=2)
def zones(model: HeadModel) -> dict[str, np.ndarray]:
    """`body.regions.fields` over the picture, every fourth texel: (HEIGHT / 4, WIDTH / 4) each."""
    points = surface(model)[::4, ::4]
    at = project(points).reshape(-1, 2)
    refined, shown = _outside(model)
    matrix = catmull_clark(model.faces["skin"], len(model.template)).matrix
    names = ("lips", "nose", "cheeks", "chin", "forehead", "beard", "neck", "under_eye", "eyelids")
    table = np.stack([(matrix @ fields(model)[name])[shown] for name in names], axis=1)
    found = LinearNDInterpolator(project(refined[shown]), table, fill_value=0.0)(at)
    return {n: found[:, k].reshape(points.shape[:2]) for k, n in enumerate(names)}


@lru_cache(maxsize=1)
def border() -> np.ndarray:
    """(HEIGHT, WIDTH) float32: 1 inside, fading to 0 towards the ends of the chart."""
    row, column = np.linspace(0, 1, HEIGHT), np.linspace(0, 1, WIDTH)
    fade = [smoothstep(0.005, 0.06, np.minimum(at, 1 - at)) for at in (row, column)]
    return np.outer(*fade).astype(np.float32)


@lru_cache(maxsize=2)
def _outside(model: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """The refined template (V', 3) and the vertices that the chart shows."""
    matrix = catmull_clark(model.faces["skin"], len(model.template)).matrix
    refined = matrix @ model.template
    zone = fields(model)
    hidden = matrix @ (zone["mouth_interior"] + zone["eye_socket"] + zone["ears"])
    used = np.isin(np.arange(len(model.template)), model.groups["skin"])
    used = (matrix @ used.astype(float)) > 0.99
    return refined, used & (hidden < 0.3) & (project(refined)[:, 1] > 0)


@lru_cache(maxsize=2)
def _front(model: HeadModel) -> LinearNDInterpolator:
    refined, shown = _outside(model)
    points = refined[shown & (refined[:, 1] < -0.02)]
    cell = np.floor(points[:, [0, 2]] / 0.005).astype(int)
    _, where = np.unique(cell, axis=0, return_inverse=True)
    where = where.ravel()
    first = np.full(where.max() + 1, np.inf)
    np.minimum.at(first, where, points[:, 1])
    points = points[points[:, 1] < first[where] + 0.012]
    return LinearNDInterpolator(points[:, [0, 2]], points[:, 1])
