"""The training loop: any stage, resumed at any step, on one device or several.

What happens in a step follows from the run's seed and the step's number alone: which samples, which
noise. So a run that was killed and resumed makes the very steps that it would have made. Devices
and processes are Lightning Fabric's business.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from assets_procedural.conventions.console import duration
from assets_procedural.conventions.files import write_atomically
from totalediting.errors import InputError
from totalediting.training import checkpoints
from totalediting.training.checkpoints import Checkpoint
from totalediting.training.stage import Stage, Validation
from totalediting.training.stages import Schedule

log = logging.getLogger(__name__)

_MOST_SKIPPED = 20  # consecutive steps without a finite loss: it will not come back
_QUIET = 30.0  # seconds at most, or 50 steps, between lines of progress


@dataclass(frozen=True)
class Machine:
    """The hardware to train on."""

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


Part = Literal["forward", "backward", "update"]
"""What a step consists of, in order."""


@dataclass(frozen=True)
class Step:
    """What came of a training step."""

    loss: float
    gradient: float
    """Norm of the gradient before clipping, the largest of the parts'; NaN or infinite as they."""
    terms: dict[str, float]
    """What the stage logs of its loss."""

    @property
    def finite(self) -> bool:
        """Whether the step changed the weights: loss and gradient were finite."""
        return math.isfinite(self.loss) and math.isfinite(self.gradient)


class Training:
    """A stage in training: its network and optimiser on a device, and the weights' average."""

    def __init__(
        self,
        fabric: Fabric,
        stage: Stage,
        schedule: Schedule,
        seed: int = 0,
        mixed: bool = False,
        found: Checkpoint | None = None,
    ) -> None:
        """Set up on a launched `fabric`; `mixed` trains in bfloat16, from `found` if given."""
        self.fabric, self.stage, self.schedule, self.seed = fabric, stage, schedule, seed
        self.mixed = mixed
        optimiser = torch.optim.AdamW(
            paced(stage.network), schedule.learning_rate, weight_decay=schedule.weight_decay
        )
        average = {name: value.clone() for name, value in stage.network.state_dict().items()}
        if found is not None:
            stage.network.load_state_dict(found.model)
            average = found.average
            checkpoints.restore_optimiser(optimiser, found.state)
        self.network, self.optimiser = fabric.setup(stage.network, optimiser)
        self.average = {name: value.to(fabric.device) for name, value in average.items()}


def launch(machine: Machine) -> Fabric:
    """Fabric on a machine, in as many processes as it has devices."""
    # Not every stage trains every part: the background's, for one.
    several = "ddp_find_unused_parameters_true" if machine.devices > 1 else "auto"
    fabric = Fabric(accelerator=machine.device, strategy=several, devices=machine.devices)
    fabric.launch()
    return fabric


def step(
    training: Training, batch: Any, number: int, done: Callable[[Part], None] | None = None
) -> Step:
    """Train on a batch, on the training's device, as step `number` >= 0 of its schedule.

    A step whose loss or gradient is not finite changes nothing. `done` is called after each part.
    """
    done = done or (lambda part: None)
    fabric, stage, schedule = training.fabric, training.stage, training.schedule
    network, optimiser = training.network, training.optimiser
    # After the batch was read: the first one starts an iterator, which draws a number as well.
    torch.manual_seed((training.seed * 1_000_003 + number) * 64 + fabric.global_rank)
    for group in optimiser.param_groups:
        group["lr"] = group["pace"] * learning_rate(schedule, number)
    network.train()
    # Not Fabric's: it would round what goes into a network as well, cameras among it.
    with torch.autocast(fabric.device.type, torch.bfloat16, training.mixed):
        loss, terms = stage.loss(network, batch, number)
    done("forward")
    optimiser.zero_grad()
    fabric.backward(loss)
    done("backward")
    norms = [
        nn.utils.clip_grad_norm_(part.parameters(), schedule.clip)
        for part in clipped(stage.network)
    ]
    result = Step(loss.item(), float(torch.stack(norms).max()), terms)
    if result.finite:
        optimiser.step()
        decay = min(schedule.average, (1 + number) / (10 + number))
        _follow(training.average, stage.network, decay)
    done("update")
    return result


