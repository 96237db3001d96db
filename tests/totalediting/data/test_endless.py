"""Processes that read data: their messages."""

from __future__ import annotations

import logging

import pytest

from totalediting.data import endless


def test_a_worker_that_inherits_no_handler_shows_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    endless._begin_worker(0)
    assert len(root.handlers) == 1


def test_a_worker_leaves_inherited_handlers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    root, own = logging.getLogger(), logging.NullHandler()
    monkeypatch.setattr(root, "handlers", [own])
    endless._begin_worker(0)
    assert root.handlers == [own]
