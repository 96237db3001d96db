"""Creases: valleys along the folds of the face, deepened by age and by the expression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter

from assets_procedural.body.head import HeadModel
from assets_procedural.mesh.vectors import smoothstep, way_along
from assets_procedural.motion.expressions import Actions
from assets_procedural.person import Skin
from assets_procedural.skin_detail import chart
from assets_procedural.skin_detail.fold_curves import FOLDS, Fold

_STEP = 2.0e-3
# Off the middle of the face texels are lower than `chart.TEXEL`, metres.
_LOW_TEXEL = 0.28e-3
_Box = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class _Relief:
    """A fold of one side: `height` over `box` of the chart, metres, at full strength."""

    fold: Fold
    side: str
    box: _Box
    height: np.ndarray

    def strength(self, wrinkles: float, actions: Actions) -> float:
        """How deep it is, 0 to about 1.3; loose skin folds deeper under the same pull."""
        at_rest = self.fold.smooth + (self.fold.ageing - self.fold.smooth) * wrinkles
        pull = 0.0
        for name, share in self.fold.pulls.items():
            sides = (self.side,) if self.side else ("Left", "Right")
            values = [actions.get(name + s, actions.get(name, 0.0)) for s in sides]
            pull += share * sum(values) / len(sides)
        return min(at_rest + (0.55 + 0.55 * wrinkles) * pull, 1.3)


class Creases:
    """A person's own folds; `height` adds them up for an expression."""

    def __init__(self, skin: Skin, model: HeadModel) -> None:
        self._wrinkles = skin.wrinkles
        rng = np.random.default_rng([skin.seed, 2])
        self._reliefs = [
            relief for fold in FOLDS.values() for relief in _person_fold(fold, model, rng)
        ]

    def height(self, actions: Actions) -> np.ndarray:
        """(HEIGHT, WIDTH) float32 of the chart, metres; `actions` by ARKit name."""
        total = np.zeros((chart.HEIGHT, chart.WIDTH), np.float32)
        for relief in self._reliefs:
            total[relief.box] += np.float32(relief.strength(self._wrinkles, actions)) * (
                relief.height
            )
        return total


def _person_fold(fold: Fold, model: HeadModel, rng: np.random.Generator) -> list[_Relief]:
    own = float(np.exp(rng.normal(0, 0.3)))
    shift = rng.normal(0, [0.5, 0.7])
    reliefs = []
    for side in ("Left", "Right") if fold.sided else ("",):
        lines = []
        for curve in fold.curves:
            # Both sides share a habit and differ in detail.
            present = rng.random() < fold.often
            depth = own * float(np.exp(rng.normal(0, 0.28))) * (1.0 if present else 0.25)
            points = np.array(curve) + shift + rng.normal(0, 0.55, (len(curve), 2))
            if side == "Right":
                points[:, 0] *= -1
            lines.append((points * 1e-3, depth))
        reliefs.append(_relief(fold, side, lines, model, rng))
    return reliefs


