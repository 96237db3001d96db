"""What a step of training costs, stage by stage: time, memory, and where the time goes.

    python benchmarks/training.py DATASET [--presets tiny,small] [--stages tracker,lightmaps]
        [--steps 5] [--batch N] [--device cpu] [--compile]

Every preset and stage has a process of its own, so that its memory peak is its own: on a CPU the
process's resident set, imports included, on a GPU the allocator's. Weights are fresh. Steps are
numbered from the middle of the stage's schedule, where all terms of the loss count; times are
medians over steps after two that warm up, so that what comes once in 16 steps (R_TV, R1) is not in
them. A step is that of `totalediting train`: it waits for its batch from one worker and ends with
the moving average of the weights. "a sample" is what making one takes without a worker. Time by
piece is from further steps with hooks: nested pieces do not count twice, "volume rendering" is what
is left of the model's forward, "losses" what is left of the loss. A piece's backward is from the
gradient of its output to that of its last parameter. What is measured holds for the number of
threads that is printed; OMP_NUM_THREADS sets it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import report
import torch
from torch import Tensor, nn

from totalediting.data.endless import to_device
from totalediting.errors import InputError
from totalediting.presets import PRESETS
from totalediting.training import loop, runs
from totalediting.training.stage import StageSettings
from totalediting.training.stages import STAGES

WARM = 2  # steps
SAMPLES = 8  # that are made to time one
DATA, MLS, RENDERING, LOSSES, OPTIMISER = (
    "data",
    "deformation (MLS)",
    "volume rendering",
    "losses",
    "optimiser",
)
PARTS = {
    "appearance": "appearance encoder",
    "deenactor": "deenactor",
    "reenactor": "reenactor",
    "geometry_encoder": "tri-plane encoders",
    "shading_encoder": "tri-plane encoders",
    "background": "background",
    "superresolution": "super-resolution",
}
"""Attribute of the model → the piece that it is timed as."""


class Timeline:
    """Moments of a step. What runs between two of them belongs to one piece.

    `stack` holds the pieces that are running, the innermost last. A backward pass has no nesting:
    it is in the piece whose output, or one of whose parameters, got its gradient last.
    """

    def __init__(self, device: torch.device) -> None:
        self.cuda = device.type == "cuda"
        self.stack = [LOSSES]
        self.marks: list[tuple[tuple[str, bool], Any]] = []
        self.start()

    def start(self) -> None:
        self.stack, self.marks, self.backward = [LOSSES], [], False
        self.mark(DATA)

    def mark(self, piece: str) -> None:
        """All since the last moment belongs to `piece`."""
        if self.cuda:  # an event waits for nothing, and is stamped where the GPU comes to it
            moment = torch.cuda.Event(enable_timing=True)
            moment.record()
        else:
            moment = time.perf_counter()
        self.marks.append(((piece, self.backward), moment))

    def enter(self, piece: str) -> None:
        self.mark(self.stack[-1])
        self.stack.append(piece)

    def leave(self) -> None:
        self.mark(self.stack.pop())

    def begin(self, piece: str) -> None:
        """The output of `piece` has its gradient."""
        self.mark(self.stack[-1])
        self.stack[-1] = piece

    def go_on(self, piece: str) -> None:
        """A parameter of `piece` has its gradient."""
        self.mark(piece)
        self.stack[-1] = piece

    def seconds(self) -> dict[tuple[str, bool], float]:
        """By piece, and whether backward."""
        if self.cuda:
            torch.cuda.synchronize()
        found: dict[tuple[str, bool], float] = defaultdict(float)
        for (_, before), (piece, after) in zip(self.marks, self.marks[1:], strict=False):
            found[piece] += before.elapsed_time(after) / 1e3 if self.cuda else after - before
        return found


def watch(network: nn.Module, timeline: Timeline) -> None:
    """Mark on the timeline where the parts of a stage's network begin and end."""
    model: Any = network if hasattr(network, "deformation") else getattr(network, "model", None)
    if model is None:  # the tracker or the estimator by itself
        _watch(network, "network", timeline)
        return
    for attribute, piece in PARTS.items():
        _watch(getattr(model, attribute), piece, timeline)
    _scope(model, RENDERING, timeline)
    _follow(model.decoders, RENDERING, timeline)
    deform = model.deformation

    def timed(*arguments: Any, **named: Any) -> Any:
        timeline.enter(MLS)
        try:
            return deform(*arguments, **named)
        finally:
            timeline.leave()

    model.deformation = timed
    if hasattr(network, "estimator"):
        _watch(network.estimator, "lightmap estimator", timeline)


