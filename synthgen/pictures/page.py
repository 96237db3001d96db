"""Pages of pictures with labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from assets_procedural.conventions.colour import display, to_bytes
from assets_procedural.conventions.files import replacing
from synthgen.dataset.folder import StorageError
from synthgen.dataset.reading import Dataset

PAPER, INK, FAINT = (18, 18, 20), (236, 236, 238), (138, 138, 146)
GAP, EDGE = 6, 28


@dataclass
class Tile:
    """A picture at its place on a page; `label` is written below it."""

    picture: np.ndarray
    x: int
    y: int
    width: int
    height: int
    label: str = ""


def fit(picture: np.ndarray, width: int, height: int | None = None) -> Image.Image:
    """Scale a picture; transparent ones are put on grey."""
    image = Image.fromarray(picture)
    if image.mode == "RGBA":
        ground = Image.new("RGBA", image.size, (72, 72, 76, 255))
        image = Image.alpha_composite(ground, image)
    size = (width, height or width)
    image = image.convert("RGB")
    return image if image.size == size else image.resize(size, Image.Resampling.LANCZOS)


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The one typeface of all pages; `size` in pixels."""
    return ImageFont.load_default(size)


def words(text: str) -> str:
    """Somebody else's words as they can be drawn: one short line of characters that show."""
    short = text if len(text) <= 120 else text[:117] + "..."
    return "".join(c if c.isprintable() else "?" for c in short)


def put(page: Image.Image, tile: Tile) -> None:
    """Draw a tile and its label."""
    page.paste(fit(tile.picture, tile.width, tile.height), (tile.x, tile.y))
    if tile.label:
        draw = ImageDraw.Draw(page)
        draw.text((tile.x + 1, tile.y + tile.height + 3), words(tile.label), FAINT, font(12))


def save(page: Image.Image, target: Path) -> Path:
    """Write a page as JPEG or PNG by its name, whole or not at all. Returns `target`."""
    kind = {".jpg": "JPEG", ".jpeg": "JPEG"}.get(target.suffix.lower(), "PNG")
    with replacing(target) as file:
        page.save(file, kind, optimize=True, quality=88)
    return target


def thumbnail(dataset: Dataset, identifier: str, width: int) -> np.ndarray:
    """A panorama, exposed for its greys and developed, (width / 2, width, 3).

    Raises `StorageError` if it is missing or damaged.
    """
    try:
        panorama = dataset.environment(identifier)
    except KeyError:
        raise StorageError(f"{dataset.folder}: environment {identifier} is missing") from None
    except ValueError as error:
        raise StorageError(f"{dataset.folder}: {error}") from None
    # What a renderer never writes would have no exposure.
    panorama = np.clip(np.nan_to_num(panorama, posinf=1e6, neginf=0.0), 0.0, 1e6)
    step = max(1, panorama.shape[1] // (2 * width))
    panorama = panorama[::step, ::step]
    grey = panorama.mean(-1)
    exposure = min(0.18 / max(np.median(grey), 1e-6), 1.2 / max(np.percentile(grey, 95), 1e-6))
    shown = to_bytes(display(panorama * exposure))
    return np.asarray(fit(shown, width, width // 2))
