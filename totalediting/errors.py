"""What a user did wrong, in one line."""

from __future__ import annotations


class InputError(ValueError):
    """A file or an option that cannot be used; the message names it, its fault and the remedy."""
