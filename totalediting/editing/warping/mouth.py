"""The inside of a mouth: the photograph's as far as it shows one, drawn beyond."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from totalediting.editing.warping.bust import (
    GROUPS,
    View,
    WholeBust,
    group_of_triangle,
    triangles,
)
from totalediting.editing.warping.distances import distance
from totalediting.editing.warping.numbers import sampled, smooth
from totalediting.editing.warping.portrait import Portrait
from totalediting.editing.warping.raster import Raster

_IN_MOUTH = [GROUPS.index(name) for name in ("teeth_upper", "teeth_lower", "tongue")]
_STRETCHED = (1.6, 2.6)  # times that a mouth opens farther: stretched still; drawn anew
_SHUT = 0.012  # of the head's height, below which the photograph shows no inside of a mouth
# By the white of the photograph's light; the lower teeth lie behind the upper ones.
_UPPER, _LOWER = np.array([1.0, 0.95, 0.86]), np.array([0.88, 0.82, 0.73])
_TONGUE, _CAVITY = np.array([0.62, 0.3, 0.29]), np.array([0.2, 0.07, 0.06])
_LET_IN = 0.03  # of the head's height, from the lips' edge, over which it gets darker
_ROUND = 0.2  # of the light that a tooth loses where it turns away
_BRIGHT = 90  # percentile of the skin's brightness, which teeth have at least


def inside_lips(view: View, bust: WholeBust, raster: Raster) -> np.ndarray:
    """(S, S) where teeth, tongue or the back of the mouth show."""
    group = _groups(raster)
    normals = raster.interpolate(bust.normals, triangles())
    towards = view.frame[:3, 3] - raster.interpolate(bust.vertices, triangles())
    back = (group == 0) & ((normals * towards).sum(-1) < 0)
    lips = binary_dilation(np.isin(group, _IN_MOUTH), iterations=2 + len(group) // 128)
    return np.isin(group, _IN_MOUTH) | (back & lips)


def with_mouth(
    colour: np.ndarray,
    portrait: Portrait,
    bust: WholeBust,
    view: View,
    raster: Raster,
    inside: np.ndarray,
) -> np.ndarray:
    """A picture (S, S, 3) whose mouth is stretched from the photograph's, drawn anew as far as the
    photograph's lips are less open."""
    if not inside.any():
        return colour
    opened = inside_lips(portrait.view, portrait.bust, portrait.raster)
    missing = smooth(_opening(inside) / max(_opening(opened), 1e-6), *_STRETCHED)
    if _opening(opened) < _SHUT * portrait.head_height:
        missing = 1.0
    if not missing:
        return colour
    drawn = _drawn(portrait, bust, view, raster, inside)
    # Teeth move with their jaws as a whole: what the photograph shows of them is theirs still.
    places, _ = portrait.view.project(
        raster.interpolate(portrait.bust.vertices, triangles()), len(colour)
    )
    own = sampled(portrait.person, places)
    clear = binary_erosion(opened, iterations=max(1, len(colour) // 256)).astype(np.float64)
    known = sampled(gaussian_filter(clear, 1.0)[..., None], places)
    upper = _groups(raster) == GROUPS.index("teeth_upper")
    drawn = np.where(upper[..., None], known * own + (1 - known) * drawn, drawn)
    share = missing * gaussian_filter(inside.astype(np.float64), 1.0)[..., None]
    return (1 - share) * colour + share * drawn


def _drawn(
    portrait: Portrait, bust: WholeBust, view: View, raster: Raster, inside: np.ndarray
) -> np.ndarray:
    group = _groups(raster)
    skin = portrait.picture[portrait.raster.covered & (portrait.matte > 0.5)]
    white = 1.0 if not len(skin) else float(np.percentile(skin.mean(-1), _BRIGHT))
    normals = raster.interpolate(bust.normals, triangles())
    towards = view.frame[:3, 2]  # the camera looks the other way
    facing = np.abs(normals @ towards)[..., None]
    depth = distance(~inside) / (_LET_IN * portrait.head_height)
    deep = (1 - 0.25 * smooth(depth, 0.0, 1.0))[..., None]
    rim = (0.75 + 0.25 * smooth(depth, 0.0, 0.15))[..., None]
    drawn = np.broadcast_to(_CAVITY * deep, (*group.shape, 3)).copy()
    for name, tint in (("teeth_upper", _UPPER), ("teeth_lower", _LOWER), ("tongue", _TONGUE)):
        part = (group == GROUPS.index(name))[..., None]
        lit = tint * rim * (1 - _ROUND + _ROUND * facing)
        drawn = np.where(part, lit * (deep if name == "tongue" else 1.0), drawn)
    return np.stack([gaussian_filter(white * drawn[..., k], 0.7) for k in range(3)], -1)


def _groups(raster: Raster) -> np.ndarray:
    """(S, S) number in `GROUPS` of what is seen, -1 for nothing."""
    return np.where(raster.covered, group_of_triangle()[raster.triangle], -1)


def _opening(inside: np.ndarray) -> float:
    """Pixels of height of what is seen inside the lips, where it is widest open."""
    return float(inside.sum(0).max())
