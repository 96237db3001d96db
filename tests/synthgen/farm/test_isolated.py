"""A function in a process of its own: its value or one error, whatever happens to the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assets_procedural.conventions.errors import UserError
from synthgen.errors import JobError
from synthgen.farm.isolated import IsolatedError, isolated, isolated_steps


def double(value: Any) -> tuple[Any, int]:
    print("doubling")
    return 2 * value, os.getpid()


def die() -> None:
    print("about to die", flush=True)
    os.kill(os.getpid(), signal.SIGKILL)


def sleep() -> None:
    time.sleep(60)


def fail() -> None:
    raise ValueError("no hair left\nand a second line")


def complain() -> None:
    raise JobError("--device", "", "cuda", "is not there")


def give_a_lambda() -> Any:
    return lambda: None


def count(pids: Path, stop: int) -> Iterator[int]:
    pids.write_text(str(os.getpid()))
    yield from range(stop)
    time.sleep(60)


def test_a_value_comes_back_from_another_process_and_what_it_prints_goes_to_the_log(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.txt"
    large = np.arange(300_000)
    value, pid = isolated(double, large, time_limit=60, log=log)
    assert (value == 2 * large).all()
    assert pid != os.getpid()
    assert log.read_text() == "doubling\n"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("function", "limit", "reason"),
    [
        (die, 60, "its process died of SIGKILL: about to die"),
        (sleep, 1.0, "took more than 1 s"),
        (fail, 60, "ValueError: no hair left"),
        (complain, 60, "--device: cuda: is not there"),
        (give_a_lambda, 60, "Can't pickle"),
    ],
)
def test_every_trouble_is_one_clear_error(function: Any, limit: float, reason: str) -> None:
    with pytest.raises(IsolatedError) as error:
        isolated(function, time_limit=limit)
    assert isinstance(error.value, UserError)
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


def test_steps_arrive_one_by_one_and_closing_ends_the_process(tmp_path: Path) -> None:
    pids = tmp_path / "pid"
    steps = isolated_steps(count, pids, 3, time_limit=60)
    assert [next(steps), next(steps)] == [0, 1]
    steps.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int(pids.read_text()), 0)


PARENT = """
import sys
from synthgen.farm.isolated import isolated
if __name__ == "__main__":
    isolated(exec, f"import os, time; open({sys.argv[1]!r}, 'w').write(str(os.getpid())); "
                   "time.sleep(60)", time_limit=60)
"""


def test_the_process_dies_with_its_parent(tmp_path: Path) -> None:
    pids, script = tmp_path / "pid", tmp_path / "parent.py"
    script.write_text(PARENT)
    parent = subprocess.Popen([sys.executable, str(script), str(pids)])
    try:
        assert waited_for(lambda: pids.exists() and pids.read_text())
    finally:
        parent.kill()
        parent.wait()
    assert waited_for(lambda: not is_alive(int(pids.read_text())))


def waited_for(truth: Callable[[], Any]) -> bool:
    """Whether something becomes true within half a minute."""
    deadline = time.monotonic() + 30
    while not truth() and time.monotonic() < deadline:
        time.sleep(0.05)
    return bool(truth())


def is_alive(pid: int) -> bool:
    """Whether a process runs; an orphan that nobody has waited for yet does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"


def test_the_limit_is_that_of_a_step(tmp_path: Path) -> None:
    steps = isolated_steps(count, tmp_path / "pid", 2, time_limit=2.0)
    with pytest.raises(IsolatedError, match="took more than 2 s"):
        list(steps)
