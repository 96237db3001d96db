"""Scalp hair: the strands that a style grows on a subject.

Guides are grown over the skull (`growth`), children mix guides of their own side of the parting,
tied hair gets its tails (`braiding`), then everything locks, curls and strays (`hair_detail`).
"""

from __future__ import annotations

import numpy as np

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.body.roots import HeadFrame, sample_roots
from assets_procedural.conventions.parts import Part
from assets_procedural.hair.braiding import tails
from assets_procedural.hair.combing import upright
from assets_procedural.hair.draping import Draped, Surface, chin_height
from assets_procedural.hair.growth import CLOTHES_MARGIN, falls_forward, grow, tie_points
from assets_procedural.hair.hair_detail import detailed
from assets_procedural.hair.scalp import (
    parted_aside,
    parting_sides,
    scalp_density,
    with_style_loss,
)
from assets_procedural.hair.strands import mix, resample, spread, strand_lengths
from assets_procedural.hair.styles import STYLES, Style
from assets_procedural.hair.tones import colouring, toned
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.outfit.headwear import above_rim, hides_hair
from assets_procedural.person import Hat, Person

_GUIDES = 900
_TAIL_SHARE = 0.35
_SMALL_PUSH = 0.008
# Hair of more than this length, metres, reaches the shoulders, which part it.
_DIVIDED = 0.22
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
    person = parted_aside(with_style_loss(person, style), style.aside)
    return [_grown(style, person, identity, rng)]


def _grown(
    style: Style, person: Person, identity: Identity, rng: np.random.Generator
) -> StrandPiece:
    hair = person.hair
    frame = HeadFrame.of(identity)
    template = identity.model.template
    density = scalp_density(person, style, identity.model.masks["ears"])
    guide_roots = sample_roots(identity, density, _GUIDES, rng)
    count = int(style.count * (0.5 + 0.5 * hair.density))
    child_roots = sample_roots(identity, density, count, rng)
    guide_at, child_at = guide_roots.of(template), child_roots.of(template)
    guide_side, side = (_sides(style, person, at, rng) for at in (guide_at, child_at))

    chin = chin_height(identity)
    surface = Surface.of(identity.neutral)
    guides = grow(
        style, person, frame, surface, chin, guide_roots.of(identity.rest),
        unit(guide_roots.of(identity.neutral.normals)), guide_at, np.sign(guide_side), rng,
    )  # fmt: skip
    roots = child_roots.of(identity.rest)
    # Hair that stands has no locks of its own to follow.
    focus = 1.5 if style.combing is upright else 4.0
    ids, weights = spread(guides[:, 0], guide_side, roots, side, focus=focus)
    strands = roots[:, None] + mix(guides - guides[:, :1], ids, weights)
    tail = np.zeros(len(strands), bool)
    if style.ties:
        fresh, axes, number = tails(
            style, person, frame, surface, int(_TAIL_SHARE * len(strands)), rng
        )
        ids = np.concatenate([ids, np.repeat((len(guides) + number)[:, None], ids.shape[1], 1)])
        weights = np.concatenate([weights, np.full((len(fresh), ids.shape[1]), 1 / ids.shape[1])])
        strands, guides = np.concatenate([strands, fresh]), np.concatenate([guides, axes])
        child_at = np.concatenate([child_at, frame.to_template(fresh[:, 0])])
        side = np.append(side, 10 + number)
        tail = np.append(tail, np.ones(len(fresh), bool))
    strands, radius, tone = detailed(style, person, strands, side, child_at, tail, rng)
    strands = resample(strands, _off_the_face(frame.to_template(strands)), style.points)
    if style.combing is not upright:
        clear = np.minimum(np.linspace(0, 0.004, style.points), 0.0012)
        out = surface.push_out(strands[:, 1:], clear[1:]) - strands[:, 1:]
        # Guides are clear of the skin: whatever is far off it here is in the gap of an ear.
        far = np.linalg.norm(out, axis=-1, keepdims=True)
        strands[:, 1:] += out * np.minimum(1, _SMALL_PUSH / np.maximum(far, 1e-9))
    if person.hat is not None:
        strands, radius = _under_hat(person.hat, identity, surface, strands, radius)

    place = Draped(
        strands.astype(np.float32), guides.astype(np.float32), ids, weights, chin, CLOTHES_MARGIN
    )
    temples = smoothstep(0.80, 0.72, child_at[:, 2])
    grey = np.clip(hair.grey * (0.75 + 0.6 * temples), 0, 0.96)
    shading = colouring(hair.melanin, hair.redness, grey, len(strands), rng, style.roughness)
    length = strand_lengths(strands)
    # A tail is the far end of the hair that is tied.
    length = np.where(tail, length + 0.15, length)
    return StrandPiece("hair", Part.HAIR, radius, place, toned(shading, hair, tone, length))


def _sides(style: Style, person: Person, at: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What strands at template points (N, 3) do not mix across: the sign is the side of a parting
    or tie, tied are ±2, loose ±1, or ±3 where they hang to the back instead of the chest."""
    side = parting_sides(at, person, rng) if style.parted else np.ones(len(at), int)
    back = (style.length[1] > _DIVIDED) & ~falls_forward(at, person)
    loose = np.where(back, 3 * side, side)
    if not style.ties:
        return loose
    bound, number = tie_points(style, at)
    if len(style.ties) > 1:
        side = np.where(number == 0, 1, -1)
    return np.where(bound, 2 * side, np.abs(loose) * side)


def _off_the_face(points: np.ndarray) -> np.ndarray:
    """The fraction (N,) of strands of template points (N, K, 3) before the middle of the face."""
    x, y, z = np.moveaxis(points, -1, 0)
    inside = (np.abs(x) < 0.040) & (y < -0.105) & (z < 0.750) & (z > 0.61)
    first = np.where(inside.any(axis=1), inside.argmax(axis=1), points.shape[1] - 1)
    return np.maximum(first - 1.0 * inside.any(axis=1), 0.5) / (points.shape[1] - 1)


def _under_hat(
    wearing: Hat,
    identity: Identity,
    surface: Surface,
    strands: np.ndarray,
    radius: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    above = above_rim(strands.reshape(-1, 3), wearing, identity).reshape(strands.shape[:2])
    strands = surface.pull_in(strands, _UNDER_HAT + _HAT_FLARE * np.maximum(-above, 0))
    return strands, np.where(above > 0, 0, radius)
