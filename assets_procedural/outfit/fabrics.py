"""Fabrics: how far they stand off the body, how they fold, and how they look."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from assets_procedural.mesh.vectors import arctan2, smoothstep
from assets_procedural.person import Hat, Jacket, Scarf, Top


@dataclass(frozen=True)
class Fabric:
    """`slack` over the body, height of the `folds` and `thickness` in metres; `crisp` sharpens the
    folds; `weave` names the relief that the material draws."""

    slack: float
    folds: float
    crisp: float
    thickness: float
    weave: str
    roughness: float = 0.9


FABRICS: dict[str, Fabric] = {
    "jersey": Fabric(0.004, 0.0065, 2.2, 0.0010, "jersey"),
    "sweat": Fabric(0.009, 0.0102, 1.8, 0.0022, "fleece"),
    "fleece": Fabric(0.011, 0.0078, 1.5, 0.0034, "pile"),
    "knit": Fabric(0.008, 0.0068, 1.6, 0.0028, "knit"),
    "cable": Fabric(0.010, 0.0056, 1.5, 0.0036, "cable"),
    "rib": Fabric(0.003, 0.0022, 1.8, 0.0016, "rib"),
    "poplin": Fabric(0.006, 0.0081, 3.2, 0.0008, "poplin", 0.8),
    "silk": Fabric(0.005, 0.0081, 2.0, 0.0006, "satin", 0.42),
    "flannel": Fabric(0.008, 0.0071, 2.2, 0.0014, "fleece"),
    "denim": Fabric(0.009, 0.0068, 2.6, 0.0018, "denim"),
    "leather": Fabric(0.009, 0.0087, 2.4, 0.0022, "leather", 0.45),
    "nylon": Fabric(0.010, 0.0096, 2.6, 0.0012, "poplin", 0.5),
    "suiting": Fabric(0.009, 0.0031, 1.6, 0.0018, "twill", 0.85),
}
"""Fabrics by name."""


def cloth_look(worn: Top | Jacket | Scarf | Hat, weave: str, roughness: float) -> dict[str, Any]:
    """The `parameters` of a piece of "cloth"."""
    return {
        "colour": worn.colour,
        "accent": worn.accent,
        "pattern": worn.pattern,
        "weave": weave,
        "roughness": roughness,
    }


def folds(p: np.ndarray, crisp: float, rng: np.random.Generator) -> np.ndarray:
    """Heights (N,) from 0 to about 1 of folds over positions (N, 3) on the average person.

    Fans of tension folds leave the armpits, drapes hang from the shoulders, gathers ring the
    sleeves; between them the cloth is slack and nearly smooth.
    """
    across, depth, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    warp = np.zeros(len(p))
    for scale in (9.0, 22.0, 45.0):
        phase = rng.uniform(0, 2 * np.pi, 2)
        warp += 9 / scale * np.sin(p @ rng.normal(0, scale, 3) + phase[0])
        warp += 9 / scale * np.sin(p @ rng.normal(0, scale, 3) + phase[1])
    height = np.zeros(len(p))
    for side in (-1.0, 1.0):
        own = smoothstep(-0.015, 0.03, side * p[:, 0])
        for facing in (-1.0, 1.0):
            seen = own * smoothstep(-0.02, 0.03, facing * (depth + 0.01))
            # Fans out of the armpit.
            dx, dz = across - rng.uniform(0.165, 0.185), z - rng.uniform(0.385, 0.415)
            angle, reach = arctan2(dz, -dx), np.hypot(dx, dz)
            near = np.exp(-(((reach - 0.065) / 0.055) ** 2)) * smoothstep(-0.9, 0.1, angle)
            fan = _ridge(rng.uniform(9, 14) * angle + 0.8 * warp + rng.uniform(0, 6), crisp)
            height += 0.9 * rng.uniform(0.6, 1.1) * seen * near * fan
            # Drapes that hang from the point of the shoulder towards the breastbone.
            dx, dz = across - rng.uniform(0.12, 0.17), z - rng.uniform(0.56, 0.60)
            angle, reach = arctan2(dx, -dz), np.hypot(dx, dz)
            hang = smoothstep(0.07, 0.15, reach) * smoothstep(0.42, 0.2, reach)
            drape = _ridge(rng.uniform(11, 17) * angle + 0.9 * warp + rng.uniform(0, 6), crisp)
            height += 0.6 * rng.uniform(0.3, 1.0) * seen * hang * drape
        # Rings and spirals around the sleeve, out of the armpit and over the shoulder cap.
        along = 0.72 * across - 0.70 * z
        slant = rng.normal(0, 7)
        ring = _ridge(
            along * rng.uniform(120, 170) + slant * depth + warp + rng.uniform(0, 6), crisp
        )
        height += 0.8 * own * smoothstep(0.145, 0.195, across) * ring
    # Slack cloth sags a little in between.
    lean = rng.normal(0, 0.5)
    direction = np.array([np.cos(lean), 0.3, np.sin(lean)]) * 2 * np.pi / rng.uniform(0.07, 0.12)
    slack = _ridge(p @ direction + 1.2 * warp, 1.5)
    patch = 0.5 + 0.5 * np.sin(p @ rng.normal(0, 16, 3) + rng.uniform(0, 6))
    return height + 0.5 * slack * patch


def _ridge(phase: np.ndarray, crisp: float) -> np.ndarray:
    """Rounded ridges with a steeper flank, 0 to 1."""
    return (0.5 + 0.5 * np.sin(phase + 0.45 * np.sin(phase))) ** crisp
