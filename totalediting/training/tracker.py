"""The stage `tracker`: the head tracker on single portraits, with exact labels."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn

from totalediting.data.portraits import Portrait
from totalediting.geometry.camera_jitter import jittered, photographed
from totalediting.networks.head_tracker import HeadTracker, tracking_errors, tracking_loss
from totalediting.presets import Preset
from totalediting.training.single_portraits import PortraitStage, draw_jitter
from totalediting.training.stage import Loss, StageSettings, Validation

_WIDER = 1.6  # times the jitter of scale that the tracker sees: clips are framed by others
_MISPLACED = 0.01  # frames that a point of the face is off by, in training as when it is found


class TrackerStage(PortraitStage):
    """The head tracker, on true motion, identity and camera."""

    network: HeadTracker

    def __init__(self, data: Path, preset: Preset, seed: int, workers: int = 1) -> None:
        super().__init__(data, preset, seed, workers)
        self.network = HeadTracker(preset)

    def loss(self, network: nn.Module, batch: Portrait, step: int) -> Loss:
        image, truth = jittered(batch.image, batch.truth, *draw_jitter(batch, _WIDER))
        image = photographed(image)
        face = truth.face + _MISPLACED * torch.randn(truth.face.shape).to(image.device)
        found = network(image, face)
        errors = {name: e.item() for name, e in tracking_errors(found, truth).items()}
        return tracking_loss(found, truth), errors

    def validate(self, network: nn.Module) -> Validation:
        found, truth = [], []
        for batch in self.validation_batches(next(network.parameters()).device):
            found.append(network(batch.image))
            truth.append(batch.truth)
        whole = [
            type(parts[0])(*map(torch.cat, zip(*parts, strict=True))) for parts in (found, truth)
        ]
        errors = tracking_errors(*whole)
        return Validation(
            score=float(tracking_loss(*whole)),
            figures={f"{name}_error": float(error) for name, error in errors.items()},
        )


def build(settings: StageSettings) -> TrackerStage:
    """The stage, see `stages.STAGES`."""
    return TrackerStage(settings.data, settings.preset, settings.seed, settings.workers)
