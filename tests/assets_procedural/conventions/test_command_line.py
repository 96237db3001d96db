"""What both commands share: one line for a user's error, a traceback for ours."""

from __future__ import annotations

import errno
import logging
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from answer import Answer

from assets_procedural.conventions import command_line
from assets_procedural.conventions.command_line import EXTRAS, run
from assets_procedural.conventions.errors import UserError, one_line

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
DISTRIBUTIONS = {"colour": "colour-science"}
"""Modules whose distribution has another name."""


def required(extra: str) -> set[str]:
    """The distributions that an extra names itself."""
    requirements = PROJECT["optional-dependencies"][extra]
    return {name(requirement) for requirement in requirements}


def name(requirement: str) -> str:
    match = re.match(r"[\w-]+", requirement)
    assert match is not None
    return match[0].lower().replace("_", "-")


def distribution(module: str) -> str:
    return DISTRIBUTIONS.get(module, module).lower().replace("_", "-")


def raising(error: Exception) -> Callable[[], None]:
    def app() -> None:
        raise error

    return lambda: run(app)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (UserError("job.toml: seed = x:\n give a [whole] number"), "give a [whole] number"),
        (FileNotFoundError(errno.ENOENT, "No such file", "a/b"), "error: a/b: No such file"),
        (OSError("a stream"), "error: a stream"),
        (ModuleNotFoundError(name="torch"), "pip install 'totalediting[model]'"),
        (ModuleNotFoundError(name="lightning_fabric.x"), "pip install 'totalediting[train]'"),
    ],
)
def test_what_a_user_can_mend_is_one_line(run_main: Callable, error: Exception, line: str):
    answer: Answer = run_main(raising(error))
    assert line in answer.error


@pytest.mark.parametrize("error", [ValueError("ours"), ModuleNotFoundError(name="typo")])
def test_what_is_our_fault_keeps_its_traceback(error: Exception):
    with pytest.raises(type(error)):
        raising(error)()


@pytest.mark.parametrize("module", EXTRAS)
def test_the_extra_that_is_named_brings_the_module(module: str):
    assert distribution(module) in required(EXTRAS[module])
    assert distribution(module) not in map(name, PROJECT["dependencies"])


@pytest.mark.parametrize("extra", sorted(set(EXTRAS.values())))
def test_all_that_an_extra_brings_is_known_by_its_name(extra: str):
    core = {*map(name, PROJECT["dependencies"]), name(PROJECT["name"])}
    assert required(extra) - core <= {distribution(module) for module in EXTRAS}


def test_on_another_python_the_line_says_which_one_blender_takes(
    run_main: Callable, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(command_line, "BLENDER_PYTHON", (3, 8))
    answer: Answer = run_main(raising(ModuleNotFoundError(name="bpy")))
    assert "not for 3." in answer.error


def test_an_error_without_a_message_says_what_it_is():
    assert one_line(ValueError()) == "ValueError"


def test_what_libraries_log_is_shown(run_main: Callable):
    def app() -> None:
        logging.getLogger("synthgen.somewhere").info("step 1 of 2")
        logging.getLogger("synthgen.somewhere").warning("slow [here]")
        raise SystemExit(0)

    answer: Answer = run_main(lambda: run(app))
    assert answer.stderr.splitlines() == ["step 1 of 2", "warning: slow [here]"]
