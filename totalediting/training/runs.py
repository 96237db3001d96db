"""A run: its stages in order, on a CPU two at a time where neither needs the other.

A second core helps the small networks of `tiny` little: two stages on a core each finish sooner
than one after the other on both.
"""

from __future__ import annotations

import errno
import logging
import os
import pkgutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import torch

from assets_procedural.conventions.command_line import set_up_logging
from totalediting.errors import InputError
from totalediting.presets import preset_with
from totalediting.training import checkpoints, loop, stages
from totalediting.training.loop import Machine
from totalediting.training.stage import RealVideo, Stage, StageSettings

log = logging.getLogger(__name__)

PROCESSES = 2
"""Stages that train at the same time on a CPU."""

Figures = dict[str, float]
"""Of a validation, see `figures`."""


@dataclass(frozen=True)
class RunSettings:
    """Data, place and manner of training: the same for every stage of a run."""

    data: Path
    run: Path
    """Each stage is trained in a folder of its name in it."""
    preset: str
    switches: list[str]
    """Of the preset, see `presets.preset_with`."""
    schedule: dict[str, float]
    """Fields of `stages.Schedule` that replace the stage's own."""
    seed: int
    workers: int
    """Processes that read data, of each stage."""
    machine: Machine
    real: RealVideo | None
    """Real clips for the stage `joint`."""


def build(name: str, settings: StageSettings) -> Stage:
    """The stage of that name in `stages.STAGES`.

    Raises:
        InputError: no dataset there, one of another format, or an empty split.
    """
    return pkgutil.resolve_name(stages.STAGES[name].build)(settings)


def train_all(settings: RunSettings) -> dict[str, Figures]:
    """Train all stages, or resume them; gives the figures of each.

    Raises:
        InputError: see `train_stage`; the other stages stop where they are.
    """
    threads = torch.get_num_threads() // PROCESSES
    one_by_one = settings.machine.device != "cpu" or settings.machine.devices > 1 or not threads
    found: dict[str, Figures] = {}
    for names in stages.waves():
        if one_by_one or len(names) == 1:
            found |= {name: train_stage(name, settings) for name in names}
        else:
            found |= _side_by_side(names, settings, threads)
    return found


def train_stage(name: str, settings: RunSettings) -> Figures:
    """Train one stage, or resume it; gives the figures of its last validation.

    Raises:
        InputError: no such dataset, one of another format, a split without shots; the folder holds
            another run; a stage that it needs was not trained there; the disk is full.
    """
    spec = stages.STAGES[name]
    preset = preset_with(settings.preset, settings.switches)
    schedule = replace(spec.schedule, **settings.schedule)  # pyright: ignore[reportArgumentType]
    folder = spec.folder(settings.run)
    for needed in spec.needs:
        _check_preset(stages.STAGES[needed].folder(settings.run), settings.preset)
    torch.manual_seed(settings.seed)
    stage = build(
        name,
        StageSettings(
            settings.data,
            preset,
            settings.run,
            schedule.steps,
            settings.seed,
            settings.workers,
            settings.real,
        ),
    )
    facts: dict[str, Any] = {
        "stage": name,
        "preset": settings.preset,
        "set": sorted(settings.switches),
        "data": str(settings.data.resolve()),
        **stage.facts,
    }
    if checkpoints.latest(folder) is None:
        stage.start_from(settings.run)
    for term, reason in stage.off.items():
        log.info("%s: without %s: %s", name, term, reason)
    try:
        figures = loop.train(stage, folder, schedule, settings.seed, facts, settings.machine)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        raise InputError(
            f"{folder}: cannot be written to ({error.strerror}); free disk space and run the "
            "same command again: training resumes from the last checkpoint"
        ) from None
    for key, reason in stage.skipped.items():
        log.warning("%s: skipped %s: %s", name, key, reason)
    return figures


def evaluate(
    run: Path,
    data: Path,
    split: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Figures]:
    """Figures of every stage that was trained in `run`, on all of a split of any dataset.

    `progress` is called with stages (done, total).

    Raises:
        InputError: nothing was trained there, or there is no such dataset or split.
    """
    if not (trained := trained_in(run)):
        raise InputError(f"{run}: nothing was trained there; train it first")
    found = {}
    for spec in trained:
        progress(len(found), len(trained))
        folder = spec.folder(run)
        config, preset = checkpoints.read_config(folder), checkpoints.preset_of(folder)
        settings = StageSettings(Path(config["data"]), preset, run, config["steps"])
        stage = build(spec.name, settings)
        stage.validate_on(data, split)
        checkpoints.load_best(folder, stage.network)
        with torch.no_grad():
            found[spec.name] = stage.validate(stage.network.eval()).figures
    return found


def trained_in(run: Path) -> list[stages.StageSpec]:
    """The stages that have something to use in a run's folder, which need not be there."""
    specs = stages.STAGES.values()
    return [s for s in specs if checkpoints.best_step(s.folder(run)) is not None]


def _side_by_side(
    names: tuple[str, ...], settings: RunSettings, threads: int
) -> dict[str, Figures]:
    context = get_context("spawn")
    with ProcessPoolExecutor(PROCESSES, context, _begin_process, (threads,)) as pool:
        try:
            jobs = {pool.submit(train_stage, name, settings): name for name in names}
            found = {jobs[job]: job.result() for job in as_completed(jobs)}
        except BaseException as error:  # the others need not finish
            pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():
                child.terminate()
            if not isinstance(error, BrokenProcessPool):
                raise
            raise InputError(
                f"{settings.run}: a training process was killed; if memory ran out, give a "
                "smaller --batch; the same command again resumes from the last checkpoints"
            ) from None
    return {name: found[name] for name in names}


def _begin_process(threads: int) -> None:
    """In a process of a pool: its share of the cores, and no life beyond its parent's."""
    set_up_logging()
    torch.set_num_threads(threads)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _check_preset(folder: Path, preset: str) -> None:
    """What was trained in `folder`, if anything, has the sizes of `preset`."""
    if checkpoints.best_step(folder) is None:
        return
    before = checkpoints.read_config(folder)["preset"]
    if before != preset:
        raise InputError(
            f"{folder}: was trained with preset = {before}, not {preset}; give --preset {before}, "
            "or another --out"
        )
