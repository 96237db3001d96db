"""The albedo of an eye's front as one picture: pupil, iris, limbus and sclera with its vessels."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from assets_procedural.mesh.vectors import arctan2, smoothstep
from assets_procedural.person import Eyes

SIZE = 512
# The disc of the texture reaches this angle from the optic axis (radians); beyond, it clamps.
_RIM = np.radians(100.0)
# Gives the iris more pixels than an equidistant map would.
_POWER = 0.75


def texture_radius(theta: np.ndarray) -> np.ndarray:
    """Radius in the texture's disc, in [0, 1], of angles from the optic axis (radians)."""
    return np.clip(theta / _RIM, 0, 1) ** _POWER


def eye_texture(
    eyes: Eyes, limbus_angle: float, pupil: float, rng: np.random.Generator
) -> np.ndarray:
    """(SIZE, SIZE, 3) float32 linear Rec.709 albedo; row 0 is the top of the eye.

    `limbus_angle` is the iris's edge in radians from the optic axis, `pupil` the pupil's radius
    over the iris's. Column 0 is the nasal side of a left eye.
    """
    axis = (np.arange(SIZE) + 0.5) / SIZE * 2 - 1
    x, z = np.meshgrid(axis, -axis)
    theta = _RIM * np.minimum(np.hypot(x, z), 1.2) ** (1 / _POWER)
    phi = arctan2(z, x)
    # Distance from the optic axis over the iris's radius, as seen from the front.
    radius = np.sin(np.minimum(theta, np.pi / 2)) / np.sin(limbus_angle)
    radius = np.where(theta > np.pi / 2, 1 / np.sin(limbus_angle), radius)

    iris = _iris(eyes, radius, phi, pupil, rng)
    sclera = _sclera(eyes, theta, x, z, limbus_angle, rng)
    wobble = 0.012 * _angular_noise(rng, phi, 6.0)
    # The limbus is a soft transition: wider where the sclera overlaps the iris (above and below).
    softness = 0.1 + 0.05 * eyes.limbus + 0.04 * np.abs(np.sin(phi))
    edge = smoothstep(0, 1, (radius + wobble - 1.0) / softness + 0.5)[..., None]
    picture = iris * (1 - edge) + sclera * edge
    halo = eyes.limbus * 0.35 * np.exp(-(((radius - 1.05) / 0.09) ** 2))
    picture *= 1 - halo[..., None] * np.array([0.6, 0.7, 0.6])
    return picture.astype(np.float32)


def _iris(
    eyes: Eyes, radius: np.ndarray, phi: np.ndarray, pupil: float, rng: np.random.Generator
) -> np.ndarray:
    base = np.array(eyes.iris)
    share = np.clip((radius - pupil) / (1 - pupil), 0, 1)
    # Fibres run outwards and meander a little, at two scales.
    wind = 0.1 * _angular_noise(rng, phi, 5.0) * share
    coarse = _streaks(rng, phi + wind, share, 40.0)
    fine = _streaks(rng, phi + 0.5 * wind, share, 110.0)
    fibre = np.clip(0.5 + 0.27 * coarse + 0.22 * fine, 0, 1.3)
    collarette = 0.32 + 0.05 * _angular_noise(rng, phi, 14.0)
    ridge = np.exp(-(((share - collarette) / 0.09) ** 2))
    pupillary = smoothstep(0, 1, (collarette - share) / 0.12 + 0.5)
    # Small crypts: dark gaps just outside the collarette.
    crypts = np.clip(_streaks(rng, phi, 0.35 * share, 22.0) - 0.9, 0, 1)
    crypts = crypts * np.exp(-(((share - 0.5) / 0.14) ** 2))

    value = 0.45 + 0.95 * fibre + 0.45 * ridge - 0.7 * crypts
    value *= 1 - 0.25 * pupillary
    colour = base * np.clip(value, 0.12, 2.2)[..., None]
    # Pigment sits around the pupil: brown in light irides (central heterochromia).
    lightness = float(base.max())
    brown = np.array([0.20, 0.105, 0.04]) * (0.4 + lightness * 2.5)
    inner = pupillary * np.clip(0.25 + 0.5 * fibre, 0, 1) * min(0.2 + 2.0 * lightness, 0.65)
    colour = colour * (1 - inner[..., None]) + brown * value[..., None] * inner[..., None]
    ring = eyes.limbus * smoothstep(0, 1, (share - 0.72) / 0.28) ** 1.5
    colour *= 1 - 0.85 * ring[..., None]
    colour *= (1 - 0.55 * np.exp(-((share / 0.05) ** 2)))[..., None]
    hole = smoothstep(0, 1, (radius - pupil * 0.98) / (0.04 * pupil + 0.012) + 0.5)
    return np.clip(colour, 0, 0.8) * hole[..., None] + 0.002


