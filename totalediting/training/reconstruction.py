"""Reconstruction: the model against pairs of pictures of one person, L_rec + L_reg.

First the two have one pose and expression and differ in view and light, then in all. B, S, h as in
`totalediting.model`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting import metrics
from totalediting.baselines.warp import warp
from totalediting.data.endless import loader, to_device
from totalediting.data.kept_tables import KeptTables
from totalediting.data.pairs import MIRRORED, PortraitPair, PortraitPairs
from totalediting.geometry.field import Control, Table
from totalediting.geometry.identity import faces_of
from totalediting.geometry.mirroring import MIRROR
from totalediting.light import phong
from totalediting.model import Edit, Tables, TotalEditing, Window
from totalediting.presets import Preset
from totalediting.pretrained.fetch import NetworkError
from totalediting.pretrained.lpips import Lpips
from totalediting.training import losses
from totalediting.training.objective import Truth, terms, truth_of
from totalediting.training.stage import Loss, Stage, StageSettings, Validation

Network = TypeVar("Network", bound=nn.Module)

VALIDATED = 64
"""Samples that a validation looks at, at most."""

_VALIDATION_BATCH = 8  # pairs
TABLES = "tables"
"""Folder in a run where deformations are kept; it can be deleted at any time."""
_STATIC = 0.25  # share of the stage's steps before pairs differ in motion


class PairStage(Stage):
    """A stage that learns from pairs of pictures of one person."""

    most = VALIDATED
    closely = False
    """Whether validation takes its time for all figures."""

    def __init__(
        self,
        data: Path,
        preset: Preset,
        seed: int,
        workers: int,
        static_steps: int = 0,
        tables: Path | None = None,
    ) -> None:
        """In the first `static_steps` steps, pairs are static, see `PortraitPairs`. Deformations
        are kept in the folder `tables`, if there is one."""
        self.preset, self.workers, self.static_steps = preset, workers, static_steps
        self.static = PortraitPairs(data, preset, "train", seed, augment=True, static=True)
        self.train = PortraitPairs(data, preset, "train", seed, augment=True)
        self.held_out = PortraitPairs(data, preset, "validation")
        self._off: dict[str, str] = {}
        self.lpips = self.pretrained("lpips", lambda: Lpips("alex"))
        solved = preset.deformation, preset.rotation, preset.alpha, preset.deformation_nodes
        self.kept = KeptTables(tables, str(solved))

    def validate_on(self, data: Path, split: str) -> None:
        self.held_out = PortraitPairs(data, self.preset, split)
        self.most, self.closely = len(self.held_out), True

    def validate(self, network: nn.Module) -> Validation:
        return validate(network, self.held_out, self.most, self.lpips, self.closely)

    @property
    def skipped(self) -> dict[str, str]:
        return self.static.skipped | self.train.skipped

    @property
    def off(self) -> dict[str, str]:
        return self._off

    def pretrained(self, term: str, make: Callable[[], Network]) -> Network | None:
        """The network of a term of the loss, or None if it cannot be had; `off` then says why."""
        try:
            return make().eval()
        except NetworkError as error:
            self._off[term] = str(error)
            return None

    def perceived(
        self, found: dict[str, Tensor | None], edit: Edit, truth: Truth, factors: dict[str, float]
    ) -> None:
        """Add L_LPIPS to the terms of an edit."""
        if self.lpips is not None and factors["lpips"]:
            image, target = truth.counts * edit.image, truth.counts * truth.image
            found["lpips"] = self.lpips.to(image.device)(image, target).mean()

    def tables(self, model: TotalEditing, batch: PortraitPair) -> Tables:
        """The batch's deformations, from posed to canonical space and from there to the source;
        each is solved once. A mirrored pair's are the mirror images of the pair's own."""
        turned = [key.endswith(MIRRORED) for key in batch.key]
        sides = batch.control.posed.new_ones(len(turned), 1, 3)
        sides[turned] = MIRROR.to(sides)
        found = []
        for control in (batch.control, batch.app.control.back()):
            own = [Control(*parts) for parts in zip(*(sides * a for a in control), strict=True)]
            tables = self.kept.of(own, model.deformation)
            pairs = zip(tables, turned, strict=True)
            found.append(Table.stack([t.mirrored() if m else t for t, m in pairs]))
        return Tables(*found)

    def truth(self, batch: PortraitPair, tables: Tables) -> Truth:
        """What a batch's edits should be."""
        return truth_of(batch, tables.there if self.preset.expression == "warped" else None)

    def batches(self, first: int, size: int, rank: int, ranks: int) -> Iterator[PortraitPair]:
        start, moving = first * size * ranks, self.static_steps * size * ranks
        if start < moving:
            yield from loader(self.static, size, self.workers, start, moving, rank, ranks)
        start = max(start, moving)
        yield from loader(self.train, size, self.workers, start, rank=rank, world=ranks)


class ReconstructStage(PairStage):
    """L_rec + L_reg in true light, without L_id: a window rarely shows a face."""

    network: TotalEditing

    def __init__(
        self,
        data: Path,
        preset: Preset,
        seed: int,
        workers: int = 1,
        faces: Tensor | None = None,
        weights: losses.LossWeights = losses.OURS,
        static_steps: int = 0,
        tables: Path | None = None,
    ) -> None:
        super().__init__(data, preset, seed, workers, static_steps, tables)
        self.weights = weights
        self.network = TotalEditing(preset, faces)

    def loss(self, network: nn.Module, batch: PortraitPair, step: int) -> Loss:
        generator = generator_on(batch.mot_image.device)
        window = window_in(self.network.preset)
        tables = self.tables(self.network, batch)
        edit = edit_of(network, batch, generator, window=window, tables=tables)
        truth = self.truth(batch, tables).within(window, self.network.preset)
        found = terms(self.network, edit, truth, self.weights.at(step), generator)
        self.perceived(found, edit, truth, self.weights.at(step))
        total = losses.total(found, self.weights, step)
        return total.loss, total.scalars


