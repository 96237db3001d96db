"""Benchmarks are programs, not a package: their folder goes on the path."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def report(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return _imported("report", monkeypatch)


@pytest.fixture
def realism(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return _imported("realism", monkeypatch)


def _imported(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module(name)