def _sclera(
    eyes: Eyes,
    theta: np.ndarray,
    x: np.ndarray,
    z: np.ndarray,
    limbus_angle: float,
    rng: np.random.Generator,
) -> np.ndarray:
    white = np.array([0.53, 0.485, 0.45])
    outward = np.clip((theta - limbus_angle) / 0.9, 0, 1)
    pink = np.array([0.52, 0.33, 0.28])
    blush = (0.25 + 0.5 * eyes.redness) * outward**1.2
    # Conjunctiva is pinker in the corners than above and below.
    blush = blush * (0.35 + 0.65 * np.abs(x) / np.maximum(np.hypot(x, z), 1e-6))
    colour = white * (1 - blush[..., None]) + pink * blush[..., None]
    vessels = _vessels(eyes.redness, limbus_angle, rng) * (0.35 + 0.65 * eyes.redness)
    vessels = np.clip(vessels, 0, 0.8)[..., None]
    return colour * (1 - vessels) + np.array([0.48, 0.09, 0.07]) * vessels


def _vessels(redness: float, limbus_angle: float, rng: np.random.Generator) -> np.ndarray:
    """Coverage (SIZE, SIZE) of winding vessels that thin out from the corners to the limbus."""
    cover = np.zeros((SIZE, SIZE))
    start, end = texture_radius(np.array([np.radians(85.0), limbus_angle * 1.12]))
    for _ in range(14 + int(30 * redness)):
        side = np.pi if rng.random() < 0.5 else 0.0
        angle = side + rng.normal(0, 0.42)
        reach = rng.uniform(0.35, 1.0)
        steps = 150
        along = np.linspace(0, reach, steps)
        drift = gaussian_filter1d(rng.normal(0, 1, steps), 9, mode="nearest") * 0.28
        bends = gaussian_filter1d(rng.normal(0, 1, steps), 3, mode="nearest") * 0.05
        r = start + (end - start) * along
        a = angle + drift + bends + rng.normal(0, 0.18) * along
        width = rng.uniform(0.6, 1.3) * (1 - 0.6 * along)
        strength = rng.uniform(0.25, 0.75) * (1 - along / reach) ** 0.6
        column = (0.5 + 0.5 * r * np.cos(a)) * SIZE - 0.5
        row = (0.5 - 0.5 * r * np.sin(a)) * SIZE - 0.5
        _stamp(cover, row, column, width, strength)
    return cover


def _stamp(
    cover: np.ndarray, row: np.ndarray, column: np.ndarray, width: np.ndarray, strength: np.ndarray
) -> None:
    """Draw a line of round dots of Gaussian profile, keeping the strongest at each pixel."""
    offset = np.arange(-3, 4)
    dr, dc = np.meshgrid(offset, offset, indexing="ij")
    r0, c0 = np.rint(row).astype(int), np.rint(column).astype(int)
    rows = np.clip(r0[:, None] + dr.ravel(), 0, SIZE - 1)
    columns = np.clip(c0[:, None] + dc.ravel(), 0, SIZE - 1)
    distance = (rows - row[:, None]) ** 2 + (columns - column[:, None]) ** 2
    value = strength[:, None] * np.exp(-distance / (2 * width[:, None] ** 2))
    np.maximum.at(cover, (rows.ravel(), columns.ravel()), value.ravel())


def _angular_noise(rng: np.random.Generator, phi: np.ndarray, frequency: float) -> np.ndarray:
    """Periodic noise of unit variance around the axis."""
    count = 1024
    sigma = count / (2 * np.pi * frequency)
    ring = gaussian_filter1d(rng.normal(size=count), sigma, mode="wrap")
    ring /= max(float(ring.std()), 1e-9)
    return np.interp(
        phi % (2 * np.pi), np.arange(count) * 2 * np.pi / count, ring, period=2 * np.pi
    )


def _streaks(
    rng: np.random.Generator, phi: np.ndarray, share: np.ndarray, frequency: float
) -> np.ndarray:
    """Angular noise that changes from the pupil to the limbus: fibres that fork and end."""
    levels = [_angular_noise(rng, phi, frequency) for _ in range(4)]
    position = np.clip(share, 0, 1) * (len(levels) - 1)
    result = np.zeros_like(phi)
    for k, level in enumerate(levels):
        result += level * np.clip(1 - np.abs(position - k), 0, 1)
    return result
