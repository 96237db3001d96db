"""The training loop: any stage, resumed at any step, on one device or several.

What happens in a step follows from the run's seed and the step's number alone: which samples, which
noise. So a run that was killed and resumed makes the very steps that it would have made. Devices
and processes are Lightning Fabric's business.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from assets_procedural.conventions.files import write_atomically
from totalediting.errors import InputError
from totalediting.training import checkpoints
from totalediting.training.checkpoints import Checkpoint

_MOST_SKIPPED = 20  # steps in a row whose loss is no number: it will not come back


@dataclass(frozen=True)
class Schedule:
    """How long and how fast is trained."""

    steps: int
    """Steps in all."""
    batch: int
    """Samples of a step, over all processes."""
    learning_rate: float = 1e-4
    """At its height; it rises over `warmup` steps and falls as a cosine to a twentieth."""
    warmup: int = 100
    """Steps until the learning rate is at its height."""
    weight_decay: float = 0.01
    """Of AdamW."""
    clip: float = 1.0
    """Largest norm of a step's gradient."""
    average: float = 0.998
    """Decay of the moving average of the weights, which is what is validated and used."""
    save_every: int = 500
    """Steps between checkpoints, each of which is validated."""


class Stage(Protocol):
    """What is trained. All randomness comes from `step` and the generators that are given."""

    @property
    def name(self) -> str:
        """The folder in a run that it is trained in."""
        ...

    @property
    def network(self) -> nn.Module:
        """What is trained."""
        ...

    @property
    def skipped(self) -> dict[str, str]:
        """Samples that could not be read, and why."""
        ...

    def batches(self, first: int, size: int, rank: int, ranks: int) -> Iterator[Any]:
        """The batches of steps `first`, `first` + 1, …: this process's share of `size` samples."""
        ...

    def loss(self, network: nn.Module, batch: Any, step: int) -> tuple[Tensor, dict[str, float]]:
        """What is minimised, and what is logged."""
        ...

    def validate(self, network: nn.Module) -> tuple[float, dict[str, float], dict[str, Tensor]]:
        """A figure that is best when lowest, all figures, and pictures (3, H, W) in [0, 1]."""
        ...


@dataclass(frozen=True)
class Machine:
    """What is trained on."""

    device: str = "cpu"
    """cpu, cuda or mps."""
    devices: int = 1
    """Processes, one on each device."""
    precision: Literal["32-true", "bf16-mixed"] = "32-true"
    """bf16-mixed: convolutions and matrix products of the networks in bfloat16."""


def fastest_precision(device: str) -> Literal["32-true", "bf16-mixed"]:
    """bf16-mixed where the device multiplies bfloat16 itself, else 32-true.

    A CPU that does not, of AVX2 alone for one, takes a hundred times as long over such products.
    """
    if device == "cuda":
        native = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        can = getattr(torch.cpu, "get_capabilities", dict)()  # older versions do not say
        native = any(can.get(name) for name in ("avx512_bf16", "amx_bf16", "bf16"))
    return "bf16-mixed" if native else "32-true"


def train(
    stage: Stage,
    run: Path,
    schedule: Schedule,
    seed: int,
    facts: dict[str, Any],
    machine: Machine | None = None,
    stop_after: int | None = None,
) -> dict[str, float]:
    """Train a stage in the folder `run`, or go on where it stopped; gives the last figures.

    `facts` are what else makes the run what it is (data, preset): another run's folder is refused.
    `stop_after` ends the call after that many steps of its own.

    Raises:
        InputError: the folder holds another run, the disk is full, or the loss stays no number.
    """
    machine = machine or Machine()
    # Not every stage trains every part: the background's, for one.
    several = "ddp_find_unused_parameters_true" if machine.devices > 1 else "auto"
    fabric = Fabric(
        accelerator=machine.device,
        strategy=several,
        devices=machine.devices,
    )
    fabric.launch()
    config = {"stage": stage.name, "seed": seed, **facts, **asdict(schedule)}
    if fabric.is_global_zero:
        checkpoints.configure(run, config)
    fabric.barrier()

    optimiser = torch.optim.AdamW(
        paced(stage.network), schedule.learning_rate, weight_decay=schedule.weight_decay
    )
    average = {name: value.clone() for name, value in stage.network.state_dict().items()}
    figures: dict[str, float] = {}
    lowest, first = math.inf, 0
    if (found := checkpoints.latest(run)) is not None:
        stage.network.load_state_dict(found.model)
        average, figures, first = found.average, found.facts["figures"], found.step
        lowest = found.facts["lowest"]
        if found.facts["best"]:  # it may have been killed before it said so
            checkpoints.mark_best(run, first)
        checkpoints.restore_optimiser(optimiser, found.state)
    network, optimiser = fabric.setup(stage.network, optimiser)
    average = {name: value.to(fabric.device) for name, value in average.items()}
    log = _Log(run, first, schedule.steps, fabric.is_global_zero)
    last = schedule.steps if stop_after is None else min(schedule.steps, first + stop_after)
    skipped = 0
    share = schedule.batch // fabric.world_size
    batches = stage.batches(first, share, fabric.global_rank, fabric.world_size)
    for step in range(first, last):
        torch.manual_seed((seed * 1_000_003 + step) * 64 + fabric.global_rank)
        for group in optimiser.param_groups:
            group["lr"] = group["pace"] * learning_rate(schedule, step)
        network.train()
        batch = fabric.to_device(next(batches))
        # Not Fabric's: it would round what goes into a network as well, cameras among it.
        with torch.autocast(fabric.device.type, torch.bfloat16, machine.precision != "32-true"):
            loss, terms = stage.loss(network, batch, step)
        optimiser.zero_grad()
        fabric.backward(loss)
        norm = fabric.clip_gradients(
            network, optimiser, max_norm=schedule.clip, error_if_nonfinite=False
        )
        norm = math.nan if norm is None else norm.item()
        finite = math.isfinite(loss.item()) and math.isfinite(norm)
        skipped = 0 if finite else skipped + 1
        if finite:
            optimiser.step()
            _follow(average, stage.network, min(schedule.average, (1 + step) / (10 + step)))
        elif skipped >= _MOST_SKIPPED:
            raise InputError(
                f"{run}: the loss was no number {skipped} times in a row at step {step}; lower the "
                "learning rate and run again: it goes on from the last checkpoint"
            )
        log.step(step, {"loss": loss.item(), "gradient": norm, **terms})
        done = step + 1
        if done % schedule.save_every == 0 or done == last:
            value, figures, pictures = _validate(stage, average)
            is_best, lowest = value <= lowest, min(value, lowest)
            if fabric.is_global_zero:
                log.validation(done, figures, pictures)
                state = checkpoints.optimiser_tensors(optimiser.optimizer)
                kept = {"step": done, "figures": figures, "lowest": lowest, "best": is_best}
                model = stage.network.state_dict()
                checkpoints.save(run, Checkpoint(model, average, state, kept), is_best)
            fabric.barrier()
    log.close()
    return figures


