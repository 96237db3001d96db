"""Seconds that editing a photograph takes, by part: first, and with what is kept.

    python benchmarks/editing.py PORTRAIT.png --motion DRIVER.png --lighting PANORAMA.exr

Prints a Markdown table of medians over `--rounds` in CPU seconds of this process, on one thread.
Needs the extra `edit`.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from totalediting import Editor
from totalediting.editing import compose
from totalediting.editing.sources import read_photograph
from totalediting.editing.subject import subject_of
from totalediting.editing.warping import warp
from totalediting.editing.warping.bust import bust_of


def cpu_seconds(work: Callable[[], object], rounds: int) -> float:
    """Median over rounds."""
    taken = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return statistics.median(taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("portrait", type=Path)
    parser.add_argument("--motion", type=Path, required=True)
    parser.add_argument("--lighting", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rounds = arguments.rounds

    rows: dict[str, float] = {}
    start = time.process_time()
    editor = Editor.load()
    rows["networks and head model, once"] = time.process_time() - start
    start = time.process_time()
    subject = editor.subject(arguments.portrait)
    driver = editor.face(arguments.motion).tracking
    editor.edit(arguments.portrait, driver, arguments.lighting, background="light")
    rows["the first picture"] = time.process_time() - start

    photograph = read_photograph(arguments.portrait)
    found = editor.face(arguments.portrait)
    rows["a face found and fitted"] = cpu_seconds(
        lambda: editor.tracker.pictures(iter([("", 0, photograph.picture)]), whole=False), rounds
    )
    rows["the photograph taken apart: mattes"] = cpu_seconds(
        lambda: subject_of(photograph, found, editor.matting), rounds
    )
    moved = editor.edit(arguments.portrait, driver).pose
    rows["warped into a pose"] = cpu_seconds(
        lambda: warp.repose(subject.portrait, bust_of(driver), moved.view), rounds
    )
    edited = editor.edit(arguments.portrait, driver, arguments.lighting)
    rows["put together"] = cpu_seconds(
        lambda: compose.composed(subject, edited.edit, edited.background), rounds
    )
    turns = iter(np.linspace(1, 350, 2 * rounds))
    rows["**a new pose, all in**"] = cpu_seconds(
        lambda: (
            editor.edit(
                arguments.portrait, driver, arguments.lighting, view=(float(next(turns)) / 20, 0)
            ).picture
        ),
        rounds,
    )
    rows["**the light turned, all in**"] = cpu_seconds(
        lambda: (
            editor.edit(
                arguments.portrait, driver, arguments.lighting, rotate_light=float(next(turns))
            ).picture
        ),
        rounds,
    )
    height, width = photograph.picture.shape[:2]
    print(f"{width} x {height} pixels, square of {len(subject.portrait.picture)}\n")
    print("| CPU seconds | |\n|---|---|")
    for name, seconds in rows.items():
        print(f"| {name} | {seconds:.2f} |")


if __name__ == "__main__":
    main()
