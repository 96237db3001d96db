"""What a job amounts to: counts and bytes from its plan, core-hours from a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from assets_procedural.conventions.console import size
from synthgen.farm import calibration
from synthgen.planning.plan import Plan, subject_bytes

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class SubsetEstimate:
    """One subset. `hours` of one process (of `threads` threads) are None if nothing was measured;
    `exact` says whether resolution, samples and threads were measured as they are."""

    name: str
    kind: str
    subjects: int
    shots: int
    frames: int
    bytes: float
    hours: float | None
    exact: bool


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
    def hours(self) -> float | None:
        """Hours of one process for everything, or None if a kind was never measured."""
        parts = [s.hours for s in self.subsets]
        return None if None in parts else sum(h for h in parts if h is not None)

    def machines(self, within_hours: float) -> int | None:
        """Machines like this one that finish in time."""
        if self.hours is None:
            return None
        return max(1, math.ceil(self.hours / (self.processes * within_hours)))


def estimate(plan: Plan, device: str, threads: int, renderer: str) -> Estimate:
    """Estimate a plan by what was measured on this machine (see `synthgen.farm.calibration`)."""
    job = plan.job
    subsets = []
    for name, spec in job.subsets.items():
        found = calibration.find(job, spec.kind, device, threads, renderer)
        size = found[0].bytes(spec) if found else subject_bytes(job, spec)
        subsets.append(
            SubsetEstimate(
                name=name,
                kind=spec.kind,
                subjects=spec.subjects,
                shots=spec.subjects * spec.shots,
                frames=spec.subjects * spec.shots * spec.environments,
                bytes=spec.subjects * size,
                hours=found[0].seconds(spec) * spec.subjects / 3600 if found else None,
                exact=bool(found and found[1]),
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
    total = SubsetEstimate(
        "total",
        "",
        sum(s.subjects for s in result.subsets),
        sum(s.shots for s in result.subsets),
        sum(s.frames for s in result.subsets),
        sum(s.bytes for s in result.subsets),
        result.hours,
        all(s.exact for s in result.subsets),
    )
    for s in (*result.subsets, total):
        if s is total:
            table.add_section()
        hours = "not measured" if s.hours is None else f"{s.hours * cores_each:,.2f}"
        table.add_row(
            s.name, f"{s.subjects:,}", f"{s.shots:,}", f"{s.frames:,}", size(s.bytes), hours
        )
    console.print(table)
    if result.hours is None:
        console.print("Add --calibrate to measure what this takes on this machine.")
        return
    if not total.exact:
        console.print("Carried over from another resolution, samples or threads: --calibrate.")
    days = result.hours / result.processes / 24
    how = f"{result.processes} processes x {result.threads} threads, {result.device}"
    console.print(f"This machine ({how}) needs {_days(days)}.")
    if within_hours is not None:
        count = result.machines(within_hours)
        plural = "machine" if count == 1 else "machines"
        console.print(f"Within {_days(within_hours / 24)}: {count:,} {plural} like this one.")
        if count is not None and count > 1:
            console.print(f"Give each its slice: --shard 1/{count} to {count}/{count}.")


def _days(days: float) -> str:
    if days >= 2:
        return f"{days:,.1f} days"
    return f"{days * 24:.1f} hours" if days >= 1 / 12 else f"{days * 1440:.0f} minutes"
