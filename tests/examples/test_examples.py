"""What examples/ has runs, over the small dataset."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(*command: str | Path, **variables: str) -> str:
    done = subprocess.run(
        list(map(str, command)),
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("example", "arguments", "said"),
    [
        ("read_numpy.py", [], "the first is lit by "),
        ("read_torch.py", [], "pictures of (3, 48, 48), focal length "),
        ("read_webdataset.py", [], "more: (48, 48, 3), 3 parts, up to 1."),
        ("read_hugging_face.py", ["multiview"], ": (48, 48, 3), head at [-0."),
    ],
)
def test_it_reads_the_dataset(
    small_dataset: Path, tmp_path: Path, example: str, arguments: list[str], said: str
):
    variables = {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1"}
    lines = run(sys.executable, EXAMPLES / example, small_dataset, *arguments, **variables)
    assert said in lines


def test_every_reading_example_is_run():
    tested = {"read_numpy.py", "read_torch.py", "read_webdataset.py", "read_hugging_face.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested


def test_a_task_of_the_array_renders_its_slice(tmp_path: Path):
    # A `synthgen` that says how it was called: that the options exist, `--help` says.
    spy = tmp_path / "synthgen"
    spy.write_text('#!/bin/sh\necho "$@"\n')
    spy.chmod(0o755)
    said = run(
        EXAMPLES / "slurm_array.sh",
        PATH=f"{tmp_path}:{os.environ['PATH']}",
        JOB="paper",
        OUT="/data/paper",
        SLURM_ARRAY_TASK_ID="3",
        SLURM_ARRAY_TASK_COUNT="64",
        SLURM_CPUS_PER_TASK="16",
    )
    words = shlex.split(said)
    assert words[:4] == ["render", "paper", "--out", "/data/paper"]
    assert words[words.index("--shard") + 1] == "3/64"
    help_text = run(
        sys.executable, "-c", "from synthgen.cli import main; main()", "render", "--help"
    )
    assert {word for word in words if word.startswith("--")} <= set(help_text.split())
