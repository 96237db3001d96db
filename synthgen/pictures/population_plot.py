"""The people of a job as a table on the terminal and as a picture of bars."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image, ImageDraw

from synthgen.pictures.page import EDGE, FAINT, INK, PAPER, font, save, words

if TYPE_CHECKING:
    from rich.console import Console

    from synthgen.planning.population import Marginal, Population

_COLUMNS, _COLUMN, _LINE, _BAR = 3, 420, 18, 160
_DRAWN, _ASKED = (66, 135, 245), (245, 130, 88)
_CELLS = 24


def report(population: Population, console: Console) -> None:
    """Print every marginal: the share of each value as drawn and as asked, with a bar."""
    from rich.table import Table

    table = Table(title=_title(population), title_justify="left", box=None)
    for name in ("attribute", "value"):
        table.add_column(name)
    for name in ("asked", "drawn"):
        table.add_column(name, justify="right")
    table.add_column("")
    for marginal in population.marginals:
        name, longest = marginal.attribute, max(marginal.drawn.values(), default=1.0) or 1.0
        for value, share in marginal.drawn.items():
            asked = marginal.asked.get(value)
            shown = "" if asked is None else f"{100 * asked:.1f} %"
            bar = "█" * round(_CELLS * share / longest)
            table.add_row(name, value, shown, f"{100 * share:.1f} %", bar)
            name = ""
        table.add_section()
    console.print(table)


def plot(population: Population, target: Path) -> Path:
    """Draw every marginal as bars, with a mark where a quota asks it to end. Returns `target`."""
    heights = [0] * _COLUMNS
    places = []
    for marginal in population.marginals:
        column = heights.index(min(heights))
        places.append((EDGE + column * (_COLUMN + EDGE), heights[column]))
        heights[column] += (len(marginal.drawn) + 3) * _LINE
    width = EDGE + _COLUMNS * (_COLUMN + EDGE)
    page = Image.new("RGB", (width, max(heights) + 2 * EDGE + 2 * _LINE), PAPER)
    draw = ImageDraw.Draw(page)
    draw.text((EDGE, EDGE), words(_title(population)), INK, font(18))
    for marginal, (x, y) in zip(population.marginals, places, strict=True):
        _bars(draw, marginal, x, y + EDGE + 2 * _LINE)
    return save(page, target)


def _title(population: Population) -> str:
    return f"{population.people:,} people of {population.subset}"


def _bars(draw: ImageDraw.ImageDraw, marginal: Marginal, x: int, y: int) -> None:
    draw.text((x, y), marginal.attribute, INK, font(14))
    shares = [*marginal.drawn.values(), *marginal.asked.values()]
    scale = _BAR / max(max(shares, default=1.0), 1e-9)
    left = x + 150
    for value, share in marginal.drawn.items():
        y += _LINE
        draw.text((x, y), value, FAINT, font(12))
        draw.rectangle((left, y + 3, left + scale * share, y + 13), fill=_DRAWN)
        asked = marginal.asked.get(value)
        if asked is not None:
            at = left + scale * asked
            draw.line((at, y + 1, at, y + 15), fill=_ASKED, width=2)
        draw.text((left + _BAR + 10, y), f"{100 * share:.1f} %", FAINT, font(12))
