"""What a command line printed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Answer:
    """What a command said."""

    returncode: int
    stdout: str
    stderr: str

    @property
    def error(self) -> str:
        """The one line of a user's error."""
        assert self.returncode == 2, self.stderr
        assert self.stdout == ""
        assert self.stderr.startswith("error: ")
        assert self.stderr.count("\n") == 1, self.stderr
        return self.stderr.strip()
