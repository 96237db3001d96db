"""Pictures of a dataset: one shot with all its passes, and a contact sheet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from synthgen import ledger
from synthgen.dataset import Dataset, open_dataset
from synthgen.display import display, to_bytes
from synthgen.shards import replacing
from synthgen.shot import Shot

PAPER, INK, FAINT = (18, 18, 20), (236, 236, 238), (138, 138, 146)
GAP, EDGE = 6, 28
# One colour per part id, 0-18; neighbours on a face are far apart. 255 (ignore) is white.
PALETTE = np.zeros((256, 3), np.uint8)
PALETTE[:19] = [
    *((24, 24, 28), (226, 178, 148), (245, 130, 88), (66, 135, 245), (44, 205, 235)),
    *((150, 90, 210), (205, 110, 225), (120, 160, 60), (170, 205, 80), (120, 20, 40)),
    *((215, 60, 90), (245, 110, 140), (190, 140, 110), (110, 74, 46), (150, 112, 60)),
    *((60, 95, 120), (20, 20, 160), (205, 170, 50), (90, 150, 150)),
]
PALETTE[255] = 255


# ---------------------------------------------------------------- passes as pictures


def passes(shot: Shot) -> dict[str, np.ndarray]:
    """Every pass of a shot as an (H, W, 3) uint8 picture, label -> picture."""
    mask = (shot.parts > 0)[..., None]
    return {
        "albedo": shot.albedo,
        "normal": _where(mask, to_bytes(shot.normal.astype(np.float32) * 0.5 + 0.5)),
        "depth": _where(mask, _depth(shot.depth)),
        "uv": _where(mask, _uv(shot.uv)),
        "canonical": _where(mask, _canonical(shot.canonical, mask[..., 0])),
        "parts": PALETTE[shot.parts],
        "alpha": np.repeat(shot.alpha[..., None], 3, -1),
        "landmarks": _landmarks(shot),
    }


def _where(mask: np.ndarray, picture: np.ndarray) -> np.ndarray:
    return np.where(mask, picture, np.uint8(24)).astype(np.uint8)


def _depth(depth: np.ndarray) -> np.ndarray:
    """Near is bright; the range is the shot's own."""
    seen = depth[depth > 0]
    if not seen.size:
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(seen, (0.5, 99.5))
    shade = 1 - np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    return np.repeat(to_bytes(0.12 + 0.88 * shade)[..., None], 3, -1)


def _uv(uv: np.ndarray) -> np.ndarray:
    """u in red, v in green, and a checker of 1/40 to show stretch."""
    checker = (np.floor(uv * 40).sum(-1) % 2)[..., None]
    colour = np.concatenate([uv, np.full_like(uv[..., :1], 0.35)], -1)
    return to_bytes(np.clip(colour, 0, 1) * (0.8 + 0.2 * checker))


def _canonical(points: np.ndarray, mask: np.ndarray) -> np.ndarray:
    if not mask.any():
        return np.zeros(points.shape, np.uint8)
    low, high = np.percentile(points[mask], (1, 99), axis=0)
    return to_bytes(np.clip((points - low) / np.maximum(high - low, 1e-6), 0, 1))


def _landmarks(shot: Shot) -> np.ndarray:
    """Dots on the picture: bright where visible, dim where hidden."""
    size = 512
    image = _square(shot.rgb[0], size).point(lambda v: v * 0.6)
    draw = ImageDraw.Draw(image)
    scale = size / shot.depth.shape[1]
    marks = shot.meta["landmarks"]
    for (x, y), visible in zip(marks["points"], marks["visible"], strict=True):
        x, y = x * scale, y * scale
        colour = (96, 235, 150) if visible else (235, 110, 80)
        draw.ellipse((x - 3.5, y - 3.5, x + 3.5, y + 3.5), fill=colour)
    return np.asarray(image)


# ---------------------------------------------------------------- drawing


@dataclass
class Tile:
    """A picture at its place on a page; `label` is written below it."""

    picture: np.ndarray
    x: int
    y: int
    width: int
    height: int
    label: str = ""


def _square(picture: np.ndarray, width: int, height: int | None = None) -> Image.Image:
    """Scale a picture; transparent ones are put on grey."""
    image = Image.fromarray(picture)
    if image.mode == "RGBA":
        ground = Image.new("RGBA", image.size, (72, 72, 76, 255))
        image = Image.alpha_composite(ground, image)
    size = (width, height or width)
    image = image.convert("RGB")
    return image if image.size == size else image.resize(size, Image.Resampling.LANCZOS)


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _put(page: Image.Image, tile: Tile) -> None:
    page.paste(_square(tile.picture, tile.width, tile.height), (tile.x, tile.y))
    if tile.label:
        draw = ImageDraw.Draw(page)
        draw.text((tile.x + 1, tile.y + tile.height + 3), tile.label, FAINT, _font(12))


def _save(page: Image.Image, target: Path) -> Path:
    with replacing(target) as file:
        page.save(file, "PNG", optimize=True)
    return target


