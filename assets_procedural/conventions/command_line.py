"""What both commands share: one-line errors, log messages, missing extras."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import re
import select
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from typer import Abort, BadParameter, Option, Typer

from assets_procedural.conventions import console
from assets_procedural.conventions.errors import UserError, one_line, remedy

EXTRAS = {
    "OpenImageIO": "render",
    "ai_edge_litert": "edit",
    "anny": "distill",
    "av": "train",
    "bpy": "render",
    "colour": "render",
    "fastapi": "demo",
    "gradio": "demo",
    "lightning_fabric": "train",
    "safetensors": "train",
    "scipy": "render",
    "starlette": "browse",
    "tensorboard": "train",
    "torch": "model",
    "trimesh": "render",
    "uvicorn": "browse",
}
"""Modules that the core does without, and the extra that brings each."""
# Click's ClickException, which newer versions of Typer bring themselves.
_UsageError: type[Exception] = next(
    c for c in BadParameter.__mro__ if c.__name__ == "ClickException"
)
BLENDER_PYTHON = (3, 11)
"""The one Python that Blender's wheel is made for."""
INTERRUPTED, NOBODY_READS = 130, 141
"""Exit codes, as shells have them for SIGINT and SIGPIPE."""


def run(app: Callable[..., Any]) -> None:
    """Run a Typer app and end the process.

    What the user or the machine is to blame for becomes one line on stderr with its remedy and exit
    code 2; Ctrl-C is "interrupted" and 130; where nobody reads the answer any more (`| head`), the
    command ends in silence with 141, as a program that SIGPIPE kills. Our own faults keep their
    traceback.
    """
    _open_streams()
    set_up_logging()
    try:
        code = app(standalone_mode=False)
        sys.stdout.flush()
    except Exception as error:
        line = _user_line(error)
        if line is None:
            raise
        _end(line)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except SystemExit as error:  # Typer's help ends so with 1
        code = NOBODY_READS if _nobody_reads(unknown=False) else error.code
    if code == INTERRUPTED:
        _say("interrupted")
    _exit(code if isinstance(code, int) else 0)


