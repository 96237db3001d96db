"""One pose under all lights of its subject: what depends on light, and what all lights share.

Each environment has a pass of its own, or few passes serve them all (`basis_samples`). Guides and
coverage are means over the samples of all lights and are denoised once a shot; only colour is
denoised light by light.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from assets_procedural.conventions.camera import Camera
from synthgen.planning.job import JobSpec
from synthgen.planning.light_basis import basis_samples, groups
from synthgen.planning.plan import EnvironmentUse, ShotPlan
from synthgen.stage import scene
from synthgen.stage.light.denoising import Denoiser
from synthgen.stage.light.dome import set_dome
from synthgen.stage.light.patches import basis

_PART = 1 << 17
"""Pixels of a picture that are rendered at once: each takes 2.5 kB per copy of all lights."""


class View(NamedTuple):
    """How a shot of a pose is taken."""

    shot: ShotPlan
    camera: Camera
    focus: float
    """Planar distance in metres of what is in focus."""


class Lit(NamedTuple):
    """A shot under all lights of its subject."""

    light: list[np.ndarray]
    """(H, W, 3) each: linear Rec.709, premultiplied, denoised, finite in half."""
    coverage: np.ndarray
    """(H, W) in [0, 1], denoised."""
    surface: np.ndarray
    """(H, W, 7) as in `scene.Beauty`, with its noise."""


def shoot(
    views: Sequence[View],
    environments: Sequence[EnvironmentUse],
    folder: Path,
    job: JobSpec,
    denoiser: Denoiser,
) -> Mapping[str, Lit]:
    """The posed figure under all environments; by the keys of the shots.

    `folder` holds `<id>.exr`.
    """
    taken: dict[str, list[scene.Beauty]] = {view.shot.key: [] for view in views}
    samples = basis_samples(job, len(environments))
    scene.set_mode("beauty", samples or job.samples)
    for group in [[use] for use in environments] if samples is None else groups(environments):
        if samples is None:
            scene.set_light(folder / f"{group[0].id}.exr", group[0].rotation)
            weights, parts = None, [None]
        else:
            lights = basis(group, folder)
            names = set_dome(lights)
            weights = dict(zip(names, lights.weights.swapaxes(0, 1), strict=True))
            parts = _parts(job.resolution)
        for shot, camera, focus in views:
            scene.set_camera(camera)
            scene.set_focus(job.lens.f_number, focus)
            seed = (group[0].seed + shot.seed) % 2**31
            pieces = []
            for rows in parts:
                scene.set_part(rows)
                pieces.append(scene.shoot_beauty(seed, camera, weights))
            planes = [np.concatenate(each, axis=-3) for each in zip(*pieces, strict=True)]
            taken[shot.key].append(scene.Beauty(*planes))
        scene.set_part(None)
    return {view.shot.key: _lit(taken.pop(view.shot.key), denoiser) for view in views}


def _parts(resolution: int) -> Sequence[tuple[int, int]]:
    """Rows of a picture that are rendered together, so that all lights' layers fit in memory."""
    count = math.ceil(resolution**2 / _PART)
    edges = [round(i * resolution / count) for i in range(count + 1)]
    return list(itertools.pairwise(edges))


def _lit(seen: Sequence[scene.Beauty], denoiser: Denoiser) -> Lit:
    light = [each for beauty in seen for each in beauty.light]
    surface = np.mean([beauty.surface for beauty in seen], axis=0)
    guides = np.mean([beauty.guides for beauty in seen], axis=0)
    return denoised(light, surface, guides, denoiser)


def denoised(
    light: Sequence[np.ndarray], surface: np.ndarray, guides: np.ndarray, denoiser: Denoiser
) -> Lit:
    """A shot without noise, from its pictures and the means of what they share."""
    albedo = denoiser.guide("albedo", guides[..., :3])
    normal = denoiser.guide("normal", guides[..., 3:])
    return Lit(
        [np.clip(denoiser.light(each, albedo, normal), 0, 65000) for each in light],
        denoiser.coverage(surface[..., 6]),
        surface,
    )
