"""Runs: every stage is trained, no process lives on, and precision is what the processor has."""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import subprocess
import sys
import time
from graphlib import CycleError
from pathlib import Path

import pytest
import torch

from totalediting import cli
from totalediting.training import runs, stages
from totalediting.training.loop import fastest_precision

PARENT = """
import logging, multiprocessing, os, time
from totalediting.training import runs

def child(parent):
    runs._begin_process(1)
    logging.getLogger("totalediting.training").info("it began")
    parent.send(os.getpid())
    time.sleep(600)

if __name__ == "__main__":
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    context.Process(target=child, args=(theirs,)).start()
    print(ours.recv(), flush=True)
    time.sleep(600)
"""


def test_stages_train_after_those_that_they_need() -> None:
    waves = list(stages.waves())
    assert waves == [("reconstruct", "tracker", "lightmaps"), ("joint",)]
    trained: set[str] = set()
    for names in waves:
        assert all(set(stages.STAGES[name].needs) <= trained for name in names)
        trained |= set(names)
    assert trained == set(stages.STAGES)


def test_stages_that_need_each_other_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = dataclasses.replace(stages.STAGES["tracker"], needs=("joint",))
    monkeypatch.setitem(stages.STAGES, "tracker", tracker)
    with pytest.raises(CycleError):
        list(stages.waves())


def test_the_documentation_has_every_stage() -> None:
    page = (Path(__file__).parents[3] / "docs" / "model.md").read_text()
    (table,) = re.findall(r"^\| stage \| learns .*\n((?:\|.*\n)+)", page, re.MULTILINE)
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == set(stages.STAGES)


def test_naming_the_stages_imports_no_torch() -> None:
    code = "import sys, totalediting.training.stages; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_training_process_does_not_outlive_its_parent() -> None:
    """Else a killed run that is resumed would have two writers."""
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None and parent.stderr is not None
        child = int(parent.stdout.readline())
        assert parent.stderr.readline() == "it began\n", "it shows what libraries log"
        os.kill(child, 0)
        parent.send_signal(signal.SIGKILL)
    for _ in range(100):
        if not _lives(child):
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    pytest.fail("it lives on")


def _lives(pid: int) -> bool:
    """Whether a process runs; one that ended and that nobody waited for does not."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")")[-1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(
    ("can", "precision"),
    [({"avx2": True}, "32-true"), ({"avx512_bf16": True}, "bf16-mixed"), ({}, "32-true")],
)
def test_bfloat16_is_for_processors_that_have_it(
    monkeypatch: pytest.MonkeyPatch, can: dict[str, bool], precision: str
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: can, raising=False)
    assert fastest_precision("cpu") == precision


@pytest.mark.parametrize("can", [True, False])
def test_who_asks_a_processor_for_bfloat16_that_it_emulates_is_told(
    monkeypatch: pytest.MonkeyPatch, run_main, can: bool
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": can}, raising=False)
    monkeypatch.setattr(runs, "train_stage", lambda stage, settings: {})
    said = run_main(
        *(cli.main, "train", "tracker", "DATA", "--out", "RUN", "--precision", "bf16-mixed")
    )
    assert said.returncode == 0
    assert ("--precision: bf16-mixed: this processor emulates" in said.stderr) is not can
