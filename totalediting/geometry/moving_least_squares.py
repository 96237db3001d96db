"""Moving least squares: the deformation from posed to canonical space.

Symbols: P query points, V control points, K clusters of them; positions in metres; fields as in
`totalediting.geometry.field`.

In the paper's form (Zhu & Gortler 2007), with weights w_i = (|V^t_i - p|^2 + epsilon)^-alpha, T(p)
is the rigid motion that takes the posed control points V^t to the canonical V^c in the weighted
least-squares sense, and R(p) the rotation that takes the posed normals N^t to the canonical N^c.
Both need only weighted sums of 25 products per control point, so all points of a neighbourhood cost
two matrix products; each rotation is an eigenvector of a 4x4 matrix. On a GPU all points are one
neighbourhood: there it is the number of operations that takes time, not their size.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from totalediting.geometry.field import (
    Control,
    Field,
    batched,
    cells,
    check_control,
    check_points,
    favours_few_operations,
    kabsch,
    quaternion_of,
)

ALPHA = 2.0
"""Fall-off of the presets; the paper uses 1. docs/measurements.md compares them on real necks."""
EPSILON = 6.25e-8
"""Softening in square metres: (0.25 mm)^2 keeps the weight at a control point itself finite."""
CLUSTERS = 256
"""Groups of control points that stand in for their members where these are far."""

_OPENING = 2.0  # a cluster is far beyond this many of its own radii
_PAIRS = 1 << 20  # weights at once, which bounds the memory: 4 MB in single precision
_PAIRS_EVERYWHERE = 1 << 24  # the same where all points are one neighbourhood: 128 MB in double
_SOLVED = 1 << 14  # points whose rotations are found at once


@torch.no_grad()
def mls(
    points: Tensor,
    control: Control,
    alpha: float = ALPHA,
    epsilon: float = EPSILON,
    clusters: int | None = None,
) -> Field:
    """T and R of moving least squares at `points` (..., P, 3); exact, or with `clusters` nearly so.

    Leading dimensions of points and control points must be equal. With `clusters`, control points
    are put into that many groups, and a group acts from its centroid where it is farther than twice
    its radius; on a GPU it is exact. Memory does not grow with P or V beyond the result.

    Raises:
        ValueError: shapes that do not fit, NaN or Inf, normals that are not unit, alpha outside
            (0, 4], epsilon that is not positive, clusters below 1.
    """
    check_points(points)
    check_control(control, points.shape[:-2])
    if not 0 < alpha <= 4:
        raise ValueError(f"alpha must be in (0, 4], got {alpha}")
    if not epsilon > 0:
        raise ValueError(f"epsilon must be positive, got {epsilon}")
    if clusters is not None and clusters < 1:
        raise ValueError(f"clusters must be at least 1, got {clusters}")
    return batched(points, control, lambda p, c: _mls(p, c, alpha, epsilon, clusters))


@torch.no_grad()
def mls_reference(
    points: Tensor, control: Control, alpha: float = ALPHA, epsilon: float = EPSILON
) -> tuple[Tensor, Tensor]:
    """T (P, 3) and R (P, 3, 3) as the equations read, by SVD in float64: slow, for comparison."""
    posed, canonical, posed_normals, canonical_normals = (a.double() for a in control)
    positions, rotations = [], []
    for p in points.double():
        w = ((posed - p).square().sum(-1) + epsilon) ** -alpha
        w = w / w.sum()
        posed_mean, canonical_mean = w @ posed, w @ canonical
        moment = (w[:, None] * (posed - posed_mean)).T @ (canonical - canonical_mean)
        positions.append(kabsch(moment) @ (p - posed_mean) + canonical_mean)
        rotations.append(kabsch((w[:, None] * posed_normals).T @ canonical_normals))
    return torch.stack(positions), torch.stack(rotations)


def _mls(
    points: Tensor, control: Control, alpha: float, epsilon: float, clusters: int | None
) -> Field:
    """`mls` for points (P, 3) and control points (V, 3)."""
    whole = favours_few_operations(points)
    sources = _Sources(control, None if whole else clusters)
    sums = (_sums_everywhere if whole else _sums_nearby)(points, sources, alpha, epsilon)
    field = Field(torch.empty_like(points), points.new_empty(len(points), 4))
    waiting: list[tuple[Tensor, Tensor]] = []
    for part in sums:
        waiting.append(part)
        if sum(len(index) for index, _ in waiting) >= _SOLVED:
            _solve(points, sources.origin, waiting, field)
    _solve(points, sources.origin, waiting, field)
    return field


def _sums_nearby(
    points: Tensor, sources: _Sources, alpha: float, epsilon: float
) -> Iterator[tuple[Tensor, Tensor]]:
    """Places among the points, and their weighted sums (P', 25), by neighbourhoods."""
    for index, centre, reach in cells(points):
        place, columns = sources.seen_from(centre, reach)
        # Weights relative to those at this distance stay within single precision everywhere.
        scale = float(place.square().sum(-1).min().clamp_min(epsilon))
        # Near a control point the rest weighs little and yet decides: hence sums in float64.
        sums = [
            _weights(part - centre, place, alpha, epsilon, scale).double() @ columns
            for part in points[index].split(max(1, _PAIRS // len(place)))
        ]
        yield index, torch.cat(sums)


def _sums_everywhere(
    points: Tensor, sources: _Sources, alpha: float, epsilon: float
) -> Iterator[tuple[Tensor, Tensor]]:
    """The same in few operations: one neighbourhood, so wide that all of it is in float64."""
    place = sources.place.double() - sources.origin
    size = max(1, _PAIRS_EVERYWHERE // len(place))
    for index in torch.arange(len(points), device=points.device).split(size):
        part = points[index].double() - sources.origin
        yield index, _weights(part, place, alpha, epsilon, epsilon) @ sources.columns


def _solve(
    points: Tensor, origin: Tensor, waiting: list[tuple[Tensor, Tensor]], field: Field
) -> None:
    """T and R from weighted sums of columns (P', 25), whose x and y are about `origin`."""
    if not waiting:
        return
    index, sums = (torch.cat(parts) for parts in zip(*waiting, strict=True))
    waiting.clear()
    total, x_mean, y_mean, products, normals = sums.split([1, 3, 3, 9, 9], 1)
    x_mean, y_mean = x_mean / total, y_mean / total
    moment = products / total - _outer(x_mean, y_mean)
    motion, turn = quaternion_of(torch.stack([moment, normals]).unflatten(-1, (3, 3)))
    # Turning by q is turning back by its conjugate.
    back = Field(x_mean, motion * motion.new_tensor([1.0, -1.0, -1.0, -1.0]))
    moved = back.to_posed(points[index] - origin - x_mean) + y_mean + origin
    field.position[index] = moved.to(points.dtype)
    field.quaternion[index] = turn.to(points.dtype)


def _weights(points: Tensor, sources: Tensor, alpha: float, epsilon: float, scale: float) -> Tensor:
    """((|x_i - p|^2 + epsilon) / scale)^-alpha, (P, V).

    |x - p|^2 = |x|^2 - 2 x.p + |p|^2 is one matrix product. Coordinates are about the points' own
    cell, so that what cancels is small and single precision loses nothing that matters.
    """
    squares = points.square().sum(-1, True), sources.square().sum(-1, True)
    left = torch.cat([-2 * points, squares[0], torch.ones_like(squares[0])], 1) / scale
    right = torch.cat([sources, torch.ones_like(squares[1]), squares[1]], 1)
    squared = (left @ right.T).clamp_min_(0).add_(epsilon / scale)
    if alpha == 1:
        return squared.reciprocal_()
    if alpha == 2:
        return squared.square_().reciprocal_()
    if alpha == 1.5:
        return squared.rsqrt_().pow_(3)
    return squared.pow_(-alpha)


class _Sources:
    """Control points, and clusters of them, as a neighbourhood sees them.

    `columns` (V, 25) float64 are the products that are summed: 1, x, y, x y^T and n^t n^c^T with x
    and y about `origin` (3,).
    """

    def __init__(self, control: Control, clusters: int | None) -> None:
        self.place = control.posed
        x, y, *normals = (a.double() for a in control)
        self.origin = x.mean(0)
        x, y = x - self.origin, y - self.origin
        products = [torch.ones_like(x[:, :1]), x, y, _outer(x, y), _outer(*normals)]
        self.columns = torch.cat(products, 1)
        self.clustered = clusters is not None and clusters < len(x)
        if clusters is not None and self.clustered:
            self.label, self.centre, self.radius = _clusters(control.posed, clusters)
            total = self.columns.new_zeros(len(self.centre), 25)
            self.total = total.index_add_(0, self.label, self.columns)

    def seen_from(self, centre: Tensor, reach: float) -> tuple[Tensor, Tensor]:
        """Places (N, 3) about `centre`, and their columns (N, 25).

        Clusters that are far from all that lies within `reach` of it stand for their members.
        """
        if not self.clustered:
            return self.place - centre, self.columns
        far = (self.centre - centre).norm(dim=-1) - reach > _OPENING * self.radius
        near = ~far[self.label]
        place = torch.cat([self.place[near], self.centre[far]]) - centre
        return place, torch.cat([self.columns[near], self.total[far]])


def _clusters(points: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Farthest-point clusters: label (V,), centroid (K, 3) and radius (K,) of each."""
    seeds = torch.zeros(count, dtype=torch.long, device=points.device)
    distance = (points - points[0]).square().sum(-1)
    for k in range(1, count):
        seeds[k] = distance.argmax()
        distance = torch.minimum(distance, (points - points[seeds[k]]).square().sum(-1))
    label = torch.cdist(points, points[seeds]).argmin(1)
    number = torch.bincount(label, minlength=count).to(points)[:, None].clamp_min(1)
    centre = torch.zeros_like(points[seeds]).index_add_(0, label, points) / number
    off = (points - centre[label]).norm(dim=-1)
    radius = torch.zeros_like(number[:, 0]).scatter_reduce_(0, label, off, "amax")
    return label, centre, radius


def _outer(a: Tensor, b: Tensor) -> Tensor:
    """Products a b^T of (N, 3) and (N, 3), flattened to (N, 9)."""
    return (a[:, :, None] * b[:, None]).flatten(1)
