"""`UserError`: what the person at the keyboard can mend, told in one line."""

from __future__ import annotations


class UserError(Exception):
    """Base of all errors of the user's making.

    `str()` is one line that names the file, field or option, its value and the remedy. Anything
    else that is raised is a fault of the program, and keeps its traceback.
    """


def one_line(error: BaseException) -> str:
    """An error as one line: its message, or what it is where it has none."""
    if isinstance(error, OSError) and error.strerror:
        names = [str(name) for name in (error.filename, error.filename2) if name is not None]
        text = ": ".join([" -> ".join(names), error.strerror] if names else [error.strerror])
    else:
        text = str(error)
    return " ".join(text.split()) or type(error).__name__
