"""Brows and lashes, on strands that ride on the moving skin.

Regions are drawn in template space (see `roots`) and asked for at every root, not at vertices, so
that their edges are as fine as the hairs. Directions are in the rest frame; the subject's left half
is described and the right one mirrored.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.body.roots import Roots, SkinBound, sample_roots
from assets_procedural.conventions.parts import Part
from assets_procedural.hair.strands import clump, locks, tapered, wander
from assets_procedural.hair.tones import colouring
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.person import Person

# Brow: distance from the middle (m) → height of its axis in template space, half width.
_BROW_X = np.array([0.009, 0.016, 0.024, 0.032, 0.039, 0.046, 0.054])
_BROW_Z = np.array([0.7445, 0.7462, 0.7485, 0.7508, 0.7520, 0.7505, 0.7455])
_BROW_HALF = np.array([0.0042, 0.0046, 0.0044, 0.0040, 0.0033, 0.0024, 0.0010])


def brows(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """Left and right brow."""
    look = np.random.default_rng(person.brows.seed)
    arch, height, reach = look.normal(0, 1, 3)
    male = 1 - person.phenotypes.get("gender", 0.5)
    axis = _BROW_Z + 0.0006 * height - 0.0022 * male + 0.0016
    axis = axis + (0.0008 * arch + 0.0012 * (0.5 - male)) * np.exp(
        -(((_BROW_X - 0.039) / 0.012) ** 2)
    )
    start = 0.0005 * reach - 0.0015 * male * look.random()
    half = _BROW_HALF * (0.55 + 0.7 * person.brows.thickness + 0.22 * male)
    pieces = []
    for name, part, sign in (
        ("brow_left", Part.LEFT_BROW, 1),
        ("brow_right", Part.RIGHT_BROW, -1),
    ):
        # No two brows are alike.
        shift, tilt = look.normal(0, 0.0005), look.normal(0, 0.015)

        def across(points: np.ndarray, sign=sign, shift=shift, tilt=tilt) -> tuple:
            x = sign * points[:, 0]
            centre = np.interp(x, _BROW_X + start, axis) + shift + tilt * (x - 0.03)
            return x, (points[:, 2] - centre) / np.interp(x, _BROW_X + start, half)

        def density(points: np.ndarray, roots: Roots, across=across) -> np.ndarray:
            x, v = across(points)
            body = smoothstep(1.3, 0.3, np.abs(v)) * (points[:, 1] < -0.10)
            head = smoothstep(_BROW_X[0] + start - 0.001, _BROW_X[0] + start + 0.011, x)
            tail = smoothstep(_BROW_X[-1] + start + 0.001, _BROW_X[-1] + start - 0.006, x)
            return body * (0.12 + 0.88 * head) * (x > _BROW_X[0] + start - 0.001) * tail

        count = int((170 + 330 * person.brows.density) * (0.75 + 0.5 * person.brows.thickness))
        roots = sample_roots(identity, density, count, rng)
        x, v = across(roots.of(identity.model.template))
        along = np.clip((x - _BROW_X[0]) / 0.045, 0, 1)
        # Up at the nose, then outward; the upper rows lean down and the lower ones up.
        angle = np.interp(along, [0, 0.12, 0.3, 0.6, 1], [80, 58, 32, 12, -22])
        angle = np.radians(angle - 22 * np.clip(v, -1, 1) * smoothstep(0.05, 0.4, along))
        angle += rng.normal(0, 0.16, len(x))
        flow = np.stack([sign * np.cos(angle), np.full(len(x), -0.05), np.sin(angle)], axis=1)
        length = rng.uniform(0.004, 0.009, len(x)) * (1 - 0.35 * along)
        strands = _lying(identity, roots, flow, length, 6, lift=0.35, hug=0.0007)
        strands = _locked(strands, 5, 0.3, rng)
        strands = wander(strands, 0.00035, rng)
        radius = tapered(len(x), 6, 4.6e-5, 1.2e-5, rng)
        grey = float(np.clip(person.hair.grey * 1.1 - 0.35, 0, 1))
        melanin = np.clip(0.15 + 0.85 * person.hair.melanin, 0, 0.98)
        shading = colouring(melanin, person.hair.redness, grey, len(x), rng, 0.4)
        bound = SkinBound.at_rest(identity, roots, strands)
        pieces.append(StrandPiece(name, part, radius, bound, shading))
    return pieces


def lashes(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """All four rows of lashes in one piece; they ride on the lids, so they close with them."""
    model = identity.model
    male = 1 - person.phenotypes.get("gender", 0.5)
    all_roots, all_strands = [], []
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

            count = int((120 if upper else 55) * (1.1 - 0.25 * male))
            roots = sample_roots(
                identity, rim, count, rng, faces=model.faces[f"lashes_{side}_{lid}"]
            )
            at = roots.of(model.template)
            fan = np.clip((sign * at[:, 0] - 0.031) / 0.012, -1.2, 1.3)
            length = rng.uniform(0.75, 1.05, count) * (0.0088 - 0.0012 * male if upper else 0.0045)
            length *= 0.85 + 0.15 * fan if upper else 0.9 + 0.1 * fan
            length *= 1 - 0.25 * smoothstep(0.4, 1.2, np.abs(fan))
            out = np.stack([sign * 0.55 * fan, -1 - 0 * fan, -0.18 + 0 * fan], axis=1)
            if not upper:
                out[:, 2] = -0.55
            out = unit(out + rng.normal(0, 0.07, (count, 3)))
            bend = np.array([0, 0.12, 1.0]) if upper else np.array([0, -0.1, -0.35])
            along = np.linspace(0, 1, 6)[None, :, None]
            reach = length[:, None, None]
            curl = rng.uniform(0.6, 0.85, (count, 1, 1))
            strands = reach * (
                out[:, None] * (along - 0.25 * curl * along**2) + bend * curl * along**2
            )
            strands = roots.of(identity.rest)[:, None] + strands
            tips = _locked(strands, 3, 0.55, rng)
            all_roots.append(roots)
            all_strands.append(tips)
    roots = Roots(
        np.concatenate([r.triangle for r in all_roots]),
        np.concatenate([r.barycentric for r in all_roots]),
    )
    strands = np.concatenate(all_strands)
    count = len(strands)
    radius = tapered(count, 6, 5.5e-5, 1.2e-5, rng)
    melanin = float(np.clip(0.45 + 0.55 * person.hair.melanin, 0, 0.98))
    shading = colouring(melanin, person.hair.redness * 0.5, 0.0, count, rng, 0.4)
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
    hug: float,
) -> np.ndarray:
    """Strands (N, points, 3) that leave the skin by `lift` and then follow `flow` (N, 3) along it.

    `lift` is the sine-like share of the normal at the root; `hug` > 0 pulls the strand down to
    that height (metres) above the root's tangent plane.
    """
    normal = unit(roots.of(identity.neutral.normals))
    along_skin = unit(flow - normal * (flow * normal).sum(-1, keepdims=True))
    heading = unit(along_skin * (1 - lift) + normal * lift)
    step = (length / (points - 1))[:, None]
    start = roots.of(identity.rest)
    point, path = start, [start]
    for _ in range(points - 1):
        point = point + step * heading
        height = ((point - start) * normal).sum(-1, keepdims=True)
        if hug > 0:
            heading = unit(heading + normal * np.clip((hug - height) / hug, -1, 0) * 0.6)
        else:
            heading = unit(heading + 0.2 * flow)
        path.append(point)
    return np.stack(path, axis=1)
