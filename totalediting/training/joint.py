"""The joint stage: everything together, L = L_rec + L_reg + L_adv (paper, supplement A).

The model continues from the stage `reconstruct`, the lightmap estimator from `lightmaps`; the last
layer of its normals gets no gradient from light and is frozen, and so are E_app and F_de, as in the
paper (`preset.freeze`). In every other step on synthetic
pairs the light is what the estimator sees in the driver's picture, so that it learns from the
result as well; otherwise it is the true light. Real pairs, two frames of a clip, are described by
the head tracker; their light is always the estimator's.

The discriminator is trained in the same step by the same optimiser: the generator's term passes
through a copy of its weights that receives no gradient, its own terms see pictures that receive
none. So both descend in the same step rather than in turns, and a run has one state to save. It
judges synthetic pairs, whose canonical coordinates are known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn import functional

from totalediting.data.clips import ClipPair, Clips
from totalediting.data.endless import loader
from totalediting.data.pairs import PortraitPair
from totalediting.geometry.field import Control
from totalediting.geometry.identity import faces_of
from totalediting.geometry.rig import camera_of, control_of
from totalediting.geometry.source import Source
from totalediting.geometry.tracking import Tracking
from totalediting.light.lightmaps import encode
from totalediting.model import Edit, TotalEditing
from totalediting.networks import discriminator, lightmap_estimator
from totalediting.networks.discriminator import Discriminator
from totalediting.networks.head_tracker import HeadTracker
from totalediting.networks.lightmap_estimator import LightmapEstimator
from totalediting.presets import Preset
from totalediting.pretrained.sface import Recognition
from totalediting.training import checkpoints, losses
from totalediting.training.objective import Truth, terms, truth_of_real
from totalediting.training.reconstruction import TABLES, PairStage, edit_of, generator_on
from totalediting.training.stage import Loss, RealVideo, StageSettings, Validation
from totalediting.training.stages import STAGES

R1_EVERY = 16
"""Steps between penalties of the discriminator's gradient, each of which counts as many times."""
R1 = 1.0
"""Their gamma, EG3D's for faces of 128 pixels."""


@dataclass(frozen=True)
class RealClips:
    """Real clips in training, and what describes their frames."""

    clips: Clips
    tracker: HeadTracker
    """Trained; its weights are frozen here."""
    settings: RealVideo

    def before(self, step: int) -> int:
        """Real steps before a step: they are spread evenly."""
        return int(self.settings.share * step + 1e-9)

    def at(self, step: int) -> bool:
        """Whether a step is real."""
        return self.before(step + 1) > self.before(step)


class Joint(nn.Module):
    """Model, estimator and discriminator, which learn together.

    Its `forward` is the objective itself: what several processes share must pass through it.
    """

    def __init__(
        self,
        preset: Preset,
        faces: Tensor | None,
        objective: Callable[[PortraitPair | ClipPair, int], Loss] | None = None,
    ) -> None:
        super().__init__()
        self.objective = objective
        self.model = TotalEditing(preset, faces)
        self.estimator = LightmapEstimator(preset)
        self.discriminator = Discriminator(preset)
        self.estimator.to_normal.requires_grad_(False)
        if preset.freeze == "paper":
            self.model.appearance.requires_grad_(False)
            self.model.deenactor.requires_grad_(False)

    @property
    def clipped(self) -> list[nn.Module]:
        """Adversaries: a step of one must not be cut short for the other's gradient."""
        return [nn.ModuleList([self.model, self.estimator]), self.discriminator]

    def forward(self, batch: PortraitPair | ClipPair, step: int) -> Loss:
        assert self.objective is not None  # only training calls this
        return self.objective(batch, step)


