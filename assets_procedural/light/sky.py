"""Procedural daylight: `sky(parameters)` is pure, `sky_rand(rng)` draws the parameters.

The clear sky is single scattering by air, aerosol and ozone (Nishita et al. 1993; coefficients of
Bruneton and Neyret 2008) with a constant share for higher orders. Clouds, ground and a distant
skyline are painted on it and lit consistently. Radiance is relative: the sun above the atmosphere
gives irradiance 20 at normal incidence.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from pydantic import Field

from assets_procedural.conventions.colour import LUMINANCE
from assets_procedural.conventions.panorama import texel_directions, texel_solid_angles
from assets_procedural.mesh.vectors import arctan2
from assets_procedural.settings import Settings

SUN_IRRADIANCE = 20.0
_EARTH, _TOP = 6360.0, 6420.0  # km
_RAYLEIGH = np.array([5.8e-3, 13.5e-3, 33.1e-3])  # 1/km at the ground, scale height 8 km
_MIE = 4.0e-3  # 1/km at turbidity 2, scale height 1.2 km
_OZONE = np.array([0.65e-3, 1.881e-3, 0.085e-3])  # 1/km at 25 km
_MIE_G = 0.76
_ADAPTATION = 0.7  # of a camera's white balance; 1 would make the mean of every scene grey
_HIGHER_ORDERS = 0.35  # of the single scattering source, isotropic

Colour = tuple[float, float, float]


class SkyParameters(Settings):
    """Angles in degrees; colours are linear Rec.709 reflectances; others in [0, 1]."""

    sun_elevation: float = Field(default=35.0, ge=-5.0, le=90.0)
    sun_azimuth: float = 0.0
    turbidity: float = Field(default=2.0, ge=1.0, le=10.0)
    cloud_cover: float = Field(default=0.3, ge=0.0, le=1.0)
    cloud_scale: float = Field(default=0.5, ge=0.0, le=1.0)
    ground: Colour = (0.2, 0.17, 0.12)
    skyline: float = Field(default=0.4, ge=0.0, le=1.0)
    skyline_colour: Colour = (0.06, 0.08, 0.04)
    seed: int = 0


_GROUNDS: tuple[Colour, ...] = (
    (0.09, 0.11, 0.045),  # grass
    (0.30, 0.26, 0.20),  # sand
    (0.18, 0.18, 0.18),  # asphalt
    (0.28, 0.27, 0.25),  # concrete
    (0.16, 0.11, 0.07),  # soil
    (0.75, 0.77, 0.80),  # snow
)
_SKYLINES: tuple[Colour, ...] = (
    (0.05, 0.08, 0.03),  # trees
    (0.03, 0.05, 0.03),  # conifers
    (0.22, 0.17, 0.13),  # brick
    (0.26, 0.26, 0.26),  # concrete
    (0.12, 0.12, 0.15),  # rock
)


def sky_rand(rng: np.random.Generator) -> SkyParameters:
    """Draw a sky: from dusk to noon, clear to overcast, over various grounds."""
    # Low suns are over-represented: they give the most varied light on a face.
    elevation = 3.0 + 67.0 * rng.beta(1.1, 1.7) if rng.random() < 0.88 else rng.uniform(-4.0, 3.0)
    cover = rng.choice([0.0, rng.uniform(0.15, 0.7), rng.uniform(0.75, 1.0)], p=[0.25, 0.45, 0.3])
    tint = rng.normal(1.0, 0.05, (2, 3)) * rng.uniform(0.65, 1.2, (2, 1))
    weights = [0.27, 0.15, 0.2, 0.18, 0.15, 0.05]
    ground = np.array(_GROUNDS[rng.choice(len(_GROUNDS), p=weights)]) * tint[0]
    skyline = np.array(_SKYLINES[rng.integers(len(_SKYLINES))]) * tint[1]
    return SkyParameters(
        sun_elevation=round(float(elevation), 3),
        sun_azimuth=round(float(rng.uniform(-180.0, 180.0)), 3),
        turbidity=round(float(1.5 + 4.5 * rng.beta(1.3, 3.0)), 3),
        cloud_cover=round(float(cover), 3),
        cloud_scale=round(float(rng.random()), 3),
        ground=_reflectance(ground),
        skyline=round(float(rng.beta(1.2, 1.8)), 3),
        skyline_colour=_reflectance(skyline),
        seed=int(rng.integers(2**31)),
    )


def _reflectance(colour: np.ndarray) -> Colour:
    red, green, blue = (round(float(c), 4) for c in np.clip(colour, 0.01, 0.85))
    return red, green, blue


def sky(parameters: SkyParameters, height: int = 512) -> np.ndarray:
    """Panorama (height, 2 height, 3) float32 of a sky over a ground."""
    p = parameters
    direction = texel_directions(height)
    elevation, azimuth = np.radians(p.sun_elevation), np.radians(p.sun_azimuth)
    sun = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    sun_colour = SUN_IRRADIANCE * _transmittance(p.sun_elevation, p.turbidity)
    clear = _clear_sky(direction, azimuth, _scattering_table(p.sun_elevation, p.turbidity))
    solid = texel_solid_angles(height)[:, None]
    up = np.clip(direction[..., 2], 0.0, None)
    ambient = np.einsum("hwc,hw->c", clear, up * solid)
    rng = np.random.default_rng(p.seed)
    clouds = _Noise(rng, 2.1)
    covered, _, shade = _cloud_layer(clouds, direction, sun, p)
    # Light that reaches the ground directly is what the cloud in front of the sun lets through.
    in_front = float(_cloud_layer(clouds, sun[None, None], sun, p)[1][0, 0])
    through = np.exp(-7.0 * in_front) * (1.0 - 0.97 * max(0.0, p.cloud_cover - 0.8) / 0.2)
    total = ambient + sun_colour * max(0.0, float(sun[2]))
    forward = 0.5 + 1.6 * np.clip(direction @ sun, 0.0, 1.0)[..., None] ** 12
    bright = (total / np.pi) * (0.35 + 0.9 * shade[..., None] * forward) + 0.4 * ambient / np.pi
    radiance = clear * (1.0 - covered[..., None]) + bright * covered[..., None]
    ambient = np.einsum("hwc,hw->c", radiance, up * solid)
    radiance = _add_sun(radiance, direction, sun, sun_colour * through, solid)
    radiance = _add_land(radiance, direction, sun, sun_colour * through, ambient, rng, p)
    return _white_balanced(radiance, solid)


def _white_balanced(radiance: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Radiance as a camera records it that has adapted, as most do, to the colour of the light.

    Without it a dusk is pink all over. The luminance of the mean stays as it was.
    """
    mean = np.einsum("hwc,hw->c", radiance, solid)
    gain = (mean @ LUMINANCE / mean) ** _ADAPTATION
    gain *= (mean @ LUMINANCE) / (mean * gain @ LUMINANCE)
    return radiance * gain.astype(radiance.dtype)


