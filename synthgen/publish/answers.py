"""The answer to a query as CSV, JSON, Parquet, or a table for people; rows are never all held."""

from __future__ import annotations

import contextlib
import csv
import datetime
import io
import itertools
import json
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Literal, TextIO

from assets_procedural.conventions import console
from assets_procedural.conventions.files import replacing
from synthgen.dataset import manifest
from synthgen.dataset.manifest import Answer
from synthgen.errors import JobError

Format = Literal["csv", "json", "parquet", "table"]

SHOWN = 1000
"""Rows after which a table's columns are as wide as they get; longer values move what follows."""


def write(answer: Answer, form: Format | None, target: Path | None) -> None:
    """Write an answer to a file, which appears whole or not at all, or else to stdout.

    Without a format, the file's ending decides, then whether stdout is a terminal: that gets a
    table, all else CSV. Raises `JobError` for Parquet on stdout.
    """
    if form is None:
        form = _format_of(target)
    if target is None:
        if form == "parquet":
            raise JobError("--format", "", "parquet", "is no text; give a file with --output")
        _write_text(answer, form, sys.stdout)
    elif form == "parquet":
        _write_parquet(answer, target)
    else:
        with replacing(target) as file:
            text = io.TextIOWrapper(file, "utf-8", "backslashreplace", newline="")
            _write_text(answer, form, text)
            text.flush()
            text.detach()


def _format_of(target: Path | None) -> Format:
    if target is None:
        return "table" if sys.stdout.isatty() else "csv"
    endings: dict[str, Format] = {".json": "json", ".parquet": "parquet", ".txt": "table"}
    return endings.get(target.suffix.lower(), "csv")


def _write_text(answer: Answer, form: Format, file: TextIO) -> None:
    match form:
        case "csv":
            _write_csv(answer, file)
        case "json":
            _write_json(answer, file)
        case _:
            for line in table(answer, shutil.get_terminal_size().columns if file.isatty() else 160):
                file.write(line + "\n")


# ---------------------------------------------------------------- for programs


def _write_csv(answer: Answer, file: TextIO) -> None:
    """RFC 4180 but for line ends, which are \\n; NULL is empty, lists and structs are JSON."""
    # A terminal must not obey what is written; a file or another program gets every byte of it.
    shown = console.printable if file.isatty() else str
    lines = csv.writer(file, lineterminator="\n")
    lines.writerow([shown(name) for name in answer.column_names])
    for rows in answer.chunks:
        lines.writerows([cell(v, shown) for v in row] for row in rows)


def cell(value: Any, shown: Callable[[str], str] = str) -> Any:
    """A value as a cell of CSV; texts are written as `shown` has them."""
    kind = type(value)
    if value is None:
        return ""
    if kind is str:
        return shown(value)
    if kind is int or kind is float:
        return value
    return _text(value)


def _text(value: Any) -> str:
    """A value in one line: as DuckDB shows it, but lists and structs as JSON."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | dict | tuple):
        return json.dumps(_plain(value), ensure_ascii=False)
    return value.hex() if isinstance(value, bytes) else str(value)


def _write_json(answer: Answer, file: TextIO) -> None:
    """An array with an object per row and line; NaN and infinity, which JSON lacks, are null."""
    names = _distinct(answer.column_names)
    before = "[\n"
    for row in _rows(answer):
        entry = dict(zip(names, map(_plain, row), strict=True))
        file.write(before + json.dumps(entry, ensure_ascii=False, allow_nan=False))
        before = ",\n"
    file.write("[]\n" if before == "[\n" else "\n]\n")


def _plain(value: Any) -> Any:
    """A value of DuckDB as JSON has it; what JSON lacks is a string."""
    match value:
        case None | bool() | str() | int():
            return value
        case float():
            return value if math.isfinite(value) else None
        case list() | tuple():
            return [_plain(v) for v in value]
        case dict():
            return {str(k): _plain(v) for k, v in value.items()}
    return value.hex() if isinstance(value, bytes) else str(value)


def _write_parquet(answer: Answer, target: Path) -> None:
    """With the columns' own types."""
    names = _distinct(answer.column_names)
    rows = target.with_name(f".{target.name}.{os.getpid()}.rows.tmp")
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        with rows.open("w", encoding="utf-8", errors="backslashreplace") as file:
            for row in _rows(answer):
                file.write(json.dumps(dict(zip(names, map(_stored, row), strict=True))) + "\n")
        manifest.write_answer(target, rows, dict(zip(names, answer.column_types, strict=True)))
    finally:
        with contextlib.suppress(OSError):
            rows.unlink()


def _stored(value: Any) -> Any:
    """A value in JSON as DuckDB reads it back into its type."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, bytes):
        return "".join(f"\\x{byte:02X}" for byte in value)
    if isinstance(value, datetime.timedelta):
        return f"{value / datetime.timedelta(microseconds=1):.0f} microseconds"
    if isinstance(value, list | tuple):
        return [_stored(v) for v in value]
    if isinstance(value, dict):
        return {str(k): _stored(v) for k, v in value.items()}
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _rows(answer: Answer) -> Iterator[tuple[Any, ...]]:
    for chunk in answer.chunks:
        yield from chunk


def _distinct(names: Iterable[str]) -> list[str]:
    """Names of which each occurs once: a second `a` is `a_1`."""
    given: list[str] = []
    for name in names:
        candidate, number = name, 0
        while candidate in given:
            number += 1
            candidate = f"{name}_{number}"
        given.append(candidate)
    return given


# ---------------------------------------------------------------- for people


def table(answer: Answer, width: int) -> Iterator[str]:
    """Lines of a table, or, where that is wider than `width`, a line per value of each row.

    Numbers stand on the right. No line is longer than `width` for the names alone; long values are
    written whole.
    """
    names = [console.printable(name) for name in answer.column_names]
    rows = (["" if v is None else _line(v) for v in row] for row in _rows(answer))
    first = list(itertools.islice(rows, SHOWN))
    widths = [max(map(len, column)) for column in zip(names, *first, strict=True)]
    every = itertools.chain(first, rows)
    if sum(widths) + 2 * (len(widths) - 1) > width:
        yield from _vertical(names, every)
        return
    right = [_is_number(kind) for kind in answer.column_types]

    def line(cells: list[str]) -> str:
        padded = (
            c.rjust(w) if r else c.ljust(w) for c, w, r in zip(cells, widths, right, strict=True)
        )
        return "  ".join(padded).rstrip()

    yield line(names)
    yield "  ".join("─" * w for w in widths)
    yield from map(line, every)


def _vertical(names: list[str], rows: Iterable[list[str]]) -> Iterator[str]:
    longest = max(map(len, names))
    for number, row in enumerate(rows, 1):
        yield f"── row {number} ".ljust(longest + 12, "─")
        for name, value in zip(names, row, strict=True):
            yield f"{name.ljust(longest)}  {value}".rstrip()


def _line(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else _text(value)
    return console.printable(text).replace("\n", "\\n").replace("\t", "\\t")


def _is_number(kind: str) -> bool:
    return not kind.endswith("]") and (
        ("INT" in kind and kind != "INTERVAL") or kind.startswith(("DECIMAL", "DOUBLE", "FLOAT"))
    )
