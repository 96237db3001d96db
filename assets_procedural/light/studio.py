"""Procedural studio light: `studio(parameters)` is pure, `studio_rand(rng)` draws the parameters.

A set-up is a dim room, a backdrop with a gradient behind the subject (+Y) and softboxes at
positions given in the subject's frame: azimuth 0 is straight ahead of the face (-Y), positive
towards the subject's left (+X). Everything is at infinity, as in any panorama.
"""

from __future__ import annotations

import warnings

import numpy as np
from pydantic import Field

from assets_procedural.conventions.panorama import shrink, texel_directions, texel_solid_angles
from assets_procedural.mesh.vectors import arctan2
from assets_procedural.settings import Settings

Colour = tuple[float, float, float]

WHITE_KELVIN = 5300.0  # the camera's white balance: light of this temperature is neutral


class Softbox(Settings):
    """A rectangular light. Angles in degrees."""

    azimuth: float
    elevation: float = Field(ge=-90.0, le=90.0)
    width: float = Field(gt=0.0, le=140.0)
    """Full angular width, degrees."""
    height: float = Field(gt=0.0, le=140.0)
    """Full angular height, degrees."""
    roll: float = 0.0
    irradiance: float = Field(ge=0.0)
    """On a surface that faces the light; the key light's is 1."""
    kelvin: float = Field(default=5600.0, ge=1700.0, le=20_000.0)
    edge: float = Field(default=0.15, ge=0.01, le=1.0)
    """Share of the half width over which the light falls off."""


class StudioParameters(Settings):
    """Radiance is relative to a key light that gives irradiance 1."""

    lights: tuple[Softbox, ...]
    backdrop: Colour = (0.2, 0.2, 0.2)
    """Reflectance of the backdrop."""
    backdrop_light: float = Field(default=0.5, ge=0.0)
    """Irradiance at the middle of the backdrop."""
    vignette: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of light lost towards the backdrop's edge."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Brightest place of the backdrop: azimuth off +Y towards +X, and elevation, degrees."""
    room: Colour = (0.02, 0.02, 0.02)
    """Radiance of walls and ceiling."""
    floor: Colour = (0.1, 0.1, 0.1)
    """Reflectance of the floor."""


def studio_rand(rng: np.random.Generator) -> StudioParameters:
    """Draw a set-up: key, usually a fill, often one or two rims, rarely a top light."""
    side = float(rng.choice([-1.0, 1.0]))
    kelvin = float(rng.normal(5300.0, 350.0)) if rng.random() < 0.7 else rng.uniform(2900.0, 7500.0)
    lights = [
        _softbox(rng, side * rng.uniform(15.0, 75.0), rng.uniform(8.0, 50.0), (14, 75), 1.0, kelvin)
    ]
    if rng.random() < 0.8:
        ratio = float(2.0 ** rng.uniform(-3.3, -0.5))
        azimuth = -side * rng.uniform(15.0, 80.0)
        tone = kelvin + float(rng.normal(0.0, 400.0))
        lights.append(_softbox(rng, azimuth, rng.uniform(-10.0, 30.0), (40, 100), ratio, tone))
    rims = int(rng.choice([0, 1, 2], p=[0.35, 0.4, 0.25]))
    for k in range(rims):
        azimuth = (-side if k == 0 else side) * rng.uniform(120.0, 165.0)
        tone = float(rng.uniform(2800.0, 9000.0)) if rng.random() < 0.25 else kelvin
        strength = float(2.0 ** rng.uniform(-1.5, 1.0))
        lights.append(_softbox(rng, azimuth, rng.uniform(5.0, 45.0), (8, 30), strength, tone))
    if rng.random() < 0.25:
        strength = float(rng.uniform(0.1, 0.5))
        lights.append(_softbox(rng, 0.0, rng.uniform(65.0, 85.0), (25, 70), strength, kelvin))
    value = float(rng.choice([rng.uniform(0.02, 0.1), rng.uniform(0.15, 0.45), 0.8]))
    chroma = rng.normal(0.0, 0.25 if rng.random() < 0.4 else 0.03, 3)
    backdrop = np.clip(value * np.exp(chroma - chroma.mean()), 0.01, 0.9)
    wall = float(10.0 ** rng.uniform(-2.4, -1.0)) * rng.normal(1.0, 0.06, 3)
    return StudioParameters(
        lights=tuple(lights),
        backdrop=_colour(backdrop),
        backdrop_light=round(float(rng.uniform(0.2, 1.4)), 4),
        vignette=round(float(rng.beta(1.5, 1.5)), 4),
        centre=(round(float(rng.normal(0.0, 15.0)), 3), round(float(rng.normal(-2.0, 10.0)), 3)),
        room=_colour(np.clip(wall, 0.001, None)),
        floor=_colour(rng.uniform(0.03, 0.4) * np.clip(rng.normal(1.0, 0.05, 3), 0.8, 1.2)),
    )


