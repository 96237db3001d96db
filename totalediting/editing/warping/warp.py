"""Another pose of a photograph, with nothing learnt: every pixel looked up where it came from.

The bust is rasterised in the new pose. A pixel on it shows a point of a triangle, which lies
somewhere in the photograph, too; where something hid it there, its counterpart on the other side of
the face is taken. All else moves with a smooth field (`field`), and what opens of the mouth is
drawn in (`mouth`).

Pictures are squares of side S, as they are shown; places are pixels, x right and y down, the centre
of the upper left one at (0.5, 0.5).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from totalediting.editing.warping.bust import View, WholeBust, head_model, opposite, triangles
from totalediting.editing.warping.distances import nearest
from totalediting.editing.warping.field import moved_along
from totalediting.editing.warping.mouth import inside_lips, with_mouth
from totalediting.editing.warping.numbers import sampled, smooth, unit
from totalediting.editing.warping.portrait import Portrait
from totalediting.editing.warping.raster import Raster

_SAME_DEPTH = 8e-3  # metres behind what is seen, within which a point counts as seen
_FACING = (0.1, 0.45)  # cosine from which a point is seen, and seen well
_SOFT = 2.0  # pixels at S = 512 over which what is seen gives way to what is not
_EDGE = 0.7  # pixels at S = 512, deviation of the outline's blur
_OF_PERSON = (0.3, 0.7)  # of the matte: a place shows the background; the person


class Warped(NamedTuple):
    """A portrait in another pose."""

    person: np.ndarray
    """(S, S, 3) in [0, 1], its colours going on beyond the outline."""
    matte: np.ndarray
    """(S, S) where the person is now."""
    raster: Raster
    """Of the new bust."""
    normals: np.ndarray
    """(S, S, 3) of the new bust, in model space; 0 off it."""
    normals_before: np.ndarray
    """(S, S, 3) of the same points in the photograph."""
    skin: np.ndarray
    """(S, S) from 0 to 1, where the bust's own surface shows: not under hair or in the mouth."""


def unmoved(portrait: Portrait) -> Warped:
    """The portrait in its own pose."""
    normals = portrait.normals
    inside = inside_lips(portrait.view, portrait.bust, portrait.raster)
    front = portrait.raster.interpolate(_regions(), triangles())[..., 1]
    skin = front * ~inside
    return Warped(portrait.person, portrait.matte, portrait.raster, normals, normals, skin)


def repose(portrait: Portrait, bust: WholeBust, view: View | None = None) -> Warped:
    """The portrait with another bust of the same person, before another camera or the same."""
    view = view or portrait.view
    side = len(portrait.picture)
    soft = _SOFT * side / 512
    raster = bust.raster(view, side)
    normals = unit(raster.interpolate(bust.normals, triangles()))
    before = unit(raster.interpolate(portrait.bust.normals, triangles()))
    inside = inside_lips(view, bust, raster)
    face, front = (raster.interpolate(_regions(), triangles())[..., k] for k in (0, 1))

    own, seen = _look_up(portrait, raster, portrait.bust.vertices, before)
    # Hair lies over skull and ears: there, what is near tells more than the surface.
    seen = seen * ~inside
    near = moved_along(portrait, bust, view, raster, own, seen * front)
    share = np.minimum(gaussian_filter(seen * front, soft), front)[..., None]
    places = share * own + (1 - share) * near
    colour = sampled(portrait.person, places)

    mirror = opposite()
    mirrored = unit(raster.interpolate(portrait.bust.normals[mirror], triangles()))
    other, other_seen = _look_up(portrait, raster, portrait.bust.vertices[mirror], mirrored)
    opposed = sampled(portrait.person, other)
    opposed = _likeness(colour, opposed, seen * other_seen) * opposed
    # Where neither is seen, the own place is the better guess.
    take = gaussian_filter((1 - seen) * other_seen * face * ~inside, soft)[..., None]
    colour = (1 - take) * colour + take * opposed
    colour = with_mouth(colour, portrait, bust, view, raster, inside)
    matte = np.maximum(sampled(portrait.matte[..., None], places)[..., 0], face)

    beside = sampled(portrait.person, near)
    matte_beside = sampled(portrait.matte[..., None], near)[..., 0]
    # Over the outline the bust's colours go on, so that its edge is no staircase.
    row, column = nearest(raster.covered)
    on = gaussian_filter(raster.covered.astype(np.float64), _EDGE * side / 512)
    inner, outer = on * matte[row, column], (1 - on) * matte_beside
    whole = (inner + outer).clip(0, 1)
    share = np.where(whole > 1e-3, inner / whole.clip(1e-3), on)[..., None]
    person = share * colour[row, column] + (1 - share) * beside
    return Warped(person, whole, raster, normals, before, front * ~inside)


def _look_up(
    portrait: Portrait, raster: Raster, vertices: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the points of a raster are in the photograph (S, S, 2), and how well seen (S, S)."""
    side = len(portrait.picture)
    points = raster.interpolate(vertices, triangles())
    places, depth = portrait.view.project(points, side)
    column, row = (np.floor(places[..., k]).astype(int).clip(0, side - 1) for k in (0, 1))
    within = (places > 0).all(-1) & (places < side).all(-1)
    there = portrait.raster.depth[row, column]
    shown = within & (depth < there + _SAME_DEPTH) & np.isfinite(there)
    towards = unit(portrait.view.frame[:3, 3] - points)
    facing = smooth((normals * towards).sum(-1), *_FACING)
    person = smooth(portrait.matte[row, column], *_OF_PERSON)
    return places, np.where(raster.covered & shown, facing * person, 0.0)


@lru_cache(maxsize=1)
def _regions() -> np.ndarray:
    """(V, 2): 1 in the face; 1 there and below the chin. 0 on skull and ears."""
    model = head_model()
    place = model.template - model.template[model.groups["eye_left"]].mean(0)
    forward, below = smooth(-place[:, 1], -0.055, -0.03), smooth(-place[:, 2], 0.11, 0.14)
    return np.stack([forward * (1 - below), np.maximum(forward, below)], -1)


def _likeness(colour: np.ndarray, other: np.ndarray, both: np.ndarray) -> np.ndarray:
    """(3,) by what the other side is to be multiplied to look like this one where both are seen."""
    weight = (both > 0.5)[..., None]
    if not weight.any():
        return np.ones(3)
    return ((colour * weight).sum((0, 1)) / (other * weight).sum((0, 1)).clip(1e-6)).clip(0.5, 2)
