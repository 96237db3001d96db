"""Pictures of lightmaps: an environment beside its five maps, and a ball in front of it.

Both show linear light times one exposure through the dataset's display transform. The exposure is
metered as with an incident light meter: of a white matte surface that faces the brightest light the
strongest channel is shown at `WHITE`. So the diffuse map is little compressed, lights themselves
are, and all parts of a picture compare.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from assets_procedural.conventions.files import replacing
from assets_procedural.light.backdrop import backdrop
from totalediting.light import phong
from totalediting.light.ball import shade_ball
from totalediting.light.lightmaps import LOBES, sample, texel_directions

PAPER, INK, FAINT = (18, 18, 20), (236, 236, 238), (138, 138, 146)
EDGE, GAP, LABEL, TILE = 28, 12, 22, 360
WHITE = 0.8
"""Linear light of a white surface in the brightest light."""
BALL_SIZE, BALL_SHARE = 512, 0.7
"""Pixels of the ball's picture, and the share of them that the ball spans."""


def exposure_of(lightmaps: torch.Tensor) -> float:
    """The factor of linear light that pictures of normalised lightmaps (5, 3, H, 2H) are shown at.

    1 where nothing shines.
    """
    brightest = float(lightmaps[0].max())
    return WHITE / brightest if brightest > 0.0 else 1.0


def draw_lightmaps(
    environment: torch.Tensor, lightmaps: torch.Tensor, title: str, target: Path
) -> None:
    """Draw an environment (H, 2H, 3) and its normalised lightmaps (5, 3, h, 2h) as one PNG page."""
    exposure = exposure_of(lightmaps)
    column, row = TILE + GAP, TILE // 2 + LABEL + GAP
    wide = 2 * TILE + GAP
    top = EDGE + 44
    page = Image.new("RGB", (2 * EDGE + 3 * TILE + 2 * GAP, top + 3 * row - GAP + EDGE), PAPER)
    draw = ImageDraw.Draw(page)
    small = ImageFont.load_default(13)
    draw.text((EDGE, EDGE - 8), title, INK, ImageFont.load_default(22))
    height, width = environment.shape[:2]
    rows, columns = lightmaps.shape[-2:]
    facts = f"{width} x {height}, lightmaps {columns} x {rows}, exposure {np.log2(exposure):+.1f}"
    draw.text((EDGE, EDGE + 20), f"{facts} stops", FAINT, small)

    step = max(1, width // (2 * wide))  # a huge one need not be developed whole
    shown = Image.fromarray(_bytes(environment[::step, ::step] * exposure))
    page.paste(shown.resize((wide, wide // 2), Image.Resampling.LANCZOS), (EDGE, top))
    where = "middle: +X, the subject's left    three quarters: -Y, what the subject looks at"
    draw.text((EDGE + 1, top + wide // 2 + 4), f"environment    {where}", FAINT, small)

    # The diffuse map and the widest lobe to the right of the environment, the others below it.
    places = [(2, 0), (2, 1), (0, 2), (1, 2), (2, 2)]
    # Read as the model reads them, rather than resized.
    directions = texel_directions(TILE // 2).to(lightmaps)
    maps = sample(lightmaps, directions.flatten(0, 1)).unflatten(1, (TILE // 2, TILE))
    for lobe, pixels, (i, j) in zip(LOBES, maps, places, strict=True):
        x, y = EDGE + i * column, top + j * row
        page.paste(Image.fromarray(_bytes(pixels * exposure)), (x, y))
        draw.text((x + 1, y + TILE // 2 + 4), lobe, FAINT, small)
    _save(page, target)


def draw_ball(
    environment: torch.Tensor,
    lightmaps: torch.Tensor,
    albedo: Sequence[float],
    k_d: float,
    k_s: Sequence[float],
    target: Path,
) -> None:
    """Draw a ball under normalised lightmaps as PNG, the environment out of focus behind it.

    Both are seen from -Y; the environment as through a lens of 40 degrees.
    """
    across = round(BALL_SIZE * BALL_SHARE)
    light, coverage = (t.cpu() for t in shade_ball(lightmaps, across, albedo, k_d, k_s))
    slope = np.tan(np.radians(20)) * ((np.arange(BALL_SIZE) + 0.5) / BALL_SIZE * 2 - 1)
    x, z = np.meshgrid(slope, -slope)
    rays = np.stack([x, np.ones_like(x), z], axis=-1)
    picture = torch.from_numpy(backdrop(environment.cpu().numpy(), rays, 0.0, BALL_SIZE / 40))
    start = (BALL_SIZE - across) // 2
    inside = slice(start, start + across)
    picture[inside, inside] = torch.lerp(picture[inside, inside], light, coverage[..., None])
    _save(Image.fromarray(_bytes(picture * exposure_of(lightmaps))), target)


def _bytes(linear: torch.Tensor) -> np.ndarray:
    return (phong.display(linear) * 255.0).round().to(torch.uint8).cpu().numpy()


def _save(picture: Image.Image, target: Path) -> None:
    with replacing(target) as file:
        picture.save(file, "PNG")
