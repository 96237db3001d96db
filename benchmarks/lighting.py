"""How exact the lightmaps of Blender's panoramas are, and what they cost beside other ways.

    python benchmarks/lighting.py [--device cpu] [--panorama city]

Prints tables, in about four minutes on two cores. Errors are against the integral over all
texels at full resolution, in percent: relative L2 over the map, and in brackets the largest error
by the map's peak. Times on a CPU are CPU seconds on one thread, on a GPU seconds; memory is what a
fresh process takes beyond its imports and the panorama, tables included.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from multiprocessing import get_context

import numpy as np
import report
import torch
from scipy.special import lpmv

from assets_procedural.conventions import panorama
from assets_procedural.light.pool import BUNDLED, EnvironmentSettings, panorama_of, pool
from totalediting.light.lightmaps import (
    LOBE_INTEGRALS,
    SHININESS,
    bake,
    brute_force,
    sample,
    texel_directions,
)

HEIGHT = 32
LOBES = ("diffuse, n = 1", *(f"n = {exponent}" for exponent in SHININESS[1:]))
DEGREE, MIDDLE = 40, 128
"""Of the spherical harmonics that are compared with: degree, and rows that they are projected from
(at full resolution the matrix would take 3.5 GB)."""


def bundled() -> torch.Tensor:
    """The panoramas of Blender's wheel, (8, 512, 1024, 3), in the order of BUNDLED."""
    return torch.from_numpy(np.stack([panorama_of(s) for s in pool(EnvironmentSettings(), 0)]))


def normalise(lobes: torch.Tensor) -> torch.Tensor:
    """Integrals (..., 4, 3, H, W) of the specular lobes, by the solid angles of the lobes."""
    scale = torch.tensor(LOBE_INTEGRALS[1:], dtype=lobes.dtype, device=lobes.device)
    return lobes / scale[:, None, None, None]


# Four ways to get the maps (4, 3, HEIGHT, 2 HEIGHT) of the exponents of SHININESS; the diffuse map
# is the first of them. Tables that depend on no environment are kept.


def ours(environment: torch.Tensor) -> torch.Tensor:
    return bake(environment, HEIGHT)[..., 1:, :, :, :]


def integral(environment: torch.Tensor) -> torch.Tensor:
    """Every texel of the map sums over every texel of the panorama, as the equation says."""
    height = environment.shape[0]
    angles = torch.from_numpy(panorama.texel_solid_angles(height)).to(environment)
    light = (environment * angles[:, None, None]).flatten(0, 1)
    texels = texel_directions(height, device=environment.device).flatten(0, 1)
    chunks = []
    for chunk in texel_directions(HEIGHT, device=environment.device).flatten(0, 1).split(16):
        cosine = (chunk @ texels.T).clamp_min(0.0)
        chunks.append(torch.stack([cosine.pow(exponent) @ light for exponent in SHININESS]))
    return normalise(torch.cat(chunks, dim=1).mT.unflatten(-1, (HEIGHT, 2 * HEIGHT)))


def shrink(environment: torch.Tensor, height: int) -> torch.Tensor:
    """The average over texels of (height, 2 height, 3), by solid angle."""
    rows = environment.shape[0]
    weights = torch.from_numpy(panorama.texel_solid_angles(rows)).to(environment)[:, None, None]
    total = torch.from_numpy(panorama.texel_solid_angles(height)).to(environment)[:, None, None]
    blocks = (environment * weights).unflatten(0, (height, -1)).unflatten(2, (2 * height, -1))
    return blocks.sum((1, 3)) / total


@lru_cache(maxsize=1)
def _matrices(device: torch.device) -> torch.Tensor:
    directions = texel_directions(HEIGHT, torch.float64).flatten(0, 1)
    cosine = (directions @ directions.T).clamp_min(0.0)
    angles = torch.from_numpy(panorama.texel_solid_angles(HEIGHT)).repeat_interleave(2 * HEIGHT)
    lobes = torch.stack([cosine.pow(exponent) for exponent in SHININESS]) * angles
    return (lobes / lobes.sum(-1, keepdim=True)).to(device, torch.float32)


def averaged(environment: torch.Tensor) -> torch.Tensor:
    """The panorama averaged down to the map's grid, then one matrix per lobe."""
    lobes = _matrices(environment.device) @ shrink(environment, HEIGHT).flatten(0, 1)
    return lobes.mT.unflatten(-1, (HEIGHT, 2 * HEIGHT))