def build(settings: StageSettings) -> ReconstructStage:
    """The stage, see `stages.STAGES`."""
    return ReconstructStage(
        settings.data,
        settings.preset,
        settings.seed,
        settings.workers,
        faces_of(settings.preset),
        losses.PRESETS[settings.preset.weights].over(settings.steps),
        static_steps=int(_STATIC * settings.steps),
        tables=settings.run / TABLES,
    )


def generator_on(device: torch.device) -> torch.Generator:
    """A generator there, seeded by the global one on the CPU."""
    return torch.Generator(device).manual_seed(int(torch.randint(2**31, ())))


def window_in(preset: Preset) -> Window:
    """A random window of the preset's size; draws from the global generator."""
    room = preset.neural - preset.window + 1
    row, column = torch.randint(room, (2,)).tolist()
    return Window(row, column, preset.window)


def edit_of(
    network: nn.Module,
    batch: PortraitPair,
    generator: torch.Generator | None,
    lightmaps: Tensor | None = None,
    to_light: Tensor | None = None,
    window: Window | None = None,
    tables: Tables | None = None,
) -> Edit:
    """The edit that should be the batch's target; in its true light, or in another."""
    transparent = bool(batch.transparent.all())
    return network(
        batch.app,
        batch.mot_code,
        batch.control,
        batch.camera_to_world,
        batch.intrinsics,
        batch.lightmaps if lightmaps is None else lightmaps,
        to_light,
        background=batch.background if transparent else None,
        generator=generator,
        window=window,
        tables=tables,
    )


def validate(
    network: nn.Module,
    pairs: PortraitPairs,
    most: int,
    lpips: Lpips | None = None,
    closely: bool = False,
) -> Validation:
    """Judge a model by its PSNR on the first `most` pairs of held-out people; beside it stand the
    figures of returning the source. All pictures are over black. `closely` adds the PSNR of pixels
    that the source shows and, where there is the network, LPIPS."""
    device = next(network.parameters()).device
    found: dict[str, list[Tensor]] = {}
    picture = None
    for samples in loader(pairs, _VALIDATION_BATCH, stop=min(most, len(pairs))):
        batch = to_device(samples, device)
        edit = edit_of(network, batch, None)
        size = batch.normal.shape[-2:]
        normal, albedo = (
            functional.interpolate(part, size, mode="bilinear")
            for part in (edit.rendering.normal, edit.rendering.albedo)
        )
        difference = (albedo - batch.alpha * batch.albedo).abs() * batch.alpha
        shown, truth, matte = over_black(batch, edit), batch.foreground, batch.alpha
        values = {
            **metrics.picture_figures(shown, truth, matte),
            **metrics.source_figures(batch.app.image, truth, matte),
            "normal_error": metrics.normal_error(normal, batch.normal, matte),
            "albedo_error": difference.mean((1, 2, 3)) / matte.mean((1, 2, 3)),
        }
        if closely:
            values |= _closely(batch, shown, lpips)
        for name, value in values.items():
            found.setdefault(name, []).append(value)
        picture = picture if picture is not None else edit_picture(batch, edit)
    figures = {name: float(torch.cat(values).nanmean()) for name, values in found.items()}
    assert picture is not None  # a split is never empty
    return Validation(-figures["psnr"], figures, {"edit": picture})


def _closely(batch: PortraitPair, shown: Tensor, lpips: Lpips | None) -> dict[str, Tensor]:
    """Figures (B,) of results over black that take longer."""
    truth, source = batch.foreground, batch.alpha * batch.app.image
    seen = warp(batch).seen.to(shown)
    found = {
        "seen_psnr": metrics.psnr_within(shown, truth, seen),
        "source_seen_psnr": metrics.psnr_within(source, truth, seen),
    }
    if lpips is not None:
        lpips = lpips.to(shown.device)
        found |= {"lpips": lpips(shown, truth), "source_lpips": lpips(source, truth)}
    return found


def over_black(batch: PortraitPair, edit: Edit) -> Tensor:
    """(B, 3, S, S) the result where the background does not count: a transparent set is judged over
    black, of an opaque one the true matte cuts it out."""
    known = batch.transparent[:, None, None, None]
    return torch.where(known, edit.image, batch.alpha * edit.image)


def decomposition(edit: Edit, camera_to_world: Tensor) -> dict[str, Tensor]:
    """Pictures (B, 3, h, h) in [0, 1] of what an edit is made of."""
    r = edit.rendering
    distance = camera_to_world[:, :3, 3].norm(dim=-1)[:, None, None, None]
    near = (0.5 - (r.depth - distance) / 0.5).clamp(0, 1) * r.opacity
    return {
        "albedo": phong.display(r.albedo, 1),
        "normal": 0.5 * r.normal + 0.5 * r.opacity,
        "diffuse": phong.display(r.diffuse, 1),
        "specular": phong.display(r.specular, 1),
        "residual": (0.5 + r.residual).clamp(0, 1),
        "depth": near.expand(-1, 3, -1, -1),
    }


def edit_picture(batch: PortraitPair, edit: Edit) -> Tensor:
    """(3, H, W): source, truth, result, then what the result is made of."""
    size = batch.mot_image.shape[-2:]
    parts = decomposition(edit, batch.camera_to_world).values()
    large = [functional.interpolate(part, size, mode="bilinear") for part in parts]
    cells = [batch.app.image, batch.mot_image, over_black(batch, edit), *large]
    rows = torch.cat(cells, -1)[:4]
    return torch.cat(list(rows), -2).cpu()
