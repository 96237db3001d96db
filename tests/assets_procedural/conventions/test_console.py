"""How far long work is, counts, and words that a terminal must not obey."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time

import pytest
from rich.table import Table

from assets_procedural.conventions import console


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "FIRST_LINE", 0.05)
    monkeypatch.setattr(console, "LINE_EVERY", 0.1)


def test_long_work_says_how_far_it_is_though_nothing_was_done(
    quick: None, capsys: pytest.CaptureFixture[str]
):
    for number in console.track(range(3), "exporting"):
        time.sleep(0.5 if number == 1 else 0.0)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 3
    assert all(line.startswith("exporting: 1 of 3, ") for line in lines)


def test_work_without_a_number_says_for_how_long_it_runs(
    quick: None, capsys: pytest.CaptureFixture[str]
):
    with console.progress("measuring"):
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line == "measuring: 0 s so far" for line in lines)
    assert "?" not in "".join(lines)


def test_short_work_says_nothing(capsys: pytest.CaptureFixture[str]):
    assert list(console.track(iter("ab"), "exporting", 2)) == ["a", "b"]
    assert capsys.readouterr().err == ""


def test_its_lines_come_soon_and_often():
    assert console.FIRST_LINE < 1.0
    assert console.LINE_EVERY <= 30.0


@pytest.mark.parametrize(
    ("number", "words", "said"),
    [
        (1, ("subject",), "1 subject"),
        (0, ("subject",), "0 subjects"),
        (1200, ("subject",), "1,200 subjects"),
        (1, ("person", "people"), "1 person"),
        (2, ("person", "people"), "2 people"),
    ],
)
def test_one_is_no_plural(number: int, words: tuple[str, ...], said: str):
    assert console.count(number, *words) == said


def test_a_terminal_obeys_no_data():
    assert console.printable("a\x1b[2J\x9b\rb") == "a\\x1b[2J\\x9b\\rb"


def test_a_console_takes_every_string_for_text(capsys: pytest.CaptureFixture[str]) -> None:
    words = "[/x][bold red]:smile:\x1b[2J\u202e"
    shown = "[/x][bold red]:smile:\\x1b[2J\\u202e"
    table = Table(words, title=words, box=None)
    table.add_row(words)
    for thing in (words, table):
        console.stdout().print(thing)
    console.say(words)
    printed = capsys.readouterr().out
    assert printed.count(shown) == 5 and "\x1b" not in printed


def test_a_library_is_not_heard_and_other_threads_are(capfd: pytest.CaptureFixture[str]):
    def other() -> None:
        print("other out", flush=True)
        print("other err", file=sys.stderr, flush=True)

    with console.without_chatter(), console.without_chatter():
        os.write(2, b"from C\n")
        print("from Python")
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    os.write(2, b"later C\n")
    print("later")
    assert capfd.readouterr() == ("other out\nlater\n", "other err\nlater C\n")


def test_progress_is_heard_while_a_library_is_not():
    """In a process of its own, whose `sys.stderr` is file descriptor 2."""
    program = """
import os, time
from assets_procedural.conventions import console
console.FIRST_LINE = 0.05
with console.progress("reading"), console.without_chatter():
    os.write(2, b"from C")
    time.sleep(0.5)
os.close(2)
with console.without_chatter():
    pass
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "reading: 0 s so far\n")
