"""The surface field: the deformation of the nearest triangle, the baseline of moving least squares.

Symbols: P points, F triangles; positions in metres; fields as in `totalediting.geometry.field`.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.field import (
    Control,
    Field,
    batched,
    cells,
    check_control,
    check_points,
    quaternion_of,
)

_PAIRS = 1 << 20  # pairs of point and triangle at once, which bounds the memory


@torch.no_grad()
def surface_field(points: Tensor, control: Control, faces: Tensor) -> Field:
    """T and R by the nearest triangle (Bergman et al. 2022): what moving least squares replaces.

    A point keeps its barycentric place in the posed triangle (faces (F, 3) into the control
    points) that is nearest to it, and its offset from there turns with that triangle, so that it
    keeps its signed distance along the normal. Exact on the mesh and for rigid motions, but the
    nearest triangle jumps. Points (..., P, 3).

    Raises:
        ValueError: shapes that do not fit, NaN or Inf, normals that are not unit.
    """
    check_points(points)
    check_control(control, points.shape[:-2])
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"faces must be (F, 3), got {tuple(faces.shape)}")
    return batched(points, control, lambda p, c: _surface_field(p, c, faces))


def _surface_field(points: Tensor, control: Control, faces: Tensor) -> Field:
    corners, canonical = control.posed[faces], control.canonical[faces]
    frames = [_frames(a.double()) for a in (corners, canonical)]
    turn = quaternion_of(frames[0].mT @ frames[1]).to(points.dtype)
    triangle, foot, share = nearest_triangle(points, corners)
    image = (share[:, :, None] * canonical[triangle]).sum(1)
    quaternion = turn[triangle]
    moved = Field(image, quaternion * quaternion.new_tensor([1.0, -1.0, -1.0, -1.0]))
    return Field(image + moved.to_posed(points - foot), quaternion)


def _frames(corners: Tensor) -> Tensor:
    """Orthonormal rows (F, 3, 3) of triangles: along the first edge, in the plane, normal."""
    edge = functional.normalize(corners[:, 1] - corners[:, 0], dim=-1)
    normal = torch.linalg.cross(edge, corners[:, 2] - corners[:, 0])
    normal = functional.normalize(normal, dim=-1)
    return torch.stack([edge, torch.linalg.cross(normal, edge), normal], -2)


def nearest_triangle(points: Tensor, corners: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The triangle of (F, 3, 3) nearest to each point (P, 3): exact, by bounds on distances.

    Returns its index (P,), the nearest point on it (P, 3) and that point's barycentric (P, 3).
    """
    centre = corners.mean(1)
    radius = (corners - centre[:, None]).norm(dim=-1).amax(1)
    triangle = torch.zeros(len(points), dtype=torch.long, device=points.device)
    share = points.new_zeros(len(points), 3)
    for index, middle, reach in cells(points):
        # No triangle can be nearest whose near side is farther than another one's centre.
        away = (centre - middle).norm(dim=-1)
        near = (away - radius - reach <= away.min() + reach).nonzero()[:, 0]
        for part in index.split(max(1, _PAIRS // len(near))):
            distance = torch.cdist(points[part], centre[near])
            within = distance - radius[near] <= distance.amin(1, keepdim=True)
            row, column = within.nonzero().unbind(1)
            candidate = near[column]
            place = _closest(points[part][row], corners[candidate])
            foot = (place[:, :, None] * corners[candidate]).sum(1)
            squared = (points[part][row] - foot).square().sum(-1)
            least = squared.new_full((len(part),), torch.inf)
            least.scatter_reduce_(0, row, squared, "amin")
            # Of equally near ones the first: written last.
            best = (squared == least[row]).nonzero()[:, 0].flip(0)
            triangle[part[row[best]]] = candidate[best]
            share[part[row[best]]] = place[best]
    return triangle, (share[:, :, None] * corners[triangle]).sum(1), share


def _closest(points: Tensor, corners: Tensor) -> Tensor:
    """Barycentric (N, 3) of the point of each triangle (N, 3, 3) that is nearest to (N, 3)."""
    a, b, c = corners.unbind(1)
    normal = torch.linalg.cross(b - a, c - a)
    area = normal.square().sum(-1).clamp_min(1e-30)
    inside = torch.stack(
        [
            (torch.linalg.cross(q - p, points - p) * normal).sum(-1) / area
            for p, q in ((b, c), (c, a), (a, b))
        ],
        -1,
    )
    best = inside
    least = torch.where((inside >= 0).all(-1), -1.0, torch.inf).to(points)
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        edge = end - start
        along = ((points - start) * edge).sum(-1) / edge.square().sum(-1).clamp_min(1e-30)
        along = along.clamp(0, 1)
        squared = (start + along[:, None] * edge - points).square().sum(-1)
        place = torch.zeros_like(inside)
        place[:, k], place[:, (k + 1) % 3] = 1 - along, along
        nearer = squared < least
        best = torch.where(nearer[:, None], place, best)
        least = torch.where(nearer, squared, least)
    return best
