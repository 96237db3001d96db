"""How a rendering process is started: spawned, with a fixed number of numerical threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from typing import Any

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
