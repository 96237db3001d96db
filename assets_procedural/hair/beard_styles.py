"""The catalogue of beards, which planning knows without what grows them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BeardStyle:
    """Where a beard grows, each region in [0, 1], and how many hairs it has at its densest.

    `length_mm` is the range of its length; `tidy` in [0, 1] is how sharp the razor made its edges.
    """

    count: int
    length_mm: tuple[float, float]
    cheeks: float = 0.0
    chin: float = 0.0
    moustache: float = 0.0
    sideburns: float = 0.0
    tidy: float = 0.3


BEARDS: dict[str, BeardStyle] = {
    "stubble": BeardStyle(36000, (0.5, 2.0), 0.75, 1.0, 1.0, 0.9, tidy=0.0),
    "moustache": BeardStyle(3600, (4.0, 9.0), moustache=1.0),
    "goatee": BeardStyle(8500, (4.0, 14.0), chin=1.0, moustache=1.0),
    "boxed": BeardStyle(21000, (4.0, 8.0), 0.85, 1.0, 1.0, 0.9, tidy=0.8),
    "full": BeardStyle(20000, (9.0, 22.0), 1.0, 1.0, 1.0, 1.0),
    "long": BeardStyle(18000, (35.0, 90.0), 1.0, 1.0, 1.0, 0.8, tidy=0.1),
    "sideburns": BeardStyle(6500, (4.0, 9.0), sideburns=1.0, tidy=0.5),
}
BEARD_STYLES = ("none", *BEARDS)
