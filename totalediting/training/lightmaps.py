"""The stage `lightmaps`: the lightmap estimator by itself, on single portraits."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting import metrics
from totalediting.data.endless import loader
from totalediting.data.portraits import Portrait
from totalediting.geometry.camera_jitter import jittered_light
from totalediting.light import phong
from totalediting.light.lightmaps import encode
from totalediting.networks import lightmap_estimator
from totalediting.networks.lightmap_estimator import LightmapEstimator
from totalediting.presets import Preset
from totalediting.training import losses
from totalediting.training.single_portraits import PortraitStage, draw_jitter
from totalediting.training.stage import Loss, StageSettings, Validation

_TEXELS = 192  # queries of lightmaps in a step; all of them would cost ten times as much


class LightmapStage(PortraitStage):
    """L_pre = L_S + L_N: the estimator by itself, on true light and normals (supplement, A)."""

    network: LightmapEstimator

    def __init__(self, data: Path, preset: Preset, seed: int, workers: int = 1) -> None:
        super().__init__(data, preset, seed, workers)
        self.network = LightmapEstimator(preset)
        self.weights = lightmap_estimator.texel_weights(preset.lightmap_height)

    def loss(self, network: nn.Module, batch: Portrait, step: int) -> Loss:
        texels = torch.randint(self.network.queries, (_TEXELS,)).to(batch.image.device)
        seen = (batch.image, batch.normal, batch.alpha, batch.lightmaps)
        image, normals, alpha, lightmaps = jittered_light(*seen, *draw_jitter(batch))
        code, normal = network(image, texels)
        truth = encode(lightmap_estimator.fold(lightmaps)[:, texels])
        light = losses.lightmap_loss(code, truth, self.weights.to(texels.device)[texels])
        smaller = [functional.avg_pool2d(x, 2) for x in (normals, alpha)]
        shape = losses.normal_loss(normal, *smaller)
        return light + shape, {"lightmap": light.item(), "normal": shape.item()}

    @cached_property
    def mean_lightmaps(self) -> Tensor:
        """The mean lightmaps of the training set: the best answer without looking."""
        count = min(512, len(self.train))
        maps = [batch.lightmaps for batch in loader(self.train, 32, stop=count)]
        return metrics.mean_lightmaps(torch.cat(maps))

    def validate(self, network: nn.Module) -> Validation:
        assert isinstance(network, LightmapEstimator)
        device = network.light.device
        errors: dict[str, list[Tensor]] = {"light": [], "mean": [], "angle": [], "normal": []}
        picture = None
        for batch in self.validation_batches(device):
            maps, (_, normal) = network.lightmaps(batch.image), network.encode(batch.image)
            mean = self.mean_lightmaps.to(device).expand_as(maps)
            errors["light"].append(metrics.lightmap_error(maps, batch.lightmaps))
            errors["mean"].append(metrics.lightmap_error(mean, batch.lightmaps))
            errors["angle"].append(metrics.light_error(maps, batch.lightmaps, "specular32"))
            smaller = [functional.avg_pool2d(x, 2) for x in (batch.normal, batch.alpha)]
            errors["normal"].append(metrics.normal_error(normal, *smaller))
            picture = picture if picture is not None else _light_picture(batch, maps, normal)
        found = {name: torch.cat(values) for name, values in errors.items()}
        relative = (found["light"].mean() / found["mean"].mean()).item()
        figures = {
            "relative_light_error": relative,
            "dominant_light_error": float(found["angle"].median()),
            "normal_error": float(found["normal"].nanmean()),
        }
        assert picture is not None  # a split is never empty
        return Validation(relative, figures, {"light": picture})


def build(settings: StageSettings) -> LightmapStage:
    """The stage, see `stages.STAGES`."""
    return LightmapStage(settings.data, settings.preset, settings.seed, settings.workers)


def _light_picture(batch: Portrait, maps: Tensor, normal: Tensor) -> Tensor:
    """(3, H, W): portraits, then true and estimated n = 32 maps, then true and found normals."""
    rows = []
    for k in range(min(4, len(batch.image))):
        side = batch.image.shape[-1]
        cells = [batch.image[k]]
        for light in (batch.lightmaps[k, 3], maps[k, 3]):
            shown = phong.display(0.5 * light, 0)
            cells.append(functional.interpolate(shown[None], (side, 2 * side))[0])
        for n in (batch.normal[k], functional.interpolate(normal[k][None], (side, side))[0]):
            cells.append((0.5 * n + 0.5) * batch.alpha[k])
        rows.append(torch.cat(cells, -1))
    return torch.cat(rows, -2).cpu()
