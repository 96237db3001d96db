"""What the benchmarks share: a clock, memory, tables."""

from __future__ import annotations

import mmap
import time
from types import ModuleType

import pytest


def test_the_clock_tells_waiting_from_work(report: ModuleType):
    with report.clock() as took:
        time.sleep(0.05)
    assert took.seconds >= 0.05 > took.cpu_seconds
    with report.clock() as took:
        start = time.process_time()
        while time.process_time() < start + 0.05:
            pass
    assert took.cpu_seconds >= 0.05


def test_the_peak_counts_what_is_no_longer_held(report: ModuleType):
    before = report.resident()
    # Not an array: whether its memory goes back to the system is the allocator's affair.
    with mmap.mmap(-1, 64_000_000) as memory:
        memory.write(bytes([1]) * len(memory))
        held = report.resident()
        assert held - before > 56
    assert report.resident() < held - 32
    assert report.peak() > held - 1


def test_a_table_is_markdown_where_no_terminal_shows_it(
    report: ModuleType, capsys: pytest.CaptureFixture[str]
):
    report.table(["what", "ms"], ([name, k] for k, name in enumerate(("read", "decode"))))
    lines = "| what | ms |", "| --- | --- |", "| read | 0 |", "| decode | 1 |"
    assert capsys.readouterr().out == "\n".join(lines) + "\n\n"
