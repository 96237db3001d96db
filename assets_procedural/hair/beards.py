"""Beards, on strands that ride on the moving skin.

Regions are drawn in template space (see `roots`) and asked for at every root, not at vertices, so
that their edges are as fine as the hairs: every edge is a fall of density, bent by noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets_procedural.body.hairline import hairline_distance
from assets_procedural.body.head import Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.body.roots import Roots, SkinBound, sample_roots
from assets_procedural.conventions.parts import Part
from assets_procedural.hair.beard_styles import BEARD_STYLES, BEARDS, BeardStyle
from assets_procedural.hair.strands import clump, locks, tapered, tousled, wander
from assets_procedural.hair.tones import colouring
from assets_procedural.mesh.vectors import across, arctan2, smoothstep, unit
from assets_procedural.person import Person

# Azimuth about the skull's axis (degrees) → upper edge on the cheek in template space.
_CHEEK_AZIMUTH = np.array([0, 14, 22, 32, 45, 58, 66, 72, 82])
_CHEEK_HEIGHT = np.array([0.684, 0.683, 0.676, 0.667, 0.664, 0.672, 0.690, 0.712, 0.72])


def beard(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """The beard, no piece where there is none.

    Raises:
        KeyError: `person.beard.style` is not in `BEARD_STYLES`.
    """
    name = person.beard.style
    if name not in BEARD_STYLES:
        raise KeyError(f"no beard style named {name!r}; known: {', '.join(BEARD_STYLES)}")
    if name == "none":
        return []
    style = BEARDS[name]
    density = _density(style, person, identity)
    count = int(style.count * (0.35 + 0.65 * person.beard.density))
    roots = sample_roots(identity, density, count, rng)
    at = roots.of(identity.model.template)
    count = len(at)
    stubble = name == "stubble"
    points = 4 if stubble else 9
    # Shorter towards the edges, on the cheeks and the neck; a moustache stays off the mouth.
    full = person.beard.length_mm * 1e-3
    edge = smoothstep(0.05, 0.8, density(at, roots))
    chin = smoothstep(0.050, 0.015, np.abs(at[:, 0])) * smoothstep(0.660, 0.640, at[:, 2])
    neck = smoothstep(-0.095, -0.070, at[:, 1]) * smoothstep(0.645, 0.62, at[:, 2])
    length = np.minimum(full, 0.012) + np.maximum(full - 0.012, 0) * chin * (1 - 0.6 * neck)
    length = length * (0.3 + 0.7 * edge) * rng.uniform(0.55, 1.1, count)
    lip = smoothstep(0.668, 0.674, at[:, 2]) * (np.abs(at[:, 0]) < 0.035)
    length = np.where(lip > 0, np.minimum(length, 0.009 + 0.05 * np.abs(at[:, 0])), length)

    side = np.sign(at[:, 0])
    outward = np.clip(np.abs(at[:, 0]) / 0.02, 0.15, 1.0)
    below = smoothstep(0.668, 0.64, at[:, 2])
    # A moustache is parted under the nose and combed to the corners of the mouth.
    aside = outward * (0.9 - 0.65 * below) + 0.5 * lip
    flow = np.stack([side * aside, -0.25 * below, -1 + 0.3 * lip], axis=1)
    flow = unit(flow + 0.25 * tousled(at * 2.5, rng) + rng.normal(0, 0.2, (count, 3)))
    strands = _grown(identity, roots, flow, length, points, lift=0.45 if stubble else 0.4)
    tone = rng.normal(0, 0.25, count)
    if not stubble:
        for size, strength in ((10, 0.35), (60, 0.5 if full > 0.012 else 0.1)):
            leader = locks(strands[:, 0], np.ones(count, int), size, rng)
            strands = clump(strands, leader, strength * rng.uniform(0.6, 1.2, count))
            tone = tone + rng.normal(0, 0.2, count)[leader]
        strands = wander(strands, np.minimum(0.14 * length, 0.005), rng)
    root = 9e-5 if stubble else 6.5e-5
    radius = tapered(count, points, root, 0.4 * root, rng)
    # The chin greys first.
    grey = np.clip(person.hair.grey * (0.85 + 0.6 * chin), 0, 0.96)
    redness = min(person.hair.redness * 1.3 + 0.1, 1)
    shading = colouring(person.hair.melanin, redness, grey, count, rng, 0.35)
    shading["tone"] = np.exp(tone).astype(np.float32)
    bound = SkinBound.at_rest(identity, roots, strands)
    return [StrandPiece("beard", Part.BEARD, radius, bound, shading)]


def _density(style: BeardStyle, person: Person, identity: Identity) -> Callable:
    masks = identity.model.masks
    normals = identity.neutral.normals
    look = np.random.default_rng(person.beard.seed)
    drop, patchy = look.normal(-0.001, 0.003), look.uniform(0.2, 1)
    seeds = look.integers(2**31, size=3)
    # Half widths of the edges on cheek and neck, metres.
    soft = 0.011 - 0.007 * style.tidy

    def density(points: np.ndarray, roots: Roots) -> np.ndarray:
        x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
        coarse, fine, patches = (
            tousled(points * scale, np.random.default_rng(seed))[:, 0]
            for scale, seed in zip((1.3, 5.0, 2.0), seeds, strict=True)
        )
        ragged = (0.0020 * coarse + 0.0016 * fine) * (1.3 - style.tidy)
        azimuth = np.degrees(arctan2(x, -(y + 0.05)))
        cheek = np.interp(azimuth, _CHEEK_AZIMUTH, _CHEEK_HEIGHT) + ragged
        cheek = cheek + (drop + 0.004 * (style.tidy - 0.5)) * smoothstep(20, 40, azimuth)
        neck = 0.616 + 0.85 * np.maximum(y + 0.075, 0) + 1.5 * ragged
        skin = smoothstep(0.35, 0.1, roots.of(masks["lips"]))
        skin = skin * smoothstep(0.3, 0.05, roots.of(masks["inside-mouth"]))
        skin = skin * smoothstep(0.5, 0.1, roots.of(masks["ears"])) * (y < -0.035)
        # Sideburns run into the hair of the temples.
        skin = skin * smoothstep(12, 2, hairline_distance(points, person) * (z > 0.66))
        # Under the jaw it is thinner: from the front it would add up to a dark edge.
        skin = skin * (1 - 0.6 * smoothstep(-0.2, -0.7, unit(roots.of(normals))[:, 2]))
        # Not inside the nostrils nor the mouth: hair grows on skin that faces away from the head.
        facing = (roots.of(normals) * (points - [0, -0.06, 0.67])).sum(-1) > 0
        below = smoothstep(soft, -soft, z - cheek)
        whole = below * smoothstep(-1.3 * soft, 1.3 * soft, z - neck)
        whole = whole * (1 - 0.5 * patchy * (1 - person.beard.density) * smoothstep(0, 1, patches))

        bend = ragged * 0.6
        lip = smoothstep(0.6660, 0.6685, z) * smoothstep(0.6885, 0.6805, z + bend)
        lip = lip * smoothstep(0.037, 0.026, x + bend) * (y < -0.115)
        lip = lip * (0.6 + 0.4 * smoothstep(0.001, 0.006, x))
        # Around the corners of the mouth the moustache runs down to the chin.
        corner = smoothstep(0.010, 0.004, np.abs(x - 0.0295)) * smoothstep(0.676, 0.668, z)
        corner = corner * whole * (y < -0.085)
        # The gaps beside the soul patch.
        gap = smoothstep(0.004, 0.008, np.abs(x - 0.0135)) + (z < 0.643) + (z > 0.658)
        gap = np.clip(gap, 0.15, 1)
        middle = whole * gap * smoothstep(0.039, 0.026, x + 2 * bend) * (y < -0.085) * (z < 0.667)
        burns = whole * smoothstep(56, 66, azimuth + 900 * bend) * smoothstep(0.665, 0.69, z)
        flank = whole * gap * smoothstep(0.0, 0.012, 0.700 + 0.03 * (x > 0.05) - z)
        flank = np.where((z > 0.6665) & (x < 0.030), 0, flank)

        grown = np.maximum(style.cheeks * flank, style.sideburns * burns)
        grown = np.maximum(grown, style.chin * middle)
        grown = np.maximum(grown, style.moustache * lip)
        grown = np.maximum(grown, min(style.chin, style.moustache) * corner)
        return grown * skin * facing

    return density


def _grown(
    identity: Identity,
    roots: Roots,
    flow: np.ndarray,
    length: np.ndarray,
    points: int,
    lift: float,
) -> np.ndarray:
    """Strands (N, points, 3) that leave the skin by the share `lift` of its normal, then flow."""
    normal = unit(roots.of(identity.neutral.normals))
    heading = unit(across(flow, normal) * (1 - lift) + normal * lift)
    step = (length / (points - 1))[:, None]
    # Long hair gives way to its weight.
    weight = np.array([0, 0, -1.0]) * smoothstep(0.01, 0.05, length)[:, None]
    path = [roots.of(identity.rest)]
    for _ in range(points - 1):
        path.append(path[-1] + step * heading)
        heading = unit(heading + 0.2 * flow + 0.3 * weight)
    return np.stack(path, axis=1)
