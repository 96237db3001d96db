"""What is trained, stage by stage: the tracker and the lightmap estimator here, then the model.

Each is a `training.Stage`: batches by step, a loss, a validation on people that are held out.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.data.clips import Clips
from totalediting.data.endless import loader, to_device
from totalediting.data.portraits import Portrait, Portraits
from totalediting.errors import InputError
from totalediting.geometry.camera_jitter import ROLL, SCALE, jittered, jittered_light, photographed
from totalediting.geometry.identity import faces_of
from totalediting.light import phong
from totalediting.light.lightmaps import encode
from totalediting.networks import lightmap_estimator
from totalediting.networks.head_tracker import HeadTracker, tracking_errors, tracking_loss
from totalediting.networks.lightmap_estimator import LightmapEstimator
from totalediting.presets import Preset
from totalediting.training import checkpoints, losses, metrics
from totalediting.training.joint import JointStage, RealClips
from totalediting.training.loop import Schedule
from totalediting.training.reconstruction import VALIDATED, ReconstructStage

_AT_ONCE = 8  # portraits of a validation
_TEXELS = 192  # queries of lightmaps in a step; all of them would cost ten times as much
_WIDER = 1.6  # times the jitter of scale that the tracker sees: clips are framed by others
_MISPLACED = 0.01  # frames that a point of the face is off by, in training as when it is found
_STATIC = 0.25  # share of the stage `reconstruct` before pairs differ in motion

SCHEDULES = {
    "tracker": Schedule(steps=2000, batch=8, learning_rate=5e-4),
    "lightmaps": Schedule(steps=3400, batch=8, learning_rate=1.5e-3),
    "reconstruct": Schedule(steps=700, batch=4, learning_rate=8e-4),
    "joint": Schedule(steps=60, batch=4, learning_rate=2e-4, warmup=20),
}
"""Of the preset `tiny`: what two cores with AVX2 alone have time for in `make train-demo`."""


class _Shown:
    """What stages of single portraits share: the same people in and out of training."""

    most = VALIDATED

    def __init__(self, data: Path, preset: Preset, seed: int, workers: int) -> None:
        self.preset, self.workers = preset, workers
        self.train = Portraits(data, preset, "train", seed, mirror=True, mix=True)
        self.held_out = Portraits(data, preset, "validation")

    def judge_by(self, data: Path, split: str) -> None:
        """Validate on all of another split."""
        self.held_out = Portraits(data, self.preset, split)
        self.most = len(self.held_out)

    @property
    def skipped(self) -> dict[str, str]:
        """Training portraits that could not be read, and why."""
        return self.train.skipped

    def batches(self, first: int, size: int, rank: int, ranks: int) -> Iterator[Portrait]:
        start = first * size * ranks
        return iter(loader(self.train, size, self.workers, start, rank=rank, world=ranks))

    def validated(self, device: torch.device) -> Iterator[Portrait]:
        """Batches of the held-out portraits, the same every time."""
        for batch in loader(self.held_out, _AT_ONCE, stop=min(self.most, len(self.held_out))):
            yield to_device(batch, device)


class LightmapStage(_Shown):
    """L_pre = L_S + L_N: the estimator by itself, on true light and normals (supplement, A)."""

    name = "lightmaps"

    def __init__(self, data: Path, preset: Preset, seed: int, workers: int = 1) -> None:
        super().__init__(data, preset, seed, workers)
        self.network = LightmapEstimator(preset)
        self.weights = lightmap_estimator.texel_weights(preset.lightmap_height)

    def loss(
        self, network: nn.Module, batch: Portrait, step: int
    ) -> tuple[Tensor, dict[str, float]]:
        texels = torch.randint(self.network.queries, (_TEXELS,)).to(batch.image.device)
        shown = (batch.image, batch.normal, batch.alpha, batch.lightmaps)
        image, normals, alpha, lightmaps = jittered_light(*shown, *_jitter(batch))
        code, normal = network(image, texels)
        truth = encode(lightmap_estimator.fold(lightmaps)[:, texels])
        light = losses.lightmap_loss(code, truth, self.weights.to(texels.device)[texels])
        smaller = [functional.avg_pool2d(x, 2) for x in (normals, alpha)]
        shape = losses.normal_loss(normal, *smaller)
        return light + shape, {"lightmap": light.item(), "normal": shape.item()}

    @cached_property
    def known(self) -> Tensor:
        """What one would say without looking: the mean lightmaps of the training set."""
        count = min(512, len(self.train))
        maps = [batch.lightmaps for batch in loader(self.train, 32, stop=count)]
        return metrics.mean_lightmaps(torch.cat(maps))

    def validate(self, network: nn.Module) -> tuple[float, dict[str, float], dict[str, Tensor]]:
        assert isinstance(network, LightmapEstimator)
        device = network.light.device
        errors: dict[str, list[Tensor]] = {"light": [], "mean": [], "angle": [], "normal": []}
        picture = None
        for batch in self.validated(device):
            maps, (_, normal) = network.lightmaps(batch.image), network.encode(batch.image)
            known = self.known.to(device).expand_as(maps)
            errors["light"].append(metrics.lightmap_error(maps, batch.lightmaps))
            errors["mean"].append(metrics.lightmap_error(known, batch.lightmaps))
            errors["angle"].append(metrics.light_error(maps, batch.lightmaps, "specular32"))
            smaller = [functional.avg_pool2d(x, 2) for x in (batch.normal, batch.alpha)]
            errors["normal"].append(metrics.normal_error(normal, *smaller))
            picture = picture if picture is not None else _light_picture(batch, maps, normal)
        found = {name: torch.cat(values) for name, values in errors.items()}
        figures = {
            "light / mean light": (found["light"].mean() / found["mean"].mean()).item(),
            "dominant light, median °": float(found["angle"].median()),
            "normal, mean °": float(found["normal"].nanmean()),
        }
        assert picture is not None  # a split is never empty
        return figures["light / mean light"], figures, {"light": picture}


class TrackerStage(_Shown):
    """The head tracker, on true motion, identity and camera."""

    name = "tracker"

    def __init__(self, data: Path, preset: Preset, seed: int, workers: int = 1) -> None:
        super().__init__(data, preset, seed, workers)
        self.network = HeadTracker(preset)

    def loss(
        self, network: nn.Module, batch: Portrait, step: int
    ) -> tuple[Tensor, dict[str, float]]:
        image, truth = jittered(batch.image, batch.truth, *_jitter(batch, _WIDER))
        image = photographed(image)
        face = truth.face + _MISPLACED * torch.randn(truth.face.shape).to(image.device)
        found = network(image, face)
        errors = {name: e.item() for name, e in tracking_errors(found, truth).items()}
        return tracking_loss(found, truth), errors

    def validate(self, network: nn.Module) -> tuple[float, dict[str, float], dict[str, Tensor]]:
        found, truth = [], []
        for batch in self.validated(next(network.parameters()).device):
            found.append(network(batch.image))
            truth.append(batch.truth)
        whole = [
            type(parts[0])(*map(torch.cat, zip(*parts, strict=True))) for parts in (found, truth)
        ]
        errors = {name: float(e) for name, e in tracking_errors(*whole).items()}
        return float(tracking_loss(*whole)), errors, {}


STAGES = tuple(SCHEDULES)
"""Names, in the order that they are trained in."""


def make(
    name: str,
    data: Path,
    preset: Preset,
    seed: int,
    workers: int,
    steps: int,
    real: RealClips | None = None,
) -> TrackerStage | LightmapStage | ReconstructStage | JointStage:
    """The stage of that name; what a loss's schedule says is stretched or shrunk to `steps`.

    `real` is what the stage `joint` sees beside the dataset.

    Raises:
        InputError: no dataset there, one of another format, or an empty split.
    """
    if name == "tracker":
        return TrackerStage(data, preset, seed, workers)
    if name == "lightmaps":
        return LightmapStage(data, preset, seed, workers)
    weights, faces = losses.OURS.over(steps), faces_of(preset)
    if name == "reconstruct":
        static = int(_STATIC * steps)
        return ReconstructStage(data, preset, seed, workers, faces, weights, static)
    return JointStage(data, preset, seed, workers, faces, weights, real)


def real_clips(
    folder: Path, run: Path, preset: Preset, seed: int, share: float, light: Any
) -> RealClips:
    """Real clips for the stage `joint`, described by the tracker that was trained in `run`.

    Raises:
        InputError: there is no clip, or no tracker was trained there.
    """
    tracker = HeadTracker(preset)
    checkpoints.load_best(run / "tracker", tracker)
    return RealClips(Clips(folder, preset, seed), tracker.requires_grad_(False), share, light)


def evaluate(run: Path, data: Path, split: str) -> dict[str, dict[str, float]]:
    """Figures of every stage that was trained in `run`, on all of a split of any dataset.

    Raises:
        InputError: nothing was trained there, or there is no such dataset or split.
    """
    found = {}
    for name in STAGES:
        folder = run / name
        if checkpoints.best_step(folder) is None:
            continue
        config, preset = checkpoints.read_config(folder), checkpoints.preset_of(folder)
        stage = make(name, Path(config["data"]), preset, 0, 0, config["steps"])
        stage.judge_by(data, split)
        checkpoints.load_best(folder, stage.network)
        with torch.no_grad():
            found[name] = stage.validate(stage.network.eval())[1]
    if not found:
        raise InputError(f"{run}: nothing was trained there; train it first")
    return found


def _jitter(batch: Portrait, wider: float = 1.0) -> tuple[Tensor, Tensor]:
    """Roll and logarithm of the scale (B,) of a step, from the global generator."""
    roll, log_scale = torch.randn(2, len(batch.image)).to(batch.image.device)
    return ROLL * roll, wider * SCALE * log_scale


def _light_picture(batch: Portrait, maps: Tensor, normal: Tensor) -> Tensor:
    """(3, H, W): portraits, then true and estimated n = 32 maps, then true and found normals."""
    rows = []
    for k in range(min(4, len(batch.image))):
        side = batch.image.shape[-1]
        cells = [batch.image[k]]
        for light in (batch.lightmaps[k, 3], maps[k, 3]):
            shown = phong.display(0.5 * light)
            cells.append(functional.interpolate(shown[None], (side, 2 * side))[0])
        for n in (batch.normal[k], functional.interpolate(normal[k][None], (side, side))[0]):
            cells.append((0.5 * n + 0.5) * batch.alpha[k])
        rows.append(torch.cat(cells, -1))
    return torch.cat(rows, -2).cpu()
