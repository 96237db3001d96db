"""Brows and lashes, on strands that ride on the moving skin.

Regions are drawn in template space (see `roots`) and asked for at every root, not at vertices, so
that their edges are as fine as the hairs. Directions are in the rest frame; the subject's left half
is described and the right one mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.body.roots import Roots, SkinBound, sample_roots
from assets_procedural.conventions.parts import Part
from assets_procedural.hair.strands import clump, locks, tapered, wander
from assets_procedural.hair.tones import colouring
from assets_procedural.mesh.vectors import across, smoothstep, unit
from assets_procedural.person import Person

# Brow: distance from the middle (m) → height of its axis in template space, half width.
_BROW_X = np.array([0.009, 0.016, 0.024, 0.032, 0.039, 0.046, 0.054])
_BROW_Z = np.array([0.7464, 0.7465, 0.7467, 0.7469, 0.7469, 0.7455, 0.7418])
_BROW_HALF = np.array([0.0042, 0.0046, 0.0045, 0.0040, 0.0033, 0.0024, 0.0011])
_BROW_MIDDLE, _BROW_PEAK = 0.030, 0.038
# Brows bend back to this height over the skin, metres.
_HUG = 0.0006


@dataclass(frozen=True)
class BrowStyle:
    """What sets a family of brows apart from the plain one.

    `arch` and `tail` lift the peak and the outer end (mm), `slope` the outer end against the inner
    one (mm per mm). The others are factors; `unruly` is the spread of the hairs' directions.
    """

    arch: float = 0.0
    tail: float = 0.0
    slope: float = 0.0
    width: float = 1.0
    density: float = 1.0
    length: float = 1.0
    unruly: float = 1.0


BROWS = {
    "natural": BrowStyle(),
    "flat": BrowStyle(arch=-1.3, tail=1.6),
    "straight": BrowStyle(arch=-0.9, tail=1.0, slope=0.035),
    "arched": BrowStyle(arch=2.0, tail=-0.6, width=0.9),
    "rounded": BrowStyle(arch=1.2, tail=-1.6, width=0.85),
    "bushy": BrowStyle(width=1.3, density=1.35, length=1.25, unruly=2.0),
    "sparse": BrowStyle(width=0.85, density=0.5, length=0.85, unruly=1.3),
    "thin": BrowStyle(arch=1.2, width=0.55, density=0.85, length=0.8, unruly=0.7),
}
"""Families of brows, which people of any job may have."""


def brows(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """Left and right brow.

    Raises:
        KeyError: `person.brows.style` is not in `BROWS`.
    """
    wearing = person.brows
    if wearing.style not in BROWS:
        raise KeyError(f"no brows named {wearing.style!r}; known: {', '.join(BROWS)}")
    style = BROWS[wearing.style]
    look = np.random.default_rng(wearing.seed)
    male = 1 - person.phenotypes.get("gender", 0.5)
    outwards = (_BROW_X - _BROW_MIDDLE) / 0.02
    # The male brow sits lower on the ridge and is flatter.
    axis = _BROW_Z + 1e-3 * wearing.height_mm + 0.0012 * (0.5 - male)
    axis = axis + 0.02 * (style.slope + wearing.slope) * outwards
    arch = style.arch + wearing.arch_mm + 1.2 * (0.5 - male)
    axis = axis + 1e-3 * arch * np.exp(-(((_BROW_X - _BROW_PEAK) / 0.011) ** 2))
    axis = axis + 1e-3 * style.tail * smoothstep(_BROW_PEAK, 0.054, _BROW_X)
    half = _BROW_HALF * style.width * (0.5 + 0.75 * wearing.thickness + 0.15 * male)
    half = half * np.clip(1 - 0.5 * wearing.taper * outwards, 0.45, 1.6)
    x_axis = _BROW_X + 1e-3 * wearing.start_mm * np.linspace(1, 0, len(_BROW_X))
    pieces = []
    for name, part, sign in (
        ("brow_left", Part.LEFT_BROW, 1),
        ("brow_right", Part.RIGHT_BROW, -1),
    ):
        # No two brows are alike.
        shift, tilt = look.normal(0, 0.0005), look.normal(0, 0.015)
        ragged = look.normal(0, 0.12, 12)

        def placed(points: np.ndarray, sign=sign, shift=shift, tilt=tilt) -> tuple:
            x = sign * points[:, 0]
            centre = np.interp(x, x_axis, axis) + shift + tilt * (x - _BROW_MIDDLE)
            return x, (points[:, 2] - centre) / np.interp(x, x_axis, half)

        def density(points: np.ndarray, roots: Roots, placed=placed, ragged=ragged) -> np.ndarray:
            x, v = placed(points)
            v = v + np.interp(x, np.linspace(x_axis[0], x_axis[-1], len(ragged)), ragged)
            # The lower edge is the cleaner one; stray hairs grow around both.
            body = smoothstep(1.3, 0.35, v) * smoothstep(-1.15, -0.45, v)
            body = np.maximum(body, 0.05 * smoothstep(2.0, 1.0, np.abs(v)))
            head = smoothstep(x_axis[0] - 0.001, x_axis[0] + 0.012, x)
            tail = smoothstep(x_axis[-1] + 0.001, x_axis[-1] - 0.009, x)
            grown = body * (0.1 + 0.9 * head) * (0.1 + 0.9 * tail)
            within = (x > x_axis[0] - 0.001) & (x < x_axis[-1] + 0.001)
            return grown * within * (points[:, 1] < -0.10)

        thick = 0.6 + 0.6 * wearing.thickness
        count = int((260 + 480 * wearing.density) * thick * style.density * style.width**0.5)
        roots = sample_roots(identity, density, count, rng)
        count = len(roots)
        x, v = placed(roots.of(identity.model.template))
        along = np.clip((x - x_axis[0]) / (x_axis[-1] - x_axis[0]), 0, 1)
        # Up at the nose, then outward; the upper rows lean down and the lower ones up.
        angle = np.interp(along, [0, 0.1, 0.25, 0.5, 0.75, 1], [84, 68, 40, 17, -6, -30])
        angle = angle - 30 * np.clip(v, -1, 1) * smoothstep(0.08, 0.4, along)
        angle = np.radians(angle) + style.unruly * rng.normal(0, 0.13, count)
        flow = np.stack([sign * np.cos(angle), np.full(count, -0.05), np.sin(angle)], axis=1)
        # A third is fine short down that fills the brow between its terminal hairs.
        down = rng.random(count) < 0.35
        length = style.length * rng.uniform(0.0045, 0.0085, count) * (1 - 0.4 * along**2)
        length = length * np.where(down, 0.55, 1) * (0.8 + 0.4 * half.max() / _BROW_HALF.max())
        strands = _lying(identity, roots, flow, length, 6, lift=0.3)
        strands = _locked(strands, 5, 0.25, rng)
        strands = wander(strands, 0.00025 * style.unruly, rng)
        radius = tapered(count, 6, 4.4e-5, 1.0e-5, rng)
        radius = radius * np.where(down, 0.6, 1)[:, None].astype(np.float32)
        grey = float(np.clip(person.hair.grey * 1.1 - 0.35, 0, 1))
        melanin = np.clip(0.25 + 0.75 * person.hair.melanin, 0, 0.98)
        shading = colouring(melanin, person.hair.redness, grey, count, rng, 0.4)
        bound = SkinBound.at_rest(identity, roots, strands)
        pieces.append(StrandPiece(name, part, radius, bound, shading))
    return pieces


def lashes(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """All four rows of lashes in one piece; they ride on the lids, so they close with them."""
    model = identity.model
    male = 1 - person.phenotypes.get("gender", 0.5)
    all_roots, all_strands, all_radii = [], [], []
    for sign, side in ((1, "left"), (-1, "right")):
        eye = model.template[model.groups[f"eye_{side}"]].mean(axis=0)
        for lid in ("lower", "upper"):
            upper = lid == "upper"

            def rim(points: np.ndarray, roots: Roots, eye=eye, sign=sign) -> np.ndarray:
                away = np.linalg.norm(points - eye, axis=1)
                x = sign * points[:, 0]
                # The helper strips begin behind the rim of the lid, which is 17 mm from the
                # eye's centre; the corners carry few lashes.
                ends = smoothstep(0.0195, 0.0245, x) * smoothstep(0.0448, 0.0425, x)
                return ((away > 0.0163) & (away < 0.0172)) * (0.05 + 0.95 * ends) * (x > 0.0195)

            count = int((170 if upper else 70) * (1.1 - 0.25 * male))
            roots = sample_roots(
                identity, rim, count, rng, faces=model.faces[f"lashes_{side}_{lid}"]
            )
            at = roots.of(model.template)
            fan = np.clip((sign * at[:, 0] - 0.031) / 0.012, -1.2, 1.3)
            length = rng.uniform(0.6, 1.05, count) * (0.0088 - 0.0012 * male if upper else 0.0038)
            length *= 0.85 + 0.15 * fan if upper else 0.9 + 0.1 * fan
            length *= 1 - 0.25 * smoothstep(0.4, 1.2, np.abs(fan))
            out = np.stack([sign * 0.55 * fan, -1 - 0 * fan, -0.18 + 0 * fan], axis=1)
            if not upper:
                out[:, 2] = -0.55
            out = unit(out + rng.normal(0, 0.12 if upper else 0.18, (count, 3)))
            bend = np.array([0, 0.12, 1.0]) if upper else np.array([0, -0.1, -0.35])
            along = np.linspace(0, 1, 6)[None, :, None]
            reach = length[:, None, None]
            curl = rng.uniform(0.6, 0.85, (count, 1, 1))
            strands = reach * (
                out[:, None] * (along - 0.25 * curl * along**2) + bend * curl * along**2
            )
            strands = roots.of(identity.rest)[:, None] + strands
            tips = _locked(strands, 3, 0.55, rng)
            thick = tapered(count, 6, 6.2e-5 if upper else 3.6e-5, 1.0e-5, rng)
            all_radii.append(thick)
            all_roots.append(roots)
            all_strands.append(tips)
    roots = Roots(
        np.concatenate([r.triangle for r in all_roots]),
        np.concatenate([r.barycentric for r in all_roots]),
    )
    strands = np.concatenate(all_strands)
    count = len(strands)
    radius = np.concatenate(all_radii)
    # Lashes are darker than the hair of the head and grey late.
    melanin = float(np.clip(0.75 + 0.23 * person.hair.melanin, 0, 0.98))
    shading = colouring(melanin, person.hair.redness * 0.3, 0.0, count, rng, 0.4)
    bound = SkinBound.at_rest(identity, roots, strands)
    return [StrandPiece("lashes", Part.SKIN, radius, bound, shading)]


def _locked(
    strands: np.ndarray, size: float, strength: float, rng: np.random.Generator
) -> np.ndarray:
    leader = locks(strands[:, 0], np.ones(len(strands), int), size, rng)
    return clump(strands, leader, strength)


def _lying(
    identity: Identity,
    roots: Roots,
    flow: np.ndarray,
    length: np.ndarray,
    points: int,
    lift: float,
) -> np.ndarray:
    """Strands (N, points, 3) that run along the skin towards `flow` (N, 3), close above it.

    They leave it by the share `lift` of its normal and bend back to `_HUG` above the plane that
    touches it at the root.
    """
    normal = unit(roots.of(identity.neutral.normals))
    heading = unit(across(flow, normal) * (1 - lift) + normal * lift)
    step = (length / (points - 1))[:, None]
    start = roots.of(identity.rest)
    point, path = start, [start]
    for _ in range(points - 1):
        point = point + step * heading
        height = ((point - start) * normal).sum(-1, keepdims=True)
        heading = unit(heading + normal * np.clip((_HUG - height) / _HUG, -1, 0) * 0.6)
        path.append(point)
    return np.stack(path, axis=1)