class JointStage(PairStage):
    """L_rec + L_reg + L_adv on pairs of one person, and on real clips."""

    network: Joint

    def __init__(
        self,
        data: Path,
        preset: Preset,
        seed: int,
        workers: int = 1,
        faces: Tensor | None = None,
        weights: losses.LossWeights = losses.OURS,
        real: RealClips | None = None,
        tables: Path | None = None,
    ) -> None:
        super().__init__(data, preset, seed, workers, tables=tables)
        self.weights, self.real = weights, real
        self.network = Joint(preset, faces, self._objective)
        self.texels = lightmap_estimator.texel_weights(preset.lightmap_height)
        self.recognition = self.pretrained("identity", Recognition)

    def start_from(self, run: Path) -> None:
        for part, stage in (
            (self.network.model, "reconstruct"),
            (self.network.estimator, "lightmaps"),
        ):
            checkpoints.load_best(STAGES[stage].folder(run), part)

    @property
    def facts(self) -> dict[str, Any]:
        if self.real is None:
            return {}
        real = self.real.settings
        return {"clips": str(real.folder.resolve()), "real": real.share, "real light": real.light}

    @property
    def skipped(self) -> dict[str, str]:
        return super().skipped | (self.real.clips.skipped if self.real else {})

    def batches(
        self, first: int, size: int, rank: int, ranks: int
    ) -> Iterator[PortraitPair | ClipPair]:
        real = self.real
        if real is None:
            yield from super().batches(first, size, rank, ranks)
            return
        before = real.before(first)
        start = before * size * ranks
        clips = iter(loader(real.clips, size, self.workers, start, rank=rank, world=ranks))
        pairs = super().batches(first - before, size, rank, ranks)
        step = first
        while True:
            yield next(clips) if real.at(step) else next(pairs)
            step += 1

    def loss(self, network: nn.Module, batch: PortraitPair | ClipPair, step: int) -> Loss:
        return network(batch, step)

    def _objective(self, batch: PortraitPair | ClipPair, step: int) -> Loss:
        if isinstance(batch, PortraitPair):
            return self._synthetic(batch, step)
        return self._real(batch, step)

    def _real(self, batch: ClipPair, step: int) -> Loss:
        """L_1, L_LPIPS, L_id, L_seg and L_n where a clip has mattes and normals, and L_reg."""
        assert self.real is not None
        joint, factors, real = self.network, self.weights.at(step), self.real
        image, side = batch.mot_image, batch.mot_image.shape[-1]
        generator = generator_on(image.device)
        with torch.no_grad():
            tracker = real.tracker.to(image.device).eval()
            app, mot = tracker(batch.app_image), tracker(image)
            # The source's identity, with the driver's expression and pose, framed as the driver.
            shown = mot._replace(identity=app.identity)
            control = control_of(shown)
            if self.preset.expression == "warped":
                still = shown._replace(expression=0 * shown.expression, gaze=0 * shown.gaze)
                control = control.showing(control_of(still))
            camera_to_world, intrinsics = camera_of(shown, side)
            source = self._source(batch, app, control)
        seen = batch.light_image if real.settings.light == "random" else image
        code = joint.estimator(seen).code
        # A clip's camera does not move: the light that one frame shows holds for all.
        edit = joint.model(
            source,
            mot.code,
            control,
            camera_to_world,
            intrinsics,
            self._light(code),
            camera_to_world[:, :3, :3].mT,
            generator=generator,
        )
        normal = (camera_to_world[:, :3, :3] @ batch.normal.flatten(2)).view_as(batch.normal)
        truth = truth_of_real(image, batch.alpha, batch.matted, normal)
        found = terms(joint.model, edit, truth, factors, generator)
        if real.settings.light == "consistent":
            other = joint.estimator(batch.light_image).code
            found["lightmap"] = losses.lightmap_loss(code, other, self.texels.to(code.device))
        self._faces(found, edit, truth, mot.points(side), factors)
        total = losses.total(found, self.weights, step)
        return total.loss, {f"real_{name}": value for name, value in total.scalars.items()}

    def _synthetic(self, batch: PortraitPair, step: int) -> Loss:
        joint, factors = self.network, self.weights.at(step)
        generator = generator_on(batch.mot_image.device)
        to_camera = batch.camera_to_world[:, :3, :3].mT
        code = joint.estimator(batch.mot_image).code
        seen, to_light = None, None
        if step % 2:
            seen, to_light = self._light(code), to_camera
        tables = self.tables(joint.model, batch)
        edit = edit_of(joint.model, batch, generator, seen, to_light, tables=tables)
        wanted = self.truth(batch, tables)
        found = terms(joint.model, edit, wanted, factors, generator)
        truth = encode(lightmap_estimator.fold(batch.seen_lightmaps))
        found["lightmap"] = losses.lightmap_loss(code, truth, self.texels.to(code.device))
        self._faces(found, edit, wanted, batch.points, factors)
        critic: Tensor | float = 0.0
        if factors["adversarial"]:
            found["adversarial"], critic = self._adversarial(edit, batch, step)
        total = losses.total(found, self.weights, step)
        scalars = total.scalars | ({"critic": critic.item()} if isinstance(critic, Tensor) else {})
        return total.loss + critic, scalars

    def _source(self, batch: ClipPair, app: Tracking, control: Control) -> Source:
        """A frame of a clip as a source, by what the tracker and the estimator find in it."""
        image = batch.app_image
        camera_to_world, intrinsics = camera_of(app, image.shape[-1])
        return Source(
            image=image,
            alpha=batch.app_alpha,
            code=app.code,
            control=control_of(app).showing(control),
            camera_to_world=camera_to_world,
            intrinsics=intrinsics,
            lightmaps=self._light(self.network.estimator(image).code),
            to_light=camera_to_world[:, :3, :3].mT,
        )

    def _light(self, code: Tensor) -> Tensor:
        """Lightmaps (B, 5, 3, H, 2H), linear, of what the estimator says at all of their texels."""
        return lightmap_estimator.unfold(code.clamp_min(0).expm1(), self.network.estimator.height)

    def _faces(
        self,
        found: dict[str, Tensor | None],
        edit: Edit,
        truth: Truth,
        points: Tensor,
        factors: dict[str, float],
    ) -> None:
        """Add L_LPIPS and L_id; the target's face has its five `points` (B, 5, 2) in pixels."""
        self.perceived(found, edit, truth, factors)
        if self.recognition is None or not factors["identity"]:
            return
        recognition = self.recognition.to(points.device)
        with torch.no_grad():
            wanted = recognition.features(truth.counts * truth.image, points)
        made = recognition.features(truth.counts * edit.image, points)
        found["identity"] = losses.identity_loss(made, wanted)

    def validate(self, network: nn.Module) -> Validation:
        return super().validate(self.network.model)

    def _adversarial(self, edit: Edit, batch: PortraitPair, step: int) -> tuple[Tensor, Tensor]:
        """The generator's term, and the discriminator's own with its penalty."""
        critic, side = self.network.discriminator, batch.mot_image.shape[-1]
        camera = discriminator.camera_code(batch.camera_to_world, batch.intrinsics, side)
        rendering = edit.rendering
        made = discriminator.stack(
            batch.alpha * edit.image, edit.foreground, rendering.canonical, rendering.opacity
        )
        size = edit.raw.shape[-2:]
        target = batch.alpha * batch.mot_image
        small = [
            functional.interpolate(part, size, mode="area")
            for part in (target, batch.canonical * batch.alpha, batch.alpha)
        ]
        real = discriminator.stack(target, *small)
        still = {name: p.detach() for name, p in critic.named_parameters()}
        fooled = discriminator.generator_loss(functional_call(critic, still, (made, camera)))
        own = discriminator.discriminator_loss(critic(real, camera), critic(made.detach(), camera))
        if step % R1_EVERY == 0:
            own = own + 0.5 * R1 * R1_EVERY * discriminator.r1_penalty(critic, real, camera)
        return fooled, own


def build(settings: StageSettings) -> JointStage:
    """The stage, see `stages.STAGES`.

    Raises:
        InputError: there is no real clip, or no tracker in the run to describe it.
    """
    real = None
    if settings.real is not None:
        tracker = HeadTracker(settings.preset)
        checkpoints.load_best(STAGES["tracker"].folder(settings.run), tracker)
        clips = Clips(settings.real.folder, settings.preset, settings.seed)
        real = RealClips(clips, tracker.requires_grad_(False), settings.real)
    return JointStage(
        settings.data,
        settings.preset,
        settings.seed,
        settings.workers,
        faces_of(settings.preset),
        losses.PRESETS[settings.preset.weights].over(settings.steps),
        real,
        settings.run / TABLES,
    )
