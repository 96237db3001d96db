"""Another pose of a photograph, with nothing learnt: every pixel looked up where it came from.

The bust is rasterised in the new pose. A pixel on it shows a point of a triangle, which lies
somewhere in the photograph, too; where something hid it there, its counterpart on the other side of
the face is taken. Pixels off the bust, hair and background, move with what of the bust is near
(moving least squares), ever less the farther they are. What opens of the mouth is drawn in.

Pictures are squares of side S, as they are shown; places are pixels, x right and y down, the centre
of the upper left one at (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.ndimage import binary_dilation, gaussian_filter
from torch.nn import functional

from totalediting.editing.bust import (
    GROUPS,
    View,
    WholeBust,
    group_of_triangle,
    head_model,
    opposite,
    triangles,
)
from totalediting.editing.distances import distance, nearest
from totalediting.editing.raster import Raster
from totalediting.geometry.field import Control
from totalediting.geometry.moving_least_squares import mls

_CELL = 8  # pixels, of the grid that moves what is off the bust
_CLUSTERS = 256
_WITH_BUST = (0.12, 0.6)  # heights of the head off the bust: moves as the bust; does not move
_SAME_DEPTH = 8e-3  # metres behind what is seen, within which a point counts as seen
_FACING = (0.05, 0.3)  # cosine from which a point is seen, and seen well
_SOFT = 1.5  # pixels at S = 512 over which what is seen gives way to what is not
_TEETH, _FLESH = np.array([1.15, 1.08, 0.98]), np.array([0.75, 0.36, 0.34])  # by skin's mean
_IN_MOUTH = [GROUPS.index(name) for name in ("teeth_upper", "teeth_lower", "tongue")]
_TEETH_GROUPS = _IN_MOUTH[:2]
_RIM = 0.12  # of the picture's side, from its border, in which motion fades
_LET_BE = (0.05, 0.14)  # sides off the new outline from which places stay
_CHIN = -0.12  # metres above the eyes
_STRETCHED = (1.6, 2.6)  # times that a mouth opens farther: stretched still; drawn anew
_SHUT = 0.012  # of the head's height, below which the photograph shows no inside of a mouth
_CAVITY = np.array([0.3, 0.13, 0.11])


@dataclass(frozen=True, eq=False)
class Portrait:
    """A square photograph with its fitted bust."""

    picture: np.ndarray
    """(S, S, 3) in [0, 1]."""
    bust: WholeBust
    view: View
    raster: Raster


class Warped(NamedTuple):
    """A portrait in another pose."""

    picture: np.ndarray
    """(S, S, 3) in [0, 1]."""
    matte: np.ndarray
    """(S, S) where the person is now."""
    raster: Raster
    """Of the new bust."""
    normals: np.ndarray
    """(S, S, 3) of the new bust, in model space; 0 off it."""
    normals_before: np.ndarray
    """(S, S, 3) of the same points in the photograph."""


def portrait_of(picture: np.ndarray, bust: WholeBust, view: View) -> Portrait:
    """A portrait of a square picture (S, S, 3) in [0, 1]."""
    return Portrait(picture, bust, view, bust.raster(view, len(picture)))


def repose(portrait: Portrait, bust: WholeBust, matte: np.ndarray) -> Warped:
    """The portrait with another bust of the same person, before the same camera.

    `matte` (S, S) says where the person is in the photograph.
    """
    side = len(portrait.picture)
    raster = bust.raster(portrait.view, side)
    normals = _unit(raster.interpolate(bust.normals, triangles()))
    before = _unit(raster.interpolate(portrait.bust.normals, triangles()))
    inside = _inside_lips(portrait.view, bust, raster)

    near = _with_near(portrait, bust, raster)
    own, seen = _look_up(portrait, raster, portrait.bust.vertices, before)
    # Hair lies over skull and ears: there, what is near tells more than the surface.
    front = (raster.interpolate(_front()[:, None], triangles())[..., 0] * ~inside)[..., None]
    own = _bridged(front * own + (1 - front) * near, raster.covered & ~inside)
    mirror = opposite()
    mirrored = _unit(raster.interpolate(portrait.bust.normals[mirror], triangles()))
    other, other_seen = _look_up(portrait, raster, portrait.bust.vertices[mirror], mirrored)
    colour, opposed = _sampled(portrait.picture, own), _sampled(portrait.picture, other)
    opposed = _likeness(colour, opposed, seen * other_seen) * opposed
    # Where neither is seen, the own place is the better guess.
    take = gaussian_filter((1 - seen) * other_seen * front[..., 0], _SOFT * side / 512)[..., None]
    colour = (1 - take) * colour + take * opposed
    colour = _with_mouth(colour, raster, inside, portrait)

    around = _beyond_outline(near, raster, portrait)
    beside = _sampled(portrait.picture, around)
    moved = _sampled(np.repeat(matte[..., None], 3, -1), around)[..., 0]
    soft = gaussian_filter(raster.covered.astype(np.float64), 0.7 * side / 512)[..., None]
    soft = np.where(raster.covered[..., None], soft, 0.0)
    picture = soft * colour + (1 - soft) * beside
    return Warped(picture, np.maximum(moved, soft[..., 0]), raster, normals, before)


def _look_up(
    portrait: Portrait, raster: Raster, vertices: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the points of a raster are in the photograph (S, S, 2), and how well seen (S, S)."""
    side = len(portrait.picture)
    points = raster.interpolate(vertices, triangles())
    places, depth = portrait.view.project(points, side)
    column, row = (np.floor(places[..., k]).astype(int).clip(0, side - 1) for k in (0, 1))
    inside = (places > 0).all(-1) & (places < side).all(-1)
    there = portrait.raster.depth[row, column]
    shown = inside & (depth < there + _SAME_DEPTH) & np.isfinite(there)
    towards = _unit(portrait.view.frame[:3, 3] - points)
    facing = _smooth((normals * towards).sum(-1), *_FACING)
    return places, np.where(raster.covered & shown, facing, 0.0)


