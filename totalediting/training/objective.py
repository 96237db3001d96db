"""What an edit is compared with: the terms of L_rec and R of one picture, synthetic or real.

Only the subject counts where its matte is known: the two pictures of a synthetic pair may have
other backgrounds. A real frame without a matte counts as a whole, before the background of I_app.
B, S, h as in `totalediting.model`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.data.pairs import PortraitPair
from totalediting.model import Edit, TotalEditing, Window
from totalediting.networks.rendering import density_jitter, density_normals
from totalediting.presets import Preset
from totalediting.training import losses

_TV_POINTS, _NORMAL_POINTS = 1000, 4096


class Truth(NamedTuple):
    """Ground truth of an edit."""

    image: Tensor
    """(B, 3, S, S), I*."""
    alpha: Tensor
    """(B, 1, S, S) coverage; 1 where it is not known."""
    matted: Tensor
    """(B,) bool: whether the coverage is known."""
    normal: Tensor
    """(B, 3, S, S) unit, model space; 0 where unknown."""
    albedo: Tensor | None
    """(B, 3, S, S) linear; None of real pictures."""
    canonical: Tensor | None
    """(B, 3, S, S) canonical positions, 0 where nothing is; None of real pictures."""

    def within(self, window: Window, preset: Preset) -> Truth:
        """The part of it in a window of the raw picture."""
        scale = preset.image // preset.neural
        return Truth(
            window.of(self.image, scale),
            window.of(self.alpha, scale),
            self.matted,
            window.of(self.normal, scale),
            *(None if a is None else window.of(a, scale) for a in (self.albedo, self.canonical)),
        )


def truth_of(batch: PortraitPair) -> Truth:
    """The ground truth of synthetic pictures."""
    matted = torch.ones(len(batch.alpha), dtype=torch.bool, device=batch.alpha.device)
    return Truth(batch.mot_image, batch.alpha, matted, batch.normal, batch.albedo, batch.canonical)


def terms(
    model: TotalEditing,
    edit: Edit,
    truth: Truth,
    factors: dict[str, float],
    generator: torch.Generator,
) -> dict[str, Tensor | None]:
    """L_1, L_seg, L_a, L_n and the regularisers; those whose factor is 0 are not computed."""
    rendering, matte, target = edit.rendering, truth.alpha, truth.image
    side = edit.raw.shape[-2:]
    known = truth.matted.to(matte)[:, None, None, None]

    def small(picture: Tensor) -> Tensor:
        return functional.interpolate(picture, side, mode="area")

    small_matte, small_target = small(matte), small(matte * target)
    decomposed = model.preset.decoder == "phong"
    found: dict[str, Tensor | None] = {
        "final": losses.l1(matte * edit.image, matte * target),
        "raw": losses.l1(small_matte * edit.raw, small_target),
        "foreground": losses.l1(edit.foreground, small_target, known),
        "mask": losses.mask_loss(rendering.opacity, small_matte, known),
        "residual": rendering.residual_l1.mean() if decomposed else None,
    }
    if decomposed:  # the plain decoder knows neither
        found["normal"] = losses.normal_loss(rendering.normal, small(truth.normal), small_matte)
        if truth.albedo is not None:
            albedo = small(truth.albedo)
            found["albedo"] = losses.albedo_loss(rendering.albedo, albedo, small_matte)
    if truth.canonical is not None and factors["surface"]:
        hit = small((truth.canonical != 0).any(1, keepdim=True).to(matte))
        place = small(truth.canonical) / hit.clamp_min(1e-6)
        wholly = (hit > 0.99).to(matte)  # elsewhere it is a mean over an edge
        found["surface"] = losses.surface_loss(
            rendering.weights, rendering.points, place.flatten(2).mT, wholly.flatten(1)
        )
    volume = edit.planes.geometry, edit.planes.laid, model.decoders.geometry
    if factors["tv"]:
        found["tv"] = losses.tv_loss(*density_jitter(*volume, _TV_POINTS, generator))
    if factors["density_normal"] and decomposed:
        batch_size, device = len(rendering.weights), rendering.weights.device
        count = rendering.weights[0].numel()
        chosen = torch.randint(count, (_NORMAL_POINTS,), generator=generator, device=device)
        points, normals, weights = (
            a.reshape(batch_size, count, -1)[:, chosen]
            for a in (rendering.points, rendering.canonical_normals, rendering.weights)
        )
        with torch.no_grad():
            facing = density_normals(*volume, points)
        found["density_normal"] = losses.density_normal_loss(normals, facing, weights[..., 0])
    return found
