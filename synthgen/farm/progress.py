"""The progress of a run: a bar for people, a note for `synthgen status`."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from synthgen import console, ledger
from synthgen.farm.commit import frames_done

if TYPE_CHECKING:
    from synthgen.farm.run import Run


@contextlib.contextmanager
def bar(run: Run) -> Iterator[Callable[[], None]]:
    """A bar with rate and time left; nothing at all when the output is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    total = sum(
        len(s.subjects) * (spec.shots * spec.environments)
        for s in run.shards
        for spec in [run.plan.job.subsets[s.subset]]
    )
    before = frames_done(run.out, run.plan, run.shards)
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} frames"),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console.stderr()) as shown:
        task = shown.add_task("rendering", total=total, completed=before, note="starting workers")

        def advance() -> None:
            done = run.summary.frames
            elapsed = time.time() - run.started
            text = "starting workers" if not any(s.ready for s in run.slots.values()) else ""
            if done:
                left = (total - before - done) * elapsed / done
                text = f"{done / elapsed:.2f} frames/s, {console.duration(left)} left"
            bad = len(ledger.failures(run.out)) if run.streak else 0
            text += f", {bad} failed" if bad else ""
            shown.update(task, completed=before + done, note=text)

        yield advance


def note(run: Run) -> None:
    """Tell `synthgen status`, in another process, what this run is busy with."""
    now, clock = time.time(), time.monotonic()
    content = {
        "pid": os.getpid(),
        "started": run.started,
        "workers": len(run.slots),
        "frames": run.summary.frames,
        "running": [
            [s.task.subject.subset, s.task.subject.key, now - (clock - s.since)]
            for s in run.slots.values()
            if s.task is not None
        ],
    }
    path = note_file(run)
    path.parent.mkdir(exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(content))
    temporary.replace(path)


def note_file(run: Run) -> Path:
    """Where `note` leaves it; there while the run lasts."""
    return run.out / "work" / "runs" / f"{run.slice}.json"
