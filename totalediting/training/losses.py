"""What training minimises: the paper's supplement, "Training Scheme and Objective Functions".

    L_pre = L_S + L_N                                       the lightmap estimator alone
    L     = L_rec + L_reg + L_adv                           everything together
    L_rec = L_1 + L_LPIPS + L_id + L_seg + L_a + L_n + L_S
    L_reg = R_TV + R_delta + R_n

Symbols: B batch, N points or samples, Q queries of lightmaps. Pictures are (B, C, H, W), attributes
of points channel-last. Each term is a function that returns a scalar, a mean; `total` weights
and adds them. What has no truth is left out: albedo and lightmaps of real pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

TERMS = (
    "final",
    "raw",
    "foreground",
    "background",
    "lpips",
    "identity",
    "mask",
    "albedo",
    "normal",
    "surface",
    "lightmap",
    "tv",
    "residual",
    "density_normal",
    "adversarial",
)
"""Names of the terms: L_1 of the final, the volume-rendered and the foreground picture, and of what
is beside the subject, L_LPIPS, L_id, L_seg, L_a, L_n, ours that draws density onto the true
surface, L_S, R_TV, R_delta, R_n, L_adv."""
_RUN = 100_000  # steps that the presets' schedules are meant for


@dataclass(frozen=True)
class LossWeights:
    """Weight of each of `TERMS`, and from which step on it counts."""

    final: float = 1.0
    raw: float = 1.0
    foreground: float = 1.0
    background: float = 1.0
    lpips: float = 1.0
    identity: float = 1.0
    mask: float = 1.0
    albedo: float = 1.0
    normal: float = 0.5
    surface: float = 5.0
    lightmap: float = 1.0
    tv: float = 0.25
    residual: float = 0.1
    density_normal: float = 0.05
    adversarial: float = 0.01

    tv_every: int = 16
    """R_TV is computed every so many steps and counts as many times (lazily, as StyleGAN2's)."""
    identity_from: int = 0
    """First step of L_id."""
    adversarial_from: int = 50_000
    """First step of L_adv, which comes last: what is wrong altogether, the others tell."""
    density_normal_from: int = 2_000
    """R_n is 0 up to this step and rises linearly,"""
    density_normal_until: int = 10_000
    """until here, where it has its whole weight."""

    def over(self, steps: int) -> LossWeights:
        """The same, with the schedule, meant for 100 000 steps, shrunk or stretched to `steps`."""
        scheduled = (
            "identity_from",
            "adversarial_from",
            "density_normal_from",
            "density_normal_until",
        )
        return replace(self, **{n: getattr(self, n) * steps // _RUN for n in scheduled})

    def at(self, step: int) -> dict[str, float]:
        """The factor of each term at a step, by name; 0 where it need not be computed."""
        factors = {name: float(value) for name, value in asdict(self).items() if name in TERMS}
        factors["tv"] *= self.tv_every if step % self.tv_every == 0 else 0
        factors["identity"] *= step >= self.identity_from
        factors["adversarial"] *= step >= self.adversarial_from
        rise = max(self.density_normal_until - self.density_normal_from, 1)
        share = (step - self.density_normal_from) / rise
        if step < self.density_normal_until:
            factors["density_normal"] *= min(max(share, 0.0), 1.0)
        return factors


OURS = LossWeights()
"""To start from; for a run of another length than 100 000 steps, `OURS.over`."""
PAPER = LossWeights(
    raw=0.0,
    foreground=0.0,
    mask=1.0,
    normal=1.0,
    surface=0.0,
    tv=1.0,
    residual=1.0,
    density_normal=1.0,
    adversarial=1.0,
    tv_every=1,
    identity_from=0,
    adversarial_from=0,
    density_normal_from=0,
    density_normal_until=0,
)
"""The paper's: the plain sum, from the first step; of pictures only the final one is compared, and
what is behind the subject, which is ours to learn by itself."""


PRESETS = {"ours": OURS, "paper": PAPER}
"""By the name of the switch `weights`."""


class Total(NamedTuple):
    """The sum, for `backward`; what to log; and which terms are off, with the reason."""

    loss: Tensor
    scalars: dict[str, float]
    """Unweighted values of the terms that count, and "total"."""
    off: dict[str, str]
    """Reason by name: "not given", "weight 0", "not yet" or "not in this step"."""


def total(terms: Mapping[str, Tensor | None], weights: LossWeights, step: int) -> Total:
    """Weighted sum of the terms given at a step; None or absent ones are left out.

    Raises:
        ValueError: a name is not of `TERMS`, a term is not one number, or none counts.
    """
    if unknown := set(terms) - set(TERMS):
        raise ValueError(f"unknown terms {sorted(unknown)}; there are {', '.join(TERMS)}")
    factors = weights.at(step)
    parts: dict[str, Tensor] = {}
    off = {}
    for name in TERMS:
        term = terms.get(name)
        if getattr(weights, name) == 0:
            off[name] = "weight 0"
        elif factors[name] == 0:
            off[name] = "not in this step" if name == "tv" else "not yet"
        elif term is None:
            off[name] = "not given"
        elif term.ndim:
            raise ValueError(f"{name} must be one number, not {tuple(term.shape)}")
        else:
            parts[name] = term
    if not parts:
        raise ValueError(f"no term counts at step {step}: {off}")
    loss = torch.stack([factors[name] * term.float() for name, term in parts.items()]).sum()
    # One transfer from the device for all.
    values = torch.stack([t.detach().float() for t in (*parts.values(), loss)]).tolist()
    return Total(loss, dict(zip((*parts, "total"), values, strict=True)), off)


def l1(prediction: Tensor, truth: Tensor, weight: Tensor | None = None) -> Tensor:
    """Mean absolute difference (L_1), or its mean by a `weight` >= 0 that broadcasts to it.

    Where all weights are 0 it is 0, without gradient.

    Raises:
        ValueError: the shapes differ, or the weight's does not broadcast.
    """
    _same(prediction, truth)
    difference = (prediction - truth).abs()
    return difference.mean() if weight is None else _mean(difference, weight)


def identity_loss(features: Tensor, truth: Tensor) -> Tensor:
    """L_id: 1 - cosine of face recognition features (B, C); nothing flows into those of the truth.

    The paper's negative cosine, plus 1.
    """
    _same(features, truth)
    return 1.0 - F.cosine_similarity(features, truth.detach(), dim=-1).mean()


def mask_loss(opacity: Tensor, matte: Tensor, known: Tensor | None = None) -> Tensor:
    """L_seg: L1 of the rendered opacity against the matte, (B, 1, H, W) in [0, 1].

    `known` weighs pictures, as (B, 1, 1, 1): some have no matte.
    """
    return l1(opacity, matte, known)


def albedo_loss(albedo: Tensor, truth: Tensor, matte: Tensor) -> Tensor:
    """L_a: L1 of albedo (B, 3, H, W) in the foreground, weighted by the matte (B, 1, H, W).

    `albedo` is premultiplied by its opacity, as volume rendering leaves it; `truth` is not, and is
    premultiplied here. Both in one colour space.
    """
    return l1(albedo, matte * truth, matte)


def normal_loss(normal: Tensor, truth: Tensor, matte: Tensor) -> Tensor:
    """L_n and L_N: 1 - cosine of normals (B, 3, H, W) in the foreground, weighted by the matte.

    Only directions count: rendered normals, premultiplied, need not be unit. Both in one frame.
    Where the truth has no normal (length 0), as in the background, a pixel does not count.
    """
    _same(normal, truth)
    cosine = F.cosine_similarity(normal, truth, dim=1)[:, None]
    known = (truth.square().sum(1, keepdim=True) > 1e-6).to(matte.dtype)
    return _mean(1.0 - cosine, matte * known)


def surface_loss(weights: Tensor, points: Tensor, truth: Tensor, known: Tensor) -> Tensor:
    """How far what is seen lies from the true surface, metres: the mean over rays of the samples'
    mean distance from it, by their render weights.

    Ours: in a fog the picture says little of where things are, and exact labels do. Both the depth
    of what is seen and its spread count; how much is seen does not.

    Args:
        weights: (B, R, S) of the samples.
        points: (B, R, S, 3) their canonical positions.
        truth: (B, R, 3) canonical position of the surface that a ray meets first.
        known: (B, R) weight of a ray, 0 where it meets none.
    """
    distance = (points - truth[:, :, None]).norm(dim=-1)
    seen = (weights * distance).sum(-1) / weights.sum(-1).clamp_min(1e-3)
    return _mean(seen, known)


def lightmap_loss(code: Tensor, truth: Tensor, weights: Tensor) -> Tensor:
    """L_S: L1 of lightmaps at queries, (B, Q, 3) as log(1 + light), by solid angle (Q,).

    All texels or some: `lightmap_estimator.fold` makes queries of maps,
    `lightmap_estimator.texel_weights` gives their solid angles.
    """
    _same(code, truth)
    if weights.shape != code.shape[1:2]:
        raise ValueError(f"weights must be ({code.shape[1]},), not {tuple(weights.shape)}")
    return l1(code, truth, weights[:, None])


def tv_loss(density: Tensor, beside: Tensor) -> Tensor:
    """R_TV: L1 between densities (B, N) at points and at the points jittered, as EG3D's."""
    return l1(density, beside)


def density_normal_loss(normal: Tensor, density_normal: Tensor, weights: Tensor) -> Tensor:
    """R_n: 1 - n.m, m = -grad sigma / |grad sigma|, by the samples' render weights (B, N).

    Normals n and m are (B, N, 3) in one frame. Neither m nor the weights receive a gradient: the
    normal follows the density, and never the density the normal. Where m is shorter than 1, as the
    density hardly changes, a sample counts by its length.
    """
    _same(normal, density_normal)
    target = density_normal.detach()
    missing = target.norm(dim=-1) - (F.normalize(normal, dim=-1) * target).sum(-1)
    return _mean(missing, weights.detach())


def _mean(values: Tensor, weight: Tensor) -> Tensor:
    try:
        weight = weight.expand_as(values)
    except RuntimeError:
        raise ValueError(
            f"weight {tuple(weight.shape)} does not broadcast to {tuple(values.shape)}"
        ) from None
    return (weight * values).sum() / weight.sum().clamp_min(1e-6)


def _same(a: Tensor, b: Tensor) -> None:
    if a.shape != b.shape:
        raise ValueError(f"shapes must be equal, not {tuple(a.shape)} and {tuple(b.shape)}")