def _thumbnail(dataset: Dataset, identifier: str, width: int) -> np.ndarray:
    """A panorama, exposed for its greys and developed, (width / 2, width, 3)."""
    panorama = dataset.environment(identifier)
    step = max(1, panorama.shape[1] // (2 * width))
    panorama = panorama[::step, ::step]
    grey = panorama.mean(-1)
    exposure = min(0.18 / max(np.median(grey), 1e-6), 1.2 / max(np.percentile(grey, 95), 1e-6))
    shown = to_bytes(display(panorama * exposure))
    return np.asarray(_square(shown, width, width // 2))


# ---------------------------------------------------------------- one shot


def show(out: Path | str, key: str, target: Path | str, subset: str | None = None) -> Path:
    """Draw a shot: every environment with its panorama, then every pass. Returns `target`.

    Raises `StorageError` if there is no such shot.
    """
    dataset = open_dataset(out, subset=subset)
    try:
        shot = dataset[key]
    except KeyError as error:
        raise ledger.StorageError(f"{out}: {error.args[0]}") from None
    tile, columns = 280, 4
    label, strip = 20, 140
    uses = shot.meta["environments"]
    rows = -(-len(uses) // columns)
    maps = list(passes(shot).items())
    pass_rows = -(-len(maps) // columns)
    width = 2 * EDGE + columns * tile + (columns - 1) * GAP
    top = EDGE + 46
    light = tile + label + strip + GAP
    height = top + rows * (light + GAP) + 8 + pass_rows * (tile + label + GAP) + EDGE
    page = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(page)
    draw.text((EDGE, EDGE - 8), f"{shot.meta['subset']}/{shot.key}", INK, _font(22))
    draw.text((EDGE, EDGE + 20), _caption(shot), FAINT, _font(13))
    for i, use in enumerate(uses):
        x = EDGE + (i % columns) * (tile + GAP)
        y = top + (i // columns) * (light + GAP)
        text = f"{use['id']}  {np.degrees(use['rotation']):.0f}°  {use['exposure']:+.1f} stops"
        _put(page, Tile(shot.rgb[i], x, y, tile, tile, text))
        panorama = _thumbnail(dataset, use["id"], tile)
        _put(page, Tile(panorama, x, y + tile + label, tile, strip))
    y0 = top + rows * (light + GAP) + 8
    for i, (name, picture) in enumerate(maps):
        x = EDGE + (i % columns) * (tile + GAP)
        y = y0 + (i // columns) * (tile + label + GAP)
        _put(page, Tile(picture, x, y, tile, tile, name))
    return _save(page, Path(target))


def _caption(shot: Shot) -> str:
    person, sample = shot.meta["person"], shot.meta["camera"]["sample"]
    strongest = sorted(shot.meta["expression"].items(), key=lambda item: -item[1])[:3]
    words = [
        f"{person['age_years']:.0f} years",
        f"hair {person['hair']['style']}",
        f"camera yaw {np.degrees(sample['yaw']):.0f}°, {sample['focal_mm']:.0f} mm",
        f"{shot.meta['split']}",
        ", ".join(f"{name} {value:.2f}" for name, value in strongest if value > 0.05),
    ]
    return "   ".join(word for word in words if word)


# ---------------------------------------------------------------- contact sheet

SHEET = 1560


@dataclass
class _Block:
    """Subjects of one subset on the sheet: S shots (columns) under L environments (rows) each."""

    title: str
    subjects: list[list[Shot]]

    @property
    def shape(self) -> tuple[int, int]:
        return min(len(self.subjects[0]), 8), min(len(self.subjects[0][0].rgb), 4)

    @property
    def per_line(self) -> int:
        return min(max(1, (SHEET - 2 * EDGE) // (self.shape[0] * 150)), len(self.subjects))

    @property
    def tile(self) -> int:
        inside = SHEET - 2 * EDGE - (self.per_line - 1) * 3 * GAP
        return min((inside // self.per_line - (self.shape[0] - 1) * 2) // self.shape[0], 240)


def sheet(out: Path | str, target: Path | str, subjects: int = 6) -> Path:
    """Draw a contact sheet with up to `subjects` subjects of each subset. Returns `target`.

    First a big picture of everybody, then each subject with its views or frames (columns) under
    its environments (rows), the passes of one shot, and the environments. Raises `StorageError`
    if nothing is finished yet.
    """
    out = Path(out)
    info = ledger.read_dataset_json(out)
    dataset = open_dataset(out)
    grouped = dataset.subjects()
    blocks = []
    for subset, plan in info["plan"].items():
        chosen = _spread([p for (s, _), p in grouped.items() if s == subset], subjects)
        shots = [[dataset[i] for i in _spread(positions, 8)] for positions in chosen]
        if shots:
            blocks.append(_Block(_title(subset, plan), shots))
    page = _Sheet(info, dataset, blocks)
    people, frames = len(grouped), sum(_lights(info, s) * len(p) for (s, _), p in grouped.items())
    height = page.draw(None, people, frames)
    image = Image.new("RGB", (SHEET, height), PAPER)
    page.draw(image, people, frames)
    return _save(image, Path(target))


class _Sheet:
    """Lays the sheet out from top to bottom; without an image it only measures."""

    def __init__(self, info: dict[str, Any], dataset: Dataset, blocks: list[_Block]) -> None:
        self.info, self.dataset, self.blocks = info, dataset, blocks
        self.y = 0
        self.image: Image.Image | None = None

    def draw(self, image: Image.Image | None, people: int, frames: int) -> int:
        """Draw everything on `image`; returns the height it takes."""
        self.image, self.y = image, EDGE
        self._text(self.info["name"], 34, INK, 42)
        resolution = self.info["job"]["resolution"]
        self._text(
            f"{people} people, {frames} images of {resolution} x {resolution} pixels", 15, FAINT, 34
        )
        self._heroes()
        for block in self.blocks:
            self._text(block.title, 17, INK, 32)
            self._block(block)
        strip = (SHEET - 2 * EDGE - 7 * GAP) // 8
        self._text("passes of one shot, shared by its environments", 17, INK, 32)
        shown = passes(self.blocks[0].subjects[0][0]) if image else dict.fromkeys(range(8))
        for i, (name, picture) in enumerate(shown.items()):
            self._tile(picture, EDGE + i * (strip + GAP), self.y, strip, strip, str(name))
        self.y += strip + 32
        self._text("environments", 17, INK, 32)
        for i, name in enumerate(names := self._environments()):
            x, row = EDGE + (i % 8) * (strip + GAP), i // 8
            picture = _thumbnail(self.dataset, name, strip) if image else None
            top = self.y + row * (strip // 2 + 26)
            self._tile(picture, x, top, strip, strip // 2, name)
        return self.y + -(-len(names) // 8) * (strip // 2 + 26) + EDGE

    def _heroes(self) -> None:
        """A big picture of everybody, in full lines where that is possible."""
        shots = [s[len(s) // 2] for block in self.blocks for s in block.subjects][:12]
        columns = min(
            (c for c in (3, 4, 5, 6) if c <= max(len(shots), 3)),
            key=lambda c: (-len(shots) % c, abs(c - 4)),
        )
        size = (SHEET - 2 * EDGE - (columns - 1) * GAP) // columns
        for i, shot in enumerate(shots):
            x, y = EDGE + (i % columns) * (size + GAP), self.y + (i // columns) * (size + GAP)
            self._tile(shot.rgb[i % len(shot.rgb)], x, y, size, size)
        self.y += -(-len(shots) // columns) * (size + GAP) + 14

    def _block(self, block: _Block) -> None:
        columns, rows = block.shape
        tile = block.tile
        width, height = columns * (tile + 2) - 2, rows * (tile + 2) - 2
        for i, shots in enumerate(block.subjects):
            left = EDGE + (i % block.per_line) * (width + 3 * GAP)
            top = self.y + (i // block.per_line) * (height + 26)
            for column in range(columns):
                for row in range(rows):
                    x, y = left + column * (tile + 2), top + row * (tile + 2)
                    label = ""
                    if column == 0 and row == rows - 1:
                        label = _person(shots[0])
                    self._tile(shots[column].rgb[row], x, y, tile, tile, label)
        self.y += -(-len(block.subjects) // block.per_line) * (height + 26) + 14

    def _environments(self) -> list[str]:
        names = [
            use["id"]
            for block in self.blocks
            for shots in block.subjects
            for use in shots[0].meta["environments"]
        ]
        return list(dict.fromkeys(names))[:16]

    def _text(self, text: str, size: int, colour: tuple[int, int, int], height: int) -> None:
        if self.image is not None:
            ImageDraw.Draw(self.image).text((EDGE, self.y), text, colour, _font(size))
        self.y += height

    def _tile(
        self, picture: np.ndarray | None, x: int, y: int, width: int, height: int, label: str = ""
    ) -> None:
        if self.image is not None and picture is not None:
            _put(self.image, Tile(picture, x, y, width, height, label))


def _title(subset: str, plan: dict[str, Any]) -> str:
    each = "views" if plan["kind"] == "multiview" else "frames of a track"
    shots = plan["shots_per_subject"]
    return f"{subset}: {shots} {each} under {plan['frames_per_subject'] // shots} environments"


def _person(shot: Shot) -> str:
    person = shot.meta["person"]
    names = " over ".join(use["id"] for use in shot.meta["environments"][:4])
    return f"{shot.meta['subject']}   {person['age_years']:.0f} years, {names}"


def _lights(info: dict[str, Any], subset: str) -> int:
    plan = info["plan"][subset]
    return plan["frames_per_subject"] // plan["shots_per_subject"]


def _spread(items: list[Any], count: int) -> list[Any]:
    """At most `count` of the items, evenly chosen."""
    if len(items) <= count:
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).astype(int)]
