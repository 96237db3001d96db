"""Temporary folders that vanish: with their process, or else by the next one that makes one."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

_PREFIX = "synthgen-"
_LOCK = ".lock"
_GRACE = 3600.0
"""Seconds after which a folder without a lock is nobody's: one is made a moment before its lock."""


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder in the system's temporary one, removed at the end.

    Removes those, too, that killed processes left.
    """
    import fcntl

    _sweep(Path(tempfile.gettempdir()))
    with (
        tempfile.TemporaryDirectory(prefix=_PREFIX, ignore_cleanup_errors=True) as name,
        (Path(name) / _LOCK).open("w") as lock,
    ):
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield Path(name)


def use(folder: Path) -> None:
    """Make this process, Blender included, put its temporary files there.

    To be called before Blender is loaded.
    """
    for name in ("TMPDIR", "TEMP", "TMP"):
        os.environ[name] = str(folder)
    tempfile.tempdir = str(folder)


def _sweep(parent: Path) -> None:
    import fcntl

    for folder in parent.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            try:
                with (folder / _LOCK).open("r+") as lock:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except FileNotFoundError:
                if time.time() - folder.stat().st_mtime < _GRACE:
                    continue
            shutil.rmtree(folder, ignore_errors=True)
