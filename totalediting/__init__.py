"""What is learnt: the portrait model that trains on rendered datasets.

What `__all__` names is public and imported when first used, so that `import totalediting` is quick;
the light and motion modules under `totalediting.light` and `totalediting.geometry` are public too.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from assets_procedural import __version__

if TYPE_CHECKING:
    from totalediting.editing.editor import Editor
    from totalediting.light.lightmaps import bake

__all__ = ["Editor", "__version__", "bake"]

_HOMES = {
    "Editor": "totalediting.editing.editor",
    "bake": "totalediting.light.lightmaps",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
