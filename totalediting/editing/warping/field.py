"""How all of a picture moves with the bust: one smooth field, also where the bust tells nothing.

What of the bust is well seen in the photograph says where its pixels came from; what is off it,
hair and clothes, moves with the part of the bust that is near (moving least squares), ever less the
farther it is. Where the bust was seen at a grazing angle or not at all, nothing is known, and the
field bends as little as it can: so the stretch is spread over the hair around.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from scipy import sparse
from scipy.ndimage import gaussian_filter
from scipy.sparse.linalg import splu
from torch.nn import functional

from totalediting.editing.warping.bust import View, WholeBust, head_model
from totalediting.editing.warping.distances import distance, nearest
from totalediting.editing.warping.numbers import pixels, smooth
from totalediting.editing.warping.portrait import Portrait
from totalediting.editing.warping.raster import Raster
from totalediting.geometry.field import Control
from totalediting.geometry.moving_least_squares import mls

_CELLS = 64  # of the field, along a side
_CLUSTERS = 256
_WITH_BUST = (0.12, 0.6)  # heights of the head off the bust: moves as the bust; does not move
_WITH_HEAD = (-0.06, 0.03)  # metres above the eyes: what is beside moves with the trunk; the head
_RIM = 0.12  # of the picture's side, from its border, in which motion fades
_UNKNOWN, _BESIDE = 1e-3, 0.03  # weights of what is not seen, and of what is off the bust
_TENSE = 0.02  # of the field's slope beside its bend: keeps it from overshooting


def moved_along(
    portrait: Portrait,
    bust: WholeBust,
    view: View,
    raster: Raster,
    own: np.ndarray,
    seen: np.ndarray,
) -> np.ndarray:
    """(S, S, 2) places in the photograph, of all pixels of a new pose.

    `own` (S, S, 2) are those of what the raster shows, `seen` (S, S) from 0 to 1 how well.
    """
    side = len(portrait.picture)
    ticks = (np.arange(_CELLS) + 0.5) * side / _CELLS
    centres = np.stack(np.meshgrid(ticks, ticks), -1)
    at = np.ix_(ticks.astype(int), ticks.astype(int))
    on = raster.covered[at]

    shift = _beside(portrait, bust, view, raster, centres, at)
    shift[on] = (own - pixels(side))[at][on]
    weight = np.where(on, _UNKNOWN + seen[at], _BESIDE)
    field = _bent_least(shift, weight)

    planes = torch.from_numpy(field).permute(2, 0, 1)[None]
    fine = functional.interpolate(planes, (side, side), mode="bicubic", align_corners=False)
    # The picture's border stays where it is.
    ticks = np.arange(side) + 0.5
    rim = np.minimum(ticks, side - ticks) / side
    rim = smooth(np.minimum(rim[:, None], rim), 0.0, _RIM)[..., None]
    return pixels(side) + rim * fine[0].permute(1, 2, 0).numpy()


def _beside(
    portrait: Portrait,
    bust: WholeBust,
    view: View,
    raster: Raster,
    centres: np.ndarray,
    at: Any,
) -> np.ndarray:
    """Shifts (N, N, 2) of places `centres`, as what is off the bust moves."""
    side = len(portrait.picture)
    # The depth of the nearest point of the bust, softened.
    row, column = nearest(raster.covered)
    depth = gaussian_filter(raster.depth[row, column], side / 64)
    points = view.unproject(centres, depth[at], side)

    skin, before = bust.skin, portrait.bust
    arrays = (bust.vertices, before.vertices, bust.normals, before.normals)
    control = Control(*(torch.from_numpy(values[skin]).float() for values in arrays))
    moved = mls(torch.from_numpy(points.reshape(-1, 3)).float(), control, clusters=_CLUSTERS)
    eyes = bust.vertices[head_model().groups["eye_left"], 2].mean()
    with_head = smooth(points[..., 2:] - eyes, *_WITH_HEAD)
    moved = moved.position.double().numpy().reshape(points.shape)
    places, _ = portrait.view.project(with_head * moved + (1 - with_head) * points, side)

    either = raster.covered | portrait.raster.covered
    share = 1 - smooth(distance(either)[at] / portrait.head_height, *_WITH_BUST)
    return (places - centres) * share[..., None]


def _bent_least(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The field (N, N, C) that is near `values` by their `weight` (N, N) and bends least."""
    stiff = _stiffness(len(values))
    solve = splu((stiff + sparse.diags(weight.ravel())).tocsc()).solve
    flat = values.reshape(-1, values.shape[-1])
    return solve(weight.reshape(-1, 1) * flat).reshape(values.shape)


@lru_cache(maxsize=1)
def _stiffness(count: int) -> Any:
    """(N², N²) of a thin plate and a weak membrane, free at their borders."""
    diagonals: Any = sparse.diags  # of offsets, too
    step = diagonals([-1.0, 1.0], [0, 1], shape=(count - 1, count))
    one = sparse.identity(count)
    across, down = sparse.kron(one, step), sparse.kron(step, one)
    bend = diagonals([1.0, -2.0, 1.0], [0, 1, 2], shape=(count - 2, count))
    terms = [sparse.kron(one, bend), sparse.kron(bend, one), np.sqrt(2) * sparse.kron(step, step)]
    terms += [np.sqrt(_TENSE) * across, np.sqrt(_TENSE) * down]
    return sum(term.T @ term for term in terms)
