"""A run: its stages in order, on a CPU side by side where they need nothing of each other.

A second core helps the small networks of `tiny` little: two stages on a core each are sooner done
than one after the other on both.
"""

from __future__ import annotations

import errno
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import torch

from totalediting.errors import InputError
from totalediting.presets import preset_with
from totalediting.training import checkpoints, loop, stages
from totalediting.training.joint import JointStage
from totalediting.training.loop import Machine

CHAINS = (("tracker", "lightmaps"), ("reconstruct",))
"""Stages in order; a chain needs nothing of another, and `joint` goes on from all of them."""


@dataclass(frozen=True)
class RunSettings:
    """What is trained on, where, and how: the same for every stage of a run."""

    data: Path
    run: Path
    """A stage is trained in its folder of that name in it."""
    preset: str
    switches: list[str]
    """Of the preset, see `presets.preset_with`."""
    schedule: dict[str, float]
    """Fields of `training.Schedule` that are not the stage's own."""
    seed: int
    workers: int
    """Processes that read data, of each stage."""
    machine: Machine
    clips: Path | None
    """Real clips for the stage `joint`, with the share of its steps and their light."""
    real_share: float
    real_light: str


def train_all(settings: RunSettings) -> None:
    """Train all stages, or go on where they stopped; prints how it goes.

    Raises:
        InputError: see `train_stage`; the other stages stop where they are.
    """
    threads = torch.get_num_threads() // len(CHAINS)
    if settings.machine.device != "cpu" or settings.machine.devices > 1 or not threads:
        for names in CHAINS:
            _train_chain(names, settings)
    else:
        _side_by_side(settings, threads)
    train_stage("joint", settings)


def train_stage(name: str, settings: RunSettings) -> None:
    """Train one stage, or go on where it stopped; prints how it goes.

    Raises:
        InputError: no such dataset, one of another format, a split without shots; the folder holds
            another run; `joint` finds no trained model there; the disk is full.
    """
    preset = preset_with(settings.preset, settings.switches)
    schedule = replace(stages.SCHEDULES[name], **settings.schedule)  # pyright: ignore[reportArgumentType]
    facts: dict[str, Any] = {
        "preset": settings.preset,
        "set": sorted(settings.switches),
        "data": str(settings.data.resolve()),
    }
    folder, real = settings.run / name, None
    torch.manual_seed(settings.seed)
    if name == "joint":
        for earlier in stages.STAGES:
            _check_preset(settings.run / earlier, settings.preset)
        if settings.clips is not None:
            share, light = settings.real_share, settings.real_light
            real = stages.real_clips(
                settings.clips, settings.run, preset, settings.seed, share, light
            )
            facts |= {"clips": str(settings.clips.resolve()), "real": share, "real light": light}
    made = stages.make(
        name, settings.data, preset, settings.seed, settings.workers, schedule.steps, real
    )
    if isinstance(made, JointStage):
        if checkpoints.latest(folder) is None:
            made.start_from(settings.run)
        for term, reason in made.off.items():
            print(f"without {term}: {reason}", flush=True)
    try:
        figures = loop.train(made, folder, schedule, settings.seed, facts, settings.machine)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        raise InputError(
            f"{folder}: cannot be written into ({error.strerror}); make room and run the "
            "same command again: it goes on from the last checkpoint"
        ) from None
    for figure, value in figures.items():
        print(f"{name}: {figure}: {value:.4g}", flush=True)
    for key, reason in made.skipped.items():
        print(f"skipped {key}: {reason}", flush=True)


def _train_chain(names: tuple[str, ...], settings: RunSettings) -> None:
    for name in names:
        train_stage(name, settings)


def _side_by_side(settings: RunSettings, threads: int) -> None:
    context = get_context("spawn")
    with ProcessPoolExecutor(len(CHAINS), context, _begin_process, (threads,)) as pool:
        try:
            for done in as_completed(
                [pool.submit(_train_chain, names, settings) for names in CHAINS]
            ):
                done.result()
        except BaseException as error:  # the others need not finish
            for child in active_children():
                child.terminate()
            if not isinstance(error, BrokenProcessPool):
                raise
            raise InputError(
                f"{settings.run}: a process that trained was killed; if memory was short, give a "
                "smaller --batch; the same command again goes on from the last checkpoints"
            ) from None


def _begin_process(threads: int) -> None:
    """In a process of a pool: its share of the cores, and no life beyond its parent's."""
    torch.set_num_threads(threads)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _check_preset(run: Path, preset: str) -> None:
    """What was trained in `run`, if anything, has the sizes of `preset`."""
    if checkpoints.best_step(run) is None:
        return
    before = checkpoints.read_config(run)["preset"]
    if before != preset:
        raise InputError(
            f"{run}: was trained with preset = {before}, not {preset}; give --preset {before}, or "
            "another --out"
        )
