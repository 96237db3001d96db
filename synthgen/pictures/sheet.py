"""The contact sheet of a dataset."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from assets_procedural.conventions import console
from synthgen.dataset.folder import Place, StorageError
from synthgen.dataset.reading import Dataset, open_dataset
from synthgen.dataset.records import Description, PlannedSubset
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

SHEET = 1560
MOST = 200
"""Pictures on one page."""


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


def sheet(out: Place, target: Path | str, subjects: int = 6) -> Path:
    """Draw a contact sheet with up to `subjects` subjects of each subset. Returns `target`.

    First a big picture of everybody, then each subject with its views or frames (columns) under
    its environments (rows), the passes of one shot, and the environments. Raises `StorageError`
    if nothing is finished yet.
    """
    with console.progress("drawing the sheet") as advance:
        dataset = open_dataset(out)
        info = dataset.description
        grouped = dataset.subjects()
        chosen: dict[str, list[list[int]]] = {}
        for subset in info.plan:
            people = _spread([p for (s, _), p in grouped.items() if s == subset], subjects)
            chosen[subset] = [_spread(positions, 8) for positions in people]
        total = sum(len(positions) for each in chosen.values() for positions in each)
        done = itertools.count(1)

        def read(position: int) -> Shot:
            shot = dataset[position]
            advance(next(done), total)
            return shot

        blocks = [
            _Block(title(subset, info.plan[subset]), [[read(i) for i in p] for p in each])
            for subset, each in chosen.items()
            if each
        ]
        page = _Sheet(info, dataset, blocks)
        frames = sum(info.plan[s].environments * len(p) for (s, _), p in grouped.items())
        height = page.draw(None, len(grouped), frames)
        image = Image.new("RGB", (SHEET, height), PAPER)
        page.draw(image, len(grouped), frames)
        return save(image, Path(target))


def portraits(out: Place, target: Path | str, subset: str | None = None, columns: int = 5) -> Path:
    """Draw pictures edge to edge, `columns` in a row. Returns `target`.

    The first picture of every subject of the subset (of the dataset by default) or, if there is
    one subject alone, all of its pictures: shot after shot, under one environment after the other.
    At most `MOST`. Raises `StorageError` if nothing is finished yet.
    """
    dataset = open_dataset(out, subset=subset)
    people = list(dataset.subjects().values())
    if not people:
        raise StorageError(f"{out}: nothing of subset {subset} is finished yet; render goes on")
    single = len(people) == 1
    chosen = people[0] if single else [positions[0] for positions in people[:MOST]]
    images: list[np.ndarray] = []
    for position in console.track(chosen, "drawing portraits"):
        taken = dataset[position].rgb
        images.extend(taken if single else taken[:1])
    images = images[:MOST]
    size = SHEET // columns
    page = Image.new("RGB", (size * columns, size * -(-len(images) // columns)), PAPER)
    for i, image in enumerate(images):
        put(page, Tile(image, (i % columns) * size, (i // columns) * size, size, size))
    return save(page, Path(target))


class _Sheet:
    """Lays the sheet out from top to bottom; without an image it only measures."""

    def __init__(self, info: Description, dataset: Dataset, blocks: list[_Block]) -> None:
        self.info, self.dataset, self.blocks = info, dataset, blocks
        self.y = 0
        self.image: Image.Image | None = None

    def draw(self, image: Image.Image | None, people: int, frames: int) -> int:
        """Draw everything on `image`; returns the height it takes."""
        self.image, self.y = image, EDGE
        self._text(self.info.name, 34, INK, 42)
        resolution = self.info.job.get("resolution", "?")
        self._text(
            f"{console.count(people, 'person', 'people')}, {console.count(frames, 'image')} of "
            f"{resolution} x {resolution} pixels",
            *(15, FAINT, 34),
        )
        self._heroes()
        for block in self.blocks:
            self._text(block.title, 17, INK, 32)
            self._block(block)
        strip = (SHEET - 2 * EDGE - 7 * GAP) // 8
        self._text("passes of one shot, shared by its environments", 17, INK, 32)
        shown = pictures(self.blocks[0].subjects[0][0]) if image else dict.fromkeys(range(8))
        for i, (name, picture) in enumerate(shown.items()):
            self._tile(picture, EDGE + i * (strip + GAP), self.y, strip, strip, str(name))
        self.y += strip + 32
        self._text("environments", 17, INK, 32)
        for i, name in enumerate(names := self._environments()):
            x, row = EDGE + (i % 8) * (strip + GAP), i // 8
            picture = thumbnail(self.dataset, name, strip) if image else None
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
                    if column < len(shots) and row < len(shots[column].rgb):
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
            ImageDraw.Draw(self.image).text((EDGE, self.y), words(text), colour, font(size))
        self.y += height

    def _tile(
        self, picture: np.ndarray | None, x: int, y: int, width: int, height: int, label: str = ""
    ) -> None:
        if self.image is not None and picture is not None:
            put(self.image, Tile(picture, x, y, width, height, label))


def title(subset: str, plan: PlannedSubset) -> str:
    """What a subset's part of the sheet shows."""
    if plan.kind == "multiview":
        each = console.count(plan.shots_per_subject, "view")
    else:
        each = f"{console.count(plan.shots_per_subject, 'frame')} of a track"
    return f"{subset}: {each} under {console.count(plan.environments, 'environment')}"


def _person(shot: Shot) -> str:
    person = shot.meta["person"]
    names = " over ".join(use["id"] for use in shot.meta["environments"][:4])
    return f"{shot.meta['subject']}   {person['age_years']:.0f} years, {names}"


def _spread(items: list[Any], count: int) -> list[Any]:
    """At most `count` of the items, evenly chosen."""
    if len(items) <= count:
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).astype(int)]
