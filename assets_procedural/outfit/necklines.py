"""Where a garment ends: level sets over the rest shape of the average person, in metres.

So every cut fits every identity. `field > 0` is cloth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Outline:
    """The edge of a garment around the neck.

    `front` and `back` are the heights where it crosses the midline; `climb` is how steeply it rises
    to the sides (per metre); `vee` the point of a V (0: none) and `half` the V's half width at its
    top; `opening` pairs of height and half width of an open front, from below. `band` is the width
    of the knitted or folded band along the edge (0: none). `collar` names what stands on the edge.
    """

    front: float
    back: float
    climb: float = 3.6
    vee: float = 0.0
    half: float = 0.060
    opening: tuple[tuple[float, float], ...] = ()
    band: float = 0.0
    collar: str = ""

    def around(self, p: np.ndarray) -> np.ndarray:
        """Signed distance (N,) of positions (N, 3) below the edge around the neck, without V."""
        x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
        # A saddle through the pit of the neck (y -.080) and the nape (y .032) that climbs to the
        # sides, where the shoulder seams meet the neck.
        slope = (self.back - self.front) / 0.112
        wide = np.minimum(x, 0.12)
        edge = self.back + slope * (y - 0.032) + self.climb * wide**2
        return (edge - z) / np.sqrt(1 + slope**2 + (2 * self.climb * wide) ** 2)

    def field(self, p: np.ndarray) -> np.ndarray:
        """Signed distance (N,) of positions (N, 3) into the garment."""
        x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
        field = self.around(p)
        if self.vee:
            top = self.front + 0.030
            rise = top - self.vee
            wedge = (x * rise - (z - self.vee) * self.half) / np.hypot(rise, self.half)
            field = np.where(y < -0.02, _soft_min(field, wedge, 0.006), field)
        if self.opening:
            height, width = np.array(self.opening).T
            side = (x - np.interp(z, height, width)) * 0.95
            side = np.where(z < height[0], np.hypot(x, height[0] - z), side)
            field = np.where(y < -0.02, _soft_min(field, side, 0.004), field)
        return np.where(z > 0.635, -0.05, field)  # never the head, however wide the ears


def _soft_min(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    h = np.clip(0.5 + 0.5 * (b - a) / width, 0, 1)
    return b + (a - b) * h - width * h * (1 - h)


NECKLINES: dict[str, Outline] = {
    "crew": Outline(0.512, 0.562, band=0.019),
    "loose": Outline(0.499, 0.552, 3.0, band=0.016),
    "scoop": Outline(0.470, 0.545, 2.4, band=0.010),
    "boat": Outline(0.509, 0.543, 0.6, band=0.009),
    "vee": Outline(0.505, 0.556, vee=0.447, band=0.017),
    "henley": Outline(0.508, 0.560, vee=0.482, half=0.014, band=0.012),
    "polo": Outline(0.514, 0.566, vee=0.476, half=0.024, collar="soft"),
    "shirt": Outline(0.519, 0.570, vee=0.468, half=0.036, collar="shirt"),
    "buttoned": Outline(0.527, 0.572, collar="shirt"),
    "band": Outline(0.519, 0.568, vee=0.480, half=0.018, collar="stand"),
    "mock": Outline(0.550, 0.596, 2.0, band=0.014),
    "turtleneck": Outline(0.557, 0.608, 1.6, collar="roll"),
    "hood": Outline(0.510, 0.562, collar="hood"),
    "quarter_zip": Outline(0.516, 0.566, vee=0.455, half=0.028, collar="tall"),
}
"""Necklines of tops by name."""

_WIDE = ((0.345, 0.0), (0.37, 0.040), (0.47, 0.050), (0.56, 0.066))
_NARROW = ((0.345, 0.0), (0.37, 0.006), (0.44, 0.030), (0.56, 0.070))
JACKETS: dict[str, Outline] = {
    "blazer": Outline(0.512, 0.562, opening=_NARROW, collar="lapels"),
    "cardigan": Outline(0.512, 0.558, opening=_NARROW, band=0.026),
    "trucker": Outline(0.516, 0.564, opening=_WIDE, collar="shirt"),
    "biker": Outline(0.516, 0.564, opening=_WIDE, collar="shirt"),
    "bomber": Outline(0.518, 0.564, opening=_WIDE, collar="stand"),
}
"""Open layers over a top by name."""
