"""The recipe "Add a command" of CONTRIBUTING.md, followed in a copy of the package."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
RECIPE = (ROOT / "CONTRIBUTING.md").read_text().split("## Add a command\n")[1].split("\n## ")[0]
COMMAND, TEST = re.findall(r"```python\n(.*?)```", RECIPE, re.DOTALL)

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def synthgen(tmp_path: Path) -> Run:
    """Runs the command line of a copy of `synthgen` that has the recipe's command."""
    copy = tmp_path / "synthgen"
    shutil.copytree(ROOT / "synthgen", copy, ignore=shutil.ignore_patterns("__pycache__"))
    with (copy / "cli.py").open("a") as file:
        file.write(f"\n\n{COMMAND}")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}", "NO_COLOR": "1"}

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "synthgen", *map(str, arguments)],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_the_command_is_listed_and_answers(synthgen: Run, small_dataset: Path) -> None:
    assert re.search(r"splits +Count the people of every split\.", synthgen("--help").stdout)
    found: dict[str, Any] = {"Path": Path, "Synthgen": Run}
    exec(TEST, found)
    found["test_splits_hold_everybody"](synthgen, small_dataset)


def test_its_errors_are_one_line(synthgen: Run, tmp_path: Path) -> None:
    answer = synthgen("splits", tmp_path / "nothing")
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr == f"error: {tmp_path}/nothing: no dataset here (no dataset.json)\n"


def test_the_names_that_the_recipe_speaks_of_are_there() -> None:
    from assets_procedural.conventions import command_line, console, errors
    from synthgen import cli
    from synthgen import errors as ours
    from synthgen.dataset import ledger

    homes = (command_line, console, errors, cli, ours, ledger)
    for name in ("UserError", "JobError", "StorageError", "EXTRAS", "Device", "stdout", "main"):
        assert f"{name}" in RECIPE
        assert any(hasattr(home, name) for home in homes), name
