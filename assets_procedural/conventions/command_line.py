"""What both commands share: one-line errors, log messages, missing extras."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable
from typing import Any

from typer import Abort, BadParameter

from assets_procedural.conventions import console
from assets_procedural.conventions.errors import UserError, one_line

EXTRAS = {
    "OpenImageIO": "render",
    "anny": "distill",
    "av": "train",
    "bpy": "render",
    "colour": "render",
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


def run(app: Callable[..., Any]) -> None:
    """Run a Typer app; user errors become one line on stderr and exit code 2."""
    set_up_logging()
    try:
        code = app(standalone_mode=False)
    except _UsageError as error:
        _end(_wrong_usage(error, sys.argv[1:]))
    except (Abort, KeyboardInterrupt):
        code = 130
    except (UserError, OSError) as error:
        _end(one_line(error))
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        _end(_remedy(str(error.name), extra))
    if code == 130:
        console.stderr().print("interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def _wrong_usage(error: Any, arguments: list[str]) -> str:
    """What Typer says of a command line, led by the option and its value."""
    if not arguments:  # the help, as `no_args_is_help` wants it
        error.show()
        sys.exit(error.exit_code)
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


def _remedy(module: str, extra: str) -> str:
    if module == "bpy" and sys.version_info[:2] != BLENDER_PYTHON:
        this = "{}.{}".format(*sys.version_info)
        return (
            f"rendering needs Blender's wheel, which is made for Python 3.11 and not for {this}: "
            "install totalediting[render] there"
        )
    return f"this needs {module}, which is not installed: pip install 'totalediting[{extra}]'"


def print_version(line: str) -> Callable[[bool], None]:
    """What an option --version does once it is given."""

    def answer(given: bool) -> None:
        if given:
            print(line)
            raise SystemExit(0)

    return answer


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
        level = (
            f"[bold yellow]{record.levelname.lower()}:[/] " if record.levelno > logging.INFO else ""
        )
        console.stderr().print(level + console.escape(record.getMessage()), soft_wrap=True)


def _end(line: str) -> None:
    console.stderr().print(f"[bold red]error:[/] {console.escape(line)}", soft_wrap=True)
    sys.exit(2)
