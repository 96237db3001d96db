"""A picture of one shot with all its passes and environments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from synthgen.dataset.folder import Place
from synthgen.dataset.reading import open_dataset
from synthgen.dataset.shot import Shot
from synthgen.pictures.drawing import pictures
from synthgen.pictures.page import (
    EDGE,
    FAINT,
    GAP,
    INK,
    PAPER,
    Tile,
    font,
    put,
    save,
    thumbnail,
    words,
)


def show(out: Place, key: str, target: Path | str, subset: str | None = None) -> Path:
    """Draw a shot: every environment with its panorama, then every pass. Returns `target`.

    Raises `StorageError` if there is no such shot.
    """
    dataset = open_dataset(out, subset=subset)
    shot = dataset.find(key)
    tile, columns = 280, 4
    label, strip = 20, 140
    uses = shot.meta["environments"]
    rows = -(-len(uses) // columns)
    maps = list(pictures(shot).items())
    pass_rows = -(-len(maps) // columns)
    width = 2 * EDGE + columns * tile + (columns - 1) * GAP
    top = EDGE + 46
    light = tile + label + strip + GAP
    height = top + rows * (light + GAP) + 8 + pass_rows * (tile + label + GAP) + EDGE
    page = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(page)
    draw.text((EDGE, EDGE - 8), words(f"{shot.meta['subset']}/{shot.key}"), INK, font(22))
    draw.text((EDGE, EDGE + 20), words(_caption(shot)), FAINT, font(13))
    for i, use in enumerate(uses):
        x = EDGE + (i % columns) * (tile + GAP)
        y = top + (i // columns) * (light + GAP)
        text = f"{use['id']}  {np.degrees(use['rotation']):.0f}°  {use['exposure']:+.1f} stops"
        put(page, Tile(shot.rgb[i], x, y, tile, tile, text))
        panorama = thumbnail(dataset, use["id"], tile)
        put(page, Tile(panorama, x, y + tile + label, tile, strip))
    y0 = top + rows * (light + GAP) + 8
    for i, (name, picture) in enumerate(maps):
        x = EDGE + (i % columns) * (tile + GAP)
        y = y0 + (i // columns) * (tile + label + GAP)
        put(page, Tile(picture, x, y, tile, tile, name))
    return save(page, Path(target))


def _caption(shot: Shot) -> str:
    person, sample = shot.meta["person"], shot.meta["camera"]["sample"]
    strongest = sorted(shot.meta["expression"].items(), key=lambda item: -item[1])[:3]
    said = [
        f"{person['age_years']:.0f} years",
        f"hair {person['hair']['style']}",
        f"camera yaw {np.degrees(sample['yaw']):.0f}°, {sample['focal_mm']:.0f} mm",
        f"{shot.meta['split']}",
        ", ".join(f"{name} {value:.2f}" for name, value in strongest if value > 0.05),
    ]
    return "   ".join(word for word in said if word)
