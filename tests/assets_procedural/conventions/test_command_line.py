"""What both commands share: one line for a user's error, a traceback for ours."""

from __future__ import annotations

import errno
import logging
from collections.abc import Callable

import pytest
from answer import Answer

from assets_procedural.conventions.command_line import run
from assets_procedural.conventions.errors import UserError, one_line


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


def test_an_error_without_a_message_says_what_it_is():
    assert one_line(ValueError()) == "ValueError"


def test_what_libraries_log_is_shown(run_main: Callable):
    def app() -> None:
        logging.getLogger("synthgen.somewhere").info("step 1 of 2")
        logging.getLogger("synthgen.somewhere").warning("slow [here]")
        raise SystemExit(0)

    answer: Answer = run_main(lambda: run(app))
    assert answer.stderr.splitlines() == ["step 1 of 2", "warning: slow [here]"]