def _watch(module: Any, piece: str, timeline: Timeline) -> None:
    _scope(module, piece, timeline)
    _follow(module, piece, timeline)

    def hook(_: nn.Module, __: Any, output: Any) -> None:
        for tensor in output if isinstance(output, tuple) else (output,):
            if isinstance(tensor, Tensor) and tensor.requires_grad:
                tensor.register_hook(lambda _: timeline.begin(piece))

    module.register_forward_hook(hook)


def _scope(module: nn.Module, piece: str, timeline: Timeline) -> None:
    module.register_forward_pre_hook(lambda *_: timeline.enter(piece))
    module.register_forward_hook(lambda *_: timeline.leave())


def _follow(module: nn.Module, piece: str, timeline: Timeline) -> None:
    for parameter in module.parameters():
        if parameter.requires_grad:
            parameter.register_post_accumulate_grad_hook(lambda _: timeline.go_on(piece))


@dataclass
class Found:
    """Of one preset and stage; times in seconds."""

    step: float
    sample: float
    memory: float
    """MB."""
    pieces: dict[tuple[str, bool], float] = field(default_factory=dict)
    """By piece, and whether backward."""
    notes: list[str] = field(default_factory=list)


def measure(
    run: Path,
    name: str,
    data: Path,
    preset: str,
    batch: int,
    steps: int,
    device: str,
    compiled: bool,
) -> Found:
    """One stage in this process, its run in `run`; with `compiled`, its step and memory alone."""
    place, schedule = torch.device(device), STAGES[name].schedule
    torch.manual_seed(0)
    settings = StageSettings(data, PRESETS[preset], run, schedule.steps, workers=1)
    stage: Any = runs.build(name, settings)
    training = loop.Training(loop.launch(loop.Machine(device)), stage, schedule)
    if compiled:
        training.network = torch.compile(training.network)  # pyright: ignore[reportAttributeAccessIssue]
    timeline = Timeline(place)
    first = schedule.steps // 2
    step_once = partial(one_step, training, timeline)
    batches = stage.batches(first, batch, 0, 1)
    if place.type == "cuda":
        torch.cuda.reset_peak_memory_stats()

    def several(step: int) -> list[dict[tuple[str, bool], float]]:
        return [step_once(batches, step + k) for k in range(WARM + steps)][WARM:]

    plain = several(first)
    found = Found(
        step=statistics.median(sum(times.values()) for times in plain),
        sample=0.0,
        memory=report.peak(device),
        notes=[f"without {term}: {reason}" for term, reason in stage.off.items()],
    )
    if compiled:
        return found
    watch(stage.network, timeline)
    split = several(first + WARM + steps)
    keys = {key for times in split for key in times}
    found.pieces = {k: statistics.median(times.get(k, 0.0) for times in split) for k in keys}
    made = []
    for number in range(SAMPLES):
        with report.clock() as took:
            stage.train[number]
        made.append(took.seconds)
    found.sample = statistics.median(made)
    return found


def one_step(
    training: loop.Training, timeline: Timeline, batches: Iterator[Any], step: int
) -> dict[tuple[str, bool], float]:
    """A step of training; its seconds by piece."""

    def done(part: loop.Part) -> None:
        if part == "forward":
            timeline.mark(LOSSES)
        elif part == "backward":
            timeline.mark(timeline.stack[-1])
        else:
            timeline.mark(OPTIMISER)
        timeline.backward = part == "forward"

    timeline.start()
    batch = to_device(next(batches), training.fabric.device)
    timeline.mark(DATA)
    loop.step(training, batch, step, done)
    return timeline.seconds()


