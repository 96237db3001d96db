"""A panorama as its file stores it: what the readers of each format give to `panorama_reading`."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.errors import UserError
from assets_procedural.conventions.primaries import REC709


class PanoramaError(UserError, ValueError):
    """A panorama file that cannot be used; the message names file, fault and remedy."""


@dataclass
class StoredPanorama:
    """Pixels (h, w, 3) as stored, float, and what the header says of them."""

    pixels: np.ndarray
    window: tuple[int, int] = (0, 0)
    """Column and row of the first pixel in the display window."""
    display: tuple[int, int] = (0, 0)
    """Width and height of the display window."""
    primaries: tuple[float, ...] = REC709
    empty: np.ndarray | None = None
    """(h, w) bool: texels whose alpha says that nothing is there."""
    facts: dict[str, Any] = field(default_factory=dict)


def check_fits(path: Path, decoded: int, largest: int | None) -> None:
    """One clear line, instead of a killed process, where a file does not fit into memory."""
    if largest is not None and decoded > largest:
        raise PanoramaError(
            f"{path}: is more than {largest / 1e9:.2g} GB once decoded; scale it down"
        )
    free = available_memory()
    if free is not None and 2 * decoded > free:
        raise PanoramaError(
            f"{path}: takes {2 * decoded / 1e9:.1f} GB of memory, {free / 1e9:.1f} GB are free; "
            "scale it down"
        )


def available_memory() -> int | None:
    """Bytes that a process can still have; None where the system does not say."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return None


def reason(error: object) -> str:
    """What a library says is wrong, as a few words."""
    lines = str(error).strip().splitlines() or ["unknown format"]
    return " ".join(lines[0].split())[:120]
