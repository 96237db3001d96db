"""What makes guides a head of hair: wisps, locks, curls, strays and baby hair.

Symbols: N strands, K points a strand. Metres.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.body.hairline import hairline_distance
from assets_procedural.hair.braiding import roped
from assets_procedural.hair.scalp import near_parting
from assets_procedural.hair.strands import (
    clump,
    coil,
    locks,
    resample,
    strand_lengths,
    tapered,
    tousled,
    wander,
)
from assets_procedural.hair.styles import Style
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.person import Person


def detailed(
    style: Style,
    person: Person,
    strands: np.ndarray,
    side: np.ndarray,
    root_at: np.ndarray,
    tail: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Children with their own lengths, locks, curls and strays.

    `side` (N,) are what strands do not mix across, `root_at` (N, 3) template points, `tail` (N,)
    whether a strand is part of a tail. Returns strands (N, K, 3), radii (N, K) and the logarithm
    (N,) of the strands' tones.
    """
    count = len(strands)
    inside = hairline_distance(root_at, person)
    stop = 1 - 0.22 * rng.random(count) ** 2
    gathered = ~tail & bool(style.ties)
    stop = np.where(tail & (style.tail == "ponytail"), rng.uniform(0.6, 1, count), stop)
    stop = np.where(gathered, 1 - 0.7 * (rng.random(count) < 0.05) * rng.random(count), stop)
    # Baby hair: the outermost hairs are short, fine and go their own ways.
    baby = (rng.random(count) < smoothstep(2, -4, inside)) & ~tail
    reach = strand_lengths(strands)
    short = rng.uniform(0.004, 0.022, count) / np.maximum(reach, 1e-3)
    stop = np.where(baby, np.minimum(stop, short), stop)
    fly = (rng.random(count) < style.flyaway) & ~tail

    wisp = np.zeros(count, int)
    if style.rope > 0:
        strands, wisp = roped(style, strands, side, rng)
    elif style.wisps[0] > 0:
        wisp = locks(strands[:, 0], side, count / style.wisps[0], rng)
        strands = _wisped(style, person, strands, wisp, root_at, baby | fly, tail, rng)
    tone = rng.normal(0, 0.3, count)[wisp]
    strands = resample(strands, stop, style.points)
    size, strength = style.lock
    leader = locks(strands[:, 0], side, size, rng)
    tone = tone + rng.normal(0, 0.35, count)[leader] + rng.normal(0, 0.15, count)
    if strength > 0:
        pull = strength * rng.uniform(0.6, 1.15, count) * ~(baby | fly)
        if style.parted:
            # Locks at a parting would tear it open.
            pull = pull * (1 - 0.8 * near_parting(root_at, person))
        if style.tail in ("bun", "braid", "puff"):
            pull = np.where(tail, 0, pull)
        strands = clump(strands, leader, pull)
    # In a wisp a hair strays a little; only flyaways leave it.
    kept = 0.3 if style.wisps[0] else 1.0
    stray = style.stray * rng.uniform(0.3, 1, count) * np.where(fly, 2.2, kept)
    stray = np.where(baby, np.maximum(0.5 * stray, 0.15 * short * reach), stray)
    if style.tail in ("bun", "braid"):
        stray = np.where(tail & ~fly, stray * 0.4, stray)
    strands = wander(strands, stray, rng)
    amplitude, turn = style.wave
    if amplitude > 0:
        reach = strand_lengths(strands)
        width = amplitude * (0.7 + 0.6 * person.hair.curl) * rng.uniform(0.7, 1.2, count)
        width = np.minimum(np.where(gathered, 0.15, 1) * width, 0.2 * reach)
        # A lock curls as one, with a little of every strand's own.
        phase = 2.5 * tousled(strands[:, 0] / 3, rng)[:, 0] + rng.normal(0, 0.4, count)[leader]
        phase += rng.normal(0, 1.2, count)[wisp] + rng.normal(0, 0.2, count)
        turn = turn * rng.uniform(0.75, 1.3, count)[wisp] * rng.uniform(0.9, 1.1, count)[leader]
        strands = coil(strands, width, reach / turn, phase, style.flat)
    radius = tapered(count, style.points, style.radius, style.radius * 0.3, rng)
    return strands, radius * np.where(baby, 0.6, 1)[:, None].astype(np.float32), tone


def _wisped(
    style: Style,
    person: Person,
    strands: np.ndarray,
    wisp: np.ndarray,
    root_at: np.ndarray,
    loose: np.ndarray,
    tail: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """The strands of each wisp fall together, off the head, on a way and to a length of their own.

    `wisp` (N,) is the leading strand of each strand's wisp, `loose` (N,) keep out of it.
    """
    _, strength, height = style.wisps
    count = len(strands)
    free = ~(loose | tail)
    near = near_parting(root_at, person) if style.parted else np.zeros(count)
    pull = strength * rng.uniform(0.7, 1.3, count)[wisp] * (1 - 0.7 * near) * free
    strands = clump(strands, wisp, pull)
    leaders, mine = np.unique(wisp, return_inverse=True)
    drift = wander(strands[leaders], 1.2 * height, rng) - strands[leaders]
    along = np.linspace(0, 1, strands.shape[1])
    out = unit((strands - strands[:, :1].mean(axis=0)) * np.array([1, 1, 0.35]))
    rise = np.abs(rng.normal(0, height, len(leaders)))[mine, None] * smoothstep(0.08, 0.5, along)
    share = ((1 - near) * free)[:, None, None]
    strands = strands + share * (rise[..., None] * out + drift[mine])
    if style.ties:
        return strands
    return resample(strands, (1 - 0.18 * rng.random(count))[wisp], style.points)
