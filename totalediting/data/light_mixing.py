"""Light is linear: pictures of one shot under several environments add up to one under all of them.

So the few environments that a shot was rendered under make any number of further ones, with exact
lightmaps: a mixture is an environment with a factor per channel for each. Only what a picture clips
is lost. Factors are of linear light; pictures are display-referred.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from totalediting.data.shots import rgb_name
from totalediting.light.phong import display, undisplay

_MIXED = 0.5  # share of the draws that mix
_TINT, _BRIGHTNESS = 0.12, 0.25  # standard deviations of a mixture's log factors


class Light(NamedTuple):
    """Some of a shot's environments, and the factor (3,) that each counts with."""

    environments: tuple[int, ...]
    factors: tuple[Tensor, ...]

    def members(self) -> tuple[str, ...]:
        """Names of the shot's pictures that it takes."""
        return tuple(rgb_name(environment) for environment in self.environments)

    def picture(self, pictures: Sequence[Tensor]) -> Tensor:
        """The shot in this light, (3, S, S) in [0, 1], from its pictures in `environments`."""
        if self.is_one():
            return pictures[0]
        parts = zip(pictures, self.factors, strict=True)
        light = torch.stack([undisplay(p, 0) * f[:, None, None] for p, f in parts]).sum(0)
        return display(light, 0)

    def lightmaps(self, maps: Sequence[Tensor]) -> Tensor:
        """Its exposed lightmaps (5, 3, h, 2h) from those of `environments`."""
        parts = zip(maps, self.factors, strict=True)
        return torch.stack([m * f[:, None, None] for m, f in parts]).sum(0)

    def is_one(self) -> bool:
        """Whether it is one environment as it was rendered."""
        return len(self.environments) == 1 and bool((self.factors[0] == 1).all())


def draw_light(rng: np.random.Generator, count: int, mix: bool) -> Light:
    """One of a shot's `count` environments; with `mix`, half of the time a mixture of two."""
    first = int(rng.integers(count))
    if not mix or rng.random() >= _MIXED:
        return Light((first,), (torch.ones(3),))
    factor = np.exp(rng.normal(0, _BRIGHTNESS) + rng.normal(0, _TINT, 3))
    share = rng.random() if count > 1 else 1.0
    second = (first + 1 + int(rng.integers(max(count - 1, 1)))) % count
    chosen = (first, second)[: min(count, 2)]
    shares = (share, 1 - share)[: len(chosen)]
    return Light(chosen, tuple(torch.from_numpy(s * factor).float() for s in shares))
