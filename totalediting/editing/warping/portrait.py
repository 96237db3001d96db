"""A square photograph of a person, taken apart: bust, matte, person and background."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from totalediting.editing.warping.bust import View, WholeBust, triangles
from totalediting.editing.warping.numbers import blurred, unit
from totalediting.editing.warping.raster import Raster

_CHIN = -0.12  # metres above the eyes
PERSON, BACKGROUND = 0.9, 0.02
"""The matte above and below which colours are one's alone."""
_WIDTHS = (6, 12, 24, 48, 96)  # by which the side is divided, of the blurs that fill in


@dataclass(frozen=True, eq=False)
class Portrait:
    """A square photograph with its fitted bust."""

    picture: np.ndarray
    """(S, S, 3) in [0, 1]."""
    matte: np.ndarray
    """(S, S) in [0, 1], where the person is."""
    bust: WholeBust
    view: View

    @cached_property
    def raster(self) -> Raster:
        """What of the bust is seen."""
        return self.bust.raster(self.view, len(self.picture))

    @cached_property
    def normals(self) -> np.ndarray:
        """(S, S, 3) of the bust, in model space; 0 off it."""
        return unit(self.raster.interpolate(self.bust.normals, triangles()))

    @cached_property
    def person(self) -> np.ndarray:
        """(S, S, 3) colours of the person alone, going on beyond the outline."""
        return filled_in(self.picture, self.matte > PERSON)

    @cached_property
    def background(self) -> np.ndarray:
        """(S, S, 3) without the person; there, what is around, ever softer."""
        return filled_in(self.picture, self.matte < BACKGROUND)

    @cached_property
    def head_height(self) -> float:
        """Pixels from chin to crown."""
        skin = self.bust.vertices[self.bust.skin]
        places, _ = self.view.project(skin[skin[:, 2] > _CHIN], len(self.picture))
        return float(np.ptp(places[:, 1]))


def filled_in(picture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """A picture (H, W, 3) whose pixels that are not `known` (H, W) follow from those around."""
    if known.all() or not known.any():
        return picture
    weight, trust = known[..., None].astype(np.float32), np.ones((*known.shape, 1), np.float32)
    seen, found = weight * picture, np.zeros_like(picture)
    # Coarse answers first, finer ones over them where these have neighbours.
    for parts in _WIDTHS:
        width = max(known.shape) / parts
        share = blurred(weight, width).clip(0, None)
        mean = blurred(seen, width) / share.clip(1e-6)
        found += trust * (mean - found)
        trust = np.clip(share / 0.3, 0, 1)
    return np.where(known[..., None], picture, found)
