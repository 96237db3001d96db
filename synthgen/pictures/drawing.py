"""The passes of a shot as pictures for people."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from PIL import ImageDraw

from assets_procedural.conventions.colour import to_bytes
from synthgen.dataset.passes import PASSES, Pass, Style
from synthgen.dataset.shot import Shot
from synthgen.pictures.page import fit

# One colour per part id, 0-18; neighbours on a face are far apart. 255 (ignore) is white.
PALETTE = np.zeros((256, 3), np.uint8)
PALETTE[:19] = [
    *((24, 24, 28), (226, 178, 148), (245, 130, 88), (66, 135, 245), (44, 205, 235)),
    *((150, 90, 210), (205, 110, 225), (120, 160, 60), (170, 205, 80), (120, 20, 40)),
    *((215, 60, 90), (245, 110, 140), (190, 140, 110), (110, 74, 46), (150, 112, 60)),
    *((60, 95, 120), (20, 20, 160), (205, 170, 50), (90, 150, 150)),
]
PALETTE[255] = 255


def pictures(shot: Shot) -> dict[str, np.ndarray]:
    """Every pass of a shot and its landmarks as (H, W, 3) uint8, label -> picture."""
    return {name: draw(shot) for name, draw in PICTURES.items()}


def _direction(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """-1 to 1 in each axis as 0 to 255."""
    return to_bytes(vectors.astype(np.float32) * 0.5 + 0.5)


def _distance(depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Near is bright; the range is the shot's own."""
    seen = depth[depth > 0]
    if not seen.size:
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(seen, (0.5, 99.5))
    shade = 1 - np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    return np.repeat(to_bytes(0.12 + 0.88 * shade)[..., None], 3, -1)


def _texture(uv: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """u in red, v in green, and a checker of 1/40 to show stretch."""
    checker = (np.floor(uv * 40).sum(-1) % 2)[..., None]
    colour = np.concatenate([uv, np.full_like(uv[..., :1], 0.35)], -1)
    return to_bytes(np.clip(colour, 0, 1) * (0.8 + 0.2 * checker))


def _position(points: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Coordinates as colours; the range is the shot's own."""
    if not mask.any():
        return np.zeros(points.shape, np.uint8)
    low, high = np.percentile(points[mask], (1, 99), axis=0)
    return to_bytes(np.clip((points - low) / np.maximum(high - low, 1e-6), 0, 1))


def _landmarks(shot: Shot) -> np.ndarray:
    """Dots on the picture: bright where visible, dim where hidden."""
    size = 512
    image = fit(shot.rgb[0], size).point(lambda v: v * 0.6)
    draw = ImageDraw.Draw(image)
    scale = size / shot.depth.shape[1]
    marks = shot.meta["landmarks"]
    for (x, y), visible in zip(marks["points"], marks["visible"], strict=True):
        x, y = x * scale, y * scale
        colour = (96, 235, 150) if visible else (235, 110, 80)
        draw.ellipse((x - 3.5, y - 3.5, x + 3.5, y + 3.5), fill=colour)
    return np.asarray(image)


# (array, mask) -> (H, W, 3) uint8, and whether the picture's background is blotted out.
_STYLES: dict[Style, tuple[Callable[[np.ndarray, np.ndarray], np.ndarray], bool]] = {
    "colour": (lambda array, mask: array, False),
    "direction": (_direction, True),
    "distance": (_distance, True),
    "texture": (_texture, True),
    "position": (_position, True),
    "ids": (lambda array, mask: PALETTE[array], False),
    "matte": (lambda array, mask: np.repeat(array[..., None], 3, -1), False),
}


def _draw(each: Pass, shot: Shot) -> np.ndarray:
    mask = shot.parts > 0
    style, surface_only = _STYLES[each.drawn]
    picture = style(shot.passes[each.name], mask)
    if not surface_only:
        return picture
    return np.where(mask[..., None], picture, np.uint8(24)).astype(np.uint8)


# Mattes come last: they are the least to look at.
_SHOWN = sorted(PASSES, key=lambda each: each.drawn == "matte")
PICTURES: dict[str, Callable[[Shot], np.ndarray]] = {
    **{each.name: partial(_draw, each) for each in _SHOWN},
    "landmarks": _landmarks,
}
"""How each pass of a shot is drawn, by label."""
