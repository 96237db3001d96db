"""Scalp hair: the strands that a style grows on a subject.

Guides are grown step by step over the skull, at a height above it that their layer gives them;
children mix guides of their own side of the parting, then lock, curl and stray.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.body.roots import HeadFrame, sample_roots
from assets_procedural.conventions.parts import Part
from assets_procedural.hair.draping import Draped, Surface, chin_height
from assets_procedural.hair.hair_detail import detailed, tied
from assets_procedural.hair.scalp import parting_sides, scalp_density
from assets_procedural.hair.strands import colouring, mix, resample, spread, tousled
from assets_procedural.hair.styles import STYLES, Guides, Style, upright
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.outfit.headwear import above_rim, hides_hair
from assets_procedural.person import Person

_STEPS = 24
_CLOTHES_MARGIN = 0.015
# Hair lies flat under a hat and leaves its rim at this slope.
_UNDER_HAT, _HAT_FLARE = 0.002, 0.6


def scalp_hair(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """The subject's scalp hair as strands, no piece for a bald head.

    Raises:
        KeyError: `person.hair.style` is not in `STYLES`.
    """
    if person.hair.style not in STYLES:
        raise KeyError(f"no hair style named {person.hair.style!r}; known: {', '.join(STYLES)}")
    style = STYLES[person.hair.style]
    if style.count == 0 or hides_hair(person.hat):
        return []
    return [_grown(style, person, identity, rng)]


def _grown(
    style: Style, person: Person, identity: Identity, rng: np.random.Generator
) -> StrandPiece:
    hair = person.hair
    ears = identity.model.masks["ears"]
    frame = HeadFrame.of(identity)
    template = identity.model.template
    normals = identity.neutral.normals

    guide_roots = sample_roots(identity, scalp_density(person, style, ears, 4.0), 900, rng)
    count = int(style.count * (0.55 + 0.45 * hair.density))
    child_roots = sample_roots(identity, scalp_density(person, style, ears, 2.6), count, rng)
    count = len(child_roots)
    guide_at, child_at = guide_roots.of(template), child_roots.of(template)
    if style.parted:
        guide_side, side = (
            parting_sides(guide_at, person, rng),
            parting_sides(child_at, person, rng),
        )
    else:
        guide_side, side = np.ones(len(guide_at), int), np.ones(count, int)

    chin = chin_height(identity)
    surface = Surface.of(identity.neutral)
    guides = _grow(
        style, person, frame, surface, chin, guide_roots.of(identity.rest),
        unit(guide_roots.of(normals)), guide_at, guide_side, rng,
    )  # fmt: skip
    guides = resample(guides, _trimmed(style, person, frame, guides), style.points)

    roots = child_roots.of(identity.rest)
    ids, weights = spread(guides[:, 0], guide_side, roots, side)
    strands = roots[:, None] + mix(guides - guides[:, :1], ids, weights)
    if style.tie is not None:
        strands, guides, ids, weights = tied(
            style, person, frame, strands, guides, ids, weights, rng
        )
        child_at = np.resize(child_at, (len(strands), 3))
        side = np.append(side, np.zeros(len(strands) - len(side), int))
        count = len(strands)
    strands, radius = detailed(style, person, strands, side, child_at, rng)
    if style.combing is not upright:
        clear = np.minimum(np.linspace(0, 0.004, style.points), 0.0012)
        strands[:, 1:] = surface.push_out(strands[:, 1:], clear[1:])
    if person.hat is not None:
        above = above_rim(strands.reshape(-1, 3), person.hat, identity).reshape(strands.shape[:2])
        strands = surface.pull_in(strands, _UNDER_HAT + _HAT_FLARE * np.maximum(-above, 0))
        radius = np.where(above > 0, 0, radius)

    place = Draped(
        strands.astype(np.float32), guides.astype(np.float32), ids, weights, chin, _CLOTHES_MARGIN
    )
    temples = smoothstep(0.80, 0.72, child_at[:, 2])
    grey = np.clip(hair.grey * (0.8 + 0.5 * temples), 0, 1) if hair.grey < 0.95 else 1.0
    shading = colouring(hair.melanin, hair.redness, grey, count, rng, style.roughness)
    return StrandPiece("hair", Part.HAIR, radius, place, shading)


def _trimmed(style: Style, person: Person, frame: HeadFrame, guides: np.ndarray) -> np.ndarray:
    """The fraction (G,) of each guide that the scissors leave."""
    stop = np.ones(len(guides))
    height = frame.to_template(guides)[..., 2]
    along = np.linspace(0, 1, guides.shape[1])
    if style.cut is not None:
        low = style.cut[0] + (style.cut[1] - style.cut[0]) * person.hair.length
        under = height < low
        first = np.where(under.any(axis=1), np.argmax(under, axis=1), guides.shape[1] - 1)
        row, last = np.arange(len(guides)), np.maximum(first - 1, 0)
        above, below = height[row, last], height[row, first]
        share = np.clip((above - low) / np.maximum(above - below, 1e-6), 0, 1)
        stop = along[last] + share * (along[first] - along[last])
    if style.fringe is not None:
        at = frame.to_template(guides)
        face = (np.abs(at[..., 0]) < 0.054) & (at[..., 1] < -0.085)
        under = (height < style.fringe + 0.006 * (np.abs(at[..., 0]) / 0.05) ** 2) & face
        over = under.any(axis=1)
        first = np.where(under.any(axis=1), np.argmax(under, axis=1), guides.shape[1] - 1)
        stop = np.where(over, np.minimum(stop, along[first]), stop)
    return np.maximum(stop, 0.05)


def _lengths(
    style: Style, person: Person, roots: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    low, high = style.length
    length = low + (high - low) * person.hair.length
    top = smoothstep(0.765, 0.82, roots[:, 2])
    return length * (style.sides + (1 - style.sides) * top) * rng.uniform(0.92, 1.05, len(roots))


def _grow(
    style: Style,
    person: Person,
    frame: HeadFrame,
    surface: Surface,
    chin: float,
    root: np.ndarray,
    normal: np.ndarray,
    root_at: np.ndarray,
    side: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Guides (G, steps + 1, 3) at rest."""
    length = _lengths(style, person, root_at, rng)
    if style.tie is not None:
        # Exactly as long as the path over the skull to the tie.
        length = 1.18 * np.linalg.norm(frame.to_rest(np.asarray(style.tie)) - root, axis=1)
    step = (length / _STEPS)[:, None]
    layer = rng.uniform(style.layers, 1, len(root))
    point, path = root.copy(), [root]
    parting = person.hair.parting
    sweep = np.where(style.parted, side, -np.sign(parting) if parting else 1.0)
    axes = unit(frame.matrix.T)
    unrest = style.tousle * tousled(root_at, rng)

    def combed(at: np.ndarray, up: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        flow = style.combing(Guides(frame.to_template(at), root_at, sweep, travelled)) @ axes
        flow = unit(flow + unrest * 0.6)
        if style.combing is upright:
            return flow
        return unit(flow - up * (flow * up).sum(-1, keepdims=True))

    forward = np.where(root_at[:, 1] + rng.normal(0, 0.01, len(root)) < -0.055, -1.0, 1.0)
    aside = np.stack([-0.25 * np.sign(root[:, 0]), 0.45 * forward, 0 * forward], axis=1)
    flow = combed(point, normal, np.zeros(len(root)))
    heading = unit(style.lift * normal + (1 - style.lift) * flow)
    signed, up = surface.distance(point)
    for index in range(_STEPS):
        travelled = (index + 1) * step[:, 0]
        hold = np.exp(-travelled / style.reach)[:, None]
        want = combed(point, up, travelled) * hold
        want = want + np.array([0, 0, -1.0]) * style.gravity * (1 - 0.6 * hold)
        # On the shoulders hair slides to the chest or to the back.
        want = want + aside * smoothstep(chin + 0.03, chin - 0.05, point[:, 2])[:, None]
        keep = style.stiffness * np.linalg.norm(want, axis=1, keepdims=True).clip(0.3)
        heading = unit(keep * heading + (1 - style.stiffness) * want)
        tried = point + step * heading
        height = style.volume * layer * (1 - np.exp(-travelled / 0.03))
        height = np.maximum(height, 0.0005)
        low = smoothstep(chin + 0.02, chin - 0.03, tried[:, 2])
        height = np.maximum(height, low * (_CLOTHES_MARGIN + 0.01 * layer))
        signed, up = surface.distance(tried)
        lift = np.clip(height - signed, 0, 0.02)[:, None]
        heading = unit(tried + lift * up - point)
        point = point + step * heading
        path.append(point)
    guides = np.stack(path, axis=1)
    if style.tie is not None:
        # Draw the ends together exactly.
        miss = (
            frame.to_rest(np.asarray(style.tie)) + rng.normal(0, 0.004, root.shape) - guides[:, -1]
        )
        guides += miss[:, None] * smoothstep(0.3, 1, np.linspace(0, 1, _STEPS + 1))[:, None]
    return guides