def _with_near(portrait: Portrait, bust: WholeBust, raster: Raster) -> np.ndarray:
    """(S, S, 2) places in the photograph, of pixels that move with what of the bust is near."""
    side = len(portrait.picture)
    cells = -(-side // _CELL)
    ticks = (np.arange(cells) + 0.5) * _CELL
    centres = np.stack(np.meshgrid(ticks, ticks), -1)
    # The depth of the nearest point of the bust, softened.
    row, column = nearest(raster.covered)
    depth = gaussian_filter(raster.depth[row, column], side / 64)
    index = ticks.astype(int).clip(0, side - 1)
    points = portrait.view.unproject(centres, depth[np.ix_(index, index)], side)

    skin, before = bust.skin, portrait.bust
    arrays = (bust.vertices, before.vertices, bust.normals, before.normals)
    control = Control(*(torch.from_numpy(values[skin]).float() for values in arrays))
    moved = mls(torch.from_numpy(points.reshape(-1, 3)).float(), control, clusters=_CLUSTERS)
    places, _ = portrait.view.project(moved.position.double().numpy(), side)
    shift = torch.from_numpy(places.reshape(cells, cells, 2) - centres).permute(2, 0, 1)[None]
    size = (cells * _CELL, cells * _CELL)
    fine = functional.interpolate(shift, size, mode="bilinear", align_corners=False)
    fine = fine[0].permute(1, 2, 0).numpy()[:side, :side]

    either = raster.covered | portrait.raster.covered
    still = _smooth(distance(either) / _head_height(portrait), *_WITH_BUST)
    # The picture's border stays where it is.
    ticks = np.arange(side) + 0.5
    rim = np.minimum(ticks, side - ticks) / side
    rim = np.minimum(rim[:, None], rim)
    weight = (1 - still) * _smooth(rim, 0.0, _RIM)
    pixels = np.stack(np.meshgrid(ticks, ticks), -1)
    return pixels + weight[..., None] * fine


def _beyond_outline(places: np.ndarray, raster: Raster, portrait: Portrait) -> np.ndarray:
    """Places (S, S, 2), those of what is beside the jaw moved off the jaw of the photograph.

    A turn shows points at its outline that were on the cheek or behind it. What is beside the
    outline now is looked up as far beside the outline then; above, there is hair, which goes along.
    """
    side = len(places)
    now, then = _outside(raster.covered), _outside(portrait.raster.covered)
    slope = np.stack(np.gradient(gaussian_filter(then, _SOFT * side / 256))[::-1], -1)
    below = raster.interpolate(_below_ears()[:, None], triangles())[..., 0]
    row, column = nearest(raster.covered)
    share = gaussian_filter(below[row, column], side / 100) * (1 - _smooth(now / side, *_LET_BE))
    found = places
    for _ in range(3):
        row, column = (found[..., k].astype(int).clip(0, side - 1) for k in (1, 0))
        short = np.where(now > 0, share * (now - then[row, column]), 0.0).clip(0, None)
        found = found + short[..., None] * _unit(slope[row, column])
    return found


@lru_cache(maxsize=1)
def _below_ears() -> np.ndarray:
    """(V,) 1 at jaw and neck, 0 above the ears' lobes and on the shoulders."""
    model = head_model()
    height = (model.template - model.template[model.groups["eye_left"]].mean(0))[:, 2]
    return _smooth(-height, 0.03, 0.06) * (1 - _smooth(-height, 0.16, 0.2))


def _outside(covered: np.ndarray) -> np.ndarray:
    """(S, S) pixels off what is covered; within it, below 0."""
    return distance(covered) - distance(~covered)


def _head_height(portrait: Portrait) -> float:
    """Pixels from chin to crown."""
    skin = portrait.bust.vertices[portrait.bust.skin]
    above = skin[skin[:, 2] > _CHIN]
    places, _ = portrait.view.project(above, len(portrait.picture))
    return float(np.ptp(places[:, 1]))


@lru_cache(maxsize=1)
def _front() -> np.ndarray:
    """(V,) 1 in the face, 0 on skull and ears, 1 below the chin."""
    model = head_model()
    place = model.template - model.template[model.groups["eye_left"]].mean(0)
    depth = -place[:, 1]  # forward of the eyes
    return np.maximum(_smooth(depth, -0.055, -0.03), _smooth(-place[:, 2], 0.11, 0.14))


def _inside_lips(view: View, bust: WholeBust, raster: Raster) -> np.ndarray:
    """(S, S) where teeth, tongue or the back of the mouth show."""
    group = np.where(raster.covered, group_of_triangle()[raster.triangle], -1)
    normals = raster.interpolate(bust.normals, triangles())
    towards = view.frame[:3, 3] - raster.interpolate(bust.vertices, triangles())
    back = (group == 0) & ((normals * towards).sum(-1) < 0)
    lips = binary_dilation(np.isin(group, _IN_MOUTH), iterations=2 + len(group) // 128)
    return np.isin(group, _IN_MOUTH) | (back & lips)


def _bridged(places: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Places (S, S, 2) in which those that are not `known` (S, S) follow from those around."""
    if known.all():
        return places
    side = len(places)
    ticks = np.arange(side) + 0.5
    pixels = np.stack(np.meshgrid(ticks, ticks), -1)
    shift = np.where(known[..., None], places - pixels, 0.0)
    weight = known.astype(np.float64)
    found, trust = np.zeros_like(shift), np.ones(known.shape)
    # Coarse answers first, finer ones over them where these have neighbours.
    for width in (side / 24, side / 48, side / 96, side / 192):
        share = gaussian_filter(weight, width)
        mean = np.stack([gaussian_filter(shift[..., k], width) for k in (0, 1)], -1)
        mean /= share.clip(1e-9)[..., None]
        found += trust[..., None] * (mean - found)
        trust = _smooth(share, 0.05, 0.4)
    found = np.where(known[..., None], shift, found)
    return pixels + found


def _with_mouth(
    colour: np.ndarray, raster: Raster, inside: np.ndarray, portrait: Portrait
) -> np.ndarray:
    """What is inside the lips, as far as the photograph's lips are less open."""
    if not inside.any():
        return colour
    opened = _inside_lips(portrait.view, portrait.bust, portrait.raster)
    missing = _smooth(_opening(inside) / max(_opening(opened), 1e-6), *_STRETCHED)
    if _opening(opened) < _SHUT * _head_height(portrait):
        missing = 1.0
    group = np.where(raster.covered, group_of_triangle()[raster.triangle], -1)
    light = np.median(portrait.picture[portrait.raster.covered], axis=0).mean()
    depth = gaussian_filter(distance(~inside), 1.0)
    let_in = (depth / max(float(depth.max()), 1e-6)).clip(0.35, 1)[..., None]
    teeth = np.isin(group, _TEETH_GROUPS)[..., None]
    tongue = (group == GROUPS.index("tongue"))[..., None]
    drawn = light * let_in * np.where(teeth, _TEETH, np.where(tongue, _FLESH, _CAVITY))
    drawn = np.stack([gaussian_filter(drawn[..., k], 0.8) for k in range(3)], -1)
    share = missing * gaussian_filter(inside.astype(np.float64), 1.0)[..., None]
    return (1 - share) * colour + share * drawn


def _opening(inside: np.ndarray) -> float:
    """Pixels of height of what is seen inside the lips, where it is widest open."""
    return float(inside.sum(0).max())


def _likeness(colour: np.ndarray, other: np.ndarray, both: np.ndarray) -> np.ndarray:
    """(3,) by what the other side is to be multiplied to look like this one where both are seen."""
    weight = (both > 0.5)[..., None]
    if not weight.any():
        return np.ones(3)
    return ((colour * weight).sum((0, 1)) / (other * weight).sum((0, 1)).clip(1e-6)).clip(0.5, 2)


def _sampled(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(S, S, 3) of a picture at places (S, S, 2), bicubic; its border goes on."""
    grid = torch.from_numpy(2 * places / len(picture) - 1)[None].float()
    pixels = torch.from_numpy(picture).permute(2, 0, 1)[None].float()
    found = functional.grid_sample(
        pixels, grid, mode="bicubic", padding_mode="border", align_corners=False
    )
    return found[0].permute(1, 2, 0).double().numpy().clip(0, 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _smooth(values: Any, low: float, high: float) -> Any:
    """0 below `low`, 1 above `high`, smoothly between."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)