def _ray(origin_height: float, sine: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Heights (..., steps) along rays to the top of the atmosphere, and step lengths (...)."""
    radius = _EARTH + origin_height
    length = -radius * sine + np.sqrt((radius * sine) ** 2 + _TOP**2 - radius**2)
    step = length / steps
    t = (np.arange(steps) + 0.5) * step[..., None]
    return np.sqrt(radius**2 + t**2 + 2.0 * radius * t * sine[..., None]) - _EARTH, step


def _optical_depth(height: np.ndarray, turbidity: float) -> np.ndarray:
    """Extinction (..., 3) in 1/km at `height` km."""
    air = np.exp(-height / 8.0)[..., None] * _RAYLEIGH
    aerosol = np.exp(-height / 1.2)[..., None] * (_MIE * 1.11 * turbidity / 2.0)
    return air + aerosol + np.clip(1.0 - np.abs(height - 25.0) / 15.0, 0.0, 1.0)[..., None] * _OZONE


def _transmittance(sun_elevation: float, turbidity: float) -> np.ndarray:
    """(3,) share of sunlight that reaches the ground; fades out below the horizon."""
    sine = np.array(np.sin(np.radians(max(sun_elevation, 0.0))))
    height, step = _ray(0.0, sine, 64)
    depth = (_optical_depth(height, turbidity) * step).sum(axis=0)
    return np.exp(-depth) * np.clip(1.0 + sun_elevation / 1.5, 0.0, 1.0)


@lru_cache(maxsize=4)
def _scattering_table(sun_elevation: float, turbidity: float) -> np.ndarray:
    """(48, 49, 3) radiance of the clear sky: rows by sqrt(elevation), columns by azimuth to sun."""
    elevation = (np.pi / 2) * np.linspace(0.0, 1.0, 48) ** 2
    azimuth = np.linspace(0.0, np.pi, 49)
    sun_sine = np.sin(np.radians(sun_elevation))
    sun_cosine = np.cos(np.radians(sun_elevation))
    sine = np.sin(elevation)[:, None] + 0.0 * azimuth
    cosine = np.cos(elevation)[:, None] * np.cos(azimuth)  # along the sun's azimuth
    mu = sine * sun_sine + cosine * sun_cosine
    steps = 28
    height, step = _ray(0.002, sine, steps)
    extinction = _optical_depth(height, turbidity) * step[..., None, None]
    to_eye = np.exp(-(np.cumsum(extinction, axis=-2) - 0.5 * extinction))
    distance = (np.arange(steps) + 0.5) * step[..., None]
    # Zenith angle of the sun at each sample: the Earth's curvature matters at dusk.
    radius = height + _EARTH
    local_sine = (sun_sine * _EARTH + distance * mu[..., None]) / radius
    tangent = -np.sqrt(np.clip(1.0 - (_EARTH / radius) ** 2, 0.0, None))
    lit = np.clip((local_sine - tangent) / 0.015 + 0.5, 0.0, 1.0)[..., None]
    to_sun = np.zeros((*local_sine.shape, 3))
    chord = -radius * local_sine + np.sqrt(
        np.clip((radius * local_sine) ** 2 + _TOP**2 - radius**2, 0.0, None)
    )
    for k in range(10):
        t = (k + 0.5) / 10 * chord
        h = np.sqrt(radius**2 + t**2 + 2.0 * radius * t * local_sine) - _EARTH
        to_sun += _optical_depth(np.maximum(h, 0.0), turbidity) * (chord / 10)[..., None]
    arriving = np.exp(-to_sun) * lit
    rayleigh = 3.0 / (16.0 * np.pi) * (1.0 + mu**2)
    g = _MIE_G
    mie = (
        3.0 / (8.0 * np.pi) * (1 - g**2) * (1 + mu**2)
        / ((2 + g**2) * (1 + g**2 - 2 * g * mu) ** 1.5)
    )  # fmt: skip
    isotropic = _HIGHER_ORDERS / (4.0 * np.pi)
    air = np.exp(-height / 8.0)[..., None] * _RAYLEIGH
    aerosol = np.exp(-height / 1.2)[..., None] * np.full(3, _MIE * turbidity / 2.0)
    source = (
        air * (rayleigh + isotropic)[..., None, None] + aerosol * (mie + isotropic)[..., None, None]
    )
    scattered = (source * arriving * to_eye).sum(axis=-2) * step[..., None]
    return SUN_IRRADIANCE * scattered + np.array([0.4, 0.6, 1.0]) * 2e-3


def _clear_sky(direction: np.ndarray, sun_azimuth: float, table: np.ndarray) -> np.ndarray:
    from scipy import ndimage  # slow to import, and a plan needs parameters alone

    elevation = np.arcsin(np.clip(direction[..., 2], 0.0, 1.0))
    azimuth = arctan2(direction[..., 1], direction[..., 0]) - sun_azimuth
    azimuth = np.abs((azimuth + np.pi) % (2.0 * np.pi) - np.pi)
    where = np.stack(
        [
            np.sqrt(elevation / (np.pi / 2)) * (table.shape[0] - 1),
            azimuth / np.pi * (table.shape[1] - 1),
        ]
    )
    channels = [
        ndimage.map_coordinates(table[..., c], where, order=1, mode="nearest") for c in range(3)
    ]
    return np.stack(channels, axis=-1)


class _Noise:
    """A periodic tile of fractal noise with spectrum 1 / f^`slope`, mean 0, deviation 1."""

    def __init__(self, rng: np.random.Generator, slope: float, size: int = 512) -> None:
        frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
        frequency[0, 0] = np.inf
        amplitude = (frequency + 1.5 / size) ** (-slope)
        spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * amplitude
        tile = np.fft.irfft2(spectrum, s=(size, size))
        self.tile = ((tile - tile.mean()) / tile.std()).astype(np.float32)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Noise at positions given in tile lengths."""
        from scipy import ndimage

        size = self.tile.shape[0]
        where = np.stack(np.broadcast_arrays(x * size, y * size))
        return ndimage.map_coordinates(self.tile, where, order=1, mode="grid-wrap")


def _cloud_layer(
    noise: _Noise, direction: np.ndarray, sun: np.ndarray, p: SkyParameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coverage in [0, 1], optical thickness >= 0 and sunlit share in [0, 1], each (H, W)."""
    if p.cloud_cover <= 0.0:
        zero = np.zeros(direction.shape[:-1])
        return zero, zero, zero
    scale = 0.05 + 0.13 * p.cloud_scale
    # A curved layer: it stays finite at the horizon.
    z = np.clip(direction[..., 2], 0.0, 1.0)
    reach = scale / (z + 0.12)
    x, y = direction[..., 0] * reach, direction[..., 1] * reach
    threshold = 1.6 - 3.2 * p.cloud_cover
    density = noise(x, y) - threshold
    nearer_sun = noise(x + 0.012 * sun[0], y + 0.012 * sun[1]) - threshold
    thickness = np.clip(density, 0.0, None)
    covered = 1.0 - np.exp(-2.2 * thickness * np.clip(1.5 * density, 0.0, 1.0))
    covered *= np.clip(direction[..., 2] / 0.04, 0.0, 1.0)
    shade = np.exp(-0.55 * thickness) * np.clip(0.75 + 0.5 * (density - nearer_sun), 0.25, 1.3)
    return covered, thickness, np.clip(shade, 0.0, 1.0)


def _add_sun(
    radiance: np.ndarray,
    direction: np.ndarray,
    sun: np.ndarray,
    irradiance: np.ndarray,
    solid: np.ndarray,
) -> np.ndarray:
    """Add the sun's disc, widened to two texels, with exactly its irradiance."""
    radius = max(np.radians(0.27), 1.1 * np.pi / direction.shape[0])
    angle = np.linalg.norm(direction - sun, axis=-1)
    disc = np.clip((radius - angle) / (0.5 * radius) + 0.5, 0.0, 1.0)
    return radiance + disc[..., None] * (irradiance / float((disc * solid).sum()))


def _add_land(
    radiance: np.ndarray,
    direction: np.ndarray,
    sun: np.ndarray,
    sun_irradiance: np.ndarray,
    ambient: np.ndarray,
    rng: np.random.Generator,
    p: SkyParameters,
) -> np.ndarray:
    """Ground below the horizon and a skyline above it, veiled by haze."""
    noise = _Noise(rng, 1.5)
    height = direction.shape[0]
    z = direction[..., 2]
    texel = np.pi / height
    haze = radiance[height // 2 - max(1, height // 64)].mean(axis=0)
    lit = ambient + sun_irradiance * max(0.0, float(sun[2]))
    distance = 1.7 / np.clip(-z, 2e-3, None)  # metres, eyes at 1.7 m
    ground_noise = noise(direction[..., 0] * distance / 40.0, direction[..., 1] * distance / 40.0)
    contrast = 0.22 * np.exp(-distance / 60.0)
    ground = (
        np.array(p.ground)
        * lit
        / np.pi
        * np.clip(1.0 + contrast * ground_noise, 0.2, 2.0)[..., None]
    )
    veil = np.exp(-distance / 500.0)[..., None]
    ground = ground * veil + haze * (1.0 - veil) * 0.8
    below = np.clip(0.5 - z / texel, 0.0, 1.0)[..., None]
    radiance = radiance * (1.0 - below) + ground * below
    # Outline by azimuth on a circle through the noise tile, so that it closes.
    azimuth = arctan2(direction[0, :, 1], direction[0, :, 0])
    outline = noise(0.5 + 0.35 * np.cos(azimuth), 0.5 + 0.35 * np.sin(azimuth))
    top = np.radians(35.0) * p.skyline * np.clip(0.45 + 0.3 * outline, 0.0, 1.3)
    elevation = np.arcsin(np.clip(z, -1.0, 1.0))
    foot = -0.02 - 0.03 * p.skyline
    inside = np.clip((top - elevation) / texel + 0.5, 0.0, 1.0)
    inside *= np.clip((elevation - foot) / texel + 0.5, 0.0, 1.0) * (p.skyline > 0.0)
    facing = np.clip(-(direction[..., 0] * sun[0] + direction[..., 1] * sun[1]), 0.0, None)
    # What faces the viewer is lit by half the sky and by the sun behind the viewer.
    light = 0.5 * ambient + sun_irradiance * (0.1 + 0.9 * facing)[..., None]
    detail = noise(1.6 * azimuth[None] / np.pi, 1.6 * elevation / np.pi) * 0.3
    body = np.array(p.skyline_colour) * light / np.pi * np.clip(1 + detail, 0.25, 2.0)[..., None]
    body = 0.85 * body + 0.15 * haze
    radiance = radiance * (1.0 - inside[..., None]) + body * inside[..., None]
    return np.maximum(radiance, 0.0).astype(np.float32)