@contextlib.contextmanager
def limited_memory(more: int) -> Iterator[None]:
    """Let this process take at most `more` bytes beyond what it has.

    What asks for more gets an error, where the system would end the process. Does nothing on
    systems that have no such limit, or that do not say what a process has.
    """
    try:
        import resource

        held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        before = resource.getrlimit(resource.RLIMIT_AS)
        most = held + more if before[0] < 0 else min(held + more, before[0])
        resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    except (ImportError, OSError, ValueError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _user_line(error: Exception) -> str | None:
    """What a user is told about an error, None if it is a fault of ours; some end the process."""
    match error:
        case _UsageError():  # pyright: ignore[reportGeneralTypeIssues]
            return _wrong_usage(error, sys.argv[1:])
        case UserError():
            return one_line(error)
        case BrokenPipeError() if _nobody_reads():
            _exit(NOBODY_READS)
        case OSError():
            return "; ".join(part for part in (one_line(error), remedy(error)) if part)
        case MemoryError():
            asked = f" ({one_line(error)})" if str(error) else ""
            return f"not enough memory{asked}; close other programs, or take a larger machine"
        case RecursionError():
            return f"what was read is nested too deeply ({one_line(error)}); flatten it"
        case UnicodeEncodeError():
            shown = json.dumps(str(error.object)[:80])
            return f"{shown}: is no text in {error.encoding}; give another name"
        case RuntimeError() if str(error).startswith("Symlink loop"):  # of Python before 3.13
            return f"{one_line(error)}; mend the links"
        case ValueError() if "embedded null" in str(error):
            return "a path holds a null byte; give another"
        case ModuleNotFoundError() if extra := EXTRAS.get((error.name or "").split(".")[0]):
            return _missing(str(error.name), extra)
    if isinstance(error, Abort) or _is_interrupt(error):
        _say("interrupted")
        _exit(INTERRUPTED)
    if _is_of_duckdb(error):
        return f"{one_line(error)[:400]}; `synthgen verify DIR` finds what is damaged"
    return None


def _nobody_reads(unknown: bool = True) -> bool:
    """Whether the other end of stdout is closed; `unknown` where stdout is no file."""
    try:
        ends = select.poll()
        ends.register(sys.stdout.fileno(), 0)
        return any(event & select.POLLERR for _, event in ends.poll(0))
    except (OSError, ValueError, AttributeError):  # no file, or no poll on this system
        return unknown


def _is_interrupt(error: Exception) -> bool:
    """Whether it is Ctrl-C as DuckDB reports it."""
    ours = type(error) is RuntimeError or _is_of_duckdb(error)
    return ours and "interrupted" in str(error).lower()


def _is_of_duckdb(error: Exception) -> bool:
    """Whether DuckDB raised it; its errors are about files and queries. Nothing is imported."""
    return any(c.__name__ == "Error" and "duckdb" in c.__module__ for c in type(error).__mro__)


def _wrong_usage(error: Any, arguments: list[str]) -> str:
    """What Typer says of a command line, led by the option and its value."""
    if not arguments:  # the help, as `no_args_is_help` wants it
        error.show()
        _exit(error.exit_code)
    text = " ".join(error.format_message().split())
    text = text.removesuffix(".").replace("Value error, ", "").replace("Input should be", "must be")
    text = text.split(", unable to parse")[0]
    if found := re.match(r"Invalid value for '([^' ]+)[^']*': (.*)", text):
        option, reason = found.groups()
        value = _value_of(option, arguments)
        return f"{option} = {value}: {reason}" if value is not None else f"{option}: {reason}"
    where = error.ctx.command_path if getattr(error, "ctx", None) else "the command"
    return f"{text[0].lower()}{text[1:]}; see {where} --help"


def _value_of(option: str, arguments: list[str]) -> str | None:
    for number, argument in enumerate(arguments):
        if argument.startswith(option + "="):
            return argument.removeprefix(option + "=")
        if argument == option and number + 1 < len(arguments):
            return arguments[number + 1]
    return None


def _missing(module: str, extra: str) -> str:
    if module == "bpy" and sys.version_info[:2] != BLENDER_PYTHON:
        this = "{}.{}".format(*sys.version_info)
        return (
            f"rendering needs Blender's wheel, which is made for Python 3.11 and not for {this}: "
            "install totalediting[render] there"
        )
    return f"this needs {module}, which is not installed: pip install 'totalediting[{extra}]'"


def add_version(app: Typer, line: str) -> None:
    """Give a command line the option --version, which prints `line`."""

    def show(given: bool) -> None:
        if given:
            print(line)
            raise SystemExit(0)

    help_ = "Print the version and exit."
    option = Option(False, "--version", help=help_, is_eager=True, callback=show)

    @app.callback()
    def program(version: bool = option) -> None:
        """Options of the program itself; its help is that of `app`."""


def set_up_logging() -> None:
    """Show log messages from INFO up on stderr; call it in every process that a command starts."""
    root = logging.getLogger()
    if not any(isinstance(handler, _ConsoleHandler) for handler in root.handlers):
        root.addHandler(_ConsoleHandler())
    for package in ("assets_procedural", "synthgen", "totalediting"):
        logging.getLogger(package).setLevel(logging.INFO)


class _ConsoleHandler(logging.Handler):
    """One unwrapped line per message; warnings and errors are marked as such."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno > logging.INFO:
            _say(record.getMessage(), f"{record.levelname.lower()}: ", "bold yellow")
        else:
            _say(record.getMessage())


def _open_streams() -> None:
    """Streams that take any text, also where they are closed (`>&-`) or know no UTF-8."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            # Names of files may be any bytes; JSON has the same escapes.
            stream.reconfigure(errors="backslashreplace")


def _end(line: str) -> NoReturn:
    _say(line, "error: ", "bold red")
    _exit(2)


def _say(line: str, mark: str = "", style: str = "") -> None:
    """Print a line on stderr, led by a coloured word."""
    from rich.text import Text

    with contextlib.suppress(OSError):  # stderr may be gone as well
        console.stderr().print(Text(mark, style) + Text(console.printable(line)), soft_wrap=True)


def _exit(code: int) -> NoReturn:
    """End the process; what cannot be written any more is dropped without a word."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)
