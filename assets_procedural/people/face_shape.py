"""Individual shape of head and face: correlated directions, ancestry and age, kept plausible."""

from __future__ import annotations

from functools import cache

import numpy as np

from assets_procedural.people.ancestry import Heritage
from assets_procedural.people.plausibility import keep_plausible, within_norm
from assets_procedural.people.shape_modes import (
    AVERAGE,
    CHILD,
    FEMALE,
    OLD,
    OUTLINES,
    PARTS,
    SPREAD,
    WHOLE_FACE,
)

ASYMMETRY: tuple[str, ...] = (
    "brown-1", "brown-2", "cheek-1", "cheek-2", "ear-1", "ear-2", "ear-3", "ear-4", "eye-1",
    "eye-2", "eye-3", "eye-4", "eye-5", "eye-6", "eye-7", "eye-8", "jaw-1", "jaw-2", "jaw-3",
    "mouth-1", "mouth-2", "nose-1", "nose-2", "nose-3", "nose-4", "temple-1", "temple-2", "top-1",
    "top-2",
)  # fmt: skip
"""MakeHuman's targets asym-<name>-l and asym-<name>-r."""

_ASYMMETRY_SPREAD = {"top": 0.08, "jaw": 0.16, "ear": 0.2, "brown": 0.18, "cheek": 0.18}
_LIMIT = 2.3  # standard deviations of asymmetries
NAMES = tuple(SPREAD)
# What one deviate of each kind adds: of a change's own, of a direction, and of those over all
# changes that stand for what has no name.
_OWN, _WHOLE, _PART, _REST, _REST_COUNT = 0.6, 1.1, 1.2, 0.75, 12


def draw_shape(
    rng: np.random.Generator, heritage: Heritage, age: float, male: bool, strength: float
) -> dict[str, float]:
    """Local changes in [-1, 1] for a head of the given ancestry, age in years and sex.

    `strength` scales the individual deviation, not the means of these.
    """
    whole, parts, rest = directions()
    deviates = _OWN * np.clip(rng.standard_normal(len(NAMES)), -2.5, 2.5)
    deviates += _WHOLE * within_norm(rng.standard_normal(len(whole))) @ whole
    for part in parts:
        deviates += _PART * within_norm(rng.standard_normal(len(part))) @ part
    deviates += _REST * within_norm(rng.standard_normal(len(rest))) @ rest
    # Children's faces differ less.
    strength *= float(np.interp(age, [3.0, 18.0], [0.65, 1.0]))
    deviates = keep_plausible(strength * deviates)
    mean = _mean(heritage, age, male)
    unequal = strength * rng.normal(0.0, 0.12, len(NAMES))
    shape: dict[str, float] = {}
    for name, deviate, side in zip(NAMES, deviates, unequal, strict=True):
        value = mean.get(name, 0.0) + SPREAD[name] * deviate
        if name.startswith("±"):
            shape["l-" + name[1:]] = _bounded(value + SPREAD[name] * side)
            shape["r-" + name[1:]] = _bounded(value - SPREAD[name] * side)
        else:
            shape[name] = _bounded(value)
    # A face has one outline, or lies between two: those with the highest chances.
    chance = rng.standard_normal(len(OUTLINES))
    for name, value in zip(OUTLINES, chance - np.sort(chance)[-3], strict=True):
        amount = strength * OUTLINES[name] * min(max(float(value), 0.0), 1.8)
        if amount >= 0.0001:
            shape[name] = _bounded(amount)
    return shape


@cache
def directions() -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """Directions over the deviates of `NAMES`, one a row: of the whole face, of parts, the rest."""
    rest = np.random.default_rng(1234).standard_normal((_REST_COUNT, len(NAMES)))
    whole = np.stack([_row(changes) for changes in WHOLE_FACE.values()])
    parts = tuple(np.stack([_row(c) for c in part.values()]) for part in PARTS.values())
    return whole, parts, rest / np.sqrt(_REST_COUNT)


def _row(changes: dict[str, float]) -> np.ndarray:
    row = np.zeros(len(NAMES))
    for name, value in changes.items():
        row[NAMES.index(name)] = value
    return row


def _mean(heritage: Heritage, age: float, male: bool) -> dict[str, float]:
    total = dict(AVERAGE)
    old = float(np.clip((age - 40.0) / 45.0, 0.0, 1.1)) ** 1.3
    young = float(np.interp(age, [3.0, 14.0], [1.0, 0.0]))
    grown = float(np.interp(age, [8.0, 18.0], [0.2, 1.0]))
    sex = -0.67 * grown if male else grown
    shares = ((heritage.shape(), 1.0), (FEMALE, sex), (OLD, old), (CHILD, young))
    for table, share in shares:
        for name, value in table.items():
            total[name] = total.get(name, 0.0) + share * value
    return total


def draw_asymmetry(rng: np.random.Generator, strength: float) -> dict[str, float]:
    """Asymmetry targets in [0, 1]; of each left-right pair one at most is active."""
    # Some faces are even, others crooked all over.
    strength *= float(np.exp(0.35 * rng.standard_normal()))
    out: dict[str, float] = {}
    for name, deviate in zip(ASYMMETRY, rng.standard_normal(len(ASYMMETRY)), strict=True):
        spread = _ASYMMETRY_SPREAD.get(name.partition("-")[0], 0.22)
        value = _bounded(strength * spread * min(abs(float(deviate)), _LIMIT))
        if value > 0.0:
            out[f"asym-{name}-{'l' if deviate > 0 else 'r'}"] = value
    return out


def _bounded(value: float) -> float:
    return round(min(max(float(value), -1.0), 1.0), 4)
