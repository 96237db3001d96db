"""How far a dataset is, for people and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from assets_procedural.conventions.console import count, duration, size
from synthgen.dataset.folder import Place
from synthgen.dataset.ledger import Status

if TYPE_CHECKING:
    from rich.console import Console


def as_json(state: Status) -> dict[str, Any]:
    """What `synthgen status --json` prints, which lists the keys in its help."""
    done, total = state.frames
    return {
        "name": state.name,
        "complete": state.complete,
        "frames": total,
        "frames_done": done,
        "workers": state.workers,
        "frames_per_second": state.frames_per_second,
        "seconds_left": state.seconds_left,
        "subsets": [
            {
                "name": s.name,
                "subjects": s.subjects,
                "done": s.done,
                "failed": s.failed,
                "shards": s.shards,
                "bytes": s.bytes,
                "frames_per_subject": s.frames_per_subject,
            }
            for s in state.subsets
        ],
        "running": [
            {"subset": r.subset, "key": r.key, "seconds": r.seconds} for r in state.running
        ],
        "failures": [
            {
                "subset": f.subset,
                "key": f.key,
                "attempts": f.attempts,
                "reason": f.reason,
                "log": f.log,
            }
            for f in state.failures
        ],
    }


def report(state: Status, out: Place, console: Console) -> None:
    """Print a table of the subsets, how many frames there are, what runs and what failed."""
    from rich.table import Table

    table = Table(title=f"{state.name} in {out}", title_justify="left")
    table.add_column("subset")
    for column in ("subjects", "done", "given up", "shards", "size"):
        table.add_column(column, justify="right")
    for s in state.subsets:
        counts = [f"{n:,}" for n in (s.subjects, s.done, s.failed, s.shards)]
        table.add_row(s.name, *counts, size(s.bytes))
    console.print(table)
    done, total = state.frames
    line = f"{done:,} of {count(total, 'frame')}"
    if state.frames_per_second:
        line += f", {state.frames_per_second * 3600:,.0f} frames per hour"
        line += f" by {count(state.workers, 'worker')}"
    if state.seconds_left is not None:
        line += f", {duration(state.seconds_left)} left"
    console.print(line + ("; complete" if state.complete else ""))
    for entry in state.running:
        console.print(f"running: {entry.subset}/{entry.key} for {duration(entry.seconds)}")
    for entry in state.failures:
        tries = count(entry.attempts, "attempt")
        console.print(f"failed: {entry.subset}/{entry.key}, {tries}: {entry.reason}")
