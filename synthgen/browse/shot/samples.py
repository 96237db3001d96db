"""Members of a shot's sample, read by offset out of its shard; nothing else of it is read."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synthgen.browse.folder import Folder, Refused
from synthgen.dataset.shards import BLOCK

_MEMBERS = 4096
_LARGEST = 1 << 30
_PIECE = 1 << 20


class Broken(Exception):
    """A sample that cannot be read; `str()` says why in one line."""


@dataclass(frozen=True)
class Member:
    """A member of a sample: `size` bytes from byte `offset` of the shard."""

    name: str
    offset: int
    size: int


class Sample:
    """The bytes of one shot. Raises `Broken` if its shard is missing, cut, or not what it says."""

    def __init__(self, folder: Folder, row: dict[str, Any]) -> None:
        if row.get("failed"):
            raise Broken(f"failed: {row.get('reason') or 'no reason is recorded'}")
        shard, offset, size = row.get("shard"), row.get("offset"), row.get("size")
        if not (isinstance(shard, str) and isinstance(offset, int) and isinstance(size, int)):
            raise Broken("the manifest does not say where this shot is stored")
        try:
            self.path = folder.file(shard)
        except Refused as refusal:
            raise Broken(f"shard {refusal}") from None
        self.key = str(row["key"])
        self.offset = offset
        self.members = {m.name: m for m in _entries(self.path, offset, size, self.key)}

    def place(self) -> tuple[str, int, int, int]:
        """What tells these bytes from any others: path, time of change, size, offset."""
        seen = self.path.stat()
        return str(self.path), seen.st_mtime_ns, seen.st_size, self.offset

    def member(self, name: str) -> Member:
        """A member by name; raises `Refused` if the sample has none of that name."""
        found = self.members.get(name)
        if found is None:
            raise Refused(f"this shot has no {name[:80]}; it has {', '.join(self.members)}")
        return found

    def read(self, name: str) -> bytes:
        """The content of a member; raises as `member`."""
        return b"".join(self.stream(self.member(name)))

    def stream(self, member: Member) -> Iterator[bytes]:
        """The content of a member in pieces."""
        left = member.size
        with self.path.open("rb") as file:
            file.seek(member.offset)
            while left > 0 and (piece := file.read(min(left, _PIECE))):
                yield piece
                left -= len(piece)


def _entries(path: Path, offset: int, size: int, key: str) -> list[Member]:
    """The members between two bytes of a tar, from its headers alone."""
    found: list[Member] = []
    end = offset + size
    if offset < 0 or size <= 0 or path.stat().st_size < end:
        raise Broken(f"shard {path.name} is cut short: it ends before byte {end}")
    with path.open("rb") as file:
        while offset < end:
            file.seek(offset)
            try:
                info = tarfile.TarInfo.frombuf(file.read(BLOCK), "utf-8", "surrogateescape")
            except tarfile.HeaderError:
                raise Broken(f"shard {path.name}: no tar entry at byte {offset}") from None
            owner, _, name = info.name.partition(".")
            after = offset + BLOCK + info.size + (-info.size % BLOCK)
            if owner != key or not info.isreg() or not 0 <= info.size <= _LARGEST or after > end:
                raise Broken(f"shard {path.name}: byte {offset} is not a member of {key}")
            found.append(Member(name, offset + BLOCK, info.size))
            if len(found) > _MEMBERS:
                raise Broken(f"shard {path.name}: more than {_MEMBERS} members at byte {offset}")
            offset = after
    return found


class Health:
    """Whether shards are there and long enough, told by their size alone; remembers what it saw."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self._sizes: dict[str, int | str] = {}

    def reason(self, row: dict[str, Any]) -> str | None:
        """Why the row's sample cannot be read, or None."""
        if row.get("failed"):
            return f"failed: {row.get('reason') or 'no reason is recorded'}"
        shard, offset, size = row.get("shard"), row.get("offset"), row.get("size")
        if not (isinstance(shard, str) and isinstance(offset, int) and isinstance(size, int)):
            return "the manifest does not say where this shot is stored"
        if shard not in self._sizes:
            try:
                self._sizes[shard] = self.folder.file(shard).stat().st_size
            except (Refused, OSError) as error:
                self._sizes[shard] = f"shard {error}"
        length = self._sizes[shard]
        if isinstance(length, str):
            return length
        return None if length >= offset + size else f"shard {shard} is cut short"
