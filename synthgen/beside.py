"""Where pictures and exports of a dataset go by default."""

from __future__ import annotations

import os
from pathlib import Path

from synthgen.errors import JobError


def beside(out: Path, ending: str) -> Path:
    """The dataset's own path with an `ending`, or that name in the current folder.

    Raises `JobError` if neither can be written.
    """
    folder = out if out.name not in ("", "..") else out.resolve()
    target = folder.with_name((folder.name or "dataset") + ending)
    for candidate in (target, Path(target.name)):
        if os.access(candidate.parent, os.W_OK | os.X_OK):
            return candidate
    remedy = f"neither {target.parent} nor the current folder can be written; give another place"
    raise JobError("--output", "", "", remedy)
