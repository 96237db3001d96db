"""A deformation field: canonical positions and rotations of points of posed space.

Symbols: P query points, V control points (the bust's vertices), F triangles. Positions are in
metres, in any frame that posed and canonical space share; those of tables in model space. For a
point p of posed space T(p) is its canonical position and R(p) the rotation of directions, so that
n^c = R(p) n^t and n^t = R(p)^T n^c. Both are constants to autograd: no gradient flows through them.
`totalediting.geometry.moving_least_squares` and `totalediting.geometry.surface_field` make fields.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from totalediting.geometry.space import off_planes, on_planes

_CELL = 0.05  # metres: edge of the cells that points are sorted into
_LOOKUPS = 1 << 18  # points at once in a table
_SQUARINGS = 40  # tell eigenvalues apart that agree in ten digits


class Control(NamedTuple):
    """Corresponding control points (..., V, 3) in metres and their unit normals (..., V, 3)."""

    posed: Tensor
    canonical: Tensor
    posed_normals: Tensor
    canonical_normals: Tensor

    def showing(self, other: Control) -> Control:
        """These points where they are, and at rest with the expression of another bust."""
        return self._replace(canonical=other.canonical, canonical_normals=other.canonical_normals)

    def back(self) -> Control:
        """The way from canonical to posed space: the two change places."""
        return Control(self.canonical, self.posed, self.canonical_normals, self.posed_normals)


class Field(NamedTuple):
    """T and R at P points: `position` (..., P, 3) metres, `quaternion` (..., P, 4) as (w, x, y, z).

    The quaternions are unit, so that R is proper (det R = +1) without exception.
    """

    position: Tensor
    quaternion: Tensor

    @property
    def rotation(self) -> Tensor:
        """R (..., P, 3, 3), from posed to canonical directions."""
        w, x, y, z = self.quaternion.unbind(-1)
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return torch.stack([torch.stack(row, -1) for row in rows], -2)

    def to_posed(self, directions: Tensor) -> Tensor:
        """n^t = R^T n^c for directions (..., P, 3); gradients flow to the directions."""
        w, axis = self.quaternion[..., :1], self.quaternion[..., 1:]
        turned = 2 * torch.linalg.cross(directions, axis)
        return directions + w * turned + torch.linalg.cross(turned, axis)


class Table:
    """A field over the box of `space`, looked up trilinearly: what a renderer calls for every
    sample.

    Nodes are evenly spaced in places, so finest at the face. Between them offsets T(p) - p, so that
    rigid motions are exact, and quaternions are interpolated, the latter normalised after it;
    outside, the border's are used.
    """

    def __init__(self, values: Tensor, lead: tuple[int, ...]) -> None:
        """`values` (prod(lead), 7, n, n, n): offsets, then quaternions; z, y, x of the nodes."""
        self.values, self.lead = values, lead

    @classmethod
    def of(cls, field: Field, resolution: int) -> Table:
        """`field` at `nodes(resolution)`, with any leading dimensions."""
        lead = tuple(field.position.shape[:-2])
        offset = field.position - nodes(resolution, field.position)
        # q and -q are one rotation: to be averaged, all must lie on one side.
        side = (field.quaternion * field.quaternion[..., :1, :]).sum(-1, keepdim=True)
        sign = torch.where(side < 0, -1.0, 1.0)
        values = torch.cat([offset, sign * field.quaternion], -1)
        values = values.reshape(-1, *(resolution,) * 3, 7).movedim(-1, 1).contiguous()
        return cls(values, lead)

    @classmethod
    def stack(cls, tables: list[Table]) -> Table:
        """Tables without leading dimensions as one of (B,)."""
        return cls(torch.cat([table.values for table in tables]), (len(tables),))

    def unstack(self) -> list[Table]:
        """The inverse of `stack`."""
        return [Table(values, ()) for values in self.values.split(1)]

    def mirrored(self) -> Table:
        """The table of the mirrored scene, x for -x; the box is its own mirror image."""
        signs = self.values.new_tensor([-1.0, 1, 1, 1, 1, -1, -1])  # an axis is a pseudovector
        values = self.values.flip(-1) * signs[:, None, None, None]
        return Table(values, self.lead)

    @torch.no_grad()
    def __call__(self, points: Tensor) -> Field:
        """T and R at `points` (..., P, 3), whose leading dimensions are the table's.

        Raises:
            ValueError: shapes that do not fit.
        """
        found = self._values_at(points, self.values)
        quaternion = functional.normalize(found[..., 3:], dim=-1)
        return Field(points + found[..., :3], quaternion)

    @torch.no_grad()
    def positions(self, points: Tensor) -> Tensor:
        """T alone, (..., P, 3), which takes half of the time; as `__call__`."""
        return points + self._values_at(points, self.values[:, :3])

    def _values_at(self, points: Tensor, values: Tensor) -> Tensor:
        check_points(points)
        if points.shape[:-2] != self.lead:
            raise ValueError(f"points must be {(*self.lead, 'P', 3)}, got {tuple(points.shape)}")
        flat = points.reshape(len(values), -1, 3)
        found = flat.new_empty(*flat.shape[:-1], values.shape[1])
        for part in range(0, flat.shape[1], _LOOKUPS):
            here = slice(part, part + _LOOKUPS)
            place = _between_nodes(flat[:, here], values.shape[-1])
            found[:, here] = functional.grid_sample(
                values, place[:, :, None, None], padding_mode="border", align_corners=True
            )[..., 0, 0].mT
        return found.reshape(*points.shape[:-1], -1)


@torch.no_grad()
def tabulate(
    field: Callable[[Tensor], Field], resolution: int, like: Tensor, lead: tuple[int, ...] = ()
) -> Table:
    """A `Table` of `field` with `resolution` nodes along each axis of the box, of the dtype and on
    the device of `like`; `lead` are the field's leading dimensions.

    Raises:
        ValueError: a resolution below 2.
    """
    if resolution < 2:
        raise ValueError(f"resolution must be at least 2, got {resolution}")
    return Table.of(field(nodes(resolution, like).expand(*lead, -1, 3)), resolution)


def nodes(resolution: int, like: Tensor) -> Tensor:
    """(resolution^3, 3) node positions of a `Table`, metres; x runs fastest."""
    side = torch.linspace(-1, 1, resolution, dtype=like.dtype, device=like.device)
    z, y, x = torch.meshgrid(side, side, side, indexing="ij")
    return off_planes(torch.stack([x, y, z], -1).reshape(-1, 3))


def _between_nodes(points: Tensor, resolution: int) -> Tensor:
    """Where points (..., 3) are in a table, [-1, 1] each way, by metres between its nodes."""
    last = resolution - 1
    along = off_planes(torch.linspace(-1, 1, resolution).to(points)[:, None].expand(-1, 3))
    first = ((on_planes(points) + 1) / 2 * last).floor().clamp(0, last - 1).long()
    axes = torch.arange(3, device=points.device)
    low, high = along[first, axes], along[first + 1, axes]
    return 2 * (first + (points - low) / (high - low)) / last - 1


def kabsch(moment: Tensor) -> Tensor:
    """Rotation (..., 3, 3) that best takes x to y, from sum x y^T (..., 3, 3), by SVD.

    The last axis is mirrored where the best orthogonal matrix would be a reflection (Kabsch 1978).
    """
    u, _, vh = torch.linalg.svd(moment)
    flip = torch.ones_like(moment[..., 0])
    flip[..., 2] = torch.det(u) * torch.det(vh)
    return vh.mT @ (flip[..., None] * u.mT)


def quaternion_of(moment: Tensor) -> Tensor:
    """Unit quaternion (..., 4) of the rotation that best takes x to y, from sum x y^T (..., 3, 3).

    The eigenvector of the largest eigenvalue of Horn's symmetric 4x4 matrix, in float64. It always
    is a proper rotation, also of mirrored moments; a null moment gives the identity, and where
    several rotations are equally good it is one of them.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (
        row.unbind(-1) for row in moment.double().unbind(-2)
    )
    rows = [
        # A tiny positive number makes the identity win where all else is zero.
        [xx + yy + zz + 1e-300, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
    matrix = torch.stack([torch.stack(row, -1) for row in rows], -2)
    if favours_few_operations(matrix):
        return top_eigenvector(matrix)
    return torch.linalg.eigh(matrix).eigenvectors[..., -1]


def favours_few_operations(tensor: Tensor) -> bool:
    """Whether few large operations are faster than many small ones where a tensor is: on a GPU."""
    return tensor.is_cuda


def top_eigenvector(matrix: Tensor) -> Tensor:
    """Unit eigenvector (..., N) of the largest eigenvalue of symmetric float64 (..., N, N).

    As `torch.linalg.eigh`'s, by repeated squaring, which takes all matrices in step. Shifted until
    it has no negative eigenvalue, a matrix squared `_SQUARINGS` times is of rank one, unless its
    largest eigenvalues agree in more than ten digits: then any column is an eigenvector of theirs.
    """
    power = matrix / matrix.abs().amax((-2, -1), keepdim=True)
    size = matrix.shape[-1]
    power = power + size * torch.eye(size).to(power)
    for _ in range(_SQUARINGS):
        power = power @ power
        power = power / power.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    largest = power.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None]
    column = power.take_along_dim(largest, -1)[..., 0]
    return functional.normalize(column, dim=-1)


def batched(points: Tensor, control: Control, field: Callable[[Tensor, Control], Field]) -> Field:
    """Apply a field of (P, 3) and (V, 3) over leading dimensions."""
    lead = points.shape[:-2]
    flat = [a.reshape(-1, *a.shape[-2:]) for a in (points, *control)]
    fields = [field(p, Control(*c)) for p, *c in zip(*flat, strict=True)]
    position, quaternion = (torch.stack(parts) for parts in zip(*fields, strict=True))
    return Field(
        position.reshape(*lead, *position.shape[1:]),
        quaternion.reshape(*lead, *quaternion.shape[1:]),
    )


def cells(points: Tensor) -> Iterator[tuple[Tensor, Tensor, float]]:
    """Points (P, 3) by cells of a grid: indices, the middle (3,) of a cell's points, their reach.

    A cell is 5 cm wide, or wider where points are so sparse that few would share it.
    """
    if not len(points):
        return
    offset = points - points.amin(0)
    extent = offset.amax(0)
    spacing = float(extent.prod() / len(points)) ** (1 / 3)
    edge = max(_CELL, 4 * spacing, float(extent.max()) / 1000)
    x, y, z = (offset / edge).long().unbind(-1)
    cell, order = torch.sort(x + 1024 * (y + 1024 * z), stable=True)
    counts = torch.unique_consecutive(cell, return_counts=True)[1]
    for index in order.split(counts.tolist()):
        here = points[index]
        centre = (here.amin(0) + here.amax(0)) / 2
        yield index, centre, float((here - centre).norm(dim=-1).max())


def check_points(points: Tensor) -> None:
    if points.ndim < 2 or points.shape[-1] != 3 or not points.is_floating_point():
        raise ValueError(
            f"points must be (..., P, 3) floats, got {tuple(points.shape)} {points.dtype}"
        )
    if not bool(points.isfinite().all()):
        raise ValueError(f"points {tuple(points.shape)} hold NaN or Inf")


def check_control(control: Control, lead: tuple[int, ...]) -> None:
    shape = control.posed.shape
    if len(shape) < 2 or shape[-1] != 3 or not shape[-2] or shape[:-2] != lead:
        raise ValueError(f"control.posed must be {(*lead, 'V', 3)}, got {tuple(shape)}")
    for name, array in control._asdict().items():
        if array.shape != shape:
            raise ValueError(f"control.{name} must be {tuple(shape)}, got {tuple(array.shape)}")
        if not bool(array.isfinite().all()):
            raise ValueError(f"control.{name} {tuple(shape)} holds NaN or Inf")
        if name.endswith("normals") and bool((array.norm(dim=-1) - 1).abs().max() > 1e-3):
            raise ValueError(f"control.{name} {tuple(shape)} must hold unit normals")
