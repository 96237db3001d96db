"""From linear light to the stored picture: metering, what is behind the subject, the transform."""

from __future__ import annotations

import numpy as np

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

# What a face of medium albedo is exposed to, linear, and how far the meter follows dark skin: 1
# would make all skins equally bright, 0 would meter the incident light alone.
_FACE_LEVEL = 0.30
_MEDIUM_ALBEDO = 0.40
_FOLLOW = 0.38
_F_NUMBER = 2.8


def face_exposure(linear: np.ndarray, albedo: np.ndarray, parts: np.ndarray) -> float:
    """The factor that puts the face at its level in one picture.

    `linear` (H, W, 4) premultiplied, `albedo` (H, W, 3) linear, `parts` (H, W). The meter reads the
    skin, or all that is there where no skin is seen, weighting all pixels alike up to their 90th
    percentile, so that highlights do not count.
    """
    face = np.isin(parts, (Part.SKIN, Part.NOSE))
    if face.sum() < 16:
        face = parts > 0
    light = linear[..., :3][face] @ LUMINANCE
    level = float(np.minimum(light, np.percentile(light, 90)).mean())
    reflectance = float((albedo[face] @ LUMINANCE).mean())
    target = _FACE_LEVEL * (max(reflectance, 0.03) / _MEDIUM_ALBEDO) ** (1 - _FOLLOW)
    return target / max(level, 1e-6)


def exposures(
    linear: list[np.ndarray], albedo: np.ndarray, parts: np.ndarray, stops: list[float]
) -> list[float]:
    """One factor per environment: metered on the face, then moved by the job's `stops`."""
    return [
        face_exposure(image, albedo, parts) * 2.0**stop
        for image, stop in zip(linear, stops, strict=True)
    ]


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
) -> np.ndarray:
    """The display-referred picture: (H, W, 3) uint8, or (H, W, 4) without a `background`.

    `linear` (H, W, 3) premultiplied; `alpha` (H, W) in [0, 1]; `background` is linear radiance
    (H, W, 3) under the same exposure, or one display-referred colour in [0, 1], over which the
    picture is laid. A transparent
    picture has straight alpha: its colour is the foreground's own.
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
    return to_bytes(display(light + (1 - coverage) * exposure * background))