def alone(name: str, data: Path, preset: str, batch: int, *others: Any) -> Found:
    """`measure` in a process of its own."""
    try:
        with (
            TemporaryDirectory() as run,
            ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        ):
            return pool.submit(measure, Path(run), name, data, preset, batch, *others).result()
    except (BrokenProcessPool, torch.OutOfMemoryError):
        remedy = "give fewer" if batch > 1 else "take a smaller preset"
        raise InputError(
            f"--batch: {batch}: {name} of the preset {preset} does not fit in memory; {remedy}"
        ) from None


def chosen(option: str, text: str, choices: tuple[str, ...]) -> list[str]:
    for word in text.split(","):
        if word not in choices:
            raise InputError(f"{option}: {word}: choose one of {', '.join(choices)}")
    return text.split(",")


def benchmark(options: argparse.Namespace) -> None:
    presets = chosen("--presets", options.presets, tuple(PRESETS))
    names = chosen("--stages", options.stages, tuple(STAGES))
    if options.steps < 1:
        raise InputError(f"--steps: {options.steps}: give 1 at least")
    if options.batch is not None and options.batch < 1:
        raise InputError(f"--batch: {options.batch}: give 1 at least")
    if options.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device: cuda: PyTorch finds no CUDA device here; use --device cpu")

    whole, pieces, notes = [], [], []
    for preset in presets:
        for name in names:
            batch = options.batch or STAGES[name].schedule.batch
            arguments = (name, options.data, preset, batch, options.steps, options.device)
            print(f"{preset}, {name} …", file=sys.stderr, flush=True)
            found = alone(*arguments, False)
            row = [preset, name, str(batch), *figures(found, batch)]
            if options.compile:
                try:
                    row.append(f"{alone(*arguments, True).step:.3f}")
                except InputError:
                    raise
                except Exception as error:
                    row.append("fails")
                    reason = (str(error).strip().splitlines() or [""])[0]
                    notes.append(f"{preset}, {name}: compiled: {type(error).__name__}: {reason}")
            whole.append(row)
            pieces += [[preset, name, *cells] for cells in shares(found)]
            notes += [f"{preset}, {name}: {note}" for note in found.notes]
    header = ["preset", "stage", "batch", "s a step", "steps a s", "samples a s", "a sample, ms"]
    header += ["peak memory, MB", *(["compiled, s a step"] if options.compile else [])]
    report.table(header, whole)
    header = ["preset", "stage", "piece", "forward, ms", "backward, ms", "share of the step"]
    report.table(header, pieces)
    for note in (machine(options.device), *notes):
        print(f"\n{note}")


def machine(device: str) -> str:
    if device == "cuda":
        return torch.cuda.get_device_name()
    return f"CPU, threads: {torch.get_num_threads()}"


def figures(found: Found, batch: int) -> list[str]:
    return [
        f"{found.step:.3f}",
        f"{1 / found.step:.2f}",
        f"{batch / found.step:.1f}",
        f"{1e3 * found.sample:.1f}",
        f"{found.memory:,.0f}",
    ]


def shares(found: Found) -> Iterator[list[str]]:
    """Rows of the pieces that a stage has, in the order of a step."""
    total = sum(found.pieces.values())
    order = [DATA, "network", "lightmap estimator", *dict.fromkeys(PARTS.values())]
    order[-1:-1] = [MLS, RENDERING]
    for piece in (*order, LOSSES, OPTIMISER):
        forward, backward = (found.pieces.get((piece, way), 0.0) for way in (False, True))
        if forward or backward:
            shown = f"{1e3 * backward:.1f}" if backward else ""
            share = f"{100 * (forward + backward) / total:.0f} %"
            yield [piece, f"{1e3 * forward:.1f}", shown, share]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, metavar="DATASET")
    parser.add_argument("--presets", default="tiny", help="of tiny, small and full; with commas")
    parser.add_argument("--stages", default=",".join(STAGES))
    parser.add_argument("--steps", type=int, default=5, help="that are timed; two more warm up")
    parser.add_argument("--batch", type=int, help="default: the stage's own")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--compile", action="store_true", help="time torch.compile as well")
    try:
        benchmark(parser.parse_args())
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
