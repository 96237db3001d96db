"""The jobs that come with the package (`render_jobs`): found by name, one line each."""

from __future__ import annotations

import difflib
from functools import cache
from importlib.resources import files
from pathlib import Path

from synthgen.errors import JobError

PACKAGE = "render_jobs"


@cache
def shipped_jobs() -> dict[str, Path]:
    """Name -> job file, in alphabetical order; empty where the package came without them."""
    try:
        folder = Path(str(files(PACKAGE)))
    except ModuleNotFoundError:
        return {}
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def job_file(job: str | Path) -> Path:
    """The file of a job that is given by its path, or by its name if it is a shipped one.

    What exists or ends in .toml is a path. Raises `JobError` that lists the names for any other.
    """
    path = Path(job)
    if path.suffix == ".toml" or path.is_file():
        return path
    known = shipped_jobs()
    if str(job) in known:
        return known[str(job)]
    near = difflib.get_close_matches(str(job), known, n=1)
    meant = f'did you mean "{near[0]}"? ' if near else ""
    listed = ", ".join(known) or "none are installed"
    remedy = f"no such job; {meant}shipped: {listed}; or give the path of a .toml file"
    raise JobError("JOB", "", str(job), remedy)


def purpose(file: Path) -> str:
    """What a job is for: the first sentence of the comment that its file starts with."""
    words: list[str] = []
    for line in file.read_text(encoding="utf-8").splitlines():
        text = line.removeprefix("#").strip()
        if not line.startswith("#") or not text:
            break
        words.append(text)
    sentence, _, _ = " ".join(words).partition(". ")
    return sentence.rstrip(".")
