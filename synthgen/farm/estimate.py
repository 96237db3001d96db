"""What a job amounts to: counts and bytes from its plan, hours from what rendering costs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from assets_procedural.conventions.console import count, size
from synthgen.farm import calibration
from synthgen.farm.calibration import Calibration, Found
from synthgen.planning.plan import Plan, subject_bytes

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class SubsetEstimate:
    """One subset. `hours` of one process (of `threads` threads), reckoned with `found`."""

    name: str
    kind: str
    subjects: int
    shots: int
    frames: int
    bytes: float
    hours: float
    found: Found


@dataclass(frozen=True)
class Estimate:
    """A whole job on machines like this one, with as many processes as fit its cores."""

    name: str
    resolution: int
    samples: int
    environments: int
    subsets: tuple[SubsetEstimate, ...]
    device: str
    threads: int
    cores: int

    @property
    def processes(self) -> int:
        """Processes that a machine runs at once: one on a GPU, else as many as cores allow."""
        return max(1, self.cores // self.threads) if self.device == "cpu" else 1

    @property
    def hours(self) -> float:
        """Hours of one process for everything."""
        return sum(s.hours for s in self.subsets)

    @property
    def elapsed_hours(self) -> float:
        """Hours that this machine takes."""
        return self.hours / self.processes

    def machines(self, within_hours: float) -> int:
        """Machines like this one that finish in time."""
        return max(1, math.ceil(self.elapsed_hours / within_hours))

    def total(self, what: str) -> float:
        """Sum of a figure over all subsets."""
        return sum(getattr(s, what) for s in self.subsets)


def estimate(
    plan: Plan, device: str, threads: int, renderer: str, named: Sequence[Calibration] = ()
) -> Estimate:
    """Estimate a plan by the best figures there are (see `calibration.find`).

    `named` are costs of a dataset that is to be taken (`synthgen.farm.recorded`).
    """
    job = plan.job
    subsets = []
    for name, spec in job.subsets.items():
        found = calibration.find(job, spec.kind, device, threads, renderer, named)
        measured = found.source != "reference"
        each = found.costs.bytes(spec) if measured else subject_bytes(job, spec)
        subsets.append(
            SubsetEstimate(
                name=name,
                kind=spec.kind,
                subjects=spec.subjects,
                shots=spec.subjects * spec.shots,
                frames=spec.subjects * spec.shots * spec.environments,
                bytes=spec.subjects * each,
                hours=found.costs.seconds(spec, job) * spec.subjects / 3600,
                found=found,
            )
        )
    return Estimate(
        name=job.name,
        resolution=job.resolution,
        samples=job.samples,
        environments=len(plan.environment_ids),
        subsets=tuple(subsets),
        device=device,
        threads=threads,
        cores=calibration.cores(),
    )


def as_json(result: Estimate, within_hours: float | None) -> dict[str, Any]:
    """An estimate as `synthgen plan --json` prints it, which lists the keys in its help."""
    return {
        "name": result.name,
        "resolution": result.resolution,
        "samples": result.samples,
        "environments": result.environments,
        "device": result.device,
        "threads": result.threads,
        "processes": result.processes,
        "subsets": [
            {
                "name": s.name,
                "kind": s.kind,
                "subjects": s.subjects,
                "shots": s.shots,
                "frames": s.frames,
                "bytes": round(s.bytes),
                "process_hours": s.hours,
                "costs": {
                    "source": s.found.source,
                    "exact": s.found.exact,
                    "dataset": s.found.measured.dataset or None,
                    "measured": s.found.measured.measured,
                },
            }
            for s in result.subsets
        ],
        "subjects": result.total("subjects"),
        "shots": result.total("shots"),
        "frames": result.total("frames"),
        "bytes": round(result.total("bytes")),
        "process_hours": result.hours,
        "elapsed_hours": result.elapsed_hours,
        "within_hours": within_hours,
        "machines": None if within_hours is None else result.machines(within_hours),
    }


def report(result: Estimate, within_hours: float | None, console: Console) -> None:
    """Print an estimate as a table and a few sentences."""
    from rich.table import Table

    table = Table(
        title=f"{result.name}: {result.resolution} x {result.resolution}, {result.samples} samples,"
        f" a pool of {result.environments} environments",
        title_justify="left",
    )
    unit = "core-hours" if result.device == "cpu" else f"{result.device}-hours"
    table.add_column("subset")
    for column in ("subjects", "shots", "frames", "size", unit):
        table.add_column(column, justify="right")
    cores_each = result.threads if result.device == "cpu" else 1

    rows = {s.name: partial(getattr, s) for s in result.subsets} | {"total": result.total}
    for name, figure in rows.items():
        if name == "total":
            table.add_section()
        counts = [f"{figure(what):,}" for what in ("subjects", "shots", "frames")]
        hours = f"{figure('hours') * cores_each:,.2f}"
        table.add_row(name, *counts, size(figure("bytes")), hours)
    console.print(table)
    for line in _sources(result):
        console.print(line, soft_wrap=True)
    how = f"{count(result.processes, 'process', 'processes')} of "
    how += f"{count(result.threads, 'thread')}, {result.device}"
    console.print(f"This machine ({how}) needs {_days(result.elapsed_hours / 24)}.")
    if within_hours is not None:
        needed = result.machines(within_hours)
        machines = count(needed, "machine")
        console.print(f"Within {_days(within_hours / 24)}: {machines} like this one.")
        if needed > 1:
            console.print(f"Give each its slice: --shard 1/{needed} to {needed}/{needed}.")


def _sources(result: Estimate) -> list[str]:
    """Where the hours come from: a line for each source, naming subsets where there are several."""
    by_line: dict[str, list[str]] = {}
    for s in result.subsets:
        by_line.setdefault(_source(s.found, result.device), []).append(s.name)
    if len(by_line) == 1:
        return list(by_line)
    return [f"{', '.join(names)}: {line}" for line, names in by_line.items()]


def _source(found: Found, device: str) -> str:
    measured = found.measured
    if found.source == "reference":
        measure = "add --calibrate to measure this machine, or --like DIR to go by a dataset"
        if device == "cpu":
            return f"Hours are reference figures, measured on {measured.machine}: {measure}."
        return f"Hours are an upper bound, measured without a GPU on {measured.machine}: {measure}."
    said = {
        "named": f"Hours are what {measured.dataset} took",
        "calibration": f"Hours as calibrated on this machine on {measured.measured}",
        "rendered": f"Hours are what {measured.dataset} took on this machine ({measured.measured})",
    }[found.source]
    if found.exact:
        return said + "."
    return (
        f"{said}, carried over from {measured.resolution} x {measured.resolution}, "
        f"{measured.samples} samples, {count(measured.threads, 'thread')}."
    )


def _days(days: float) -> str:
    if days >= 2:
        return f"{days:,.1f} days"
    return f"{days * 24:.1f} hours" if days >= 1 / 12 else f"{days * 1440:.0f} minutes"