def _relief(
    fold: Fold,
    side: str,
    lines: list[tuple[np.ndarray, float]],
    model: HeadModel,
    rng: np.random.Generator,
) -> _Relief:
    width = fold.width * 1e-3
    reach = (5.2 if fold.bulge else 3.2) * width
    drawn = [(chart.lift(model, _smooth(points, rng)), depth) for points, depth in lines]
    box = _box(np.concatenate([points for points, _ in drawn]), reach)
    total = np.zeros((box[0].stop - box[0].start, box[1].stop - box[1].start), np.float32)
    # Right of the curve's direction lies the other way round on the mirrored side.
    bulge = fold.bulge * (-1 if side == "Right" else 1)
    for points, depth in drawn:
        part = _box(points, reach)
        within = tuple(
            slice(p.start - b.start, p.stop - b.start) for p, b in zip(part, box, strict=True)
        )
        distance, across, along = _distance(chart.surface(model)[part], points, part)
        # A fold deepens and fades along its way, and ends softly.
        wander = np.interp(along, np.linspace(0, 1, 9), rng.uniform(0.65, 1.2, 9))
        ends = smoothstep(0, 0.22, along) * smoothstep(1, 0.72, along)
        beyond = smoothstep(2.2 * width, 0.8 * width, distance)
        narrow = width * (0.6 + 0.4 * ends)
        valley = -np.exp(-((distance / narrow) ** 2)) * np.maximum(ends, 0.15 * beyond)
        shoulder = 0.15 * np.exp(-(((distance - 2.1 * width) / (0.9 * width)) ** 2)) * ends
        if bulge:
            away = np.clip(across * np.sign(bulge), 0, None)
            rounded = (away / width) * np.exp(1 - away / (1.7 * width)) / 1.7
            shoulder = shoulder + abs(bulge) * rounded * ends * smoothstep(reach, 0.4 * reach, away)
        total[within] += (depth * fold.depth * 1e-3 * wander * (valley + shoulder)).astype(
            np.float32
        )
    # Soft where a bent curve has two nearest points, and at the ends of the chart.
    return _Relief(fold, side, box, gaussian_filter(total, 1.3) * chart.border()[box])


def _smooth(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A smooth curve (N, 2) through (K, 2) points, in steps of about `_STEP`, a little unsteady."""
    length = way_along(points)
    count = max(int(length[-1] / _STEP), 4)
    at = np.linspace(0, length[-1], count)
    path = np.stack([PchipInterpolator(length, points[:, k])(at) for k in (0, 1)], axis=1)
    knots = max(count // 3, 3)
    for k, unsteady in enumerate(rng.normal(0, 0.25e-3, (2, knots))):
        path[:, k] += np.interp(at, np.linspace(0, length[-1], knots), unsteady)
    return path


def _box(points: np.ndarray, reach: float) -> _Box:
    """The part of the chart within about `reach` metres of the points (N, 3)."""
    columns, rows = chart.pixels(points).T
    margin = reach / _LOW_TEXEL
    return (
        slice(*np.clip([rows.min() - margin, rows.max() + margin], 0, chart.HEIGHT).astype(int)),
        slice(
            *np.clip([columns.min() - margin, columns.max() + margin], 0, chart.WIDTH).astype(int)
        ),
    )


def _distance(
    surface: np.ndarray, curve: np.ndarray, box: _Box
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far texels (H, W, 3) are from a curve (N, 3), the same by side, and where along it.

    Metres, and [0, 1] from the curve's start to its end. By side: positive to the right of the
    curve's direction as seen in the picture, negative to the left, and nearer 0 beside the curve.
    """
    points, lines = surface.astype(np.float32), curve.astype(np.float32)
    best = np.full(points.shape[:2], np.inf, np.float32)
    place = np.zeros(points.shape[:2], np.float32)
    nearest = np.zeros(points.shape[:2], np.int32)
    for k, (start, step) in enumerate(zip(lines, np.diff(lines, axis=0), strict=False)):
        offset = points - start
        along = np.clip(offset @ step / (step @ step), 0, 1)
        offset -= along[..., None] * step
        square = np.einsum("hwc,hwc->hw", offset, offset)
        closer = square < best
        best = np.where(closer, square, best)
        place = np.where(closer, k + along, place)
        nearest = np.where(closer, k, nearest)
    pixels = chart.pixels(curve)
    step = np.diff(pixels, axis=0)[nearest]
    start = pixels[:-1][nearest]
    rows = np.arange(box[0].start, box[0].stop)[:, None]
    columns = np.arange(box[1].start, box[1].stop)[None]
    turn = step[..., 0] * (rows - start[..., 1]) - step[..., 1] * (columns - start[..., 0])
    distance = np.sqrt(best)
    return distance, distance * np.clip(turn / 20, -1, 1), place / (len(curve) - 1)
