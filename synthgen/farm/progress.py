"""The progress of a run: a bar or lines for people, a note for `synthgen status`."""

from __future__ import annotations

import contextlib
import itertools
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
from synthgen.planning.plan import subject_key


@contextlib.contextmanager
def shown(run: RunState, limit: int | None = None) -> Iterator[Callable[[], None]]:
    """Show rate and time left on stderr when called: as a bar, or, in a log, as lines.

    Of a run that `limit` bounds, only the subjects that it renders count; of others, what is on
    disk does too.
    """
    to_do = sum(itertools.islice(_frames_to_do(run), limit))
    before = 0 if limit is not None else frames_done(run.folder, run.plan, run.shards)
    total = before + to_do

    def done() -> int:
        return before + run.summary.frames

    def pace() -> str:
        new, elapsed = run.summary.frames, time.time() - run.started
        ready = any(slot.ready for slot in run.slots.values())
        text = "first subjects" if ready else "starting workers"
        if new:
            left = max(to_do - new, 0) * elapsed / new
            text = f"{new / elapsed:.2f} frames/s, {console.duration(left)} left"
        bad = len(ledger.failures(run.folder)) if run.streak else 0
        return text + (f", {bad} failed" if bad else "")

    if not sys.stderr.isatty():
        yield _lines(lambda: f"rendering: {done():,} of {console.count(total, 'frame')}, {pace()}")
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", style="bold", markup=False),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} frames"),
        TextColumn("{task.fields[note]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console.stderr(), transient=True) as bar:
        task = bar.add_task("rendering", total=total, completed=before, note="starting workers")
        yield lambda: bar.update(task, completed=done(), note=pace())


def _frames_to_do(run: RunState) -> Iterator[int]:
    """Frames of each subject that is still to be rendered, in the order of the run."""
    for shard in run.shards:
        if ledger.shard_record(run.folder, shard.name) is not None:
            continue
        spec = run.plan.job.subsets[shard.subset]
        for key in map(subject_key, shard.subjects):
            if ledger.waiting(run.folder, shard.subset, key) is None and not ledger.quarantined(
                run.folder, shard.subset, key
            ):
                yield spec.shots * spec.environments


def _lines(text: Callable[[], str]) -> Callable[[], None]:
    """Prints `text` when it is called, at `console.FIRST_LINE` and every `console.LINE_EVERY`."""
    due = time.monotonic() + console.FIRST_LINE

    def advance() -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + console.LINE_EVERY
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
