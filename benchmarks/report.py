"""What the benchmarks share: a clock, memory, tables."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.live import Live
from rich.table import Table

from assets_procedural.conventions.errors import UserError


@dataclass
class Took:
    """What a block took; filled when it ends."""

    seconds: float = 0.0
    """By the wall clock."""
    cpu_seconds: float = 0.0
    """Of this process alone, all its threads together."""


@contextmanager
def clock(device: str = "cpu") -> Iterator[Took]:
    """Times a block; on "cuda" until the GPU has done what the block asked for."""
    wait = _synchronise if device == "cuda" else _nothing
    took = Took()
    wait()
    start, cpu_start = time.perf_counter(), time.process_time()
    yield took
    wait()
    took.seconds = time.perf_counter() - start
    took.cpu_seconds = time.process_time() - cpu_start


def resident(process: int | None = None) -> float:
    """Megabytes that a process, this one by default, holds now; 0 where the system does not say."""
    return _status("VmRSS", process)


def peak(device: str = "cpu", process: int | None = None) -> float:
    """Megabytes that a process, this one by default, has held at most; on "cuda" what the
    allocator of this one has."""
    if device == "cuda":
        import torch

        return torch.cuda.max_memory_allocated() / 1e6
    # Not resource.getrusage: its peak survives exec and would be the parent's.
    return _status("VmHWM", process)


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table row by row as they come; as Markdown where the output is no terminal."""
    if sys.stdout.isatty():
        shown = Table(*header, box=box.SIMPLE_HEAD)
        with Live(shown, auto_refresh=False) as live:
            for row in rows:
                shown.add_row(*map(str, row))
                live.refresh()
        return
    _print_row(header)
    _print_row(["---"] * len(header))
    for row in rows:
        _print_row(row)
    print(flush=True)


def in_one_line(program: Callable[[], int]) -> int:
    """The exit code of a program; what a user can mend ends it with 1 and one line on stderr."""
    try:
        return program()
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed; run: make benchmark-setup", file=sys.stderr)
    except UserError as error:
        print(error, file=sys.stderr)
    return 1


def _print_row(cells: Sequence[object]) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def _status(field: str, process: int | None) -> float:
    try:
        text = Path(f"/proc/{process or os.getpid()}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    lines = (line.split() for line in text.splitlines())
    return next((int(line[1]) * 1024 / 1e6 for line in lines if line[0] == f"{field}:"), 0.0)


def _synchronise() -> None:
    import torch

    torch.cuda.synchronize()


def _nothing() -> None:
    pass
