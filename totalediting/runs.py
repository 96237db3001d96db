"""A run: its stages in order, on a CPU side by side where they need nothing of each other.

A second core helps the small networks of `tiny` little: two stages on a core each are sooner done
than one after the other on both.
"""

from __future__ import annotations

import errno
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import torch

from totalediting import checkpoints, stages, training
from totalediting.errors import InputError
from totalediting.joint import JointStage
from totalediting.presets import preset_with
from totalediting.training import Machine

APART = (("tracker", "lightmaps"), ("reconstruct",))
"""Stages that need nothing of the others' stages; `joint` goes on from all of them."""


@dataclass(frozen=True)
class Order:
    """What is to be trained: any of the stages, with these settings."""

    data: Path
    run: Path
    """A stage is trained in its folder of that name in it."""
    preset: str
    switches: tuple[str, ...] = ()
    """Of the preset, see `presets.preset_with`."""
    schedule: tuple[tuple[str, float], ...] = ()
    """Fields of `training.Schedule` that are not the stage's own."""
    seed: int = 0
    workers: int = 1
    """Processes that read data, of each stage."""
    machine: Machine = field(default_factory=Machine)
    clips: Path | None = None
    """Real clips for the stage `joint`, with the share of its steps and their light."""
    real_share: float = 0.5
    real_light: str = "random"


def train_all(order: Order) -> None:
    """Train all stages, or go on where they stopped; prints how it goes.

    Raises:
        InputError: see `train_stage`; the other stages stop where they are.
    """
    threads = torch.get_num_threads() // len(APART)
    if order.machine.device != "cpu" or order.machine.devices > 1 or not threads:
        for names in APART:
            _train(names, order)
    else:
        _side_by_side(order, threads)
    train_stage("joint", order)


def train_stage(name: str, order: Order) -> None:
    """Train one stage, or go on where it stopped; prints how it goes.

    Raises:
        InputError: no such dataset, one of another format, a split without shots; the folder holds
            another run; `joint` finds no trained model there; the disk is full.
    """
    preset = preset_with(order.preset, list(order.switches))
    schedule = replace(stages.SCHEDULES[name], **dict(order.schedule))  # pyright: ignore[reportArgumentType]
    facts: dict[str, Any] = {
        "preset": order.preset,
        "set": sorted(order.switches),
        "data": str(order.data.resolve()),
    }
    folder, real = order.run / name, None
    torch.manual_seed(order.seed)
    if name == "joint":
        for earlier in stages.STAGES:
            _check_preset(order.run / earlier, order.preset)
        if order.clips is not None:
            share, light = order.real_share, order.real_light
            real = stages.real_clips(order.clips, order.run, preset, order.seed, share, light)
            facts |= {"clips": str(order.clips.resolve()), "real": share, "real light": light}
    made = stages.make(name, order.data, preset, order.seed, order.workers, schedule.steps, real)
    if isinstance(made, JointStage):
        if checkpoints.latest(folder) is None:
            made.start_from(order.run)
        for term, reason in made.off.items():
            print(f"without {term}: {reason}", flush=True)
    try:
        figures = training.train(made, folder, schedule, order.seed, facts, order.machine)
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


def _train(names: tuple[str, ...], order: Order) -> None:
    for name in names:
        train_stage(name, order)


def _side_by_side(order: Order, threads: int) -> None:
    context = get_context("spawn")
    with ProcessPoolExecutor(len(APART), context, _begin, (threads,)) as pool:
        try:
            for done in as_completed([pool.submit(_train, names, order) for names in APART]):
                done.result()
        except BaseException as error:  # the others need not finish
            for child in active_children():
                child.terminate()
            if not isinstance(error, BrokenProcessPool):
                raise
            raise InputError(
                f"{order.run}: a process that trained was killed; if memory was short, give a "
                "smaller --batch; the same command again goes on from the last checkpoints"
            ) from None


def _begin(threads: int) -> None:
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