def _harmonics_at(height: int) -> torch.Tensor:
    """(harmonic, texel) real spherical harmonics up to DEGREE, float32."""
    z = panorama.texel_directions(height)[:, 0, 2]
    turns = (np.arange(2 * height) + 0.5) * (np.pi / height)
    table = []
    for n in range(DEGREE + 1):
        for m in range(n + 1):
            scale = (2 * n + 1) / (4 * math.pi) * math.exp(math.lgamma(n - m + 1))
            scale *= (2 if m else 1) * math.exp(-math.lgamma(n + m + 1))
            rows = math.sqrt(scale) * lpmv(m, n, z)[:, None]
            table.append(rows * np.cos(m * turns))
            if m:
                table.append(rows * np.sin(m * turns))
    return torch.from_numpy(np.stack(table).astype(np.float32)).flatten(1)


@lru_cache(maxsize=1)
def _harmonics(device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Projection (harmonic, texel) and evaluation (4 texels of the map, harmonic)."""
    angles = torch.from_numpy(panorama.texel_solid_angles(MIDDLE)).repeat_interleave(2 * MIDDLE)
    zonal = torch.zeros(len(SHININESS), DEGREE + 1)
    for lobe, s in enumerate(SHININESS):
        zonal[lobe, :2] = 2.0 * math.pi * torch.tensor([1 / (s + 1), 1 / (s + 2)])
        for n in range(2, DEGREE + 1):
            zonal[lobe, n] = zonal[lobe, n - 2] * (s - n + 2) / (s + n + 1)
    degrees = torch.arange(DEGREE + 1)
    scaled = zonal[:, degrees.repeat_interleave(2 * degrees + 1), None] * _harmonics_at(HEIGHT)
    projection = _harmonics_at(MIDDLE) * angles.float()
    return projection.to(device), scaled.mT.flatten(0, 1).contiguous().to(device)


def harmonics(environment: torch.Tensor) -> torch.Tensor:
    """Spherical harmonics by two matrices: project, scale by degree, evaluate."""
    projection, evaluation = _harmonics(environment.device)
    lobes = evaluation @ (projection @ shrink(environment, MIDDLE).flatten(0, 1))
    lobes = lobes.unflatten(0, (len(SHININESS), HEIGHT, 2 * HEIGHT)).movedim(-1, 1)
    return normalise(lobes).clamp_min(0.0)


METHODS: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
    "integral at full resolution": integral,
    f"averaged to {HEIGHT}×{2 * HEIGHT}, a matrix per lobe": averaged,
    f"averaged to {MIDDLE}×{2 * MIDDLE}, matrix of harmonics to degree {DEGREE}": harmonics,
    "`bake`": ours,
}


def seconds_of(call: Callable[[], object], device: str) -> float:
    """Seconds of one call; on a CPU its own, so that others do not count."""
    with report.clock(device) as took:
        call()
    return took.cpu_seconds if device == "cpu" else took.seconds


def measure(method: str, name: str, device: str) -> tuple[float, float, float, np.ndarray]:
    """First and median later seconds, MB, and the maps of one panorama; in a fresh process."""
    torch.set_num_threads(1)
    environment = bundled()[list(BUNDLED).index(name)].to(device)
    found = []

    def call() -> None:
        found[:] = [METHODS[method](environment)]

    before = report.resident() if device == "cpu" else report.peak(device)
    first = seconds_of(call, device)
    later = [first] if first > 5.0 else [seconds_of(call, device) for _ in range(15)]
    size = report.peak(device) - before
    return first, float(np.median(later)), size, found[0].cpu().numpy()


def costs(device: str) -> list[list[float]]:
    """Milliseconds per environment, by height of the maps (rows) and batch and rotation."""
    torch.set_num_threads(1)
    environments = torch.rand(16, 512, 1024, 3, device=device)
    turned = torch.eye(3, device=device)
    table = []
    for height in (16, 32, 64):
        calls: list[tuple[int, Callable[[], object]]] = [
            (batch, partial(bake, environments[:batch], height)) for batch in (1, 4, 16)
        ]
        calls.append((1, partial(bake, environments[0], height, turned)))
        row = []
        for batch, call in calls:
            seconds_of(call, device)
            seconds = np.median([seconds_of(call, device) for _ in range(7)])
            row.append(1e3 * float(seconds) / batch)
        table.append(row)
    return table


def error(found: torch.Tensor, truth: torch.Tensor) -> list[tuple[float, float]]:
    """Per lobe of (4, 3, ...): relative L2, and the largest error by the peak, in percent."""
    difference = (found.double().cpu() - truth.cpu()).flatten(1)
    whole = truth.cpu().flatten(1)
    relative = difference.norm(dim=1) / whole.norm(dim=1)
    largest = difference.abs().amax(1) / whole.amax(1)
    return [(100 * float(r), 100 * float(m)) for r, m in zip(relative, largest, strict=True)]


def cells(errors: list[tuple[float, float]]) -> list[str]:
    return [f"{relative:.2g} ({largest:.2g})" for relative, largest in errors]


def truth_at(environments: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """The integrals as normalised maps (panorama, 4, 3, point)."""
    lobes = [brute_force(environments, directions, exponent) for exponent in SHININESS]
    return normalise(torch.stack(lobes, dim=1).mT[..., None]).squeeze(-1)


def exactness(environments: torch.Tensor) -> torch.Tensor:
    """Prints the errors of maps; returns the truth at their texels."""
    texels = texel_directions(HEIGHT, torch.float64, environments.device).flatten(0, 1)
    truths = truth_at(environments, texels)
    for title, method in (("`bake`", ours), ("averaged, a matrix per lobe", averaged)):
        report.table(
            [f"{title}, {HEIGHT}×{2 * HEIGHT}", "peak radiance", *LOBES],
            (
                [
                    name,
                    f"{float(environment.max()):.0f}",
                    *cells(error(method(environment).flatten(-2), truth)),
                ]
                for name, environment, truth in zip(BUNDLED, environments, truths, strict=True)
            ),
        )

    matrix, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    rotation = torch.from_numpy(matrix * np.linalg.det(matrix)).to(environments.device)
    turned = bake(environments, HEIGHT, rotation)[:, 1:].flatten(-2)[..., ::4]
    truths_turned = truth_at(environments, texels[::4] @ rotation.T)
    report.table(
        ["`bake` into another frame, every fourth column", *LOBES],
        (
            [name, *cells(error(maps, truth))]
            for name, maps, truth in zip(BUNDLED, turned, truths_turned, strict=True)
        ),
    )
    return truths


def look_ups(environments: torch.Tensor, peaks: torch.Tensor) -> None:
    """Prints the errors of `sample` between texels; peaks (panorama, lobe)."""
    directions = np.random.default_rng(1).normal(size=(256, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    anywhere = torch.from_numpy(directions).to(environments.device)
    truth = truth_at(environments, anywhere)

    def row(height: int) -> list[str]:
        maps = bake(environments, height)[:, 1:].flatten(1, 2)
        found = sample(maps, anywhere).mT.unflatten(1, (len(SHININESS), 3))
        worst = ((found.double() - truth).abs().amax((2, 3)) / peaks).mean(0)
        return [f"{height}×{2 * height}", *(f"{100 * e:.2g}" for e in worst)]

    title = "largest error of `sample` at 256 directions by the map's peak, mean of 8"
    report.table([title, *LOBES], map(row, (16, 32, 64)))


def speed(name: str, truth: torch.Tensor, device: str) -> None:
    """Prints what every method takes, and what `bake` takes by height and batch."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as workers:
        columns = ("first, s", "later, ms", "times faster", "MB", *LOBES)

        def rows() -> Iterator[list[str]]:
            slowest = None
            for method in METHODS:
                first, later, size, maps = workers.submit(measure, method, name, device).result()
                slowest = slowest or later
                figures = (f"{first:.2f}", f"{1e3 * later:.1f}", f"{slowest / later:.0f}")
                errors = cells(error(torch.from_numpy(maps).flatten(-2), truth))
                yield [method, *figures, f"{size:.0f}", *errors]

        report.table([f"{name}, 512×1024 to {HEIGHT}×{2 * HEIGHT}", *columns], rows())
        found = zip((16, 32, 64), workers.submit(costs, device).result(), strict=True)
        report.table(
            ["ms per panorama", "batch 1", "batch 4", "batch 16", "batch 1, other frame"],
            [[f"{height}×{2 * height}", *(f"{ms:.1f}" for ms in row)] for height, row in found],
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument(
        "--panorama", choices=sorted(BUNDLED), default="city", help="that times are taken with"
    )
    options = parser.parse_args()
    if options.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device: cuda: PyTorch finds no CUDA device here; use --device cpu")
    environments = bundled().to(options.device)
    truths = exactness(environments)
    look_ups(environments, truths.amax((2, 3)))
    speed(options.panorama, truths[list(BUNDLED).index(options.panorama)], options.device)


if __name__ == "__main__":
    main()
