"""What the source shows of points of canonical space: they are projected into its picture.

A canonical point is moved to where the bust is in the source (a second field, the way back) and
looked up where the source's camera sees it: pixel-aligned features (Saito et al. 2019; Wang et al.
2021), as fine as the picture is. What stands before it there hides it: the bust's own depth tells.
Its mirror image is the second candidate, for what the source hides.

The light of the source is divided out once, for all of its pixels: the colour over the diffuse
shading s_d of the bust's normals is about the albedo. Both are shown, with what tells how much to
trust them, and what of the light was baked in can be told from the difference.

Hair and clothes are where the source is covered beside the bust: a little before and behind its
silhouette, as space carving leaves them.

B batch, P points, S side of the picture, A features. Places as of `projection`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry import bust_view
from totalediting.geometry.field import Table
from totalediting.geometry.mirroring import MIRROR
from totalediting.geometry.projection import look_up, project
from totalediting.geometry.relief import relief_of
from totalediting.geometry.source import Source
from totalediting.geometry.space import off_planes
from totalediting.light.lightmaps import sample
from totalediting.light.phong import display, undisplay

SIGHT = 11
"""Channels of one candidate: colour and unlit colour (display-referred), coverage, whether hair or
clothes off the bust must be about there, how squarely the camera sees it, how well it is seen in
all, and how far it lies behind the nearest skin, or behind the silhouette beside it."""
COVERAGE = 6
"""The one of coverage."""
OFF = 7
"""The one of hair and clothes."""
PIXEL = 8
"""Channels of `Sheet.seen`."""
_GRID = 64, 128  # sides of the bust's view, for pictures up to twice the first, and beyond
_DARK = 0.03  # of shadings: what is in the dark says little of an albedo
_SLACK, _SOFT = 0.008, 0.003  # metres behind the nearest skin from which on a point is hidden
_SQUARE = 0.4  # cosine from which on skin is seen well
_BEHIND = 0.02  # metres: unit of the last channel
_THICK = 0.02  # metres before and behind the bust's silhouette: deviation of hair off it
_BARE = 0.05  # metres behind that skin beside the bust: nothing of the bust is there


class Sheet(NamedTuple):
    """The source as it is looked up."""

    pixels: Tensor
    """(B, 10, S, S) colour and unlit colour, premultiplied by the coverage that follows; how
    squarely skin is seen; its depth in metres, and the same with that of the silhouette beside
    it."""
    warp: Table
    """The way from canonical space to the bust in the source."""
    camera_to_world: Tensor
    """(B, 4, 4)"""
    intrinsics: Tensor
    """(B, 3, 3) for side S."""
    relief: Tensor
    """(B, 8, n, n) of the bust to show, at rest, see `relief`."""

    @property
    def seen(self) -> Tensor:
        """(B, `PIXEL`, S, S) in [-1, 1], what an encoder sees of the source, pixel by pixel."""
        return 2 * self.pixels[:, :PIXEL] - 1


class Shown(NamedTuple):
    """A sheet, and features that an encoder made of it, pixel by pixel."""

    sheet: Sheet
    aligned: Tensor
    """(B, A, h, h) of any side."""

    def __call__(self, points: Tensor) -> Tensor:
        """(B, P, 2 (SIGHT + A)): what the source shows of canonical points (B, P, 3), then of their
        mirror images. Gradients flow to the features alone."""
        sight, places = _sights(self.sheet, points)
        features = look_up(self.aligned, places)
        both = torch.cat([sight, features], -1)
        return torch.cat(both.chunk(2, 1), -1)


@torch.no_grad()
def sheet_of(source: Source, warp: Table) -> Sheet:
    """The sheet of a batch of sources. `warp` takes canonical space to theirs."""
    side = source.image.shape[-1]
    grid = _GRID[0] if side <= 2 * _GRID[0] else _GRID[1]
    control, camera = source.control, (source.camera_to_world, source.intrinsics)
    view = bust_view.view(control.posed, control.posed_normals, *camera, side, grid)
    normal = view.normal.flatten(2).mT @ source.to_light.mT
    shade = sample(source.lightmaps[:, 0], normal).mT.view_as(view.normal)
    shade, facing, depth, beside = (
        functional.interpolate(a, (side, side), mode="bilinear")
        for a in (shade, view.facing, view.depth, bust_view.widened(view.depth))
    )
    light = undisplay(source.image, 1)
    unlit = display(((light + 0.2 * _DARK) / (shade + _DARK)).clamp(0, 1), 1)
    covered = source.alpha * torch.cat([source.image, unlit, torch.ones_like(depth)], 1)
    pixels = torch.cat([covered, facing, depth, beside], 1)
    relief = relief_of(control.canonical, control.canonical_normals)
    return Sheet(pixels, warp, *camera, relief)


def on_front(sheet: Sheet, side: int) -> Tensor:
    """Canonical points (B, side^2, 3), row by row, of the front of the bust at rest: one for each
    texel of the planes' XZ plane, columns along +X, rows along +Z."""
    middle = (2 * torch.arange(side, device=sheet.relief.device) + 1) / side - 1
    front = functional.interpolate(sheet.relief[:, :1], (side, side), mode="bilinear")[:, 0]
    # Beside the skin the relief is 1; the middle of the head is nearer to what may be there.
    front = torch.where(front > 0.9, 0.0, front)
    rows, columns = torch.meshgrid(middle, middle, indexing="ij")
    places = torch.stack([columns.expand_as(front), front, rows.expand_as(front)], -1)
    return off_planes(places).flatten(1, 2)


