"""Guides: grown step by step over the skull, each at the height that its layer gives it.

Symbols: G guides, K points a strand. Metres, the rest frame of `head`.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.body.roots import HeadFrame
from assets_procedural.hair.combing import Guides, upright
from assets_procedural.hair.draping import Surface
from assets_procedural.hair.scalp import part_gap
from assets_procedural.hair.strands import resample, tousled
from assets_procedural.hair.styles import Style
from assets_procedural.mesh.vectors import across, smoothstep, unit
from assets_procedural.person import Person

_STEPS = 30
CLOTHES_MARGIN = 0.015
# What hangs farther aside than the neck is drawn back to it, over this distance.
_NECK, _NECK_PULL = 0.085, 0.05
# Beside a parting hair stands hardly higher than its ridge, metres; from the sides on it is free.
_PART_HEIGHT, _RIDGE_SLOPE, _RIDGE_WIDTH = 0.0036, 0.4, 0.045
# Hair of more than this length falls over the ears, which the skin that strands keep off lacks.
_OVER_EARS, _EAR_HEIGHT = 0.15, 0.014
_EAR, _EAR_REACH = np.array([-0.042, 0.715]), np.array([0.026, 0.034])


def tie_points(style: Style, root_at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which roots (G, 3), template space, are tied (G,), and the number (G,) of their tie."""
    if not style.ties:
        return np.zeros(len(root_at), bool), np.zeros(len(root_at), int)
    ties = np.array(style.ties)
    nearest = np.abs(root_at[:, None, 0] - ties[None, :, 0]).argmin(axis=1)
    return root_at[:, 2] > style.tied_above, nearest


def falls_forward(root_at: np.ndarray, person: Person) -> np.ndarray:
    """Whether hair at template points (N, 3) hangs to the chest, else it does to the back: (N,)."""
    ragged = tousled(3.0 * root_at, np.random.default_rng([person.hair.seed, 29]))[:, 0]
    return root_at[:, 1] + 0.01 * ragged < -0.055


