"""What both commands share: one-line errors, log messages, missing extras."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

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
BLENDER_PYTHON = (3, 11)
"""The one Python that Blender's wheel is made for."""


def run(app: Callable[[], None]) -> None:
    """Run a command line; user errors become one line on stderr and exit code 2."""
    set_up_logging()
    try:
        app()
    except (UserError, OSError) as error:
        _end(one_line(error))
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        _end(_remedy(str(error.name), extra))


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
