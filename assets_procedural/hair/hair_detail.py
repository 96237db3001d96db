"""What makes guides a head of hair: tails and buns, locks, curls, strays and baby hair."""

from __future__ import annotations

import numpy as np

from assets_procedural.body.hairline import SKULL_CENTRE, hairline_distance
from assets_procedural.body.roots import HeadFrame
from assets_procedural.hair.scalp import near_parting
from assets_procedural.hair.strands import (
    clump,
    coil,
    locks,
    resample,
    sideways,
    spread,
    tapered,
    tousled,
    wander,
)
from assets_procedural.hair.styles import Style
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.person import Person


def tied(
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


def detailed(
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
            pull = pull * (1 - 0.8 * near_parting(root_at, person))
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
        phase = 2.5 * tousled(strands[:, 0] / 3, rng)[:, 0] + rng.normal(0, 0.5, count)[leader]
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
