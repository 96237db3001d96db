"""How the command line speaks: consoles, progress, counts and figures for people."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import IO, TYPE_CHECKING, Any, NoReturn, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

Item = TypeVar("Item")

FIRST_LINE = 0.5
"""Seconds after which long work says for the first time how far it is."""
LINE_EVERY = 30.0
"""Seconds between its lines where stderr is no terminal."""
_CONTROL = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def stdout() -> Console:
    """Where answers go. What is printed is plain text: no markup, and `printable`."""
    # A pipe has no width of its own, and 80 columns would break tables and paths.
    return _console(highlight=False, width=None if sys.stdout.isatty() else 160)


def stderr() -> Console:
    """Where errors and progress go; as `stdout`."""
    return _console(stderr=True, highlight=False)


def _console(**options: bool | int | None) -> Console:
    from rich.console import Console
    from rich.text import Text

    class Plain(Console):
        """Takes every string for somebody else's words; `Text` is ours, and may have colours.

        Where nobody reads any more it is left to `command_line.run` to end.
        """

        def render_str(self, text: str, **options: Any) -> Text:
            return super().render_str(printable(text), **options)

        def on_broken_pipe(self) -> NoReturn:
            raise BrokenPipeError

    return Plain(markup=False, emoji=False, **options)  # pyright: ignore[reportArgumentType]


# ---------------------------------------------------------------- progress


def track(items: Iterable[Item], what: str, total: int | None = None) -> Iterator[Item]:
    """Hand out `items` and show how many are done; `total` is their number, by default `len`."""
    if total is None and hasattr(items, "__len__"):
        total = len(items)  # pyright: ignore[reportArgumentType]
    with progress(what, total) as advance:
        for done, item in enumerate(items):
            yield item
            advance(done + 1, total)


@contextlib.contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[int, int | None], None]]:
    """Show on stderr how far long work is; it calls what it gets with (done, total).

    A bar on a terminal, gone when the work ends; elsewhere a line at once and every `LINE_EVERY`
    seconds, whether or not anything was done meanwhile. Short work says nothing.
    """
    state, started = (0, total), time.monotonic()

    def shown() -> str:
        done, total = state
        elapsed = time.monotonic() - started
        if total is None:
            return f"{what}: {duration(elapsed)} so far"
        left = f", {duration(elapsed / done * (total - done))} left" if 0 < done < total else ""
        return f"{what}: {done:,} of {total:,}{left}"

    if not sys.stderr.isatty():
        with lines(shown):

            def note(done: int, total: int | None) -> None:
                nonlocal state
                state = (done, total)

            yield note
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        BarColumn(),
        TextColumn("{task.fields[text]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=stderr(), transient=True) as bar:
        task = bar.add_task("", total=total, text=printable(shown()))

        def update(done: int, total: int | None) -> None:
            nonlocal state
            state = (done, total)
            bar.update(task, completed=done, total=total, text=printable(shown()))

        yield update


@contextlib.contextmanager
def lines(text: Callable[[], str]) -> Iterator[None]:
    """Print `text()` on stderr after `FIRST_LINE` seconds and then every `LINE_EVERY`.

    It is called in a thread of its own.
    """
    ended = threading.Event()

    def speak() -> None:
        wait = FIRST_LINE
        while not ended.wait(wait):
            with contextlib.suppress(OSError, ValueError):  # nobody listens any more
                print(printable(text()), file=sys.stderr, flush=True)
            wait = LINE_EVERY

    speaker = threading.Thread(target=speak, daemon=True)
    speaker.start()
    try:
        yield
    finally:
        ended.set()
        speaker.join()


# ---------------------------------------------------------------- libraries


@contextlib.contextmanager
def without_chatter() -> Iterator[None]:
    """Keep off the terminal what a library prints in this thread: from C++, and by `print`.

    What other threads print in Python still arrives, as far as they look up `sys.stdout` or
    `sys.stderr` for it; what their C++ prints does not.
    """
    _chatter.enter()
    try:
        yield
    finally:
        _chatter.leave()


class _Chatter:
    """Leads file descriptor 2 into nothing while any thread is inside."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside: list[int] = []
        self._before: dict[str, Any] = {}
        self._instead: dict[str, Any] = {}
        # Opened once and never closed: another thread may be writing to it at any moment.
        self._aside: IO[str] | None = None

    def enter(self) -> None:
        with self._lock:
            self._inside.append(threading.get_ident())
            if len(self._inside) > 1:
                return
            self._before = {"stdout": sys.stdout, "stderr": sys.stderr}
            self._instead = {"stdout": sys.stdout and _Apart(sys.stdout, self._inside)}
            with contextlib.suppress(OSError):  # there is no stderr
                self._lead_away()
            for name, stream in self._instead.items():
                setattr(sys, name, stream)

    def _lead_away(self) -> None:
        if self._aside is None:
            self._aside = open(os.dup(2), "w", 1, errors="backslashreplace")  # noqa: SIM115
        os.dup2(2, self._aside.fileno())
        if _descriptor(sys.stderr) == 2:
            sys.stderr.flush()
        self._instead["stderr"] = self._aside if _descriptor(sys.stderr) == 2 else sys.stderr
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 2)
        os.close(nothing)

    def leave(self) -> None:
        with self._lock:
            self._inside.remove(threading.get_ident())
            if self._inside:
                return
            if self._aside is not None and "stderr" in self._instead:
                os.dup2(self._aside.fileno(), 2)
            for name, stream in self._instead.items():
                if getattr(sys, name) is stream:
                    setattr(sys, name, self._before[name])


class _Apart:
    """A stream that takes nothing from some threads."""

    def __init__(self, stream: Any, deaf_to: list[int]) -> None:
        self._stream, self._deaf_to = stream, deaf_to

    def write(self, text: str) -> int:
        if threading.get_ident() in self._deaf_to:
            return len(text)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _descriptor(stream: Any) -> int:
    """A stream's file descriptor, -1 if it has none."""
    try:
        return stream.fileno()
    except (AttributeError, OSError, ValueError):
        return -1


_chatter = _Chatter()


# ---------------------------------------------------------------- words


def say(answer: object) -> None:
    """Print an answer as it is, in as many lines as it has, but for what a terminal would obey."""
    print(printable(str(answer)), flush=True)


def printable(text: str) -> str:
    r"""Words of somebody else for a terminal: control characters as \x1b, so that it obeys none.

    So are the marks that turn the direction of writing, and half characters.
    """
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def count(number: int, what: str, several: str = "") -> str:
    """A number of things: 1 subject, 1,200 subjects; `several` is a plural that takes no s."""
    return f"{number:,} {what if number == 1 else several or what + 's'}"


def duration(seconds: float) -> str:
    """Seconds for people: 42 s, 7 min, 3 h 05 min."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def size(count: float) -> str:
    """Bytes for people: 3.2 GB."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 999.5 or unit == "TB":
            break
        count /= 1000
    return f"{count:.3g} {unit}" if count < 999.5 else f"{count:,.0f} {unit}"
