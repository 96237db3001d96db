"""Scalp hair: a hairline, a catalogue of styles, and the strands that they grow.

A style is a row of `STYLES`: numbers plus one function for where its hair is combed. Directions and
regions live in template space (see `strands`), lengths in metres. Guides are grown step by step
over the skull, at a height above it that their layer gives them; children mix guides of their own
side of the parting, then lock, curl and stray.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from assets_procedural.head import Identity
from assets_procedural.person import Person
from assets_procedural.piece import Part, StrandPiece
from assets_procedural.strands import (
    Draped,
    HeadFrame,
    Roots,
    Surface,
    chin_height,
    clump,
    coil,
    colouring,
    mix,
    resample,
    sample_roots,
    smoothstep,
    spread,
    tapered,
    unit,
    wander,
)

SKULL_CENTRE = np.array([0.0, -0.05, 0.745])
WHORL = np.array([0.008, 0.012, 0.849])
# The hairline: azimuth from the front (degrees) to elevation about the skull's centre (degrees).
_HAIRLINE = np.array(
    [
        (0, 32.5), (12, 32.5), (24, 34), (34, 35), (44, 32), (52, 25), (58, 16), (63, 7),
        (67, -6), (70, -24), (75, -30), (79, -20), (84, -1), (92, 3), (102, 1), (109, -8),
        (115, -32), (124, -45), (150, -53), (180, -55),
    ],
    float,
)  # fmt: skip
_STEPS = 24
_CLOTHES_MARGIN = 0.014


@dataclass(frozen=True)
class Field:
    """What a combing function sees: template-space points and what is fixed per guide, all (G, …).

    `point` now, `root` the origin, `side` -1 or 1 of the parting, `travelled` metres so far.
    """

    point: np.ndarray
    root: np.ndarray
    side: np.ndarray
    travelled: np.ndarray


Combing = Callable[[Field], np.ndarray]


def combed_from_whorl(field: Field) -> np.ndarray:
    """Natural growth: away from the whorl, forward on the top, down elsewhere."""
    away = field.point - WHORL
    away[:, 2] = np.minimum(away[:, 2], 0)
    return unit(away)


def combed_from_parting(field: Field) -> np.ndarray:
    """To either side of the parting and a little back; behind the crown from the whorl."""
    front = smoothstep(0.03, -0.05, field.root[:, 1])[:, None]
    back = 0.25 + 0.5 * smoothstep(-0.09, -0.14, field.root[:, 1])
    apart = np.stack([field.side, back, np.full(len(back), -0.15)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(field))


def combed_back(field: Field) -> np.ndarray:
    """Straight back over the top, back and down along the sides."""
    low = smoothstep(0.80, 0.70, field.root[:, 2])
    x = 0.25 * np.sign(field.root[:, 0]) * (1 - low)
    return unit(np.stack([x, np.ones(len(x)), -0.15 - 0.6 * low], axis=1))


def combed_across(field: Field) -> np.ndarray:
    """The top swept over from a side parting, the sides down and back."""
    top = smoothstep(0.775, 0.805, field.root[:, 2])[:, None]
    front = smoothstep(-0.03, -0.11, field.root[:, 1])
    over = np.stack([field.side, 0.15 + 0.45 * front, np.zeros(len(front))], axis=1)
    down = np.stack([np.zeros(len(front)), np.full(len(front), 0.35), -np.ones(len(front))], axis=1)
    return unit(top * unit(over) + (1 - top) * unit(down))


def combed_forward(field: Field) -> np.ndarray:
    """The front down as a fringe, everything else from the whorl."""
    natural = combed_from_whorl(field)
    fringe = (np.abs(field.root[:, 0]) < 0.055) & (field.root[:, 1] < -0.085)
    forward = np.stack([field.root[:, 0] * 2, np.full(len(fringe), -1.0), np.full(len(fringe), -0.4)], 1)
    return unit(np.where(fringe[:, None], forward, natural))


def gathered(point: tuple[float, float, float]) -> Combing:
    """Everything drawn over the skull to one point."""

    def combing(field: Field) -> np.ndarray:
        return unit(np.asarray(point) - field.point)

    return combing


def upright(field: Field) -> np.ndarray:
    """Straight off the skull."""
    return unit(field.root - SKULL_CENTRE - np.array([0, 0, -0.02]))


@dataclass(frozen=True)
class Style:
    """One hair style. Lengths in metres; shares and strengths in [0, 1].

    `length` is the range that `Hair.length` spans on the top, `sides` the share of it on the sides
    and at the nape. `lift` turns the root off the skin, `reach` is how far combing holds against
    gravity, `volume` the height of the outermost layer. `wave` is (amplitude, length of a turn).
    """

    combing: Combing
    length: tuple[float, float]
    sides: float = 1.0
    count: int = 30000
    points: int = 10
    radius: float = 5.5e-5
    lift: float = 0.3
    reach: float = 0.05
    stiffness: float = 0.6
    gravity: float = 0.5
    volume: float = 0.012
    layers: float = 0.15
    wave: tuple[float, float] = (0.0, 0.05)
    flat: float = 0.3
    lock: tuple[float, float] = (40.0, 0.35)
    stray: float = 0.004
    flyaway: float = 0.03
    parted: bool = False
    fringe: float = 0.0
    roughness: float = 0.3


STYLES: dict[str, Style | None] = {
    "bald": None,
    "buzz": Style(
        combed_from_whorl, (0.003, 0.008), count=42000, points=4, radius=4.5e-5, lift=0.75,
        reach=1, gravity=0, volume=0, lock=(1, 0), stray=0.0004, flyaway=0, roughness=0.4,
    ),
    "short": Style(
        combed_from_whorl, (0.022, 0.045), sides=0.45, count=34000, points=7, lift=0.55, reach=0.2,
        gravity=0.1, volume=0.012, lock=(60, 0.45), stray=0.004,
    ),
    "long_straight": Style(
        combed_from_parting, (0.34, 0.46), count=26000, points=14, parted=True, volume=0.016,
        lock=(90, 0.3), stray=0.008,
    ),
}  # fmt: skip


def scalp_hair(person: Person, identity: Identity, rng: np.random.Generator) -> list[StrandPiece]:
    """The subject's scalp hair as strands, no piece for a bald head.

    Raises:
        KeyError: `person.hair.style` is not in `STYLES`.
    """
    if person.hair.style not in STYLES:
        raise KeyError(f"no hair style named {person.hair.style!r}; known: {', '.join(STYLES)}")
    style = STYLES[person.hair.style]
    if style is None:
        return []
    return [_grown(style, person, identity, rng)]


def recession(person: Person) -> float:
    """How far the front hairline has moved up, in [0, 1]: older men, each to his own degree."""
    male = 1 - person.phenotypes.get("gender", 0.5)
    chance = np.random.default_rng(person.hair.seed).random()
    aged = smoothstep(28, 75, np.asarray(person.age_years))
    return float(np.clip(male * 1.4 - 0.4, 0, 1) * aged * (0.15 + 0.85 * chance**1.5))


def hairline_distance(points: np.ndarray, person: Person) -> np.ndarray:
    """Degrees (R,) by which template points lie inside the hairline; negative outside."""
    offset = points - SKULL_CENTRE
    azimuth = np.degrees(np.arctan2(offset[:, 0], -offset[:, 1]))
    elevation = np.degrees(np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])))
    male = 1 - person.phenotypes.get("gender", 0.5)
    style = np.random.default_rng([person.hair.seed, 17])
    lag = np.abs(azimuth)
    line = np.interp(lag, _HAIRLINE[:, 0], _HAIRLINE[:, 1])
    line += (male - 0.5) * 5 * np.exp(-(((lag - 40) / 12) ** 2))
    line += style.normal(0, 1.5) * np.exp(-((lag / 45) ** 2))
    far = recession(person)
    line += far * (34 * np.exp(-(((lag - 36) / 17) ** 2)) + 14 * np.exp(-((lag / 24) ** 2)))
    for wave in (5, 9, 16, 27):
        amplitude, phase = style.normal(0, 2.2 / np.sqrt(wave)), style.random() * 2 * np.pi
        line += amplitude * np.sin(np.radians(azimuth) * wave + phase)
    return elevation - line


def _scalp_density(person: Person, ears: np.ndarray, soft: float) -> Callable:
    def density(points: np.ndarray, roots: Roots) -> np.ndarray:
        inside = hairline_distance(points, person)
        # Behind the face and above the ears; the mouth and neck are far below the hairline.
        offset = points - SKULL_CENTRE
        front = np.exp(-((np.degrees(np.arctan2(offset[:, 0], -offset[:, 1])) / 60) ** 2))
        width = soft * (0.7 + 0.6 * front)
        grown = smoothstep(-width, width, inside)
        return grown * smoothstep(0.5, 0.1, roots.of(ears))

    return density


def _part_line(person: Person, y: np.ndarray) -> np.ndarray:
    """Template x of the parting at template y; behind the crown it returns to the middle."""
    return person.hair.parting * 0.042 * smoothstep(0.035, -0.03, y)


def _sides(points: np.ndarray, person: Person, rng: np.random.Generator) -> np.ndarray:
    """Side (-1, 1) of the parting; hairs close to it cross over, so that it shows no bare line."""
    gap = points[:, 0] - _part_line(person, points[:, 1])
    gap = gap + rng.normal(0, 0.0012, len(points))
    return np.where(gap > 0, 1, -1)


def _grown(
    style: Style, person: Person, identity: Identity, rng: np.random.Generator
) -> StrandPiece:
    hair = person.hair
    ears = identity.model.masks["ears"]
    frame = HeadFrame.of(identity)
    template = identity.model.template
    normals = identity.neutral.normals

    guide_roots = sample_roots(identity, _scalp_density(person, ears, 4.0), 900, rng)
    count = int(style.count * (0.55 + 0.45 * hair.density))
    child_roots = sample_roots(identity, _scalp_density(person, ears, 2.6), count, rng)
    count = len(child_roots)
    guide_at, child_at = guide_roots.of(template), child_roots.of(template)
    if style.parted:
        guide_side, side = _sides(guide_at, person, rng), _sides(child_at, person, rng)
    else:
        guide_side, side = np.ones(len(guide_at), int), np.ones(count, int)

    length = _lengths(style, person, guide_at, rng)
    chin = chin_height(identity)
    surface = Surface.of(identity.neutral)
    guides = _grow(
        style, hair.parting, frame, surface, chin, guide_roots.of(identity.rest),
        unit(guide_roots.of(normals)), guide_at, guide_side, length, rng,
    )  # fmt: skip
    guides = resample(guides, np.ones(len(guides)), style.points)

    roots = child_roots.of(identity.rest)
    ids, weights = spread(guides[:, 0], guide_side, roots, side)
    strands = roots[:, None] + mix(guides - guides[:, :1], ids, weights)
    strands, radius = _detailed(style, person, strands, side, child_at, rng)
    clear = np.minimum(np.linspace(0, 0.004, style.points), 0.0012)
    strands[:, 1:] = surface.push_out(strands[:, 1:], clear[1:])

    place = Draped(
        strands.astype(np.float32), guides.astype(np.float32), ids, weights, chin, _CLOTHES_MARGIN
    )
    temples = smoothstep(0.80, 0.72, child_at[:, 2])
    grey = np.clip(hair.grey * (0.8 + 0.5 * temples), 0, 1) if hair.grey < 0.95 else 1.0
    shading = colouring(hair.melanin, hair.redness, grey, count, rng, style.roughness)
    return StrandPiece("hair", Part.HAIR, radius, place, shading)


def _lengths(
    style: Style, person: Person, roots: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    low, high = style.length
    length = low + (high - low) * person.hair.length
    top = smoothstep(0.765, 0.82, roots[:, 2])
    return length * (style.sides + (1 - style.sides) * top) * rng.uniform(0.9, 1.05, len(roots))


def _grow(
    style: Style,
    parting: float,
    frame: HeadFrame,
    surface: Surface,
    chin: float,
    root: np.ndarray,
    normal: np.ndarray,
    root_at: np.ndarray,
    side: np.ndarray,
    length: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Guides (G, steps + 1, 3) at rest."""
    step = (length / _STEPS)[:, None]
    layer = rng.uniform(style.layers, 1, len(root))
    point, path = root.copy(), [root]
    sweep = np.where(style.parted, side, -np.sign(parting) if parting else 1.0)
    axes = unit(frame.matrix.T)

    def combed(at: np.ndarray, up: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        flow = style.combing(Field(frame.to_template(at), root_at, sweep, travelled)) @ axes
        if style.combing is upright:
            return flow
        return unit(flow - up * (flow * up).sum(-1, keepdims=True))

    flow = combed(point, normal, np.zeros(len(root)))
    heading = unit(style.lift * normal + (1 - style.lift) * flow)
    signed, up = surface.distance(point)
    for index in range(_STEPS):
        travelled = (index + 1) * step[:, 0]
        hold = np.exp(-travelled / style.reach)[:, None]
        want = combed(point, up, travelled) * hold
        want = want + np.array([0, 0, -1.0]) * style.gravity * (1 - 0.6 * hold)
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
    return np.stack(path, axis=1)


def _detailed(
    style: Style,
    person: Person,
    strands: np.ndarray,
    side: np.ndarray,
    root_at: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Children with their own lengths, locks, curls and strays, and their radii."""
    count = len(strands)
    edge = smoothstep(8, 0, hairline_distance(root_at, person))
    stop = 1 - 0.25 * rng.random(count) ** 2
    baby = rng.random(count) < 0.5 * edge
    stop = np.where(baby, stop * rng.uniform(0.12, 0.6, count), stop)
    strands = resample(strands, stop, style.points)
    size, strength = style.lock
    if strength > 0:
        strands = clump(strands, side, size, strength * rng.uniform(0.5, 1.2, count), rng)
        strands = clump(strands, side, size / 6, 0.7 * strength, rng)
    fly = rng.random(count) < style.flyaway
    stray = style.stray * rng.uniform(0.3, 1, count) * np.where(fly, 3.5, 1) * np.where(baby, 0.6, 1)
    strands = wander(strands, stray, rng)
    amplitude, turn = style.wave
    if amplitude > 0:
        reach = np.linalg.norm(np.diff(strands, axis=1), axis=2).sum(axis=1)
        strands = coil(
            strands, amplitude * rng.uniform(0.7, 1.2, count), reach / turn,
            rng.normal(0, 0.5, count), style.flat,
        )  # fmt: skip
    radius = tapered(count, style.points, style.radius, style.radius * 0.3, rng)
    return strands, radius * np.where(baby, 0.65, 1)[:, None].astype(np.float32)