def looked_up(sheet: Sheet, picture: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Sights (B, P, 2 SIGHT) of canonical points, and what `picture` (B, C, h, h) of the source
    shows there, (B, P, C): of both candidates, by how well each is seen."""
    sight, places = _sights(sheet, points)
    own, mirrored = look_up(picture, places).chunk(2, 1)
    sight = torch.cat(sight.chunk(2, 1), -1)
    weights = [w[..., None] for w in _weights(sight)]
    return sight, weights[0] * own + weights[1] * mirrored


def colour_of(shown: Tensor, unlit: bool) -> Tensor:
    """(..., 3) display-referred colour in [0, 1] of what `Shown` gives (..., 2 (SIGHT + A)): lit or
    unlit, the point's own where that is seen well, else its mirror image's."""
    half = shown.shape[-1] // 2
    start = 3 if unlit else 0
    one, other = ((shown[..., k : k + 3] + 1) / 2 for k in (start, half + start))
    sights = torch.cat([shown[..., :SIGHT], shown[..., half : half + SIGHT]], -1)
    weights = _weights(sights)
    return weights[0][..., None] * one + weights[1][..., None] * other


def _weights(sights: Tensor) -> tuple[Tensor, Tensor]:
    """Weights of a point's own look and of its mirror image's, which add up to 1."""
    own, mirrored = ((sights[..., k] + 1) / 2 for k in (SIGHT - 2, 2 * SIGHT - 2))
    fallback = (1 - own) * mirrored
    total = own + fallback + 2e-3
    return (own + 1e-3) / total, (fallback + 1e-3) / total


@torch.no_grad()
def _sights(sheet: Sheet, points: Tensor) -> tuple[Tensor, Tensor]:
    """(B, 2 P, SIGHT) of points and of their mirror images, in [-1, 1]; where they appear."""
    both = torch.cat([points, points * MIRROR.to(points)], 1)
    side = sheet.pixels.shape[-1]
    camera = sheet.camera_to_world, sheet.intrinsics
    places, depth = project(sheet.warp.positions(both), *camera, side)
    found = look_up(sheet.pixels, places)
    colours, alpha, facing, nearest, beside = found.split([6, 1, 1, 1, 1], -1)
    behind = depth[..., None] - nearest
    inside = (places.abs() < 1).all(-1, keepdim=True)
    visible = torch.sigmoid((_SLACK - behind) / _SOFT)
    off = alpha * inside * ((nearest - beside) / _BARE).clamp(0, 1)
    off = off * (-0.5 * ((depth[..., None] - beside) / _THICK).square()).exp()
    hidden = torch.where(inside, 1 - visible, 1.0) * alpha
    off = torch.maximum(off, hidden * torch.cat(off.chunk(2, 1)[::-1], 1))
    sight = alpha * visible * inside * (facing / _SQUARE).clamp_max(1)
    colours = (colours / alpha.clamp_min(0.05)).clamp(0, 1)
    known = 2 * torch.cat([colours, alpha, off, facing, sight], -1) - 1
    return torch.cat([known, ((depth[..., None] - beside) / _BEHIND).tanh()], -1), places