def paced(network: nn.Module) -> list[dict[str, Any]]:
    """Groups of parameters for an optimiser: those of a module that has a number `pace` learn so
    many times as fast as the schedule says."""
    pace: dict[nn.Parameter, float] = {}
    for module in network.modules():
        if isinstance(number := getattr(module, "pace", None), float):
            pace |= dict.fromkeys(module.parameters(), number)
    groups: dict[float, list[nn.Parameter]] = {}
    for parameter in network.parameters():
        groups.setdefault(pace.get(parameter, 1.0), []).append(parameter)
    return [{"params": found, "pace": pace} for pace, found in groups.items()]


def learning_rate(schedule: Schedule, step: int) -> float:
    """The learning rate of a step: linear up, cosine down to a twentieth."""
    if step < schedule.warmup:
        return schedule.learning_rate * (step + 1) / schedule.warmup
    way = (step - schedule.warmup) / max(1, schedule.steps - schedule.warmup)
    return schedule.learning_rate * (0.05 + 0.95 * 0.5 * (1 + math.cos(math.pi * min(way, 1.0))))


@torch.no_grad()
def _follow(average: dict[str, Tensor], network: nn.Module, decay: float) -> None:
    for name, value in network.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, 1 - decay)
        else:
            average[name].copy_(value)


@torch.no_grad()
def _validate(
    stage: Stage, average: dict[str, Tensor]
) -> tuple[float, dict[str, float], dict[str, Tensor]]:
    """The stage's validation with the averaged weights in its network, which it gets back."""
    own = {name: value.clone() for name, value in stage.network.state_dict().items()}
    stage.network.load_state_dict(average)
    stage.network.eval()
    result = stage.validate(stage.network)
    stage.network.load_state_dict(own)
    return result


class _Log:
    """Losses as lines of JSON, TensorBoard and a progress line."""

    def __init__(self, run: Path, first: int, steps: int, active: bool) -> None:
        self.active, self.steps, self.first = active, steps, first
        self.stage = run.name
        self.start = time.monotonic()
        if not active:
            return
        from torch.utils.tensorboard import SummaryWriter

        self.path = run / "losses.jsonl"
        # What was logged after the checkpoint is made again.
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        kept = [line for line in lines if line.endswith("}") and json.loads(line)["step"] < first]
        write_atomically(self.path, "".join(f"{line}\n" for line in kept).encode())
        self.file = self.path.open("a", buffering=1)
        self.board = SummaryWriter(str(run / "tensorboard"), purge_step=first)

    def step(self, step: int, values: dict[str, float]) -> None:
        if not self.active:
            return
        self.file.write(json.dumps({"step": step, **values}) + "\n")
        if step % 20 == 0:
            for name, value in values.items():
                self.board.add_scalar(f"train/{name}", value, step)
        done = step + 1 - self.first
        if step % 50 == 0 or step + 1 == self.steps:
            left = (time.monotonic() - self.start) / done * (self.steps - step - 1)
            print(
                f"{self.stage}: step {step + 1:,} of {self.steps:,}, loss {values['loss']:.4f}, "
                f"{left / 60:.0f} min left",
                flush=True,
            )

    def validation(self, step: int, figures: dict[str, float], pictures: dict[str, Tensor]) -> None:
        for name, value in figures.items():
            self.board.add_scalar(f"validation/{name}", value, step)
        for name, picture in pictures.items():
            self.board.add_image(name, picture.clamp(0, 1), step)
        shown = ", ".join(f"{name} {value:.3g}" for name, value in figures.items())
        print(f"{self.stage}: step {step:,}: {shown}", flush=True)

    def close(self) -> None:
        if self.active:
            self.file.close()
            self.board.close()
