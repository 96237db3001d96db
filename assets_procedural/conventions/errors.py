"""`UserError`: what the user can fix, said in one line."""

from __future__ import annotations

import errno


class UserError(Exception):
    """Base class of all user errors.

    `str()` is one line that names the file, field or option, its value and the remedy. Anything
    else that is raised is a bug and keeps its traceback.
    """


_REMEDIES = {
    errno.EACCES: "change its rights, or give another place",
    errno.EPERM: "change its rights, or give another place",
    errno.EROFS: "give a place that can be written",
    errno.ENOSPC: "make room, or give another place",
    errno.EDQUOT: "make room, or give another place",
    errno.EFBIG: "make room, or give another place",
    errno.ENOENT: "check the path",
    errno.EISDIR: "give a file",
    errno.ENOTDIR: "give a folder",
    errno.EEXIST: "give another name",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ELOOP: "its links lead in a circle; mend them",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "close other programs",
    errno.ENOMEM: "close other programs, or take fewer workers",
    errno.EIO: "the disk or the network does not answer; check it",
    errno.ESTALE: "the disk or the network does not answer; check it",
}
"""What a user can do about what the system refuses."""


def one_line(error: BaseException) -> str:
    """An error as one line: its message, or its type if it has none."""
    if isinstance(error, OSError) and error.strerror:
        names = [str(name) for name in (error.filename, error.filename2) if name is not None]
        text = ": ".join([" -> ".join(names), error.strerror] if names else [error.strerror])
    else:
        text = str(error)
    return " ".join(text.split()) or type(error).__name__


def remedy(error: OSError) -> str:
    """What the user can do about an error of the system; empty where nobody can know."""
    return _REMEDIES.get(error.errno or 0, "")
