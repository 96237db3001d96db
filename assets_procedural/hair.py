"""Scalp hair: a hairline, a catalogue of styles, and the strands that they grow.

A style is a row of `STYLES`: numbers plus one function for where its hair is combed. Directions and
regions live in template space (see `strands`), lengths in metres. Guides are grown step by step
over the skull, at a height above it that their layer gives them; children mix guides of their own
side of the parting, then lock, curl and stray.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.head import Identity
from assets_procedural.headwear import above_rim
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
    locks,
    mix,
    resample,
    sample_roots,
    sideways,
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
        (67, -6), (70, -24), (75, -30), (79, -22), (84, -6), (92, -4), (102, -5), (109, -12),
        (115, -32), (124, -45), (150, -53), (180, -55),
    ],
    float,
)  # fmt: skip
_STEPS = 24
_CLOTHES_MARGIN = 0.015
# Hair lies flat under a hat and leaves its rim at this slope.
_UNDER_HAT, _HAT_FLARE = 0.002, 0.6


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
    front = smoothstep(0.035, -0.04, field.root[:, 1])[:, None]
    back = 0.55 + 0.4 * smoothstep(-0.09, -0.14, field.root[:, 1])
    apart = np.stack([field.side, back, np.full(len(back), -0.15)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(field))


def combed_loosely(field: Field) -> np.ndarray:
    """Away from the middle without a parting, a little back at the front."""
    front = smoothstep(0.035, -0.04, field.root[:, 1])[:, None]
    back = 0.1 + 0.5 * smoothstep(-0.09, -0.14, field.root[:, 1])
    x = np.tanh(field.root[:, 0] / 0.025) + 0.25 * field.side
    apart = np.stack([x, back, np.full(len(back), -0.1)], axis=1)
    return unit(front * unit(apart) + (1 - front) * combed_from_whorl(field))


def combed_back(field: Field) -> np.ndarray:
    """Straight back over the top, back and down along the sides."""
    low = smoothstep(0.80, 0.70, field.root[:, 2])
    x = 0.25 * np.sign(field.root[:, 0]) * (1 - low)
    return unit(np.stack([x, np.ones(len(x)), -0.15 - 0.6 * low], axis=1))


def combed_across(field: Field) -> np.ndarray:
    """The top swept over from a side parting and back, the sides down and back."""
    top = smoothstep(0.77, 0.80, field.root[:, 2])[:, None]
    over = np.stack([field.side, np.full(len(top), 0.55), np.zeros(len(top))], axis=1)
    down = np.stack([np.zeros(len(top)), np.full(len(top), 0.45), -np.ones(len(top))], axis=1)
    return unit(top * unit(over) + (1 - top) * unit(down))


def combed_forward(field: Field) -> np.ndarray:
    """The front third down over the forehead as a fringe, the rest as from a parting."""
    fringe = smoothstep(0.062, 0.05, np.abs(field.root[:, 0]))
    fringe = fringe * smoothstep(-0.035, -0.06, field.root[:, 1])
    x = 1.5 * field.root[:, 0]
    forward = np.stack([x, np.full(len(x), -1.0), np.full(len(x), -0.3)], axis=1)
    return unit(fringe[:, None] * forward + (1 - fringe[:, None]) * combed_from_whorl(field))


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
    and at the nape; `cut` instead trims everything at a height of template space, from and to;
    `fringe` trims what falls over the forehead. `lift` turns the root off the skin, `reach` is how
    far combing holds against gravity, `volume` the height of the outermost layer and `layers` the
    share of it of the innermost. `tousle` bends the combing by a random field. `wave` is
    (amplitude, length of a turn), widened by `Hair.curl`. `lock` is (strands, strength). `tie` is
    where tied hair leaves the skull, `tail` what it becomes: "ponytail" or "bun". `rope` > 0 is
    the radius of locs.
    """

    combing: Combing
    length: tuple[float, float]
    sides: float = 1.0
    cut: tuple[float, float] | None = None
    fringe: float | None = None
    count: int = 30000
    points: int = 10
    radius: float = 5.5e-5
    lift: float = 0.3
    reach: float = 0.05
    stiffness: float = 0.6
    gravity: float = 0.5
    volume: float = 0.012
    layers: float = 0.15
    tousle: float = 0.0
    wave: tuple[float, float] = (0.0, 0.05)
    flat: float = 0.3
    lock: tuple[float, float] = (40.0, 0.35)
    stray: float = 0.004
    flyaway: float = 0.03
    parted: bool = False
    crown: float = 0.0
    tie: tuple[float, float, float] | None = None
    tail: str = ""
    rope: float = 0.0
    roughness: float = 0.3


