"""A function in a process of its own, with a time limit and a log: for whatever loads Blender."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from assets_procedural.conventions.errors import UserError
from synthgen.farm.process import begin_process, end_process, reason_of, reason_of_death, start
from synthgen.farm.temporary import temporary_folder

T = TypeVar("T")


class IsolatedError(UserError, RuntimeError):
    """The function raised, took too long, or its process died; the message is one line."""


@dataclass(frozen=True)
class Value:
    """What the function returned or, if it is a generator, yielded."""

    value: Any


@dataclass(frozen=True)
class Finished:
    """No value follows."""


@dataclass(frozen=True)
class Raised:
    """An exception, as one line."""

    reason: str


def isolated(
    function: Callable[..., T], *arguments: Any, time_limit: float, log: Path | None = None
) -> T:
    """`function(*arguments)`, called in a spawned process that ends with this one.

    Function, arguments and value are pickled. What the process prints is appended to `log`, or is
    forgotten. After `time_limit` seconds the process is killed.

    Raises `IsolatedError` if the function raises, takes longer, or its process dies.
    """
    with closing(_values(_call, function, arguments, time_limit, log)) as values:
        return next(values)


def isolated_steps(
    function: Callable[..., Iterator[T]],
    *arguments: Any,
    time_limit: float,
    log: Path | None = None,
) -> Generator[T, None, None]:
    """What the generator `function(*arguments)` yields, as `isolated`; the limit is of each step.

    The process is killed when the generator is closed.
    """
    return _values(_iterate, function, arguments, time_limit, log)


def _values(
    body: Callable[..., None],
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    time_limit: float,
    log: Path | None,
) -> Generator[Any, None, None]:
    with temporary_folder() as folder:
        log = log or folder / "log.txt"
        ours, theirs = get_context("spawn").Pipe(duplex=False)
        process = start(body, function, arguments, theirs, log, folder)
        theirs.close()
        try:
            while True:
                if not ours.poll(time_limit):
                    raise IsolatedError(f"took more than {time_limit:.0f} s")
                try:
                    message = ours.recv()
                except (EOFError, OSError):
                    process.join(5)
                    death = reason_of_death(process.exitcode)
                    raise IsolatedError(f"its process {death}: {_last_line(log)}") from None
                match message:
                    case Value(value):
                        yield value
                    case Raised(reason):
                        raise IsolatedError(reason)
                    case Finished():
                        return
        finally:
            process.kill()
            process.join()
            ours.close()


def _call(
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    pipe: Connection,
    log: Path,
    scratch: Path,
) -> None:
    _iterate(lambda *given: iter([function(*given)]), arguments, pipe, log, scratch)


def _iterate(
    function: Callable[..., Iterator[Any]],
    arguments: tuple[Any, ...],
    pipe: Connection,
    log: Path,
    scratch: Path,
) -> None:
    """Body of the process."""
    begin_process(log, scratch)
    try:
        for value in function(*arguments):
            pipe.send(Value(value))
        pipe.send(Finished())
    except Exception as error:
        traceback.print_exc()
        pipe.send(Raised(reason_of(error)))
    end_process(0)


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").split("\n") if log.exists() else []
    said = [line.strip() for line in lines if line.strip()]
    return said[-1][:200] if said else "it said nothing"