def _softbox(
    rng: np.random.Generator,
    azimuth: float,
    elevation: float,
    size: tuple[float, float],
    irradiance: float,
    kelvin: float,
) -> Softbox:
    width = float(np.exp(rng.uniform(*np.log(size))))
    aspect = float(np.exp(rng.normal(0.0, 0.35)))
    return Softbox(
        azimuth=round(float(azimuth), 3),
        elevation=round(float(elevation), 3),
        width=round(min(width, 110.0), 3),
        height=round(float(np.clip(width * aspect, 6.0, 110.0)), 3),
        roll=round(float(rng.normal(0.0, 12.0)), 3),
        irradiance=round(irradiance, 4),
        kelvin=round(float(np.clip(kelvin, 1700.0, 20_000.0)), 1),
        edge=round(float(rng.uniform(0.05, 0.5)), 3),
    )


def _colour(value: np.ndarray) -> Colour:
    red, green, blue = (round(float(c), 4) for c in value)
    return red, green, blue


def studio(parameters: StudioParameters, height: int = 512) -> np.ndarray:
    """Panorama (height, 2 height, 3) float32 of a studio."""
    p = parameters
    direction = texel_directions(2 * height)  # twice as fine, averaged at the end
    z = direction[..., 2]
    radiance = np.broadcast_to(np.array(p.room), direction.shape) * (1.0 + 0.4 * z[..., None])
    floor_light = 0.3 + 0.4 * sum(light.irradiance for light in p.lights) / len(p.lights)
    below = _step(-z - 0.28, 0.05)[..., None]
    radiance = radiance * (1.0 - below) + below * np.array(p.floor) * floor_light / np.pi
    radiance = _add_backdrop(radiance, direction, p)
    solid = texel_solid_angles(2 * height)[:, None]
    white = blackbody(WHITE_KELVIN)
    for light in p.lights:
        shape, cosine = _softbox_shape(direction, light)
        level = light.irradiance / float((shape * cosine * solid).sum())
        colour = blackbody(light.kelvin) / white
        radiance = radiance * (1.0 - shape[..., None]) + shape[..., None] * (level * colour)
    return shrink(radiance, 2).astype(np.float32)


def _step(value: np.ndarray, width: float) -> np.ndarray:
    t = np.clip(value / width + 0.5, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _add_backdrop(radiance: np.ndarray, direction: np.ndarray, p: StudioParameters) -> np.ndarray:
    # A roll of paper 220 degrees wide, so that cameras to either side still see it.
    azimuth = np.degrees(arctan2(direction[..., 0], direction[..., 1]))
    elevation = np.degrees(np.arcsin(np.clip(direction[..., 2], -1.0, 1.0)))
    inside = _step(110.0 - np.abs(azimuth), 12.0) * _step(52.0 - elevation, 14.0)
    inside *= _step(elevation + 70.0, 40.0)
    away = ((azimuth - p.centre[0]) / 55.0) ** 2 + ((elevation - p.centre[1]) / 35.0) ** 2
    light = p.backdrop_light * (1.0 - p.vignette * (1.0 - np.exp(-away)))
    paper = np.array(p.backdrop) * light[..., None] / np.pi
    return radiance * (1.0 - inside[..., None]) + paper * inside[..., None]


def _softbox_shape(direction: np.ndarray, light: Softbox) -> tuple[np.ndarray, np.ndarray]:
    """Brightness in [0, 1] of each direction, and its cosine with the light's axis."""
    azimuth, elevation, roll = np.radians([light.azimuth, light.elevation, light.roll])
    axis = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.cross(right, axis)
    up *= np.sign(up[2]) if up[2] else 1.0
    across = np.cos(roll) * right + np.sin(roll) * up
    along = np.cos(roll) * up - np.sin(roll) * right
    cosine = np.clip(direction @ axis, 0.0, None)
    depth = np.maximum(cosine, 1e-6)
    x = np.abs(direction @ across) / depth / np.tan(np.radians(light.width / 2.0))
    y = np.abs(direction @ along) / depth / np.tan(np.radians(light.height / 2.0))
    shape = _step(1.0 - x, light.edge) * _step(1.0 - y, light.edge) * (cosine > 0.0)
    # Brighter in the middle, like a lamp behind a diffuser.
    return shape * (1.0 - 0.25 * np.clip((x**2 + y**2) / 2.0, 0.0, 1.0)), cosine


def blackbody(kelvin: float) -> np.ndarray:
    """(3,) linear Rec.709 colour of a black body with luminance 1; 6500 K is about white.

    Planckian locus of Kang et al. (2002), 1667 to 25000 K.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns about missing plotting libraries
        import colour  # here: it takes a second, and only studios need it

    xyz = colour.xy_to_XYZ(colour.temperature.CCT_to_xy_Kang2002(kelvin))
    rgb = colour.XYZ_to_RGB(xyz, colour.RGB_COLOURSPACES["sRGB"])
    return np.clip(rgb, 0.0, None)
