"""CONTRIBUTING.md, "Add a training stage", followed to the letter on a copy of the package."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import indent

import pytest

ROOT = Path(__file__).parents[2]
RECIPE = (
    (ROOT / "CONTRIBUTING.md").read_text().split("## Add a training stage\n")[1].split("\n## ")[0]
)


MAIN = """
import json, sys
from totalediting.cli import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["totalediting", *arguments]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
"""


@pytest.fixture
def totalediting(tmp_path: Path) -> Callable[..., list[str]]:
    """Runs commands of `totalediting` with the recipe's stage; gives the lines they print."""
    package = tmp_path / "totalediting"
    shutil.copytree(ROOT / "totalediting", package, ignore=shutil.ignore_patterns("__pycache__"))
    (file,) = re.findall(r"call it `totalediting/(.*?)`", RECIPE)
    module, stage, figure = re.findall(r"```python\n(.*?)```", RECIPE, re.DOTALL)
    (package / file).write_text(module)
    _append(package / "training/stages.py", "    )\n}\n", indent(stage.rstrip() + ",\n", " " * 8))
    _append(package / "training/figures.py", "}\n", indent(figure, " " * 4))
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    environment = os.environ | {"PYTHONPATH": paths}

    def run(*commands: tuple[object, ...]) -> list[str]:
        lines = [list(map(str, command)) for command in commands]
        done = subprocess.run(
            [sys.executable, "-c", MAIN, json.dumps(lines)],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    return run


def test_the_stage_is_trained_resumed_and_measured(
    totalediting: Callable[..., list[str]], small_dataset: Path, tmp_path: Path
) -> None:
    train = ("train", "colour", small_dataset, "--out", "run", "--batch", 2, "--workers", 0)
    train = (*train, "--steps", 3)
    *trained, measured = totalediting(train, train, ("evaluate", "run", small_dataset))
    assert len(trained) == 2 and trained[0] == trained[1]
    for line in (trained[0], measured):
        assert line.startswith("colour: colour, mean squared error: ")
    assert (tmp_path / "run" / "colour" / "best.json").exists()


def _append(file: Path, end: str, entry: str) -> None:
    """Add an entry to the first table of a file, which ends so."""
    before, after = file.read_text().split("\n" + end, 1)
    file.write_text(f"{before}\n{entry}{end}{after}")
