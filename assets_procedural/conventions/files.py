"""Atomic file writes (temporary name, fsync, rename), foreign files, hashes, the user's folders."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import stat
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[io.BufferedWriter]:
    """Open a file that appears as `target` whole or not at all: temporary name, fsync, rename.

    Libraries that open files themselves can write to its `name`. Missing parent folders are made.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    _sync_folder(target.parent)


def write_atomically(target: Path, content: bytes) -> None:
    """Write `content` to `target`, whole or not at all."""
    with replacing(target) as file:
        file.write(content)


def open_regular(path: Path) -> io.BufferedReader:
    """Open somebody else's file for reading: a pipe, which would block, is refused at once.

    Raises `OSError` also for devices, sockets and folders. Links are followed.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        check_regular(path, os.fstat(handle))
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_regular(path: Path, most: int) -> bytes:
    """The content of somebody else's file; `OSError` as `open_regular`, or beyond `most` bytes."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"is larger than {most >> 20} MB", str(path))
    return content


def check_regular(path: Path, seen: os.stat_result | None = None) -> None:
    """Raise `OSError` unless a path, or what `seen` tells of it, is a regular file."""
    mode = (seen or path.stat()).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a pipe, a socket or a device, not a file", str(path))


def sha256(path: Path) -> str:
    """Hex digest of a file's content; `OSError` as `open_regular`."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync_folder(folder: Path) -> None:
    if os.name == "nt":  # directories cannot be opened there
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def cache_folder() -> Path:
    """Calibrations, networks, lightmaps and thumbnails: $SYNTHGEN_CACHE or ~/.cache/synthgen."""
    return Path(os.environ.get("SYNTHGEN_CACHE", Path.home() / ".cache" / "synthgen"))


def data_folder() -> Path:
    """What a user makes and would miss: $XDG_DATA_HOME/synthgen or ~/.local/share/synthgen."""
    home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(home) / "synthgen"
