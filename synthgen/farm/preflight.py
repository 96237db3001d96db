"""What can be known to go wrong before anything is rendered: panoramas, folder, disk, device."""

from __future__ import annotations

import importlib.util
import itertools
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from assets_procedural.conventions import console
from assets_procedural.conventions.panorama_reading import PanoramaError, read
from assets_procedural.light.pool import EnvironmentSpec, pool
from synthgen.dataset import ledger
from synthgen.dataset.folder import DatasetFolder
from synthgen.errors import JobError
from synthgen.farm import DEFAULT_RENDERER
from synthgen.farm.isolated import IsolatedError, isolated
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import Plan, subject_bytes, subject_key


def make_plan(job: JobSpec, file: str | Path) -> tuple[Plan, list[EnvironmentSpec]]:
    """The plan of a job and its pool of environments, which must be large enough.

    Looks at names and places of panoramas only; `check_panorama` reads one.
    """
    try:
        specs = list(pool(job.environments, job.seed))
    except PanoramaError as error:
        raise _panorama_error(error, job.environments.folder, file) from None
    except OSError as error:
        raise _unreadable(error, job.environments.folder, file) from None
    try:
        return Plan(job, [spec.id for spec in specs]), specs
    except JobError as error:
        raise JobError(file, error.field, error.value, error.remedy) from None


def check_panorama(spec: EnvironmentSpec, file: str | Path) -> None:
    """Read a user's panorama: it must be whole, float, 2:1, finite and not black."""
    if spec.path is not None:
        try:
            read(spec.path, **spec.parameters)
        except PanoramaError as error:
            raise _panorama_error(error, spec.path, file) from None
        except OSError as error:
            raise _unreadable(error, spec.path, file) from None


def check_panoramas(environments: list[EnvironmentSpec], out: Path, file: str | Path) -> None:
    """Read the user's own panoramas, except those that the dataset holds already."""
    folder = DatasetFolder(out)
    unseen = [e for e in environments if e.kind == "file" and not folder.environment(e.id).exists()]
    for environment in console.track(unseen, "reading panoramas"):
        check_panorama(environment, file)


def check_output(out: Path) -> None:
    """`out` must be a folder, or may become one, that can be written into.

    Whether it holds another job is found by `synthgen.publish.publish.begin`.
    """
    existing = _existing_parent(out)
    if not existing.is_dir():
        which = "it" if existing == out.absolute() else str(existing)
        raise JobError("--out", "", str(out), f"{which} is a file; give another folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        remedy = f"{existing} is not writable; change its rights or give another folder"
        raise JobError("--out", "", str(out), remedy)


def check_disk(
    out: Path, job: JobSpec, slice_: tuple[int, int] = (1, 1), limit: int | None = None
) -> None:
    """Room for what a run is still to write, and a tenth more.

    The run renders slice `slice_` = (i, n) and at most `limit` subjects.
    """
    missing = sum(itertools.islice(_missing(out, job, slice_), limit))
    needed = 1.1 * missing
    free = shutil.disk_usage(_existing_parent(out)).free
    if needed > free:
        raise JobError(
            "--out",
            "",
            str(out),
            f"too little disk: about {needed / 1e9:.1f} GB needed, {free / 1e9:.1f} GB free; "
            "free some, give another disk, or split the job by --shard",
        )


def _missing(out: Path, job: JobSpec, slice_: tuple[int, int]) -> Iterator[int]:
    """Expected bytes of every subject of a slice that is not on disk, in the order of a run."""
    folder = DatasetFolder(out)
    # What a shard holds does not depend on the environments.
    the_plan = Plan(job, [""] * max(s.environments for s in job.subsets.values()))
    every = [shard for name in job.subsets for shard in the_plan.shards(name)]
    for shard in every[slice_[0] - 1 :: slice_[1]]:
        if ledger.shard_record(folder, shard.name) is None:
            size = subject_bytes(job, job.subsets[shard.subset])
            for index in shard.subjects:
                rows = folder.subject(shard.subset, subject_key(index)).waiting_rows
                if not os.path.exists(rows):
                    yield size


def check_renderer(renderer: str) -> None:
    """Raises `ModuleNotFoundError` that names bpy if `renderer` takes it and it is not installed.

    Each worker would find out for itself, after the dataset's folder was begun.
    """
    if renderer == DEFAULT_RENDERER and importlib.util.find_spec("bpy") is None:
        raise ModuleNotFoundError("No module named 'bpy'", name="bpy")


def check_device(device: str) -> None:
    """`device` must be one that Blender sees here. Starts Blender in a process unless it is cpu."""
    if device == "cpu":
        return
    check_renderer(DEFAULT_RENDERER)
    try:
        isolated(_choose_device, device, time_limit=180)
    except IsolatedError as error:
        reason = str(error).removeprefix("RuntimeError: ")
        raise JobError("--device", "", device, reason) from None


def _choose_device(device: str) -> None:
    """Runs in its own process."""
    from synthgen.stage.scene import choose_device

    choose_device(device)


def parse_shard(text: str) -> tuple[int, int]:
    """ "i/n" with 1 <= i <= n, as `--shard` takes it."""
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if match is None:
        raise JobError("--shard", "", text, "write i/n, for example 1/4 to 4/4 on four machines")
    index, count = int(match[1]), int(match[2])
    if not 1 <= index <= count:
        raise JobError("--shard", "", text, "i runs from 1 to n; write for example 1/4 to 4/4")
    return index, count


def parse_duration(text: str) -> float:
    """ "90m", "12h", "7d" or "2w" to hours, as `--within` takes it."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([mhdw])", text.strip())
    hours = float(match[1]) * {"m": 1 / 60, "h": 1, "d": 24, "w": 168}[match[2]] if match else 0.0
    if hours <= 0.0:
        raise JobError("--within", "", text, "write a time such as 12h, 7d or 2w")
    return hours


def _panorama_error(error: PanoramaError, path: Path | None, file: str | Path) -> JobError:
    """Name the field: the folder if the message speaks of a path in it, else the bundled ones."""
    message = " ".join(str(error).split())
    if path is not None and message.startswith(f"{path}: "):
        remedy = message.removeprefix(f"{path}: ")
        return JobError(file, "environments.folder", f'"{path}"', remedy)
    return JobError(file, "environments.bundled", "", message)


def _unreadable(error: OSError, path: Path | None, file: str | Path) -> JobError:
    reason = error.strerror or str(error)
    remedy = f"cannot be read ({reason}); change its rights or give another"
    field = "environments.folder" if path is not None else "environments.bundled"
    return JobError(file, field, f'"{path}"' if path is not None else "", remedy)


def _existing_parent(path: Path) -> Path:
    path = path.absolute()
    # Not Path.exists, which raises where a parent may not be entered.
    while not os.path.exists(path):
        path = path.parent
    return path
