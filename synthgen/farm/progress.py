"""The progress of a run: a bar or lines for people, a note for `synthgen status`."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator

from assets_procedural.conventions import console
from synthgen.dataset import ledger
from synthgen.dataset.records import RunNote
from synthgen.farm.commit import frames_done
from synthgen.farm.state import RunState

_LINE_EVERY = 60.0  # seconds


@contextlib.contextmanager
def shown(run: RunState) -> Iterator[Callable[[], None]]:
    """Show rate and time left when called: as a bar, in a log as a line a minute, on stderr."""
    total = sum(
        len(s.subjects) * (spec.shots * spec.environments)
        for s in run.shards
        for spec in [run.plan.job.subsets[s.subset]]
    )
    before = frames_done(run.folder, run.plan, run.shards)

    def done() -> int:
        return before + run.summary.frames

    def pace() -> str:
        new, elapsed = run.summary.frames, time.time() - run.started
        ready = any(slot.ready for slot in run.slots.values())
        text = "first subjects" if ready else "starting workers"
        if new:
            left = (total - before - new) * elapsed / new
            text = f"{new / elapsed:.2f} frames/s, {console.duration(left)} left"
        bad = len(ledger.failures(run.folder)) if run.streak else 0
        return text + (f", {bad} failed" if bad else "")

    if not sys.stderr.isatty():
        yield _lines(lambda: f"rendering: {done():,} of {total:,} frames, {pace()}")
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} frames"),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console.stderr()) as bar:
        task = bar.add_task("rendering", total=total, completed=before, note="starting workers")
        yield lambda: bar.update(task, completed=done(), note=pace())


def _lines(text: Callable[[], str]) -> Callable[[], None]:
    """Prints `text` when it is called, at most every `_LINE_EVERY` seconds."""
    last = time.monotonic()

    def advance() -> None:
        nonlocal last
        if time.monotonic() - last >= _LINE_EVERY:
            last = time.monotonic()
            print(text(), file=sys.stderr, flush=True)

    return advance


def note(run: RunState) -> None:
    """Tell `synthgen status`, in another process, what this run is busy with."""
    now, clock = time.time(), time.monotonic()
    content = RunNote(
        pid=os.getpid(),
        started=run.started,
        workers=len(run.slots),
        frames=run.summary.frames,
        running=[
            (s.task.subject.subset, s.task.subject.key, now - (clock - s.since))
            for s in run.slots.values()
            if s.task is not None
        ],
    )
    path = run.folder.run_note(run.slice)
    path.parent.mkdir(exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(content.to_json()))
    temporary.replace(path)
