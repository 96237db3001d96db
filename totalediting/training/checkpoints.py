"""Checkpoints: whole or absent, safetensors and JSON, nothing pickled.

A run's folder holds

    config.json                      what is trained: stage, preset, seed; never changes
    losses.jsonl                     a line per step that was logged
    checkpoints/<step>/              model.safetensors, average.safetensors, state.safetensors,
                                     facts.json (step and figures of the last validation)
    best.json                        the step of the one that validated best

Whatever is written gets a temporary name and is renamed, so that a kill or a full disk at any
moment leaves what was there before.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from assets_procedural.conventions.files import write_atomically
from totalediting.errors import InputError
from totalediting.presets import Preset, preset_with
from totalediting.training.figures import with_current_names

KEPT = 2
"""Checkpoints to keep in addition to the best."""


@dataclass(frozen=True)
class Checkpoint:
    """Tensors of the network, of its moving average and of the optimiser; `facts` as in JSON."""

    model: dict[str, Tensor]
    average: dict[str, Tensor]
    state: dict[str, Tensor]
    facts: dict[str, Any]

    @property
    def step(self) -> int:
        """Steps that had been made."""
        return int(self.facts["step"])


def save(run: Path, checkpoint: Checkpoint, is_best: bool) -> Path:
    """Store a checkpoint and drop old ones.

    Raises:
        InputError: the disk is full or not writable; earlier checkpoints stay intact.
    """
    target = run / "checkpoints" / f"{checkpoint.step:08d}"
    _clean(run)
    try:
        _write(target, checkpoint)
        if is_best:
            mark_best(run, checkpoint.step)
    except OSError as error:
        left = [path.name for path in _found(run)]
        kept = f"the checkpoint of step {int(left[-1])} is intact" if left else "there is none yet"
        raise InputError(
            f"{run}: step {checkpoint.step} cannot be saved ({error.strerror}); {kept}; "
            "free disk space and run the same command again"
        ) from None
    for path in _found(run)[:-KEPT]:
        if int(path.name) != best_step(run):
            shutil.rmtree(path, ignore_errors=True)
    return target


def best_step(run: Path) -> int | None:
    """The step that validated best so far, None before the first validation.

    Raises:
        InputError: the file that says so is damaged.
    """
    path = run / "best.json"
    return int(_read_json(path)["step"]) if path.exists() else None


def best(run: Path, device: str = "cpu") -> Checkpoint:
    """The checkpoint that validated best.

    Raises:
        InputError: the folder holds no trained run.
    """
    step = best_step(run)
    if step is None:
        raise InputError(f"{run}: holds no trained model; train one there first")
    return read(run / "checkpoints" / f"{step:08d}", device)


def load_best(run: Path, network: nn.Module) -> None:
    """Give a network the averaged weights of the checkpoint that validated best.

    Raises:
        InputError: the folder holds no trained run, or one of another network.
    """
    found = best(run)
    try:
        network.load_state_dict(found.average)
    except RuntimeError:
        config = read_config(run)
        built = ", ".join([f"preset = {config['preset']}", *config["set"]])
        raise InputError(f"{run}: holds a different network, trained with {built}") from None


def mark_best(run: Path, step: int) -> None:
    """Record that the checkpoint of `step` validated best."""
    _write_json(run / "best.json", {"step": step})


def latest(run: Path, device: str = "cpu") -> Checkpoint | None:
    """The newest intact checkpoint of a run, None before the first; damaged ones are skipped."""
    for path in reversed(_found(run)):
        try:
            return read(path, device)
        except InputError:
            continue
    return None


def read(path: Path, device: str = "cpu") -> Checkpoint:
    """Read a checkpoint's folder.

    Raises:
        InputError: it is not a checkpoint, or one of its files is missing or damaged.
    """
    try:
        parts = [
            load_file(path / f"{name}.safetensors", device)
            for name in ("model", "average", "state")
        ]
        facts = json.loads((path / "facts.json").read_text())
        if "figures" in facts:
            facts["figures"] = with_current_names(facts["figures"])
        model, average, state = parts
        return Checkpoint(model, average, state, facts)
    except Exception as error:  # safetensors raises its own, json and the file system others
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: incomplete or corrupt checkpoint ({reason})") from None


def configure(run: Path, config: dict[str, Any]) -> None:
    """Record what a run trains, or check that the same was trained there before.

    Raises:
        InputError: the folder holds another run, or cannot be written to.
    """
    path = run / "config.json"
    if path.exists():
        before = read_config(run)
        for key in sorted({*before, *config}):
            if before.get(key) != config.get(key):
                raise InputError(
                    f"{run}: was trained with {key} = {before.get(key)}, not {config.get(key)}; "
                    "give the same, or another --out"
                )
        return
    try:
        run.mkdir(parents=True, exist_ok=True)
        _write_json(path, config)
    except OSError as error:
        raise InputError(
            f"{run}: cannot be written to ({error.strerror}); free disk space or give another --out"
        ) from None


def read_config(run: Path) -> dict[str, Any]:
    """What `configure` wrote.

    Raises:
        InputError: nothing was trained there, or the file is damaged.
    """
    path = run / "config.json"
    if not path.exists():
        raise InputError(f"{run}: nothing was trained there; train it first")
    return _read_json(path)


def preset_of(run: Path) -> Preset:
    """The preset that a stage's folder was trained with, its switches set; raises as
    `read_config`."""
    config = read_config(run)
    return preset_with(config["preset"], config["set"])


def optimiser_tensors(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """An optimiser's state as named tensors."""
    return {
        f"{index}/{name}": value if isinstance(value, Tensor) else torch.tensor(value)
        for index, entry in optimiser.state_dict()["state"].items()
        for name, value in entry.items()
    }


def restore_optimiser(optimiser: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    """The inverse of `optimiser_tensors`."""
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        index, name = key.split("/")
        state.setdefault(int(index), {})[name] = value
    whole = optimiser.state_dict()
    optimiser.load_state_dict({"state": state, "param_groups": whole["param_groups"]})


def _clean(run: Path) -> None:
    """Remove what killed processes left under temporary names: a run has one process at a time."""
    for path in (run / "checkpoints").glob(".[0-9]*.[0-9]*"):
        shutil.rmtree(path, ignore_errors=True)
    for path in run.glob(".*.[0-9]*.tmp"):
        path.unlink(missing_ok=True)


def _write(target: Path, checkpoint: Checkpoint) -> None:
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        temporary.mkdir(parents=True)
        for name in ("model", "average", "state"):
            tensors = {
                k: v.detach().cpu().contiguous() for k, v in getattr(checkpoint, name).items()
            }
            try:
                save_file(tensors, temporary / f"{name}.safetensors")
            except Exception as error:  # its own error type, for a full disk too
                raise OSError(None, str(error)) from error
        (temporary / "facts.json").write_text(json.dumps(checkpoint.facts, sort_keys=True))
        for path in temporary.iterdir():
            with path.open("rb") as file:
                os.fsync(file.fileno())
        shutil.rmtree(target, ignore_errors=True)
        os.replace(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _read_json(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise InputError(
            f"{path}: not valid JSON ({error}); restore the file or train in another folder"
        ) from None


def _write_json(path: Path, content: dict[str, Any]) -> None:
    text = json.dumps(content, indent=2, sort_keys=True) + "\n"
    write_atomically(path, text.encode())


def _found(run: Path) -> list[Path]:
    folder = run / "checkpoints"
    return sorted(p for p in folder.glob("[0-9]*") if p.is_dir()) if folder.is_dir() else []
