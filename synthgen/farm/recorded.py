"""What rendering a dataset took, from the cost columns of its manifest: a measurement for free."""

from __future__ import annotations

import contextlib
import datetime
from typing import Any

import duckdb

from synthgen.dataset import manifest
from synthgen.dataset.database import quoted
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import read_description
from synthgen.farm import calibration
from synthgen.farm.calibration import Calibration, machine_name
from synthgen.planning.job import SubsetSpec
from synthgen.publish import publish

_SHOTS = 2000
"""So many shots of a subset are looked at: more tell no more."""
_LIGHT = "cost_beauty"
_ONCE = ("cost_build", "cost_subject")


def recorded_costs(out: Place, device: str, threads: int) -> list[Calibration]:
    """The costs of every kind of subset that a dataset holds.

    A manifest records neither machine, device nor threads: it is taken as rendered on this machine
    with those given, while as many processes ran as it did.

    Raises `StorageError` if `out` is no dataset, has no finished subject, or records no seconds.
    """
    folder = DatasetFolder(out)
    plan, renderer = publish.stored_plan(folder), read_description(folder).renderer
    found: dict[str, Calibration] = {}
    with manifest.connect(folder) as connection:
        tables = {
            name
            for (name,) in connection.execute("SELECT view_name FROM duckdb_views()").fetchall()
        }
        for name, spec in plan.job.subsets.items():
            if spec.kind in found or name not in tables:
                continue
            try:
                lights = calibration.lights_paid(plan.job, spec)
                figures = _figures(connection, name, spec, lights)
            except duckdb.Error as error:
                reason = " ".join(str(error).split())[:200]
                raise StorageError(f"{folder}: its manifest cannot be read: {reason}") from None
            if figures is not None:
                found[spec.kind] = Calibration(
                    machine=machine_name(),
                    renderer=renderer,
                    device=device,
                    threads=threads,
                    kind=spec.kind,
                    resolution=plan.job.resolution,
                    samples=plan.job.samples,
                    linear=plan.job.image.linear,
                    measured=datetime.date.today().isoformat(),
                    dataset=str(folder.root.absolute()),
                    **figures,
                )
    if not found:
        raise StorageError(f"{folder}: its manifest records no {_LIGHT}")
    return list(found.values())


def remember_costs(out: Place, device: str, threads: int) -> None:
    """For `plan`, what this run took; a cache that cannot be written spoils no rendering."""
    with contextlib.suppress(OSError, StorageError):
        calibration.save(recorded_costs(out, device, threads))


def _figures(
    connection: Any, subset: str, spec: SubsetSpec, lights: float
) -> dict[str, float] | None:
    """Means over the first shots of a subset; None if nobody noted what light took.

    `lights` are the passes of each, see `calibration.lights_paid`.
    """
    described = connection.execute(f"DESCRIBE {quoted(subset)}").fetchall()
    costs = [name for name, *_ in described if name.startswith("cost_")]
    if _LIGHT not in costs:
        return None
    # What is done once a shot, storing included; the rest of a subject's seconds are its own.
    shot = " + ".join(quoted(n) for n in costs if n not in (_LIGHT, *_ONCE))
    rendering = " + ".join(quoted(n) for n in costs if n not in (*_ONCE, "cost_store"))
    pictures = "[m.size FOR m IN members IF m.name[:3] IN ('rgb', 'hdr')]"
    row = connection.execute(
        f"""
        SELECT avg({_LIGHT}) / {lights}, avg({shot}),
               avg(greatest(cost_subject - {spec.shots} * ({rendering}), 0)),
               avg(size), avg(list_sum({pictures}))
        FROM (SELECT * FROM {quoted(subset)} LIMIT {_SHOTS})
        """
    ).fetchone()
    frame_s, shot_s, subject_s, shot_bytes, frame_bytes = row
    return {
        "subject_s": subject_s,
        "shot_s": shot_s,
        "frame_s": frame_s,
        "shot_bytes": shot_bytes - frame_bytes,
        "frame_bytes": frame_bytes / spec.environments,
    }
