"""The catalogue of hair styles: who wears each, its dimensions, and how it is combed.

Regions live in template space (see `roots`), lengths in metres. A new style is one entry of
`STYLES`: jobs accept its name, people are drawn who wear it, and `scalp_hair` grows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from assets_procedural.hair.combing import (
    Combing,
    combed_across,
    combed_back,
    combed_forward,
    combed_from_parting,
    combed_from_whorl,
    combed_in_rows,
    combed_loosely,
    combed_under,
    upright,
)
from assets_procedural.hair.popularity import Popularity, over_years, rising_with_baldness


@dataclass(frozen=True)
class Style:
    """One hair style. Lengths in metres; shares and strengths in [0, 1].

    `popularity` weighs the style in sampling; `under_hat` says that a hat fits over it. `count` is
    the number of strands of the densest hair seen closely, 0 on a bald head.

    `length` is the range that `Hair.length` spans on the top, `sides` the share of it on the sides
    and at the nape; `fade` lets it run out to stubble between two heights of template space; `cut`
    trims everything at a height, from and to; `fringe` trims what falls over the forehead.
    `receding` and `thinning` are the least hairline recession and bare crown, as of `Hair`.

    `parted` hair falls to both sides of a parting, `aside` is its least distance from the middle.
    `lift` turns the root off the skin, `reach` is how far combing holds against gravity, `volume`
    the height of the outermost layer and `layers` the share of it of the innermost, `rise` is
    added over the forehead. `tousle` bends the combing by a random field. `wave` is (amplitude,
    length of a turn), widened by `Hair.curl`. `lock` is (strands, strength), `wisps` are (number,
    strength, height off the head), every wisp with a length and a tone of its own.

    `ties` are where tied hair leaves the skull, `tied_above` the height above which hair is tied,
    `tail` what it becomes: "ponytail", "braid", "bun" or "puff". `rope` > 0 is the radius of the
    `ropes` that hair is worked into, each a "loc", "twist" or "braid" by `plait`. `rows` are
    cornrows over the head.
    """

    popularity: Popularity
    combing: Combing
    length: tuple[float, float]
    sides: float = 1.0
    fade: tuple[float, float] | None = None
    cut: tuple[float, float] | None = None
    fringe: float | None = None
    receding: float = 0.0
    thinning: float = 0.0
    count: int = 20000
    points: int = 10
    radius: float = 7e-5
    lift: float = 0.3
    reach: float = 0.05
    stiffness: float = 0.6
    gravity: float = 0.5
    volume: float = 0.012
    layers: float = 0.15
    rise: float = 0.0
    tousle: float = 0.0
    wave: tuple[float, float] = (0.0, 0.05)
    flat: float = 0.3
    lock: tuple[float, float] = (18.0, 0.85)
    wisps: tuple[int, float, float] = (130, 0.85, 0.005)
    stray: float = 0.004
    flyaway: float = 0.06
    parted: bool = False
    aside: float = 0.0
    ties: tuple[tuple[float, float, float], ...] = ()
    tied_above: float = 0.0
    tail: str = ""
    rope: float = 0.0
    ropes: int = 260
    plait: str = "loc"
    rows: int = 0
    roughness: float = 0.20
    under_hat: bool = False


_RARER_WITH_AGE = over_years((45, 1.0), (75, 0.3))
_FAVOURED_WITH_AGE = over_years((45, 1.0), (75, 2.0))
_YOUNG = over_years((28, 1.0), (55, 0.15))
_SKIN_FADE, _LOW_FADE = (0.715, 0.785), (0.69, 0.745)

# What families of styles share.
_CLIPPED: dict[str, Any] = {
    "points": 4, "radius": 9e-5, "count": 52000, "lift": 0.4, "reach": 1, "gravity": 0, "volume": 0,
    "lock": (1, 0), "wisps": (0, 0, 0), "stray": 0.0006, "flyaway": 0, "roughness": 0.35,
    "under_hat": True,
}  # fmt: skip
_SHORT: dict[str, Any] = {
    "points": 7, "radius": 7.5e-5, "count": 30000, "lift": 0.5, "reach": 0.2, "gravity": 0.12,
    "volume": 0.012, "tousle": 0.35, "lock": (10, 0.5), "wisps": (260, 0.3, 0.0015),
    "stray": 0.0025, "roughness": 0.32, "under_hat": True,
}  # fmt: skip
_SWEPT: dict[str, Any] = {
    "points": 10, "count": 30000, "lift": 0.35, "reach": 0.2, "gravity": 0.15, "volume": 0.012,
    "tousle": 0.2, "wisps": (220, 0.7, 0.0015), "stray": 0.003, "under_hat": True,
}  # fmt: skip
_FALLING: dict[str, Any] = {
    "length": (0.46, 0.52), "points": 18, "count": 25000, "parted": True, "volume": 0.020,
    "lift": 0.3, "stray": 0.0045, "under_hat": True,
}  # fmt: skip
_COILY: dict[str, Any] = {
    "points": 12, "count": 46000, "radius": 6.5e-5, "lift": 1.0, "reach": 9, "gravity": 0.0,
    "stiffness": 0.9, "volume": 0, "flat": 0.0, "lock": (40, 0.18), "wisps": (0, 0, 0),
    "roughness": 0.4, "sides": 0.85,
}  # fmt: skip
_GATHERED: dict[str, Any] = {
    "length": (0.3, 0.3), "points": 14, "count": 28000, "lift": 0.2, "reach": 9, "gravity": 0.0,
    "volume": 0.006, "wisps": (160, 0.35, 0.001), "stray": 0.0025,
}  # fmt: skip
_ROPED: dict[str, Any] = {
    "points": 20, "count": 22000, "parted": True, "volume": 0.020, "lift": 0.4, "tousle": 0.3,
    "stray": 0.0006, "lock": (1, 0), "wisps": (0, 0, 0), "flyaway": 0.03, "sides": 0.9,
    "roughness": 0.4, "under_hat": True,
}  # fmt: skip

_COILY_HAIR = (0.0, 0.03, 2.0)
STYLES: dict[str, Style] = {
    # Bare and clipped
    "bald": Style(
        Popularity(0.03, 0.5, by_age=rising_with_baldness), combed_from_whorl, (0, 0), count=0,
        under_hat=True,
    ),
    "shaved": Style(
        Popularity(0.06, 0.6, (0.8, 0.8, 1.4), rising_with_baldness), combed_from_whorl,
        (0.0015, 0.003), **_CLIPPED,
    ),
    "buzz": Style(
        Popularity(0.12, 1.2, (0.8, 0.8, 1.8)), combed_from_whorl, (0.005, 0.011), **_CLIPPED,
    ),
    "crew_cut": Style(
        Popularity(0.05, 1.3), combed_from_whorl, (0.014, 0.026), sides=0.35,
        fade=_LOW_FADE, **{**_SHORT, "lift": 0.75, "volume": 0.0, "count": 40000},
    ),
    "fade": Style(
        Popularity(0.03, 1.3, (1.0, 1.0, 1.2), _YOUNG), combed_forward, (0.026, 0.05), sides=0.15,
        fade=_SKIN_FADE, **{**_SHORT, "count": 40000, "tousle": 0.4},
    ),
    # Losing hair
    "receding": Style(
        Popularity(0.0, 1.0, (1.0, 1.0, 0.7), over_years((24, 0.0), (50, 1.8))),
        combed_from_whorl, (0.014, 0.032), sides=0.7, receding=0.75, **_SHORT,
    ),
    "thin_crown": Style(
        Popularity(0.0, 0.7, (1.0, 1.0, 0.5), over_years((30, 0.0), (60, 1.6))),
        combed_from_whorl, (0.016, 0.034), sides=0.7, receding=0.35, thinning=0.6, **_SHORT,
    ),
    "horseshoe": Style(
        Popularity(0.0, 0.8, (1.0, 1.0, 0.7), over_years((36, 0.0), (65, 2.0))),
        combed_from_whorl, (0.012, 0.03), receding=0.6, thinning=1.0, **_SHORT,
    ),
    # Short
    "short": Style(
        Popularity(0.5, 1.8, (1.0, 1.0, 0.6), _FAVOURED_WITH_AGE),
        combed_from_whorl, (0.026, 0.048), sides=0.5, **_SHORT,
    ),
    "crop": Style(
        Popularity(0.3, 1.2, (1.0, 1.0, 0.8)),
        combed_forward, (0.032, 0.048), sides=0.3, fringe=0.779, fade=_LOW_FADE, **_SHORT,
    ),
    "side_part": Style(
        Popularity(0.3, 1.6, (1.2, 1.0, 0.1), over_years((30, 0.8), (60, 1.4))),
        combed_across, (0.06, 0.085), sides=0.3, rise=0.003, parted=True, aside=0.6,
        **_SWEPT,
    ),
    "quiff": Style(
        Popularity(0.1, 1.0, (1.0, 1.0, 0.2), _YOUNG),
        combed_back, (0.055, 0.085), sides=0.16, fade=_LOW_FADE, rise=0.026, **_SWEPT,
    ),
    "slick_back": Style(
        Popularity(0.25, 0.8, (1.0, 0.8, 0.2)),
        combed_back, (0.09, 0.14), sides=0.4, **{**_SWEPT, "volume": 0.008, "under_hat": False},
    ),
    "undercut": Style(
        Popularity(0.15, 0.7, (1.0, 1.0, 0.2), _YOUNG),
        combed_across, (0.09, 0.13), sides=0.06, fade=_SKIN_FADE, rise=0.008, parted=True,
        aside=0.8, **_SWEPT,
    ),
    "curtains": Style(
        Popularity(0.15, 0.8, (1.0, 1.0, 0.2), _YOUNG),
        combed_from_parting, (0.11, 0.15), sides=0.4, parted=True, rise=0.006,
        **{**_SWEPT, "reach": 0.045, "gravity": 0.5},
    ),
    "bowl": Style(
        Popularity(0.12, 0.3, (1.4, 0.7, 0.1), _YOUNG),
        combed_under, (0.13, 0.15), cut=(0.735, 0.72), fringe=0.766,
        **{**_SWEPT, "reach": 0.08, "gravity": 0.5},
    ),
    "pixie": Style(
        Popularity(0.9, 0.1, (1.0, 1.0, 0.6), _FAVOURED_WITH_AGE),
        combed_across, (0.07, 0.10), sides=0.5, parted=True, aside=0.5, rise=0.003,
        **{**_SWEPT, "reach": 0.07, "gravity": 0.5, "tousle": 0.4},
    ),
    # Falling
    "bob": Style(
        Popularity(1.3, 0.1, (1.2, 0.7, 0.2), _FAVOURED_WITH_AGE),
        combed_from_parting, cut=(0.645, 0.605), **_FALLING,
    ),
    "wavy_bob": Style(
        Popularity(1.1, 0.15, (0.4, 1.6, 0.3), _FAVOURED_WITH_AGE),
        combed_from_parting, cut=(0.64, 0.59), wave=(0.010, 0.075), flat=0.3, tousle=0.3,
        **_FALLING,
    ),
    "fringe_bob": Style(
        Popularity(0.9, 0.05, (1.2, 0.8, 0.2)),
        combed_forward, cut=(0.665, 0.615), fringe=0.757,
        **{**_FALLING, "parted": False, "volume": 0.015},
    ),
    "lob": Style(
        Popularity(1.2, 0.15, (1.1, 1.0, 0.2)),
        combed_from_parting, cut=(0.585, 0.55), wave=(0.004, 0.12), tousle=0.15, **_FALLING,
    ),
    "layered": Style(
        Popularity(1.0, 0.25, (0.8, 1.3, 0.2)),
        combed_loosely, sides=0.8, wave=(0.006, 0.09), tousle=0.4,
        **{**_FALLING, "length": (0.2, 0.34), "parted": False},
    ),
    "long_straight": Style(
        Popularity(1.7, 0.2, (1.4, 0.4, 0.2), _RARER_WITH_AGE),
        combed_from_parting, cut=(0.56, 0.45), **_FALLING,
    ),
    "long_fringe": Style(
        Popularity(0.8, 0.05, (1.3, 0.7, 0.1), _RARER_WITH_AGE),
        combed_forward, cut=(0.55, 0.45), fringe=0.757,
        **{**_FALLING, "parted": False, "volume": 0.016},
    ),
    "long_wavy": Style(
        Popularity(1.6, 0.25, (0.5, 1.8, 0.3), _RARER_WITH_AGE),
        combed_from_parting, cut=(0.56, 0.46), wave=(0.014, 0.085), flat=0.35, tousle=0.2,
        **{**_FALLING, "volume": 0.024},
    ),
    "long_curly": Style(
        Popularity(1.0, 0.2, (0.02, 1.2, 1.3), _RARER_WITH_AGE),
        combed_from_parting, cut=(0.57, 0.50), wave=(0.010, 0.042), flat=0.0, tousle=0.4,
        **{**_FALLING, "points": 30, "volume": 0.030, "lock": (30, 1.4), "lift": 0.5},
    ),
    "half_up": Style(
        Popularity(0.8, 0.05, (1.0, 1.0, 0.2), _RARER_WITH_AGE),
        combed_from_parting, cut=(0.56, 0.46), ties=((0.0, 0.066, 0.80),), tied_above=0.79,
        tail="ponytail", **{**_FALLING, "parted": False},
    ),
    # Curly and coily
    "short_curly": Style(
        Popularity(0.6, 0.9, (0.02, 1.2, 1.0)),
        combed_loosely, (0.05, 0.09), count=24000, points=16, radius=7.5e-5, volume=0.022,
        lift=0.7, reach=0.06, gravity=0.25, tousle=0.6, wave=(0.006, 0.030), flat=0.0,
        lock=(30, 1.5), wisps=(260, 0.3, 0.003), stray=0.003, sides=0.55,
    ),
    "curly": Style(
        Popularity(1.0, 0.5, (0.05, 0.9, 1.4)),
        combed_loosely, (0.14, 0.26), count=24000, points=22, radius=8e-5, volume=0.036,
        lift=0.7, reach=0.06, gravity=0.5, tousle=0.6, wave=(0.0095, 0.044), flat=0.0,
        lock=(40, 1.8), wisps=(0, 0, 0), stray=0.003, sides=0.85,
    ),
    "afro": Style(
        Popularity(0.8, 0.4, _COILY_HAIR), upright, (0.05, 0.11), tousle=0.35,
        wave=(0.003, 0.011), stray=0.010, **_COILY,
    ),
    "coils": Style(
        Popularity(0.6, 0.8, _COILY_HAIR), upright, (0.014, 0.03), tousle=0.4,
        wave=(0.0025, 0.010), stray=0.004, under_hat=True, **{**_COILY, "sides": 0.6},
    ),
    "coily_fade": Style(
        Popularity(0.2, 1.2, _COILY_HAIR, _YOUNG), upright, (0.02, 0.04), tousle=0.4,
        wave=(0.003, 0.010), stray=0.004, fade=_SKIN_FADE, **{**_COILY, "sides": 0.3},
    ),
    # Worked into ropes and rows
    "locs": Style(
        Popularity(0.5, 0.5, _COILY_HAIR), combed_from_parting, (0.2, 0.36), rope=0.0042,
        **_ROPED,
    ),
    "short_locs": Style(
        Popularity(0.15, 0.6, _COILY_HAIR, _YOUNG), combed_loosely, (0.07, 0.12), rope=0.0036,
        **{**_ROPED, "volume": 0.03, "lift": 0.8, "parted": False, "sides": 0.6,
           "under_hat": False},
    ),
    "twists": Style(
        Popularity(0.5, 0.5, _COILY_HAIR, _YOUNG), combed_from_parting, (0.12, 0.22),
        rope=0.0040, plait="twist", **_ROPED,
    ),
    "box_braids": Style(
        Popularity(0.7, 0.15, _COILY_HAIR, _YOUNG), combed_from_parting, cut=(0.55, 0.45),
        length=(0.46, 0.52), rope=0.0034, ropes=200, plait="braid", **{**_ROPED, "points": 40},
    ),
    "cornrows": Style(
        Popularity(0.5, 0.5, _COILY_HAIR, _YOUNG), combed_in_rows(11), (0.03, 0.03), rows=11,
        count=24000, points=8, lift=0.55, reach=9, gravity=0.0, volume=0.005, layers=0.3,
        lock=(10, 0.9), wisps=(0, 0, 0), stray=0.0006, flyaway=0.02, roughness=0.4,
        under_hat=True,
    ),
    # Tied
    "ponytail": Style(
        Popularity(1.0, 0.12, (1.0, 1.0, 0.5), _RARER_WITH_AGE), combed_back,
        ties=((0.0, 0.064, 0.795),), tail="ponytail", **_GATHERED,
    ),
    "low_ponytail": Style(
        Popularity(0.7, 0.15, (1.0, 1.0, 0.4)), combed_back,
        ties=((0.0, 0.060, 0.715),), tail="ponytail", **{**_GATHERED, "under_hat": True},
    ),
    "high_ponytail": Style(
        Popularity(0.6, 0.02, (1.0, 1.0, 0.5), _YOUNG), combed_back,
        ties=((0.0, 0.030, 0.853),), tail="ponytail", **_GATHERED,
    ),
    "bun": Style(
        Popularity(0.7, 0.05, by_age=_FAVOURED_WITH_AGE), combed_back,
        ties=((0.0, 0.068, 0.775),), tail="bun", **_GATHERED,
    ),
    "top_knot": Style(
        Popularity(0.4, 0.3, by_age=_YOUNG), combed_back,
        ties=((0.0, 0.022, 0.856),), tail="bun", **_GATHERED,
    ),
    "braid": Style(
        Popularity(0.5, 0.02, (1.0, 1.0, 0.6), _RARER_WITH_AGE), combed_back,
        ties=((0.0, 0.062, 0.72),), tail="braid", **_GATHERED,
    ),
    "two_braids": Style(
        Popularity(0.4, 0.01, (1.0, 1.0, 0.6), _YOUNG), combed_back,
        ties=((0.064, 0.022, 0.70), (-0.064, 0.022, 0.70)), tail="braid", parted=True,
        **_GATHERED,
    ),
    "puff": Style(
        Popularity(0.6, 0.03, (0.0, 0.02, 2.0), _YOUNG), combed_back,
        ties=((0.0, 0.030, 0.850),), tail="puff", wave=(0.0015, 0.012), **_GATHERED,
    ),
}  # fmt: skip
