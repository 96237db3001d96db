"""Whether people at the ends of every range can be made: builds and renders them through the gate.

    python benchmarks/extremes.py [--people 500] [--first 0] [--resolution 64] [--workers 1]

Each person is drawn with the strongest shape and asymmetry a job may ask for, any age, and every
strength of skin, hair, eyes, brows, beard and body at one of its ends by chance; the pose is as far
as a job's poses go. Prints what was rejected and why, and who crashed; exit code 1 if anybody did.
`--first` with `--people` renders a part of the 500.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import report

from assets_procedural.light.pool import pool, write_pool
from assets_procedural.person import Person
from synthgen.dataset.gate import inspect
from synthgen.farm.process import redirect
from synthgen.planning.job import JobSpec, parse_job
from synthgen.planning.plan import Plan

# The ends of what is not a strength in [0, 1], by part of a person and name.
ENDS: dict[tuple[str, str], tuple[float, float]] = {
    ("hair", "parting"): (-1.0, 1.0),
    ("eyes", "pupil_mm"): (2.0, 6.0),
    ("beard", "length_mm"): (0.5, 24.0),
    ("skin", "moles"): (0, 12),
}
Finding = tuple[int, str]
PARTS = ("skin", "hair", "eyes", "brows", "beard")


def job_of(resolution: int, samples: int, people: int) -> JobSpec:
    """One picture of each of so many people, everything as strong as a job may ask."""
    return parse_job(
        {
            "name": "extremes",
            "resolution": resolution,
            "samples": samples,
            "subsets": {
                "extremes": {
                    "kind": "multiview", "subjects": people, "views": 1, "environments": 1
                }
            },
            "environments": {"bundled": ["studio"]},
            "people": {
                "age": [3, 95], "shape": 1.5, "asymmetry": 2.0, "mixed": 0.5, "glasses": 0.5,
                "sunglasses": 0.3, "hat": 0.25, "earrings": 0.8, "beard": 0.9,
            },
            "poses": {
                "expression": 1.0, "neutral": 0.0, "talking": 0.4, "closed_eyes": 0.1,
                "gaze_yaw": [-35, 35], "gaze_pitch": [-30, 30], "head_yaw": [-80, 80],
                "head_pitch": [-45, 45], "head_roll": [-45, 45],
            },
            "camera": {"yaw": [-90, 90], "pitch": [-40, 40]},
        },
        "extremes",
    )  # fmt: skip


def push(person: Person, rng: np.random.Generator) -> Person:
    """The same person with strengths at their ends."""
    data = person.model_dump()
    for part in PARTS:
        for name, value in data[part].items():
            if name == "seed" or isinstance(value, bool) or not isinstance(value, int | float):
                continue
            low, high = ENDS.get((part, name), (0.0, 1.0))
            # Where an end is not known the value has no upper one; it is left as drawn.
            if low <= value <= high and rng.random() < 0.6:
                data[part][name] = type(value)(low if rng.random() < 0.5 else high)
    for name in ("gender", "muscle", "weight", "height", "proportions"):
        if rng.random() < 0.6:
            data["phenotypes"][name] = float(rng.integers(2))
    return Person.model_validate(data)


def inspect_one(index: int, resolution: int, samples: int, folder: Path) -> list[str]:
    """What the gate has against a person's picture, a line each; whatever a crash raises."""
    from synthgen.stage.render import render_subject

    job = job_of(resolution, samples, index + 1)
    subject = Plan(job, ["studio"]).subject("extremes", index)
    person = push(subject.person, np.random.default_rng([3, index]))
    subject = subject.model_copy(update={"person": person})
    rendered = render_subject(subject, job, folder, "cpu", 1)
    return [problem for shot in rendered.shots for problem in inspect(shot)[0]]


def measure(
    indices: range, resolution: int, samples: int, workers: int
) -> tuple[list[Finding], list[Finding]]:
    """Every rejection and every crash."""
    rejected: list[Finding] = []
    crashed: list[Finding] = []
    job = job_of(resolution, samples, 1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_pool(pool(job.environments, job.seed), folder)
        with ProcessPoolExecutor(
            workers, get_context("spawn"), initializer=redirect, initargs=(folder / "log",)
        ) as workshop:
            found = [
                workshop.submit(inspect_one, index, resolution, samples, folder)
                for index in indices
            ]
            for index, future in zip(indices, found, strict=True):
                try:
                    rejected += [(index, problem) for problem in future.result()]
                except Exception as error:
                    crashed.append((index, f"{type(error).__name__}: {error}"))
                done = f"{index + 1 - indices.start} of {len(indices)} people"
                found_so_far = f"{len(rejected)} rejections, {len(crashed)} crashes"
                print(f"{done}, {found_so_far}", file=sys.stderr)
    return rejected, crashed


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name, value in (
        ("people", 500),
        ("first", 0),
        ("resolution", 64),
        ("samples", 2),
        ("workers", 1),
    ):
        parser.add_argument(f"--{name}", type=int, default=value, help=f"({value})")
    options = parser.parse_args()
    indices = range(options.first, options.first + options.people)
    rejected, crashed = measure(indices, options.resolution, options.samples, options.workers)
    kinds = Counter("".join(c for c in line if not c.isdigit()) for _, line in rejected)
    rows = [("people", options.people), ("crashed", len(crashed))]
    rows += [("rejected", len({index for index, _ in rejected}))]
    rows += [(f"… {kind}", count) for kind, count in kinds.most_common()]
    report.table(["figure", "people"], rows)
    for index, line in [*crashed, *rejected]:
        print(f"{index}: {line}")
    return int(bool(crashed))


if __name__ == "__main__":
    sys.exit(main())
