"""One pose under all lights of its subject: what depends on light, and what all lights share.

Guides and coverage are means over the samples of all lights and are denoised once a shot; only
colour is denoised light by light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from assets_procedural.conventions.camera import Camera
from synthgen.planning.plan import EnvironmentUse, ShotPlan
from synthgen.stage import scene
from synthgen.stage.light.denoising import Denoiser


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
    samples: int,
    f_number: float | None,
    denoiser: Denoiser,
) -> Mapping[str, Lit]:
    """The posed figure under each environment in turn; by the keys of the shots.

    `folder` holds `<id>.exr`; `samples` are of every picture.
    """
    scene.set_mode("beauty", samples)
    light: dict[str, list[np.ndarray]] = {view.shot.key: [] for view in views}
    shared: dict[str, np.ndarray] = {}
    for use in environments:
        scene.set_light(folder / f"{use.id}.exr", use.rotation)
        for shot, camera, focus in views:
            scene.set_camera(camera)
            scene.set_focus(f_number, focus)
            beauty = scene.shoot_beauty((use.seed + shot.seed) % 2**31, camera)
            light[shot.key].append(beauty.light)
            both = np.concatenate([beauty.surface, beauty.guides], axis=-1) / len(environments)
            shared[shot.key] = shared[shot.key] + both if shot.key in shared else both
    return {
        key: denoised(light.pop(key), both[..., :7], both[..., 7:], denoiser)
        for key, both in shared.items()
    }


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
