"""Moving least squares against true skinning, the surface field and the naive way, side by side.

    python benchmarks/deformation.py [--device cpu] [--part necks|speed|growth|picture] [--whole]

Prints Markdown tables. `necks`: errors of T and R of the fall-offs and of the surface field on real
poses, against the bust's own skinning. `picture` draws what they do to a grid. `speed`: the fast
ways beside the naive one (a dense tensor of weighted products, `torch.linalg.svd`), with the error
of each against the exact field. `growth`: cost over points and over control points. Every
measurement has a process of its own, so that its memory peak is its own.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import report
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from assets_procedural.body.head import Bust, HeadModel
from assets_procedural.motion.poses import Pose
from assets_procedural.person import Person
from totalediting.geometry.field import Control, Field, tabulate
from totalediting.geometry.moving_least_squares import ALPHA, CLUSTERS, mls
from totalediting.geometry.surface_field import surface_field

POSES = {
    "yaw 35°": {"head": (0.0, 0.0, math.radians(35))},
    "pitch 25°": {"head": (math.radians(25), 0.0, 0.0)},
    "yaw, pitch, roll, open jaw": {
        "head": (math.radians(15), math.radians(10), math.radians(35)),
        "expression": {"jawOpen": 0.7},
    },
}
LOW, HIGH = (-0.26, -0.2, 0.28), (0.26, 0.12, 0.83)
MIDDLE = (0.0, 0.0, 0.64)  # of the head, roughly: the origin of tables
TILE, GAP, LINES = 360, 14, 34  # pixels of the picture, grid lines each way
RAYS = 128 * 128 * 96
PAIRS = 30_000  # pairs of points 1 mm apart
SAMPLED = 20_000  # points at which errors against the exact field are measured
WAYS = {
    "naive": "naive: dense products, SVD",
    "exact": "exact",
    "clusters": f"exact, {CLUSTERS} clusters",
    "table 24": f"table of 24³, {CLUSTERS} clusters",
    "table 32": f"table of 32³, {CLUSTERS} clusters",
    "table 48": f"table of 48³, {CLUSTERS} clusters",
}


def bust_of(pose: str) -> Bust:
    return HeadModel.load().identity(Person()).pose(Pose(**POSES[pose]))


def control_of(bust: Bust, device: str = "cpu", dtype: torch.dtype = torch.float32) -> Control:
    skin, canonical = bust.model.groups["skin"], bust.canonical
    arrays = (bust.vertices, canonical.vertices, bust.normals, canonical.normals)
    return Control(*(torch.from_numpy(a[skin]).to(device, dtype) for a in arrays))


def triangles(model: HeadModel) -> np.ndarray:
    """(F, 3) the skin's, as places among its vertices."""
    quads = np.searchsorted(model.groups["skin"], model.faces["skin"])
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def truth(bust: Bust, count: int, heights: tuple[float, float]) -> tuple[Tensor, ...]:
    """Points at random `heights` (metres) over the skin, carried along by its own skinning.

    Gives posed points, canonical points (count, 3), rotations from posed to canonical
    (count, 3, 3): those of the blended bones, canonical and posed normals of the skin (count, 3);
    float64.
    """
    rng = np.random.default_rng(0)
    faces = bust.model.groups["skin"][triangles(bust.model)]
    corners = bust.unposed[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    share = rng.dirichlet((1, 1, 1), count)
    motion = np.einsum("nk,nkij->nij", share, bust.vertex_motions[faces[chosen]])
    normal = np.einsum("nk,nkj->nj", share, bust.canonical.normals[faces[chosen]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point = np.einsum("nk,nkj->nj", share, corners[chosen])
    point = point + rng.uniform(*heights, (count, 1)) * normal
    linear = motion[..., :3]
    posed = np.einsum("nij,nj->ni", linear, point) + motion[..., 3]
    u, _, vh = np.linalg.svd(linear)
    turned = np.einsum("nk,nkj->nj", share, bust.normals[faces[chosen]])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    arrays = (posed, point, (u @ vh).transpose(0, 2, 1), normal, turned)
    return tuple(torch.from_numpy(a) for a in arrays)


def angles(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between rotations (..., 3, 3)."""
    chord = (a - b).flatten(-2).norm(dim=-1) / math.sqrt(8)
    return torch.rad2deg(2 * torch.arcsin(chord.clamp(max=1)))


def between(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between unit vectors (..., 3)."""
    return torch.rad2deg(2 * torch.arcsin(((a - b).norm(dim=-1) / 2).clamp(max=1)))


def jumps(field, generator: torch.Generator) -> tuple[float, float]:
    """Largest change of T - p (mm) and of R (degrees) between points 1 mm apart near the head."""
    low, high = torch.tensor([-0.2, -0.2, 0.45]), torch.tensor([0.2, 0.1, 0.83])
    points = low + (high - low) * torch.rand(PAIRS, 3, generator=generator)
    step = torch.nn.functional.normalize(torch.randn(PAIRS, 3, generator=generator), dim=-1)
    one, other = field(points.double()), field((points + 1e-3 * step).double())
    change = other.position - one.position - 1e-3 * step.double()
    return float(change.norm(dim=-1).max() * 1e3), float(angles(one.rotation, other.rotation).max())


def necks() -> None:
    header = ["pose", "field", "T on the skin, mm", "R, °", "normals, °", "T within 10 mm, mm"]
    header += ["T at 20–60 mm, mm", "largest jump over 1 mm: T, mm", "R, °"]
    report.table(header, neck_rows())


def neck_rows() -> Iterator[list[str]]:
    faces = torch.from_numpy(triangles(HeadModel.load()))
    for pose in POSES:
        bust = bust_of(pose)
        control = control_of(bust, dtype=torch.float64)
        fields: dict[str, Callable[[Tensor], Field]] = {
            f"MLS, α = {alpha:g}": (lambda p, a=alpha, c=control: mls(p, c, a))
            for alpha in (1.0, 1.5, 2.0, 3.0)
        }
        fields["surface field"] = lambda p, c=control: surface_field(p, c, faces)
        for name, field in fields.items():
            cells = []
            for heights in ((0.0, 0.0), (-0.01, 0.01), (0.02, 0.06)):
                posed, point, rotation, normal, turned = truth(bust, 5000, heights)
                found = field(posed)
                cells.append(spread((found.position - point).norm(dim=-1) * 1e3))
                if heights == (0.0, 0.0):
                    cells.append(spread(angles(found.rotation, rotation)))
                    cells.append(spread(between(found.to_posed(normal), turned)))
            position, turn = jumps(field, torch.Generator().manual_seed(0))
            yield [pose, name, *cells, f"{position:.1f}", f"{turn:.0f}"]


def spread(values: Tensor) -> str:
    """Mean and 99th percentile."""
    return f"{float(values.mean()):.2f} / {float(values.quantile(0.99)):.2f}"


def naive(points: Tensor, control: Control, alpha: float) -> tuple[Tensor, Tensor]:
    """T and R as one would write them first: dense products of all pairs, one SVD per point."""
    posed, canonical, posed_normals, canonical_normals = control
    positions, rotations = [], []
    for part in points.split(2048):
        w = (torch.cdist(part, posed).square() + 6.25e-8) ** -alpha
        w = (w / w.sum(1, keepdim=True))[..., None]
        x_mean, y_mean = (w * posed).sum(1), (w * canonical).sum(1)
        x, y = posed - x_mean[:, None], canonical - y_mean[:, None]
        turns = []
        for a, b in ((x, y), (posed_normals[None], canonical_normals[None])):
            moment = (w[..., None] * (a[..., :, None] * b[..., None, :])).sum(1)
            u, _, vh = torch.linalg.svd(moment)
            flip = torch.ones_like(moment[..., 0])
            flip[:, 2] = torch.det(u) * torch.det(vh)
            turns.append(vh.mT @ (flip[..., None] * u.mT))
        positions.append((turns[0] @ (part - x_mean)[..., None])[..., 0] + y_mean)
        rotations.append(turns[1])
    return torch.cat(positions), torch.cat(rotations)


def box(device: str) -> tuple[Tensor, Tensor]:
    return torch.tensor(LOW, device=device), torch.tensor(HIGH, device=device)


def scattered(count: int, device: str) -> Tensor:
    """Points in the bust's box, as samples on rays fill it; the same on every device."""
    share = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)).to(device)
    low, high = box(device)
    return low + (high - low) * share


def answer(way: str, points: Tensor, control: Control) -> tuple[Tensor, Tensor]:
    if way == "naive":
        return naive(points, control, ALPHA)
    if way.startswith("table"):
        middle = points.new_tensor(MIDDLE)
        moved = control._replace(posed=control.posed - middle, canonical=control.canonical - middle)
        resolution = int(way.split()[1])
        field = tabulate(lambda p: mls(p, moved, clusters=CLUSTERS), resolution, points)
        found: Field = field(points - middle)
        return found.position + middle, found.rotation
    else:
        found = mls(points, control, clusters=CLUSTERS if way == "clusters" else None)
    return found.position, found.rotation


def measure(way: str, count: int, vertices: int, device: str, timed: int) -> dict[str, float]:
    """Seconds (of `timed` points, scaled to `count`), peak memory, errors of one way."""
    bust = bust_of("yaw 35°")
    control = control_of(bust, device)
    generator = torch.Generator().manual_seed(2)
    chosen = torch.randint(len(control.posed), (vertices,), generator=generator).to(device)
    if vertices != len(control.posed):
        control = Control(*(a[chosen] for a in control))
    answer(way, scattered(16, device), control)  # warm
    points = scattered(count, device)[:timed]
    before = report.peak(device)
    with report.clock(device) as took:
        position, rotation = answer(way, points, control)
    seconds = took.seconds * count / timed
    memory = report.peak(device) - before
    some = slice(0, min(SAMPLED, timed))
    exact = mls(points[some].double(), Control(*(a.double() for a in control)))
    error = (position[some] - exact.position).norm(dim=-1) * 1e3
    angle = angles(rotation[some].double(), exact.rotation)
    return {
        "seconds": seconds,
        "memory": memory,
        "mm": float(error.mean()),
        "mm 99": float(error.quantile(0.99)),
        "deg": float(angle.mean()),
        "deg 99": float(angle.quantile(0.99)),
    }


def alone(*arguments) -> dict[str, float]:
    """`measure` in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure, *arguments).result()


def speed(device: str, whole: bool) -> None:
    header = ["points", "way", "seconds", "× naive", "memory, MB"]
    header += ["T, mm: mean / 99 %", "R, °: mean / 99 %"]

    def rows() -> Iterator[list[str]]:
        for name, count in (("24³", 24**3), ("48³", 48**3), ("128² × 96", RAYS)):
            base = math.nan
            for way, title in WAYS.items():
                # The naive way is linear in the points: of very many, part is timed.
                timed = 48**3 if way == "naive" and count > 48**3 and not whole else count
                found = alone(way, count, 5465, device, timed)
                base = found["seconds"] if way == "naive" else base
                note = "" if timed == count else f" (from {timed:,} points)"
                yield [
                    name,
                    title + note,
                    f"{found['seconds']:.2f}",
                    f"{base / found['seconds']:.1f}",
                    f"{found['memory']:.0f}",
                    f"{found['mm']:.3f} / {found['mm 99']:.3f}",
                    f"{found['deg']:.3f} / {found['deg 99']:.3f}",
                ]

    report.table(header, rows())


def growth(device: str) -> None:
    sizes = [(count, 5465) for count in (10_000, 100_000, 1_000_000)]
    sizes += [(100_000, vertices) for vertices in (1000, 2500, 10_000, 20_000)]

    def row(count: int, vertices: int) -> list[str]:
        ways = ("exact", "clusters", "table 32")
        found = (alone(way, count, vertices, device, count)["seconds"] for way in ways)
        return [f"{count:,}", f"{vertices:,}", *(f"{seconds:.2f}" for seconds in found)]

    header = ["points", "control points", "exact, s", "clusters, s", "table 32³, s"]
    report.table(header, (row(*size) for size in sizes))


def draw(target: Path) -> None:
    """What fields do to a plane of posed space: a grid, coloured by the angle of R.

    Upper row: the median plane (y, z) of a nod; lower row: a level plane (x, y) below the chin of a
    head turned by 35 degrees. Dots are control points near the plane.
    """
    faces = torch.from_numpy(triangles(HeadModel.load()))
    page = Image.new("RGB", (4 * (TILE + GAP) + GAP, 2 * (TILE + 26 + GAP)), "white")
    pen = ImageDraw.Draw(page)
    planes = (
        ("pitch 25°", (1, 2), (0, 0.0), ((-0.19, 0.14), (0.46, 0.82))),
        ("yaw 35°", (0, 1), (2, 0.605), ((-0.2, 0.2), (-0.22, 0.16))),
    )
    for row, (pose, axes, plane, window) in enumerate(planes):
        control = control_of(bust_of(pose), dtype=torch.float64)
        panels = {
            f"posed, {pose}": (control.posed, lambda p: Field(p, still(p))),
            "surface field": (control.canonical, lambda p, c=control: surface_field(p, c, faces)),
            "MLS, alpha = 1": (control.canonical, lambda p, c=control: mls(p, c, 1.0)),
            "MLS, alpha = 2": (control.canonical, lambda p, c=control: mls(p, c, 2.0)),
        }
        for column, (title, (dots, field)) in enumerate(panels.items()):
            x, y = GAP + column * (TILE + GAP), GAP + row * (TILE + 26 + GAP)
            page.paste(_panel(field, dots, axes, plane, window), (x, y))
            pen.text((x + 2, y + TILE + 5), title, "#16181d", font_size=15)
    page.save(target, quality=88)


def still(points: Tensor) -> Tensor:
    return torch.tensor([1.0, 0, 0, 0], dtype=points.dtype).expand(len(points), 4)


def _panel(field, dots: Tensor, axes, plane, window) -> Image.Image:
    """One tile: grid lines of a plane (axis, level) of posed space, where `field` takes them."""
    across, level = plane
    scale, fine = 2, 1201
    picture = Image.new("RGB", (TILE * scale, TILE * scale), "#f4f5f7")
    pen = ImageDraw.Draw(picture)
    extent = 1.45 * max(high - low for low, high in window)
    middle = np.array([sum(ends) / 2 for ends in window])

    def place(points: Tensor) -> list[tuple[float, float]]:
        flat = (points[:, list(axes)].numpy() - middle) / extent * [1, -1] + 0.5
        return [(x, y) for x, y in (flat * TILE * scale).tolist()]

    lines = torch.full((2, LINES, fine, 3), level, dtype=torch.float64)
    for along in (0, 1):
        (low, high), (left, right) = window[along], window[1 - along]
        other = torch.linspace(left, right, LINES, dtype=torch.float64)
        lines[along, ..., axes[along]] = torch.linspace(low, high, fine, dtype=torch.float64)
        lines[along, ..., axes[1 - along]] = other[:, None]
    found = field(lines.reshape(-1, 3))
    angle = angles(found.rotation, torch.eye(3, dtype=torch.float64)) / 35
    for first in range(0, len(angle), fine):
        spots = place(found.position[first : first + fine])
        for k in range(0, fine - 2, 2):
            pen.line(spots[k : k + 3], tint(float(angle[first + k + 1])), scale)
    near = (dots[:, across] - level).abs() < 0.004
    for x, y in place(dots[near]):
        pen.ellipse((x - 3, y - 3, x + 3, y + 3), "#16181d")
    return picture.resize((TILE, TILE), Image.Resampling.LANCZOS)


def tint(share: float) -> tuple[int, int, int]:
    """Blue where R is the identity to orange where it is 35 degrees."""
    share = min(max(share, 0.0), 1.0)
    low, high = np.array([52, 105, 190]), np.array([232, 119, 34])
    red, green, blue = (int(v) for v in low + share * (high - low))
    return red, green, blue


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--part", choices=("necks", "speed", "growth", "picture"))
    parser.add_argument("--whole", action="store_true", help="time the naive way on all samples")
    parser.add_argument("--picture", type=Path, default=Path("docs/deformation.jpg"))
    options = parser.parse_args()
    if options.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device: cuda: PyTorch finds no CUDA device here; use --device cpu")
    parts = {
        "necks": necks,
        "speed": lambda: speed(options.device, options.whole),
        "growth": lambda: growth(options.device),
        "picture": lambda: draw(options.picture),
    }
    for name, part in parts.items():
        if options.part in (None, name):
            part()


if __name__ == "__main__":
    main()
