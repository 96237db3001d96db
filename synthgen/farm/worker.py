"""A spawned process that renders whole subjects and commits them as work files."""

from __future__ import annotations

import contextlib
import errno
import importlib
import shutil
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from synthgen.dataset.folder import DatasetFolder
from synthgen.dataset.shot import RenderedSubject
from synthgen.farm.commit import GateError, commit_subject
from synthgen.farm.process import begin_process, end_process, reason_of
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import SubjectPlan

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
NEARLY_FULL = 16_000_000
Renderer = Callable[[SubjectPlan, JobSpec, Path, str, int], RenderedSubject]


@dataclass(frozen=True)
class Orders:
    """What a worker is told once: everything but the subjects."""

    job: JobSpec
    out: Path
    renderer: str
    device: str
    threads: int
    log: Path
    temporary: Path | None = None
    """Where its temporary files go; None for the system's own folder."""


@dataclass(frozen=True)
class Ready:
    """The renderer is loaded."""


@dataclass(frozen=True)
class Broken:
    """The renderer cannot be loaded, and the process ends."""

    reason: str


@dataclass(frozen=True)
class Done:
    """The subject is committed."""


@dataclass(frozen=True)
class Failed:
    """The subject could not be rendered or broke a promise of the dataset."""

    reason: str


@dataclass(frozen=True)
class DiskFull:
    """There was no room for it in a folder."""

    folder: Path
    reason: str


Message = Ready | Broken | Done | Failed | DiskFull
"""What a worker says: `Ready` or `Broken` once, then one of the others per subject."""


def work(orders: Orders, pipe: Connection) -> None:
    """Entry point of the process: render subjects from `pipe` until it sends None."""
    begin_process(orders.log, orders.temporary)
    try:
        render = load_renderer(orders.renderer)
    except Exception as error:
        traceback.print_exc()
        pipe.send(Broken(reason_of(error)))
        end_process(1)
        return
    pipe.send(Ready())
    with contextlib.suppress(EOFError, OSError):
        while (subject := pipe.recv()) is not None:
            print(f"--- {subject.subset}/{subject.key}", flush=True)
            pipe.send(_attempt(render, orders, subject))
    end_process(0)


def load_renderer(name: str) -> Renderer:
    """The function that "package.module:function" names.

    Raises `ValueError` for a malformed name, and whatever the import raises.
    """
    module, _, function = name.partition(":")
    if not function:
        raise ValueError(f'renderer {name!r} must be "package.module:function"')
    return getattr(importlib.import_module(module), function)


def _attempt(render: Renderer, orders: Orders, subject: SubjectPlan) -> Message:
    folder, start = DatasetFolder(orders.out), time.perf_counter()
    try:
        rendered = render(subject, orders.job, folder.environments, orders.device, orders.threads)
        commit_subject(folder, subject, rendered, time.perf_counter() - start)
    except Exception as error:
        traceback.print_exc()
        reason = f"gate: {error}"[:200] if isinstance(error, GateError) else reason_of(error)
        full = _full_folder(orders, error)
        return Failed(reason) if full is None else DiskFull(full, reason)
    return Done()


def _full_folder(orders: Orders, error: Exception) -> Path | None:
    """The folder without room that `error` comes from, if it does.

    Blender reports a full disk as a RuntimeError, and what it wrote to the temporary folder, some
    140 bytes per pixel, is removed before the error arrives here.
    """
    needed = NEARLY_FULL + 256 * orders.job.resolution**2
    for folder in (orders.out, Path(tempfile.gettempdir())):
        with contextlib.suppress(OSError):
            if shutil.disk_usage(folder).free < needed:
                return folder
    return orders.out if is_disk_full(error) else None


def is_disk_full(error: BaseException) -> bool:
    return isinstance(error, OSError) and error.errno in DISK_FULL