def lengths(
    style: Style, person: Person, root_at: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Lengths (G,) in metres of the hair at template points (G, 3)."""
    low, high = style.length
    length = low + (high - low) * person.hair.length
    top = smoothstep(0.765, 0.82, root_at[:, 2])
    length = length * (style.sides + (1 - style.sides) * top)
    if style.fade is not None:
        length = length * smoothstep(*style.fade, root_at[:, 2])
    return np.maximum(length, 0.001) * rng.uniform(0.92, 1.05, len(root_at))


def grow(
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
    """Guides (G, `style.points`, 3) at rest from roots (G, 3) with skin normals (G, 3).

    `root_at` are the roots in template space, `side` (G,) -1 or 1 of the parting, `chin` the
    height of the chin.
    """
    length = lengths(style, person, root_at, rng)
    bound, number = tie_points(style, root_at)
    ties = frame.to_rest(np.array(style.ties or [(0, 0, 0)], float))[number]
    # Exactly as long as the path over the skull to the tie.
    length = np.where(bound, 1.18 * np.linalg.norm(ties - root, axis=1), length)
    step = (length / _STEPS)[:, None]
    layer = rng.uniform(style.layers, 1, len(root))
    point, path = root.copy(), [root]
    parting = person.hair.parting
    sweep = np.where(style.parted, side, -np.sign(parting) if parting else 1.0)
    axes = unit(frame.matrix.T)
    unrest = style.tousle * tousled(root_at, rng)
    quiff = style.rise * smoothstep(-0.05, -0.10, root_at[:, 1]) * (root_at[:, 2] > 0.775)
    beside = part_gap(root_at, person) if style.parted else np.full(len(root), 0.1)
    # Hair leaves a parting flat; anywhere else it stands off the skin first.
    lift = style.lift * smoothstep(0.0, 0.04, beside)[:, None] * np.where(bound, 0.5, 1)[:, None]

    def combed(at: np.ndarray, up: np.ndarray) -> np.ndarray:
        flow = style.combing(Guides(frame.to_template(at), root_at, sweep)) @ axes
        flow = unit(flow + unrest * 0.6)
        if style.combing is upright:
            return flow
        flow = np.where(bound[:, None], unit(ties - at), flow)
        return across(flow, up)

    forward = np.where(falls_forward(root_at, person), -1.0, 1.0)
    flow = combed(point, normal)
    heading = unit(lift * normal + (1 - lift) * flow)
    signed, up = surface.distance(point)
    for index in range(_STEPS):
        travelled = (index + 1) * step[:, 0]
        hold = np.where(bound, 1.0, np.exp(-travelled / style.reach))[:, None]
        want = combed(point, up) * hold
        want = want + np.array([0, 0, -1.0]) * style.gravity * (1 - 0.6 * hold) * ~bound[:, None]
        # On the shoulders hair slides to the chest or to the back.
        below = smoothstep(chin + 0.03, chin - 0.05, point[:, 2])
        x = point[:, 0]
        inwards = -np.sign(x) * np.maximum(np.abs(x) - _NECK, 0) / _NECK_PULL
        aside = np.stack([inwards, 0.45 * forward, 0 * forward], axis=1)
        want = want + below[:, None] * aside
        keep = style.stiffness * np.linalg.norm(want, axis=1, keepdims=True).clip(0.3)
        heading = unit(keep * heading + (1 - style.stiffness) * want)
        tried = point + step * heading
        at = frame.to_template(tried)
        off = (1 - np.exp(-travelled / 0.03)) * np.where(bound, 0.4, 1)
        height = np.maximum(style.volume * layer * off, 0.0005)
        ceiling = np.full(len(root), 0.06)
        if style.parted:
            gap = part_gap(at, person)
            ridge = max(_PART_HEIGHT, 0.3 * style.volume - 0.002) + _RIDGE_SLOPE * gap**2
            ridge = ridge + 25 * np.maximum(gap - _RIDGE_WIDTH, 0) ** 2
            height = np.minimum(height, ridge * (0.3 + 0.7 * layer))
            ceiling = np.where(at[:, 2] > 0.77, ridge * (0.4 + 0.6 * layer), ceiling)
        rise = quiff * off * smoothstep(length, 0.3 * length, travelled)
        height, ceiling = height + rise, ceiling + rise
        if style.length[1] > _OVER_EARS:
            away = (at[:, 1:] - _EAR) / _EAR_REACH
            over = np.exp(-(away**2).sum(axis=1)) * (travelled > 0.05) * ~bound
            height = np.maximum(height, _EAR_HEIGHT * over * (0.85 + 0.15 * layer))
        low = smoothstep(chin + 0.02, chin - 0.03, tried[:, 2])
        height = np.maximum(height, low * (CLOTHES_MARGIN + 0.01 * layer))
        signed, up = surface.distance(tried)
        push = np.clip(height - signed, 0, 0.02)
        if style.combing is not upright:
            push = push - np.clip(signed - ceiling, 0, 0.01)
        heading = unit(tried + push[:, None] * up - point)
        point = point + step * heading
        path.append(point)
    guides = np.stack(path, axis=1)
    # Draw the ends of tied hair together exactly.
    miss = (ties + rng.normal(0, 0.004, root.shape) - guides[:, -1]) * bound[:, None]
    guides += miss[:, None] * smoothstep(0.3, 1, np.linspace(0, 1, _STEPS + 1))[:, None]
    return resample(guides, _trimmed(style, person, frame, guides, bound), style.points)


def _trimmed(
    style: Style, person: Person, frame: HeadFrame, guides: np.ndarray, bound: np.ndarray
) -> np.ndarray:
    """The fraction (G,) of each guide that the scissors leave."""
    stop = np.ones(len(guides))
    at = frame.to_template(guides)
    height = at[..., 2]
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
        face = (np.abs(at[..., 0]) < 0.054) & (at[..., 1] < -0.085)
        under = (height < style.fringe + 0.006 * (np.abs(at[..., 0]) / 0.05) ** 2) & face
        over = under.any(axis=1)
        first = np.where(over, np.argmax(under, axis=1), guides.shape[1] - 1)
        stop = np.where(over, np.minimum(stop, along[first]), stop)
    return np.where(bound, 1.0, np.maximum(stop, 0.05))
