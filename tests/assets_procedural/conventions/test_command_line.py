"""What both commands share: one line for a user's error, a traceback for ours."""

from __future__ import annotations

import errno
import logging
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import duckdb
import pytest
import typer
from answer import Answer

from assets_procedural.conventions import command_line
from assets_procedural.conventions.command_line import EXTRAS, add_version, run
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


def raising(error: BaseException) -> Callable[[], None]:
    def app(standalone_mode: bool) -> None:
        raise error

    return lambda: run(app)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (UserError("job.toml: seed = x:\n give a [whole] number"), "give a [whole] number"),
        (FileNotFoundError(errno.ENOENT, "No such file", "a/b"), "error: a/b: No such file"),
        (OSError("a stream"), "error: a stream"),
        (MemoryError("asked for 5 GB"), "not enough memory (asked for 5 GB); close other"),
        (RecursionError("too deep"), "nested too deeply (too deep); flatten it"),
        (PermissionError(errno.EACCES, "denied", "x"), "x: denied; change its rights"),
        (OSError(errno.ENOSPC, "full", "x"), "x: full; make room, or give another place"),
        (IsADirectoryError(errno.EISDIR, "folder", "x"), "x: folder; give a file"),
        (NotADirectoryError(errno.ENOTDIR, "no folder", "x"), "x: no folder; give a folder"),
        (ValueError("embedded null byte"), "a path holds a null byte"),
        (RuntimeError("Symlink loop from 'x'"), "Symlink loop from 'x'; mend the links"),
        (UnicodeEncodeError("utf-8", "a\udcff", 1, 2, "no"), '"a\\udcff": is no text in utf-8'),
        (duckdb.IOException("no magic bytes in x"), "no magic bytes in x; `synthgen verify DIR`"),
        (ModuleNotFoundError(name="torch"), "pip install 'totalediting[model]'"),
        (ModuleNotFoundError(name="lightning_fabric.x"), "pip install 'totalediting[train]'"),
    ],
)
def test_what_a_user_can_mend_is_one_line(run_main: Callable, error: Exception, line: str):
    answer: Answer = run_main(raising(error))
    assert line in answer.error


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), RuntimeError("Query interrupted"), typer.Abort()]
)
def test_ctrl_c_is_one_word_wherever_it_comes_from(run_main: Callable, error: Exception):
    answer: Answer = run_main(raising(error))
    assert (answer.returncode, answer.stderr) == (130, "interrupted\n")


@pytest.mark.parametrize(
    ("command", "code"),
    # The help is printed by Typer, whose own way is 1.
    [("synthgen jobs", 141), ("synthgen plan demo", 141), ("totalediting --help", 1)],
)
def test_nobody_reads_any_more_and_nothing_is_said(command: str, code: int):
    # stdout is a pipe whose other end is closed, as `| head -1` leaves it.
    ours, theirs = os.pipe()
    os.close(ours)
    words = command.split()
    done = subprocess.run(
        [sys.executable, "-c", f"from {words[0]}.cli import main; main()", *words[1:]],
        stdout=theirs,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(theirs)
    assert (done.returncode, done.stderr) == (code, b"")


@pytest.mark.parametrize("redirection", [">&-", "> /dev/full"])
def test_an_answer_that_cannot_be_written_is_no_traceback(redirection: str):
    code = "from synthgen.cli import main; main()"
    command = f"{sys.executable} -c '{code}' jobs {redirection}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    if redirection == ">&-":
        assert (done.returncode, done.stderr) == (0, "")
    else:
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "No space left on device; make room" in done.stderr


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
    def app(standalone_mode: bool) -> None:
        logging.getLogger("synthgen.somewhere").info("step 1 of 2")
        logging.getLogger("synthgen.somewhere").warning("slow [here]")
        raise SystemExit(0)

    answer: Answer = run_main(lambda: run(app))
    assert answer.stderr.splitlines() == ["step 1 of 2", "warning: slow [here]"]


Level = Literal["low", "high"]


def toy() -> typer.Typer:
    app = typer.Typer(no_args_is_help=True)

    @app.command()
    def render(job: str, threads: int = 1, level: Level = "low") -> None:
        if job == "stop":
            raise KeyboardInterrupt

    @app.command()
    def check() -> None:
        raise typer.Exit(1)

    return app


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("render x --threads many", "error: --threads = many: must be a valid integer"),
        ("render x --threads=many", "error: --threads = many: must be a valid integer"),
        ("render x --level off", "error: --level = off: 'off' is not one of 'low', 'high'"),
        ("rendr x", "error: no such command 'rendr'"),
        ("render x --thread 2", "error: no such option: --thread"),
        ("render", "error: missing argument 'job'"),
    ],
)
def test_a_wrong_command_line_is_one_line(run_main: Callable, words: str, line: str):
    answer: Answer = run_main(lambda: run(toy()), *words.split())
    assert answer.error.startswith(line)


@pytest.mark.parametrize(
    ("words", "code", "line"),
    [("render x", 0, ""), ("check", 1, ""), ("render stop", 130, "interrupted\n")],
)
def test_a_command_ends_as_it_says(run_main: Callable, words: str, code: int, line: str):
    answer: Answer = run_main(lambda: run(toy()), *words.split())
    assert (answer.returncode, answer.stderr) == (code, line)


def test_the_version_is_printed_only_where_it_is_asked_for(run_main: Callable):
    app = toy()
    add_version(app, "synthgen 1.2")
    answer: Answer = run_main(lambda: run(app), "render", "x")
    assert (answer.returncode, answer.stdout) == (0, "")
    answer = run_main(lambda: run(app), "--version")
    assert (answer.returncode, answer.stdout) == (0, "synthgen 1.2\n")


@pytest.mark.parametrize(
    ("missing", "extra", "arguments"),
    [
        ("bpy", "render", "synthgen render demo --out OUT"),
        ("bpy", "render", "synthgen plan demo --calibrate"),
        ("uvicorn", "browse", "synthgen browse OUT"),
        ("torch", "model", "totalediting bake OUT.hdr --out OUT.exr"),
        ("torch", "model", "totalediting train lightmaps OUT --out OUT"),
        ("torch", "model", "totalediting evaluate OUT OUT"),
    ],
)
def test_a_missing_extra_is_one_line_before_anything_is_written(
    tmp_path: Path, missing: str, extra: str, arguments: str
):
    code = (
        f"import sys, runpy; sys.modules[{missing!r}] = None; "
        "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
    )
    words = arguments.replace("OUT", str(tmp_path / "out")).split()
    command = [sys.executable, "-c", code, *words]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 2, answer.stderr
    line = (
        f"error: this needs {missing}, which is not installed: pip install 'totalediting[{extra}]'"
    )
    assert answer.stderr == line + "\n"
    assert not list(tmp_path.iterdir())
