"""A spawned process that renders whole subjects and commits them as work files.

Messages to the parent: ("ready",), ("broken", reason), ("done", seconds), ("failed", reason),
("full", folder, reason). The process ends by `os._exit`: Blender may hang at interpreter exit.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import errno
import importlib
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from synthgen.dataset.folder import DatasetFolder
from synthgen.dataset.shot import RenderedSubject
from synthgen.farm.commit import GateError, commit_subject
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import SubjectPlan

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
NEARLY_FULL = 16_000_000
Renderer = Callable[[SubjectPlan, JobSpec, Path, str, int], RenderedSubject]


@dataclasses.dataclass(frozen=True)
class Orders:
    """What a worker is told once: everything but the subjects."""

    job: JobSpec
    out: Path
    renderer: str
    device: str
    threads: int
    log: Path


def work(orders: Orders, pipe: Connection) -> None:
    """Entry point of the process: render subjects from `pipe` until it sends None."""
    redirect(orders.log)
    _die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches us too; the parent decides
    try:
        render = load_renderer(orders.renderer)
    except Exception as error:
        traceback.print_exc()
        pipe.send(("broken", reason_of(error)))
        end_process(1)
        return
    pipe.send(("ready",))
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


def _attempt(render: Renderer, orders: Orders, subject: SubjectPlan) -> tuple[Any, ...]:
    folder, start = DatasetFolder(orders.out), time.perf_counter()
    try:
        rendered = render(subject, orders.job, folder.environments, orders.device, orders.threads)
        commit_subject(folder, subject, rendered, time.perf_counter() - start)
    except Exception as error:
        traceback.print_exc()
        full = _full_folder(orders, error)
        if full is not None:
            return "full", full, reason_of(error)
        return "failed", reason_of(error)
    return "done", time.perf_counter() - start


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


def reason_of(error: BaseException) -> str:
    """One short line for an exception."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else ""
    if isinstance(error, GateError):
        return f"gate: {text}"[:200]
    return f"{type(error).__name__}: {text}"[:200].rstrip(": ")


def is_disk_full(error: BaseException) -> bool:
    return isinstance(error, OSError) and error.errno in DISK_FULL


def redirect(log: Path) -> None:
    """Send both standard streams to the log at the level of file descriptors: Blender writes C."""
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.close(handle)


def _die_with_parent() -> None:
    """End this process when its parent is killed, so that no orphan renders on."""
    parent = os.getppid()
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        ctypes.CDLL(None, use_errno=True).prctl(pr_set_pdeathsig, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def end_process(code: int) -> None:
    """Flush and end at once, past Blender's exit handlers."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
