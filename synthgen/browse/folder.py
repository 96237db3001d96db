"""The dataset's folder as the only place that is read: paths are checked before they are opened.

Names come from addresses, from the manifest and from dataset.json, and none of them is trusted.
"""

from __future__ import annotations

import json
import re
import stat
from pathlib import Path
from typing import Any

from synthgen.dataset import ledger

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}")
"""Subsets, keys of shots and subjects, environments, members: a name, never a path."""


class Refused(Exception):
    """A request that is not answered: `status` is HTTP's, `str()` one line for the user."""

    def __init__(self, reason: str, status: int = 404) -> None:
        self.status = status
        super().__init__(reason)


class Folder:
    """A dataset's folder; the folder itself may be a link, nothing below it may lead outside."""

    def __init__(self, root: Path | str) -> None:
        self.given = Path(root)
        self.root = self.given.resolve()

    def file(self, relative: str) -> Path:
        """The path of a regular file inside the folder, given relative to it with slashes.

        Raises `Refused` for an absolute path, for `..`, for a symbolic link on the way, for what
        is missing, and for pipes, devices and folders.
        """
        parts = relative.split("/")
        if "\0" in relative or "\\" in relative or any(p in ("", ".", "..") for p in parts):
            raise Refused(f"{_brief(relative)}: lies outside the dataset")
        path = self.root
        try:
            for part in parts:
                path = path / part
                mode = path.lstat().st_mode
                if stat.S_ISLNK(mode):
                    raise Refused(
                        f"{_brief(relative)}: {_brief(part)} is a symbolic link; only files that "
                        "lie in the dataset's folder are shown"
                    )
        except (OSError, ValueError):
            raise Refused(f"{_brief(relative)}: no such file in the dataset") from None
        if not stat.S_ISREG(mode):
            raise Refused(f"{_brief(relative)}: is no file")
        return path

    def files(self, relative: str, ending: str) -> list[Path]:
        """Regular files of a folder with that ending, by name; links are left out."""
        try:
            found = sorted((self.root / relative).iterdir())
        except OSError:
            return []
        inside = self.root / relative
        if inside.resolve() != inside:
            return []
        return [p for p in found if p.name.endswith(ending) and p.is_file() and not p.is_symlink()]

    def description(self) -> dict[str, Any]:
        """dataset.json, with subsets whose names are names.

        Raises `StorageError` with one line if the folder is no dataset or its file makes no sense.
        """
        try:
            self.file("dataset.json")
        except Refused as refusal:
            if (self.root / "dataset.json").is_symlink():
                raise ledger.StorageError(f"{self.given}: {refusal}") from None
        info = ledger.read_dataset_json(self.given)
        plan = info.get("plan") if isinstance(info, dict) else None
        if not isinstance(plan, dict) or not all(isinstance(p, dict) for p in plan.values()):
            raise ledger.StorageError(f"{self.given}/dataset.json: has no plan of subsets")
        for name in plan:
            if not NAME.fullmatch(name):
                raise ledger.StorageError(
                    f"{self.given}/dataset.json: plan: {json.dumps(name)[:60]}: "
                    "a subset's name has letters, digits, _, - and . only"
                )
        return info


def name(text: str, what: str) -> str:
    """`text` if it is a name; raises `Refused` (400) otherwise."""
    if not NAME.fullmatch(text):
        raise Refused(f"{what} {_brief(text)}: use letters, digits, _, - and . only", 400)
    return text


def _brief(text: str) -> str:
    return json.dumps(text if len(text) <= 80 else text[:77] + "...", ensure_ascii=False)
