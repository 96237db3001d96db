"""The dataset's folder, from which alone files are served: paths are checked before opening.

Names come from addresses, from the manifest and from dataset.json, and none of them is trusted.
"""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

from assets_procedural.conventions.errors import UserError
from synthgen.dataset.folder import NAME, DatasetFolder, Place, StorageError, brief, not_a_name
from synthgen.dataset.records import description_json


class Refused(UserError):
    """A request that is refused: `status` is the HTTP status, `str()` one line for the user."""

    def __init__(self, reason: str, status: int = 404) -> None:
        self.status = status
        super().__init__(reason)


class Folder:
    """A dataset's folder; the folder itself may be a link, nothing below it may lead outside.

    `given` is its path as the user gave it, `layout` says where its files lie. With `hidden`, pages
    show a name in place of the path.
    """

    def __init__(self, root: Place, hidden: bool = False) -> None:
        self.given, self.hidden = Path(root), hidden
        self.layout = DatasetFolder(self.given.resolve())

    @property
    def shown(self) -> str:
        """The path, or what stands for it."""
        return "DATASET" if self.hidden else str(self.given)

    def without_paths(self, text: str) -> str:
        """Words for a page: where the path is hidden, without it."""
        if self.hidden:
            for path in sorted({str(self.layout.root), str(self.given)}, key=len, reverse=True):
                text = text.replace(path, self.shown)
        return text

    def file(self, wanted: str | Path) -> Path:
        """A regular file of the folder: a path of `layout`, or as manifests name it.

        Raises `Refused` for an absolute path, for `..`, for a symbolic link on the way, for what
        is missing, and for pipes, devices and folders.
        """
        name = self.layout.relative(wanted) if isinstance(wanted, Path) else wanted
        try:
            path = self.layout.inside(name)
        except StorageError as error:
            raise Refused(str(error)) from None
        link, mode = self._look(path, name)
        if link is not None:
            raise Refused(
                f"{brief(name)}: {brief(link.name)} is a symbolic link; only files that "
                "lie in the dataset's folder are shown"
            )
        if not stat.S_ISREG(mode):
            raise Refused(f"{brief(name)}: is not a regular file")
        return path

    def _look(self, path: Path, name: str) -> tuple[Path | None, int]:
        """The first symbolic link on the way to a path, and the mode of what was reached."""
        mode = 0
        try:
            for step in [*reversed(path.relative_to(self.layout.root).parents), path]:
                place = self.layout.root / step
                mode = place.lstat().st_mode
                if stat.S_ISLNK(mode):
                    return place, mode
        except (OSError, ValueError):
            raise Refused(f"{brief(name)}: no such file in the dataset") from None
        return None, mode

    def files(self, inside: Path, ending: str) -> list[Path]:
        """Regular files of a folder of `layout` with that ending, by name; links are left out."""
        try:
            found = sorted(inside.iterdir())
        except OSError:
            return []
        if inside.resolve() != inside:
            return []
        return [p for p in found if p.name.endswith(ending) and p.is_file() and not p.is_symlink()]

    def description(self) -> dict[str, Any]:
        """dataset.json, with subsets whose names are names.

        Raises `StorageError` with one line if the folder is no dataset or its file makes no sense.
        """
        path = self.layout.description
        try:
            self.file(path)
        except Refused as refusal:
            if path.is_symlink():
                raise StorageError(f"{self.given}: {refusal}") from None
        info = description_json(DatasetFolder(self.given))
        plan = info.get("plan") if isinstance(info, dict) else None
        if not isinstance(plan, dict) or not all(isinstance(p, dict) for p in plan.values()):
            raise StorageError(f"{self.given}/dataset.json: has no plan of subsets")
        for name in plan:
            if not NAME.fullmatch(name):
                raise StorageError(f"{self.given}/dataset.json: plan: {not_a_name(name, 'subset')}")
        return info


def name(text: str, what: str) -> str:
    """`text` if it is a name; raises `Refused` (400) otherwise."""
    if not NAME.fullmatch(text):
        raise Refused(not_a_name(text, what), 400)
    return text