def train(
    stage: Stage,
    run: Path,
    schedule: Schedule,
    seed: int,
    facts: dict[str, Any],
    machine: Machine | None = None,
    stop_after: int | None = None,
) -> dict[str, float]:
    """Train a stage in the folder `run`, or resume it; gives the figures of its last validation.

    `facts` are what else makes the run what it is (stage, data, preset): another run's folder is
    refused. `stop_after` ends the call after that many steps of its own.

    Raises:
        InputError: the folder holds another run, the disk is full, or the loss stays NaN or
            infinite.
    """
    machine = machine or Machine()
    fabric = launch(machine)
    config = {"seed": seed, **facts, **asdict(schedule)}
    if fabric.is_global_zero:
        checkpoints.configure(run, config)
    fabric.barrier()

    judged: dict[str, float] = {}
    lowest, first = math.inf, 0
    if (found := checkpoints.latest(run)) is not None:
        judged, first = found.facts["figures"], found.step
        lowest = found.facts["lowest"]
        if found.facts["best"]:  # it may have been killed before it recorded that
            checkpoints.mark_best(run, first)
    training = Training(fabric, stage, schedule, seed, machine.precision != "32-true", found)
    progress = _Log(run, first, schedule.steps, fabric.is_global_zero)
    last = schedule.steps if stop_after is None else min(schedule.steps, first + stop_after)
    skipped = 0
    share = schedule.batch // fabric.world_size
    batches = stage.batches(first, share, fabric.global_rank, fabric.world_size)
    for number in range(first, last):
        made = step(training, fabric.to_device(next(batches)), number)
        skipped = 0 if made.finite else skipped + 1
        if skipped >= _MOST_SKIPPED:
            raise InputError(
                f"{run}: loss was NaN or infinite for {skipped} consecutive steps, at step "
                f"{number}; lower --learning-rate and run again: training resumes from the last "
                "checkpoint"
            )
        progress.step(number, {"loss": made.loss, "gradient": made.gradient, **made.terms})
        done = number + 1
        if done % schedule.save_every == 0 or done == last:
            validation = _validate(stage, training.average)
            judged = validation.figures
            is_best, lowest = validation.score <= lowest, min(validation.score, lowest)
            if fabric.is_global_zero:
                progress.validation(done, validation)
                state = checkpoints.optimiser_tensors(training.optimiser.optimizer)
                kept = {"step": done, "figures": judged, "lowest": lowest, "best": is_best}
                model = stage.network.state_dict()
                saved = Checkpoint(model, training.average, state, kept)
                checkpoints.save(run, saved, is_best)
            fabric.barrier()
    progress.close()
    return judged


def clipped(network: nn.Module) -> list[nn.Module]:
    """The parts of a network whose gradients are clipped each by its own norm: what its `clipped`
    names, else all of it."""
    found = getattr(network, "clipped", None)
    return [network] if found is None else found


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
def _validate(stage: Stage, average: dict[str, Tensor]) -> Validation:
    """The stage's validation with the averaged weights in its network, which it gets back."""
    own = {name: value.clone() for name, value in stage.network.state_dict().items()}
    stage.network.load_state_dict(average)
    stage.network.eval()
    result = stage.validate(stage.network)
    stage.network.load_state_dict(own)
    return result


class _Log:
    """What happens in a run: losses as lines of JSON, TensorBoard, and progress as messages."""

    def __init__(self, run: Path, first: int, steps: int, active: bool) -> None:
        self.active, self.steps, self.first = active, steps, first
        self.stage = run.name
        self.start = self.told = time.monotonic()
        if not active:
            return
        from torch.utils.tensorboard import SummaryWriter

        self.path = run / "losses.jsonl"
        # Steps after the checkpoint are made, and logged, again.
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
        now, done = time.monotonic(), step + 1 - self.first
        if done == 1 or step % 50 == 0 or step + 1 == self.steps or now - self.told > _QUIET:
            self.told = now
            left = (now - self.start) / done * (self.steps - step - 1)
            log.info(
                "%s: step %s of %s, loss %.4f, %s left",
                self.stage,
                f"{step + 1:,}",
                f"{self.steps:,}",
                values["loss"],
                duration(left),
            )

    def validation(self, step: int, validation: Validation) -> None:
        for name, value in validation.figures.items():
            self.board.add_scalar(f"validation/{name}", value, step)
        for name, picture in validation.pictures.items():
            self.board.add_image(name, picture.clamp(0, 1), step)
        shown = ", ".join(f"{name} {value:.3g}" for name, value in validation.figures.items())
        log.info("%s: step %s: validation: %s", self.stage, f"{step:,}", shown)

    def close(self) -> None:
        if self.active:
            self.file.close()
            self.board.close()
