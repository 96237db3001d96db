"""`python -m synthgen`: the command `synthgen`."""

from __future__ import annotations

from synthgen.cli import main

if __name__ == "__main__":
    main()
