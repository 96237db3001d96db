"""From linear light to the stored picture: metering, what is behind the subject, the transform."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from assets_procedural.conventions.camera import SENSOR_MM, Camera
from assets_procedural.conventions.colour import (
    LUMINANCE,
    display,
    srgb_decode,
    srgb_encode,
    to_bytes,
)
from assets_procedural.conventions.parts import Part
from assets_procedural.light.backdrop import backdrop, blur_radius
from synthgen.planning.job import LensSettings
from synthgen.stage.lens import finish

# What a face of medium albedo is exposed to, linear, and how far the meter follows dark skin: 1
# would make all skins equally bright, 0 would meter the incident light alone.
_FACE_LEVEL = 0.29
_MEDIUM_ALBEDO = 0.40
_FOLLOW = 0.38
_BRIGHT = 1.2  # linear, of a background: brighter ones are metered, too
_F_NUMBER = 2.8


def face_exposure(linear: np.ndarray, albedo: np.ndarray, parts: np.ndarray) -> float:
    """The factor that puts the face at its level in one picture.

    `linear` (H, W, 4) and `albedo` (H, W, 3), linear, are premultiplied; `parts` (H, W). The meter
    reads the skin, or all that is there where no skin is seen, weighting all pixels alike up to
    their 90th percentile, so that highlights do not count.
    """
    face = np.isin(parts, (Part.SKIN, Part.NOSE))
    if face.sum() < 16:
        face = parts > 0
    light = linear[..., :3][face] @ LUMINANCE
    level = float(np.minimum(light, np.percentile(light, 90)).mean())
    reflectance = float((albedo[face] @ LUMINANCE).mean())
    target = _FACE_LEVEL * (max(reflectance, 0.03) / _MEDIUM_ALBEDO) ** (1 - _FOLLOW)
    return target / max(level, 1e-6)


def spared(background: np.ndarray, alpha: np.ndarray) -> float:
    """The factor in [0.84, 1] by which a camera exposes less before a bright background.

    `background` (H, W, 3) is exposed for the face, `alpha` (H, W). Half of the stops that its
    median is above `_BRIGHT` are taken back, a quarter stop at most: the face comes first.
    """
    seen = alpha < 0.5
    level = float(np.median(background[seen] @ LUMINANCE)) if seen.mean() > 0.02 else 0.0
    return float(np.clip(_BRIGHT / max(level, _BRIGHT), 0.7, 1.0) ** 0.5)


def matte(coverage: np.ndarray) -> np.ndarray:
    """Denoised coverage (H, W) with edges as soft as a lens leaves them, in [0, 1]."""
    soft = gaussian_filter(coverage, 0.5, mode="nearest")
    return np.clip(np.where(soft < 1 - 1e-3, soft, coverage), 0, 1)


def mean_surface(values: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Means (H, W, C) of what is covered, from premultiplied `values` and `coverage` (H, W, 1).

    Few samples hit a pixel that is little covered: there its neighbours count, too. 0 where there
    are none.
    """
    reach = (0.6, 0.6, 0)
    several = gaussian_filter(values, reach, mode="nearest")
    share = gaussian_filter(coverage, reach, mode="nearest")
    return np.where(share < 1 - 1e-3, several / np.maximum(share, 1e-6), values)


def behind(panorama: np.ndarray, camera: Camera, rotation: float, distance: float) -> np.ndarray:
    """(H, W, 3) linear radiance of the environment, out of focus behind a subject at `distance`."""
    pixels = camera.pixel_centres()
    rays = camera.unproject(pixels, np.ones(pixels.shape[:2])) - camera.position
    radius = blur_radius(camera.focal_mm, _F_NUMBER, distance, SENSOR_MM, camera.width)
    return backdrop(panorama, rays, rotation, radius)


def develop(
    linear: np.ndarray,
    alpha: np.ndarray,
    exposure: float,
    background: np.ndarray | tuple[float, float, float] | None,
    lens: LensSettings,
    rng: np.random.Generator,
) -> np.ndarray:
    """The display-referred picture: (H, W, 3) uint8, or (H, W, 4) without a `background`.

    `linear` (H, W, 3) premultiplied; `alpha` (H, W) in [0, 1]; `background` is linear radiance
    (H, W, 3) under the same exposure, or one display-referred colour in [0, 1], over which the
    picture is laid. `lens` and `rng`, for its grain, finish a picture of an environment. A
    transparent picture has straight alpha: its colour is the foreground's own.
    """
    light = exposure * linear
    coverage = alpha[..., None]
    straight = light / np.maximum(coverage, 1e-3) * (coverage > 0)
    if background is None:
        return to_bytes(np.concatenate([display(straight), coverage], axis=-1))
    if isinstance(background, tuple):
        # As anyone lays a cut-out over a page: a page is no lamp that shines through hair.
        subject = coverage * srgb_decode(display(straight))
        page = (1 - coverage) * srgb_decode(np.array(background))
        return to_bytes(srgb_encode(subject + page))
    whole = light + (1 - coverage) * exposure * background
    return to_bytes(finish(whole, lens, rng))
