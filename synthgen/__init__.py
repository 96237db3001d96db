"""How it is photographed: jobs, plan, Blender stage, shards, manifest, farm.

    from synthgen import load_job, open_dataset, render_job

These are imported when they are first asked for, so that `import synthgen` stays quick and each of
them needs only what it uses: reading and planning take neither Blender nor torch. What is in
`__all__` is there to be relied on; everything below it may move.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from assets_procedural import __version__

__all__ = ["__version__", "load_job", "open_dataset", "render_job"]


if TYPE_CHECKING:
    from synthgen.dataset import open_dataset
    from synthgen.farm.local import render_job
    from synthgen.planning.job import load_job
else:  # hidden from type checkers, which would let any name pass
    _HOMES = {
        "load_job": "synthgen.planning.job",
        "open_dataset": "synthgen.dataset",
        "render_job": "synthgen.farm.local",
    }

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(_HOMES[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
