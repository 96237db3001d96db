"""The unlearnt warp: what geometry and light alone make of a source, with all truth given.

Points of the target's depth are taken by moving least squares straight from the target's control
points to the source's, looked up in the source where it shows them, and relit by the ratio image
s_d(new) / s_d(old) in linear light. What the source hides is taken from the other side of the face,
where that is seen, else it has the mean colour. What is left to a model is what this cannot know:
hidden parts, shadows and gloss, hair off the bust, the inner mouth.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from totalediting import metrics
from totalediting.data.endless import collate
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.geometry.field import Control, Field
from totalediting.geometry.mirroring import MIRROR
from totalediting.geometry.moving_least_squares import CLUSTERS, mls
from totalediting.geometry.projection import look_up, project, unproject
from totalediting.light.lightmaps import sample
from totalediting.light.phong import display, undisplay
from totalediting.presets import Preset

ALPHA = 2.0
AGREES = 0.006
"""Metres between a moved point and the depth that the source shows there: more is hidden."""
_ALONE = 0.98  # coverage from which on a pixel is the subject's alone
_DARK = 0.02  # of shadings: what is in the dark says little
_GAIN = 4.0  # most that light is changed by


class Warped(NamedTuple):
    """A source in the target's pose and light."""

    image: Tensor
    """(B, 3, S, S) display-referred, over black."""
    seen: Tensor
    """(B, 1, S, S) bool: the subject's alone, and the source shows that point itself."""


@torch.no_grad()
def warp(pair: PortraitPair) -> Warped:
    """The warp of a batch of pairs."""
    batch, side = len(pair.alpha), pair.alpha.shape[-1]
    image = torch.zeros_like(pair.mot_image)
    seen = torch.zeros_like(pair.alpha, dtype=torch.bool)
    for k in range(batch):
        hit = (pair.depth[k, 0] > 0).flatten()
        colour, own = _colours(pair, k, hit)
        mean = colour[own].mean(0) if bool(own.any()) else colour.new_full((3,), 0.2)
        picture = mean.expand(side * side, 3).clone()
        picture[hit] = torch.where(colour[:, :1] >= 0, colour, mean)
        over_black = picture.mT.unflatten(-1, (side, side)) * pair.alpha[k]
        image[k] = display(over_black, 0)
        seen[k, 0].view(-1)[hit] = own
    return Warped(image, seen & (pair.alpha > _ALONE))


def evaluate(data: Path, preset: Preset, split: str) -> dict[str, float]:
    """Figures of the warp on every shot of a split as target; beside them, of the source itself.

    Raises:
        InputError: no such dataset or split.
    """
    pairs = PortraitPairs(data, preset, split)
    found: dict[str, list[Tensor]] = {}
    for number in range(len(pairs)):
        pair = collate([pairs[number]])
        made = warp(pair)
        seen = made.seen.to(pair.alpha)
        source = pair.app.image
        values = {
            "seen_psnr": metrics.psnr_within(made.image, pair.foreground, seen),
            "seen_share": seen.sum((1, 2, 3)) / pair.alpha.sum((1, 2, 3)),
            **metrics.picture_figures(made.image, pair.foreground, pair.alpha),
            **metrics.source_figures(source, pair.foreground, pair.alpha),
            "source_seen_psnr": metrics.psnr_within(source, pair.foreground, seen),
        }
        for name, value in values.items():
            found.setdefault(name, []).append(value)
    means = {name: torch.cat(values) for name, values in found.items()}
    return {name: float(v[v.isfinite()].mean()) for name, v in means.items()}


def _colours(pair: PortraitPair, k: int, hit: Tensor) -> tuple[Tensor, Tensor]:
    """Linear colour (P, 3) of the target's points, -1 where unknown; which are seen (P,)."""
    app, control = pair.app, Control(*(a[k] for a in pair.control))
    depth, camera, lens = pair.depth[k : k + 1], pair.camera_to_world, pair.intrinsics
    points = unproject(depth, camera[k : k + 1], lens[k : k + 1]).flatten(1, 2)[0, hit]
    normal = pair.normal[k].flatten(1).mT[hit]
    lit = sample(pair.lightmaps[k : k + 1, 0], normal[None])[0]
    source = Control(*(a[k] for a in app.control))
    posed = (source.posed, source.posed_normals)

    straight = Control(control.posed, posed[0], control.posed_normals, posed[1])
    colour, own = _source_colours(pair, k, _moved(points, normal, straight), lit)
    if bool(own.all()):
        return colour, own
    rest = ~own
    place, turned = _moved(points[rest], normal[rest], control)
    mirror = MIRROR.to(place)
    there = Control(control.canonical, posed[0], control.canonical_normals, posed[1])
    found = _moved(place * mirror, turned * mirror, there)
    other, known = _source_colours(pair, k, found, lit[rest])
    colour[rest] = torch.where(known[:, None], other, -1.0)
    return colour, own


def _moved(points: Tensor, normal: Tensor, control: Control) -> tuple[Tensor, Tensor]:
    """Points and their normals (P, 3) from a control's posed to its canonical space."""
    field: Field = mls(points, control, ALPHA, clusters=CLUSTERS)
    return field.position, (field.rotation @ normal[..., None])[..., 0]


def _source_colours(
    pair: PortraitPair, k: int, at: tuple[Tensor, Tensor], lit: Tensor
) -> tuple[Tensor, Tensor]:
    """Relit colours (P, 3), linear, that the source shows of its points; which it shows (P,)."""
    app, one = pair.app, slice(k, k + 1)
    points, normal = (a[None] for a in at)
    side = app.image.shape[-1]
    places, depth = project(points, app.camera_to_world[one], app.intrinsics[one], side)
    shown = look_up(pair.app_depth[one], places, "nearest")[..., 0]
    matte = look_up(app.alpha[one], places)[..., 0]
    inside = (places.abs() < 1).all(-1)
    own = inside & (matte > _ALONE) & ((shown - depth).abs() < AGREES)
    old = sample(app.lightmaps[one, 0], normal)[0]
    ratio = ((lit + _DARK) / (old + _DARK)).clamp(1 / _GAIN, _GAIN)
    return undisplay(look_up(app.image[one], places)[0]) * ratio, own[0]
