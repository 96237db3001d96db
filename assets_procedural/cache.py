"""Where this machine keeps what is costly to make and quick to make again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """The distilled head, calibrations, networks: $SYNTHGEN_CACHE or ~/.cache/synthgen."""
    return Path(os.environ.get("SYNTHGEN_CACHE", Path.home() / ".cache" / "synthgen"))