_HIGH_TIE = (0.0, 0.050, 0.80)
_TOP_TIE = (0.0, 0.035, 0.852)
STYLES: dict[str, Style | None] = {
    "bald": None,
    "buzz": Style(
        combed_from_whorl, (0.005, 0.011), count=60000, points=4, radius=8.5e-5, lift=0.4,
        reach=1, gravity=0, volume=0, lock=(1, 0), stray=0.0006, flyaway=0, roughness=0.4,
    ),
    "receding": Style(
        combed_from_whorl, (0.014, 0.032), sides=0.8, count=30000, points=6, lift=0.35, reach=0.2,
        gravity=0.2, volume=0.007, tousle=0.25, lock=(30, 0.35), stray=0.003, crown=1.0,
    ),
    "short": Style(
        combed_from_whorl, (0.028, 0.052), sides=0.5, count=44000, points=7, lift=0.55, reach=0.2,
        gravity=0.12, volume=0.014, tousle=0.4, lock=(45, 0.6), stray=0.003,
    ),
    "crop": Style(
        combed_forward, (0.032, 0.048), sides=0.3, fringe=0.776, count=48000, points=7, lift=0.5,
        reach=0.2, gravity=0.15, volume=0.016, tousle=0.3, lock=(60, 0.65), stray=0.003,
    ),
    "side_part": Style(
        combed_across, (0.065, 0.09), sides=0.32, count=42000, points=9, lift=0.4, reach=0.15,
        gravity=0.2, volume=0.016, tousle=0.2, lock=(80, 0.5), stray=0.004, parted=True,
    ),
    "slick_back": Style(
        combed_back, (0.09, 0.14), sides=0.6, count=36000, points=9, lift=0.45, reach=0.3,
        gravity=0.12, volume=0.014, tousle=0.15, lock=(70, 0.55), stray=0.003, flyaway=0.02,
        roughness=0.25,
    ),
    "pixie": Style(
        combed_across, (0.07, 0.10), sides=0.55, count=42000, points=9, lift=0.4, reach=0.06,
        gravity=0.6, volume=0.016, tousle=0.4, lock=(50, 0.5), stray=0.004, parted=True,
    ),
    "bob": Style(
        combed_from_parting, (0.34, 0.34), cut=(0.64, 0.60), count=34000, points=12, volume=0.022,
        lift=0.45, lock=(90, 0.35), stray=0.006, parted=True,
    ),
    "fringe_bob": Style(
        combed_forward, (0.34, 0.34), cut=(0.665, 0.615), fringe=0.754, count=36000, points=12,
        volume=0.018, lift=0.4, lock=(110, 0.5), stray=0.004,
    ),
    "long_straight": Style(
        combed_from_parting, (0.46, 0.5), cut=(0.56, 0.45), count=32000, points=14, parted=True,
        volume=0.022, lift=0.45, lock=(110, 0.5), stray=0.006,
    ),
    "long_wavy": Style(
        combed_from_parting, (0.46, 0.5), cut=(0.56, 0.46), count=30000, points=18, parted=True,
        volume=0.028, lift=0.5, tousle=0.2, wave=(0.014, 0.09), flat=0.4, lock=(200, 1.4),
        stray=0.006,
    ),
    "curly": Style(
        combed_loosely, (0.14, 0.26), count=24000, points=22, radius=6.5e-5, volume=0.040,
        lift=0.7, reach=0.06, gravity=0.5, tousle=0.6, wave=(0.0105, 0.048), flat=0.0,
        lock=(130, 2.2), stray=0.003, flyaway=0.06, sides=0.85,
    ),
    "afro": Style(
        upright, (0.05, 0.11), count=44000, points=14, radius=5e-5, lift=1.0, reach=9,
        gravity=0.0, stiffness=0.9, volume=0, tousle=0.35, wave=(0.003, 0.011), flat=0.0,
        lock=(60, 0.35), stray=0.010, sides=0.9, flyaway=0.06, roughness=0.4,
    ),
    "coils": Style(
        upright, (0.014, 0.03), count=54000, points=10, radius=5.5e-5, lift=1.0, reach=9,
        gravity=0.0, stiffness=0.9, volume=0, tousle=0.4, wave=(0.0025, 0.010), flat=0.0,
        lock=(60, 0.5), stray=0.004, sides=0.6, roughness=0.4,
    ),
    "locs": Style(
        combed_from_parting, (0.2, 0.36), count=32000, points=12, parted=True, volume=0.024,
        lift=0.4, tousle=0.3, stray=0.001, rope=0.0042, sides=0.9, lock=(1, 0), flyaway=0.05,
        roughness=0.4,
    ),
    "ponytail": Style(
        gathered(_HIGH_TIE), (0.3, 0.3), count=34000, points=12, lift=0.3, reach=9, gravity=0.0,
        volume=0.010, lock=(70, 0.4), stray=0.004, tie=_HIGH_TIE, tail="ponytail",
    ),
    "bun": Style(
        gathered(_TOP_TIE), (0.3, 0.3), count=34000, points=12, lift=0.3, reach=9, gravity=0.0,
        volume=0.010, lock=(70, 0.4), stray=0.004, tie=_TOP_TIE, tail="bun",
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


def _scalp_density(person: Person, style: Style, ears: np.ndarray, soft: float) -> Callable:
    def density(points: np.ndarray, roots: Roots) -> np.ndarray:
        inside = hairline_distance(points, person)
        offset = points - SKULL_CENTRE
        front = np.exp(-((np.degrees(np.arctan2(offset[:, 0], -offset[:, 1])) / 60) ** 2))
        width = soft * (0.7 + 0.6 * front)
        grown = smoothstep(-width, width, inside) * smoothstep(0.7, 0.35, roots.of(ears))
        if style.volume > 0:
            grown = grown * (0.25 + 0.75 * _bare_risk(points, inside, style, person))
        if style.crown > 0:
            # What pattern baldness leaves: a wreath, and down on the top.
            top = smoothstep(0.786, 0.818, points[:, 2] - 0.15 * np.maximum(points[:, 1], 0))
            grown = grown * (1 - style.crown * 0.97 * top)
        return grown

    return density


def _bare_risk(points: np.ndarray, inside: np.ndarray, style: Style, person: Person) -> np.ndarray:
    """Where hair only leaves and none arrives to cover the skin, (R,) in [0, 1].

    At a parting, the whorl and the front hairline hair must grow denser for the same cover.
    """
    parting = _near_parting(points, person) * style.parted
    whorl = np.exp(-(((points - WHORL) / 0.022) ** 2).sum(axis=1)) * (style.tie is None)
    line = smoothstep(9, 2, inside) * 0.45
    return np.maximum(np.maximum(parting, whorl), line)


def _near_parting(points: np.ndarray, person: Person) -> np.ndarray:
    """1 on the parting to 0 a centimetre and a half away from it, (R,)."""
    gap = (points[:, 0] - _part_line(person, points[:, 1])) / 0.009
    front = smoothstep(0.05, 0.0, points[:, 1]) * (points[:, 2] > 0.78)
    return np.exp(-(gap**2)) * front


def _part_line(person: Person, y: np.ndarray) -> np.ndarray:
    """Template x of the parting at template y; behind the crown it returns to the middle."""
    return person.hair.parting * 0.046 * smoothstep(0.04, -0.02, y)


def _sides(points: np.ndarray, person: Person, rng: np.random.Generator) -> np.ndarray:
    """Side (-1, 1) of the parting; hairs close to it cross over, so that it shows no bare line."""
    gap = points[:, 0] - _part_line(person, points[:, 1])
    gap = gap + rng.normal(0, 0.002, len(points))
    return np.where(gap > 0, 1, -1)


def _tousled(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A smooth random vector field (R, 3) with features of 2 to 6 cm."""
    field = np.zeros(points.shape)
    for _ in range(10):
        turn = rng.normal(size=3)
        turn *= 2 * np.pi / rng.uniform(0.02, 0.06) / np.linalg.norm(turn)
        field += np.sin(points @ turn + rng.random() * 6.28)[:, None] * rng.normal(size=3)
    return field / np.sqrt(5)


def _grown(
    style: Style, person: Person, identity: Identity, rng: np.random.Generator
) -> StrandPiece:
    hair = person.hair
    ears = identity.model.masks["ears"]
    frame = HeadFrame.of(identity)
    template = identity.model.template
    normals = identity.neutral.normals

    guide_roots = sample_roots(identity, _scalp_density(person, style, ears, 4.0), 900, rng)
    count = int(style.count * (0.55 + 0.45 * hair.density))
    child_roots = sample_roots(identity, _scalp_density(person, style, ears, 2.6), count, rng)
    count = len(child_roots)
    guide_at, child_at = guide_roots.of(template), child_roots.of(template)
    if style.parted:
        guide_side, side = _sides(guide_at, person, rng), _sides(child_at, person, rng)
    else:
        guide_side, side = np.ones(len(guide_at), int), np.ones(count, int)

    chin = chin_height(identity)
    surface = Surface.of(identity.neutral)
    guides = _grow(
        style, person, frame, surface, chin, guide_roots.of(identity.rest),
        unit(guide_roots.of(normals)), guide_at, guide_side, rng,
    )  # fmt: skip
    guides = resample(guides, _trimmed(style, person, frame, guides, guide_at), style.points)

    roots = child_roots.of(identity.rest)
    ids, weights = spread(guides[:, 0], guide_side, roots, side)
    strands = roots[:, None] + mix(guides - guides[:, :1], ids, weights)
    if style.tie is not None:
        strands, guides, ids, weights = _tied(
            style, person, frame, strands, guides, ids, weights, rng
        )
        child_at = np.resize(child_at, (len(strands), 3))
        side = np.append(side, np.zeros(len(strands) - len(side), int))
        count = len(strands)
    strands, radius = _detailed(style, person, strands, side, child_at, rng)
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


def _trimmed(
    style: Style, person: Person, frame: HeadFrame, guides: np.ndarray, root_at: np.ndarray
) -> np.ndarray:
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
        # Just as long as the way to the tie over the skull.
        length = 1.18 * np.linalg.norm(frame.to_rest(np.asarray(style.tie)) - root, axis=1)
    step = (length / _STEPS)[:, None]
    layer = rng.uniform(style.layers, 1, len(root))
    point, path = root.copy(), [root]
    parting = person.hair.parting
    sweep = np.where(style.parted, side, -np.sign(parting) if parting else 1.0)
    axes = unit(frame.matrix.T)
    unrest = style.tousle * _tousled(root_at, rng)

    def combed(at: np.ndarray, up: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        flow = style.combing(Field(frame.to_template(at), root_at, sweep, travelled)) @ axes
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


def _tied(
    style: Style,
    person: Person,
    frame: HeadFrame,
    strands: np.ndarray,
    guides: np.ndarray,
    ids: np.ndarray,
    weights: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Append what the gathered hair becomes: a tail or a bun, with guides of its own."""
    count, points = int(0.35 * len(strands)), strands.shape[1]
    tie = frame.to_rest(np.asarray(style.tie))
    out = unit(tie - frame.to_rest(SKULL_CENTRE))
    along = np.linspace(0, 1, points)
    disc = rng.normal(size=(count, 3))
    disc = unit(disc - out * (disc @ out)[:, None]) * np.sqrt(rng.random((count, 1)))
    if style.tail == "ponytail":
        length = 0.16 + 0.22 * person.hair.length
        # A falling arc: thrown off the skull, then down.
        path = np.stack(
            [0 * along, 0.022 * (1 - np.exp(-along * length / 0.03)), 0 * along], axis=1
        )
        path += out * (0.012 * (1 - np.exp(-along * length / 0.02)))[:, None]
        path[:, 2] -= np.maximum(along * length - 0.03 * (1 - np.exp(-along * length / 0.03)), 0)
        width = 0.009 + 0.02 * np.sin(np.pi * np.clip(along * 0.85 + 0.05, 0, 1)) ** 0.8
        fresh = tie + path + disc[:, None] * width[:, None]
        centre = (tie + path)[None]
    else:
        size = 0.030 + 0.012 * person.hair.length
        middle = tie + out * size * 0.75
        across = unit(np.cross(out, [1.0, 0, 0]))
        other = np.cross(out, across)
        # Strands wind around the axis of the bun on a flattened, bulging torus.
        start = rng.random(count) * 2 * np.pi
        tilt = rng.random(count) * 2 * np.pi
        turn = start[:, None] + along * rng.uniform(1.2, 2.6, (count, 1))
        level = tilt[:, None] + along * rng.uniform(0.4, 1.2, (count, 1))
        tube = size * 0.5 * np.sqrt(rng.uniform(0.55, 1, (count, 1)))
        ring = size * 0.52 + tube * np.cos(level)
        fresh = middle + out * (tube * np.sin(level) * 0.9)[..., None]
        fresh = fresh + ring[..., None] * (
            np.cos(turn)[..., None] * across + np.sin(turn)[..., None] * other
        )
        centre = np.broadcast_to(middle, (1, points, 3))
    fresh_ids = np.full((count, ids.shape[1]), len(guides))
    fresh_weights = np.full((count, ids.shape[1]), 1 / ids.shape[1])
    return (
        np.concatenate([strands, fresh]),
        np.concatenate([guides, centre]),
        np.concatenate([ids, fresh_ids]),
        np.concatenate([weights, fresh_weights]),
    )


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
    tail = side == 0
    edge = smoothstep(8, 0, hairline_distance(root_at, person)) * ~tail
    stop = 1 - 0.25 * rng.random(count) ** 2
    if style.tie is not None:
        stop = np.where(tail, stop, 1 - 0.7 * (rng.random(count) < 0.04) * rng.random(count))
    baby = rng.random(count) < 0.5 * edge
    stop = np.where(baby, stop * rng.uniform(0.12, 0.6, count), stop)
    strands = resample(strands, stop, style.points)
    if style.rope > 0:
        strands = _roped(strands, side, style.rope, rng)
    size, strength = style.lock
    leader = locks(strands[:, 0], side, size, rng)
    if strength > 0:
        pull = strength * rng.uniform(0.5, 1.2, count)
        if style.parted:
            # Locks at a parting would tear it open.
            pull = pull * (1 - 0.8 * _near_parting(root_at, person))
        if style.tail == "bun":
            pull = np.where(tail, 0, pull)
        strands = clump(strands, locks(strands[:, 0], side, size / 6, rng), 0.6 * pull)
        strands = clump(strands, leader, pull)
    fly = rng.random(count) < style.flyaway
    stray = (
        style.stray * rng.uniform(0.3, 1, count) * np.where(fly, 3.5, 1) * np.where(baby, 0.6, 1)
    )
    if style.tail == "bun":
        stray = np.where(tail & ~fly, stray * 0.5, stray)
    strands = wander(strands, stray, rng)
    amplitude, turn = style.wave
    if amplitude > 0:
        reach = np.linalg.norm(np.diff(strands, axis=1), axis=2).sum(axis=1)
        width = amplitude * (0.7 + 0.6 * person.hair.curl) * rng.uniform(0.7, 1.2, count)
        # A lock curls as one, with a little of every strand's own.
        phase = 2.5 * _tousled(strands[:, 0] / 3, rng)[:, 0] + rng.normal(0, 0.5, count)[leader]
        phase += rng.normal(0, 0.25, count)
        turn = turn * rng.uniform(0.8, 1.25, count)[leader]
        strands = coil(strands, width, reach / turn, phase, style.flat)
    radius = tapered(count, style.points, style.radius, style.radius * 0.3, rng)
    return strands, radius * np.where(baby, 0.65, 1)[:, None].astype(np.float32)


def _roped(
    strands: np.ndarray, side: np.ndarray, radius: float, rng: np.random.Generator
) -> np.ndarray:
    """Locs: strands become the fibres of ropes around some of them."""
    centres = rng.permutation(len(strands))[:260]
    ids, _ = spread(strands[centres, 0], side[centres], strands[:, 0], side, neighbours=1)
    core = strands[centres[ids[:, 0]]]
    across, other = sideways(core)
    count, points = strands.shape[:2]
    along = np.linspace(0, 1, points)
    angle = rng.random(count)[:, None] * 2 * np.pi + along * rng.normal(0, 3, (count, 1))
    reach = radius * np.sqrt(rng.uniform(0.5, 1, (count, 1))) * (1 - 0.35 * along**3)
    rope = core + reach[..., None] * (
        np.cos(angle)[..., None] * across + np.sin(angle)[..., None] * other
    )
    blend = smoothstep(0, 0.08, along)[:, None]
    return strands * (1 - blend) + rope * blend
