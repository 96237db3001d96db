"""How a rendering process starts and ends: spawned, pinned, logged, never outliving its parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from assets_procedural.conventions.errors import UserError
from synthgen.farm import temporary

# BLAS sums in another order with another number of threads, and the same job must give the same
# bytes everywhere. It reads these when numpy is imported, so they must be set before that.
_PINNED = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "VECLIB_MAXIMUM_THREADS": "1"}


def start(target: Callable[..., None], *arguments: Any) -> BaseProcess:
    """Start a daemonic spawned process that runs `target(*arguments)`."""
    process = get_context("spawn").Process(target=target, args=arguments, daemon=True)
    before = {name: os.environ.get(name) for name in _PINNED}
    os.environ.update(_PINNED)
    try:
        process.start()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
    return process


def begin_process(log: Path, scratch: Path | None) -> None:
    """First thing in a child: everything it prints goes to `log`, and it ends with its parent.

    Its temporary files go to `scratch`, if given.
    """
    redirect(log)
    if scratch is not None:
        temporary.use(scratch)
    _die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches us too; the parent decides


def end_process(code: int) -> None:
    """Last thing in a child: flush, and end past Blender's exit handlers, which may hang."""
    _flush()
    os._exit(code)


def redirect(log: Path) -> None:
    """Send both standard streams to the log at the level of file descriptors: Blender writes C."""
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    _flush()
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.close(handle)


def reason_of(error: BaseException) -> str:
    """One short line for an exception: its type and message; a user's error speaks for itself."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else ""
    if isinstance(error, UserError) and text:
        return text
    return f"{type(error).__name__}: {text}"[:200].rstrip(": ")


def reason_of_death(code: int | None) -> str:
    """What an exit code says of a process that ended without a word."""
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            return f"died of {signal.Signals(-code).name}"
    return f"ended with code {code}"


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()


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
