"""What an edit is compared with: the terms of L_rec and R of one picture, synthetic or real.

A transparent pair has one background, which is known: its pictures count as a whole. Of an opaque
one only the subject counts, by its matte: its two pictures have other backgrounds. A real frame
counts as a whole, before the background that `Background` finds in I_app. That network learns from
what is seen beside the subject. B, S, h as in `totalediting.model`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.data.pairs import PortraitPair
from totalediting.geometry.field import Table
from totalediting.geometry.projection import unproject
from totalediting.model import Edit, TotalEditing, Window
from totalediting.networks.density import Volume, density_jitter, density_normals
from totalediting.presets import Preset
from totalediting.training import losses

_TV_POINTS, _NORMAL_POINTS = 1000, 1024


class Truth(NamedTuple):
    """Ground truth of an edit."""

    image: Tensor
    """(B, 3, S, S), I*."""
    counts: Tensor
    """(B, 1, S, S) how much its pixels count."""
    alpha: Tensor
    """(B, 1, S, S) coverage; 1 where it is not known."""
    foreground: Tensor
    """(B, 3, S, S) the subject over black."""
    clear: Tensor
    """(B, 1, S, S) where that is known: it holds no background, as the rims of opaque pictures."""
    background: Tensor
    """(B, 3, S, S) what is behind the subject,"""
    beside: Tensor
    """(B, 1, S, S) where that is known, and matters."""
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
        parts = {
            name: window.of(part, scale)
            for name, part in self._asdict().items()
            if part is not None and part.ndim == 4
        }
        return self._replace(**parts)


def truth_of(batch: PortraitPair, there: Table | None = None) -> Truth:
    """The ground truth of synthetic pictures.

    Labels of canonical positions keep the expression. Where a bust at rest has none, they are
    where its deformation `there`, from the pose to show, takes the true depth.
    """
    canonical = batch.canonical
    if there is not None:
        points = unproject(batch.depth, batch.camera_to_world, batch.intrinsics).flatten(1, 2)
        moved = there.positions(points).mT.view_as(canonical)
        canonical = torch.where(batch.depth > 0, moved, 0.0)
    alpha, known = batch.alpha, batch.transparent[:, None, None, None]
    return Truth(
        image=batch.mot_image,
        counts=torch.where(known, 1.0, alpha),
        alpha=alpha,
        foreground=batch.foreground,
        clear=torch.where(known, 1.0, away_from_rims(alpha)),
        background=torch.where(known, batch.background, batch.app.image),
        beside=1 - torch.where(known, alpha, batch.app.alpha),
        matted=torch.ones(len(alpha), dtype=torch.bool, device=alpha.device),
        normal=batch.normal,
        albedo=batch.albedo,
        canonical=canonical,
    )


def truth_of_real(image: Tensor, alpha: Tensor, matted: Tensor, normal: Tensor) -> Truth:
    """The ground truth of frames of clips, whose normals (B, 3, S, S) are in model space."""
    known = matted.to(alpha)[:, None, None, None]
    return Truth(
        image=image,
        counts=torch.ones_like(alpha),
        alpha=alpha,
        foreground=alpha * image,
        clear=known * away_from_rims(alpha),
        background=image,
        beside=known * (1 - alpha),
        matted=matted,
        normal=normal,
        albedo=None,
        canonical=None,
    )


def away_from_rims(alpha: Tensor) -> Tensor:
    """1 where a matte (B, 1, S, S) is all or nothing, else 0."""
    return ((alpha > 0.98) | (alpha < 0.02)).to(alpha)


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

    small_matte = small(matte)
    decomposed = model.preset.decoder == "phong"
    found: dict[str, Tensor | None] = {
        "final": losses.l1(truth.counts * edit.image, truth.counts * target),
        "raw": losses.l1(small(truth.counts) * edit.raw, small(truth.counts * target)),
        "foreground": losses.l1(edit.foreground, small(truth.foreground), small(truth.clear)),
        "background": losses.l1(edit.behind, small(truth.background), small(truth.beside)),
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
    planes, shown = edit.planes.geometry, edit.planes.shown
    volume = Volume(planes, shown.sheet.relief, shown, model.decoders.geometry)
    if factors["tv"]:
        found["tv"] = losses.tv_loss(*density_jitter(volume, _TV_POINTS, generator))
    if factors["density_normal"] and decomposed:
        batch_size, device = len(rendering.weights), rendering.weights.device
        count = rendering.weights[0].numel()
        chosen = torch.randint(count, (_NORMAL_POINTS,), generator=generator, device=device)
        points, normals, weights = (
            a.reshape(batch_size, count, -1)[:, chosen]
            for a in (rendering.points, rendering.canonical_normals, rendering.weights)
        )
        with torch.no_grad():
            facing = density_normals(volume, points)
        found["density_normal"] = losses.density_normal_loss(normals, facing, weights[..., 0])
    return found
