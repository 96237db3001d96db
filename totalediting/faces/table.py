"""Busts fitted to pictures, as a Parquet file: a row per picture.

Columns: `source`, the key of a dataset's shot or the path of a picture or video, `/` between
folders; `frame`, of a video from 0, of a shot the environment; `seconds` at which a video shows it,
otherwise 0; `faces` found in it, of which the
largest was taken; `confidence` that it is one; `residual`, mean distance of landmarks from the
bust's, in sides of the square; `square` (left, top, side) that the fit is in, in pixels of the
picture, which it may exceed; `blendshapes`, MediaPipe's 52 in the order of `ARKIT_NAMES`; then the
fields of `Tracking`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from assets_procedural.conventions.files import replacing
from totalediting.errors import InputError
from totalediting.faces.fitting import Fits
from totalediting.faces.landmarker import Face
from totalediting.geometry.tracking import EXPRESSIONS, SIZES, Tracking

_NUMBERS = ("seconds", "confidence", "residual")
_LISTS = {"square": 3, "blendshapes": EXPRESSIONS, **SIZES._asdict()}
COLUMNS = {
    "source": "VARCHAR",
    "frame": "INTEGER",
    "faces": "INTEGER",
    **dict.fromkeys(_NUMBERS, "FLOAT"),
    **{name: f"FLOAT[{size}]" for name, size in _LISTS.items()},
}


@dataclass(frozen=True, eq=False)
class FitTable:
    """R rows, in the order of the file."""

    source: list[str]
    frame: np.ndarray
    """(R,) int."""
    faces: np.ndarray
    """(R,) int."""
    seconds: np.ndarray
    confidence: np.ndarray
    residual: np.ndarray
    square: np.ndarray
    """(R, 3) left, top and side, pixels."""
    tracking: Tracking
    """(R, …)."""
    blendshapes: np.ndarray
    """(R, 52)."""

    def rows(self) -> dict[tuple[str, int], int]:
        """Number of the row of a source and frame."""
        keys = zip(self.source, self.frame.tolist(), strict=True)
        return {key: number for number, key in enumerate(keys)}


def rows_of(
    keys: Sequence[tuple[str, int]],
    counts: Sequence[int],
    faces: Sequence[Face],
    squares: np.ndarray,
    fits: Fits,
    seconds: Sequence[float] | None = None,
) -> FitTable:
    """A table of fits in `squares` (R, 3) of the largest of `counts` faces each; `seconds` of a
    video's frames."""
    return FitTable(
        source=[source for source, _ in keys],
        frame=np.array([frame for _, frame in keys]),
        faces=np.array(counts),
        seconds=np.zeros(len(keys)) if seconds is None else np.array(seconds),
        confidence=np.array([face.confidence for face in faces]),
        residual=fits.residual,
        square=squares,
        tracking=fits.tracking,
        blendshapes=np.stack([face.blendshapes for face in faces]),
    )


def joined(tables: Sequence[FitTable]) -> FitTable:
    """The rows of all, one after the other."""
    sizes = SIZES._asdict().values()
    empty = Tracking(*(torch.zeros(0, int(size)) for size in sizes))
    nothing = np.zeros(0)

    def of(name: str, empty: np.ndarray) -> np.ndarray:
        return np.concatenate([empty, *(getattr(table, name) for table in tables)])

    return FitTable(
        source=[name for table in tables for name in table.source],
        frame=of("frame", nothing.astype(int)),
        faces=of("faces", nothing.astype(int)),
        seconds=of("seconds", nothing),
        confidence=of("confidence", nothing),
        residual=of("residual", nothing),
        square=of("square", np.zeros((0, 3))),
        tracking=Tracking(
            *map(torch.cat, zip(empty, *(table.tracking for table in tables), strict=True))
        ),
        blendshapes=of("blendshapes", np.zeros((0, EXPRESSIONS))),
    )


def write(path: Path, table: FitTable) -> None:
    """Write a table, whole or not at all."""
    import duckdb

    numbers = [table.seconds, table.confidence, table.residual]
    lists = [table.square, table.blendshapes, *(field.numpy() for field in table.tracking)]
    rows = [
        [source, int(frame), int(faces), *map(float, values), *(one.tolist() for one in fields)]
        for source, frame, faces, values, fields in zip(
            table.source,
            table.frame,
            table.faces,
            zip(*numbers, strict=True),
            zip(*lists, strict=True),
            strict=True,
        )
    ]
    with duckdb.connect() as connection:
        columns = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
        connection.execute(f"CREATE TABLE fits ({columns})")
        if rows:
            places = ", ".join("?" * len(COLUMNS))
            connection.executemany(f"INSERT INTO fits VALUES ({places})", rows)
        _copy(connection, "fits", path)


def read(path: Path) -> FitTable:
    """Read a table.

    Raises:
        InputError: it is none, or a value is missing or not finite.
    """
    import duckdb

    try:
        with duckdb.connect() as connection:
            names = ", ".join(f"{name}::{kind} AS {name}" for name, kind in COLUMNS.items())
            query = f"SELECT {names} FROM read_parquet([{_pattern(path)}])"
            found = connection.execute(query).fetchnumpy()
    except duckdb.Error as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: no table of `totalediting track`: {reason}") from None
    arrays: dict[str, np.ndarray] = {}
    for name in (*_NUMBERS, *_LISTS):
        column = np.ma.filled(found[name], np.nan)
        values = np.stack(list(column)) if name in _LISTS and len(column) else column
        values = np.asarray(values, np.float32).reshape(len(column), *_shape(name))
        if not np.isfinite(values).all():
            raise InputError(f"{path}: {name}: a value is missing or not finite; track again")
        arrays[name] = values
    return FitTable(
        source=[str(text) for text in found["source"]],
        frame=np.asarray(found["frame"], np.int64),
        faces=np.asarray(found["faces"], np.int64),
        seconds=arrays["seconds"],
        confidence=arrays["confidence"],
        residual=arrays["residual"],
        square=arrays["square"],
        tracking=Tracking(*(torch.from_numpy(arrays[name]) for name in Tracking._fields)),
        blendshapes=arrays["blendshapes"],
    )


def _shape(name: str) -> tuple[int, ...]:
    return (_LISTS[name],) if name in _LISTS else ()


def _copy(connection: Any, rows: str, path: Path) -> None:
    with replacing(path) as file:
        connection.execute(
            f"COPY (SELECT * FROM {rows}) TO {_quoted(file.name)} "
            "(FORMAT parquet, COMPRESSION zstd, USE_TMP_FILE false)"
        )


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _pattern(path: Path) -> str:
    """A path to read, of which DuckDB takes nothing for a wildcard."""
    return _quoted(re.sub(r"[*?[]", r"[\g<0>]", str(path.absolute())))
