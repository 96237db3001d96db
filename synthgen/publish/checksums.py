"""SHA256SUMS: the hash of every file of a finished dataset, which `sha256sum -c` reads as well.

Its last line, a comment to that program, is the hash of the lines above.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from assets_procedural.conventions.files import write_atomically

_LINE = re.compile(rb"([0-9a-f]{64})  ([^\n\\]+)\n")
_LAST = re.compile(rb"# ([0-9a-f]{64})\n")


def write(path: Path, hashes: dict[str, str]) -> None:
    """Write a list: path in the dataset -> sha256."""
    lines = "".join(f"{hashes[name]}  {name}\n" for name in sorted(hashes)).encode()
    last = f"# {hashlib.sha256(lines).hexdigest()}\n".encode()
    write_atomically(path, lines + last)


def read(path: Path) -> dict[str, str]:
    """The inverse of `write`; raises `ValueError` if the list is not as it was written."""
    *lines, last = path.read_bytes().splitlines(keepends=True) or [b""]
    seal = _LAST.fullmatch(last)
    if seal is None or seal[1].decode() != hashlib.sha256(b"".join(lines)).hexdigest():
        raise ValueError("changed since it was written")
    found = [_LINE.fullmatch(line) for line in lines]
    return {match[2].decode(): match[1].decode() for match in found if match is not None}
