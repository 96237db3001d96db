"""What the user can mend, in one line."""

from __future__ import annotations

from assets_procedural.conventions.errors import UserError


class InputError(UserError, ValueError):
    """A file or an option that cannot be used; the message names it, its fault and the remedy."""
