"""`python -m totalediting`: the command `totalediting`."""

from __future__ import annotations

from totalediting.cli import main

if __name__ == "__main__":
    main()
