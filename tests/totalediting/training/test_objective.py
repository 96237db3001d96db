"""What counts in a picture: subject, rims and background, each by what is known of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from totalediting.data.endless import collate
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.model import Edit
from totalediting.presets import PRESETS
from totalediting.pretrained import lpips
from totalediting.pretrained.fetch import NetworkError
from totalediting.training import losses
from totalediting.training.objective import terms, truth_of, truth_of_real
from totalediting.training.reconstruction import ReconstructStage, edit_of, over_black

TINY = PRESETS["tiny"]


def batch_of(data: Path, augment: bool = True) -> PortraitPair:
    pairs = PortraitPairs(data, TINY, augment=augment)
    return collate([pairs[0], pairs[1]])


def made(data: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[ReconstructStage, Any, Edit]:
    def missing(name: str, path: object = None) -> Path:
        raise NetworkError(f"{name}: not here")

    monkeypatch.setattr(lpips, "fetch", missing)
    torch.manual_seed(0)
    stage = ReconstructStage(data, TINY, 0, 0)
    batch = batch_of(data)
    return stage, batch, edit_of(stage.network, batch, None)


def of(stage: ReconstructStage, edit: Edit, batch: PortraitPair) -> dict[str, Tensor | None]:
    factors = losses.OURS.at(1)
    return terms(stage.network, edit, truth_of(batch), factors, torch.Generator().manual_seed(0))


def test_the_background_network_learns_from_what_is_beside_the_subject(
    transparent_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And its colour from nothing else: that of the picture is known."""
    stage, batch, edit = made(transparent_dataset, monkeypatch)
    found = of(stage, edit, batch)
    colour = [stage.network.background.out.weight, stage.network.background.out.bias]
    loss = found["background"]
    assert loss is not None and loss > 0
    (slope,) = torch.autograd.grad(loss, edit.behind, retain_graph=True)
    matte = torch.nn.functional.interpolate(batch.alpha, slope.shape[-2:], mode="area")
    assert slope.abs().sum(1, keepdim=True)[matte > 0.99].max() == 0
    assert (slope.abs().sum(1, keepdim=True)[matte < 0.01] > 0).float().mean() > 0.9
    others = torch.stack([v for k, v in found.items() if v is not None and k != "background"]).sum()
    for gradient in torch.autograd.grad(others, colour, retain_graph=True, allow_unused=True):
        assert gradient is None or gradient[:3].abs().max() == 0


def test_the_true_surface_is_where_the_deformation_takes_it(
    transparent_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Labels keep the expression, which a bust at rest may not have."""
    stage, batch, _ = made(transparent_dataset, monkeypatch)
    truth = truth_of(batch, stage.tables(stage.network, batch).there)
    assert truth.canonical is not None
    hit = (batch.depth > 0)[:, 0]
    assert not truth.canonical.movedim(1, -1)[~hit].any()
    apart = (truth.canonical - batch.canonical).norm(dim=1)[hit]
    assert 0 < apart.median() < 0.008


def test_a_transparent_picture_counts_as_a_whole(
    transparent_dataset: Path, small_dataset: Path
) -> None:
    whole, opaque = (truth_of(batch_of(data)) for data in (transparent_dataset, small_dataset))
    assert whole.counts.min() == 1 and torch.equal(opaque.counts, opaque.alpha)
    assert whole.foreground[(whole.alpha == 0).expand_as(whole.foreground)].max() == 0


def test_rims_of_opaque_pictures_are_no_foreground(
    small_dataset: Path, transparent_dataset: Path
) -> None:
    """There alpha I* holds some of what was behind; D(alpha c) of a transparent set does not."""
    opaque, whole = (truth_of(batch_of(data)) for data in (small_dataset, transparent_dataset))
    rim = (opaque.alpha > 0.02) & (opaque.alpha < 0.98)
    assert rim.any() and opaque.clear[rim].max() == 0 and opaque.clear[~rim].min() == 1
    assert whole.clear.min() == 1


def test_a_real_frame_counts_as_a_whole_and_shows_its_own_background() -> None:
    image, alpha = torch.rand(2, 3, 8, 8), torch.rand(2, 1, 8, 8).round()
    truth = truth_of_real(image, alpha, torch.tensor([True, False]), 0 * image)
    assert truth.counts.min() == 1
    assert torch.equal(truth.beside[0], 1 - alpha[0]) and truth.beside[1].max() == 0


def test_pictures_are_judged_over_black(
    transparent_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, _, _ = made(transparent_dataset, monkeypatch)
    batch = batch_of(transparent_dataset, augment=False)
    with torch.no_grad():
        edit = edit_of(stage.network.eval(), batch, None)
    assert torch.equal(over_black(batch, edit), edit.image)
    empty = edit.rendering.opacity[..., 0, 0].min()
    assert edit.raw[..., 0, 0].max() < 1 - empty + 0.2
