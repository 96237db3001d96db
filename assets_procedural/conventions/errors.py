"""`UserError`: what the user can fix, said in one line."""

from __future__ import annotations


class UserError(Exception):
    """Base class of all user errors.

    `str()` is one line that names the file, field or option, its value and the remedy. Anything
    else that is raised is a bug and keeps its traceback.
    """


def one_line(error: BaseException) -> str:
    """An error as one line: its message, or its type if it has none."""
    if isinstance(error, OSError) and error.strerror:
        names = [str(name) for name in (error.filename, error.filename2) if name is not None]
        text = ": ".join([" -> ".join(names), error.strerror] if names else [error.strerror])
    else:
        text = str(error)
    return " ".join(text.split()) or type(error).__name__
