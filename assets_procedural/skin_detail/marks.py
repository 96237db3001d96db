"""Marks on the face: freckles, age spots, moles, blemishes, veins, and the liner of the lids.

Each takes a share of the light (absorbed, linear RGB) over the chart; moles and blemishes also
stand out of the skin.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from assets_procedural.body.head import HeadModel
from assets_procedural.mesh.vectors import smoothstep, way_along
from assets_procedural.person import Person
from assets_procedural.skin_detail import chart

# Absorbed at the middle of a mark, linear RGB.
_FRECKLE = np.array([0.30, 0.50, 0.62], np.float32)
_AGE_SPOT = np.array([0.30, 0.44, 0.52], np.float32)
_MOLE = np.array([0.68, 0.78, 0.82], np.float32)
_BLEMISH = np.array([0.06, 0.36, 0.36], np.float32)
_FLUSH = np.array([0.05, 0.28, 0.25], np.float32)
_TAN = np.array([0.15, 0.21, 0.25], np.float32)
_SCAR = np.array([0.12, 0.20, 0.22], np.float32)
_VEIN = np.array([0.13, 0.055, 0.035], np.float32)
_LINER = np.array([0.90, 0.90, 0.88], np.float32)

# Seen from in front, millimetres: a vein at the temple, and the rims of the lids outwards.
_VEINS = (
    ((56, 738), (58, 745), (57, 751), (60, 758), (58.5, 766)),
    ((57, 751), (53.5, 757), (54, 764), (50, 771)),
)
_UPPER_RIM = ((18.6, 728.6), (22, 731), (27.3, 733.2), (34.9, 734), (40, 732.6), (45, 729.4))
_LOWER_RIM = ((26, 723.4), (31, 722.9), (36, 723.2), (41, 725.2), (44.5, 728))


def marks(person: Person, model: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Absorbed light (H, W, 3) in [0, 1] and relief (H, W), metres, over the chart; float32."""
    skin = person.skin
    rng = np.random.default_rng([skin.seed, 3])
    zone = chart.zones(model)
    light = 1 - skin.melanin
    absorbed = np.zeros((chart.HEIGHT, chart.WIDTH, 3), np.float32)
    relief = np.zeros((chart.HEIGHT, chart.WIDTH), np.float32)
    bare = 1 - zone["lips"]

    if skin.freckles > 0.03:
        sunny = np.clip(zone["cheeks"] + zone["nose"] + 0.25 * zone["forehead"] + 0.06, 0, 1) * bare
        spots = _spots(rng, sunny, int(900 * skin.freckles), (0.5e-3, 1.5e-3), 0.75)
        absorbed += spots[..., None] * (_FRECKLE * np.float32(0.35 + 0.55 * skin.freckles))
    elderly = float(np.clip((person.age_years - 45) / 40, 0, 1))
    if elderly > 0:
        high = (np.clip(zone["forehead"] + 0.6 * zone["cheeks"] + 0.15, 0, 1)) * bare
        count = rng.poisson(14 * elderly)
        absorbed += _spots(rng, high, count, (1.2e-3, 4.5e-3), 0.7)[..., None] * (
            _AGE_SPOT * (0.35 + 0.4 * light)
        )
    anywhere = (0.5 + 0.5 * zone["cheeks"] + 0.4 * zone["neck"]) * bare
    for _ in range(skin.moles):
        radius = float(
            rng.uniform(0.7e-3, 1.3e-3) if rng.random() < 0.8 else rng.uniform(1.3, 2.4) * 1e-3
        )
        mole = _spots(rng, anywhere, 1, (radius, radius), 0.25)
        absorbed += mole[..., None] * (_MOLE * rng.uniform(0.45, 1.0))
        if rng.random() < 0.45:
            relief += 0.5 * radius * gaussian_filter(mole, 1.0)
    oily = np.clip(0.8 * zone["cheeks"] + zone["chin"] + 0.7 * zone["forehead"] + 0.1, 0, 1) * bare
    count = rng.poisson(16 * skin.blemishes**1.3)
    pimples = _spots(rng, oily, count, (0.8e-3, 2.2e-3), 0.5, soft=2.2)
    absorbed += pimples[..., None] * (_BLEMISH * (0.35 + 0.65 * light))
    relief += 0.25e-3 * pimples
    count = rng.poisson(22 * skin.blemishes)
    scars = _spots(rng, oily, count, (0.5e-3, 1.6e-3), 0.6, soft=1.2)
    absorbed += scars[..., None] * _SCAR
    relief -= 0.18e-3 * scars

    # Skin is uneven in few spots of many sizes, not everywhere alike as noise is: blood near the
    # surface about nose, cheeks and chin, pigment wherever the sun has been.
    red = np.clip(zone["cheeks"] + 1.2 * zone["nose"] + 0.8 * zone["chin"] + 0.12, 0, 1) * bare
    brown = np.clip(zone["forehead"] + zone["cheeks"] + 0.3, 0, 1) * bare
    uneven, own = 0.5 + 0.8 * skin.blemishes, np.random.default_rng([skin.seed, 8])
    for where, tone, count in (
        (red, _FLUSH * (0.3 + 0.7 * light), 160),
        (brown, _TAN * (1.2 - 0.5 * light), 120),
    ):
        spots = _spots(own, where, own.poisson(count * uneven), (1.2e-3, 5e-3), 0.9, soft=1.8)
        absorbed += spots[..., None] * tone

    pale = float(smoothstep(0.45, 0.1, np.array(skin.melanin)))
    strength = pale * rng.uniform(0.15, 0.8) * (0.6 + 0.6 * elderly)
    paths = [np.array(vein) + rng.normal(0, 1.0, (len(vein), 2)) for vein in 2 * _VEINS]
    if strength > 0.05:
        mirrored = [path * ([1, 1] if k < len(_VEINS) else [-1, 1]) for k, path in enumerate(paths)]
        absorbed += (strength * _strokes(model, mirrored, 1.1e-3))[..., None] * _VEIN
    if person.makeup.liner > 0:
        upper, lower = (
            _strokes(model, [np.array(rim) * [side, 1] for side in (1, -1)], width)
            for rim, width in ((_UPPER_RIM, 1.0e-3), (_LOWER_RIM, 0.8e-3))
        )
        line = person.makeup.liner * np.maximum(upper, 0.45 * lower)
        absorbed += line[..., None] * _LINER
    fade = chart.border()
    return np.clip(absorbed, 0, 0.93) * fade[..., None], relief * fade


def _spots(
    rng: np.random.Generator,
    density: np.ndarray,
    count: int,
    radii: tuple[float, float],
    ragged: float,
    soft: float = 0.9,
) -> np.ndarray:
    """Irregular soft spots (H, W) in [0, 1], placed by `density` over the cells of `zones`.

    `radii` metres, the smallest most frequent; `ragged` in [0, 1]; `soft`: width of the edge in
    radii.
    """
    result = np.zeros((chart.HEIGHT, chart.WIDTH), np.float32)
    if count == 0:
        return result
    share = np.cumsum(density.ravel())
    cells = np.searchsorted(share / share[-1], rng.random(count))
    rows, columns = np.divmod(np.minimum(cells, density.size - 1), density.shape[1])
    low, high = radii
    for row, column in zip(rows, columns, strict=True):
        centre = chart.COARSE * np.array([row, column]) + rng.uniform(0, chart.COARSE, 2)
        radius = (low + (high - low) * rng.random() ** 2.2) / chart.TEXEL
        half = int(np.ceil(radius * (1.6 + soft))) + 1
        top, left = (int(c) - half for c in centre)
        if top < 0 or left < 0 or top + 2 * half >= chart.HEIGHT or left + 2 * half >= chart.WIDTH:
            continue
        size = 2 * half
        at = np.arange(size) - half
        # Texels are wider than high.
        x, y = (at - centre[1] % 1) * 1.2, at[:, None] - centre[0] % 1
        lean, turn = np.exp(rng.normal(0, 0.25 * ragged)), rng.uniform(0, np.pi)
        along, over = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        reach = np.hypot(along * lean, over / lean) / radius
        blob = zoom(rng.normal(0, 1, (5, 5)), size / 5, order=1, grid_mode=True, mode="nearest")
        reach = reach + 0.35 * ragged * blob[:size, :size]
        spot = rng.uniform(0.3, 1) * smoothstep(1 + 0.5 * soft, 1 - 0.5 * soft, reach)
        part = result[top : top + size, left : left + size]
        np.maximum(part, spot, out=part)
    return result


def _strokes(model: HeadModel, paths: list[np.ndarray], width: float) -> np.ndarray:
    """Soft lines (H, W) in [0, 1] along points (N, 2), seen from in front, mm; `width` metres."""
    drawn = np.zeros((chart.HEIGHT, chart.WIDTH), np.float32)
    for path in paths:
        front = path * 1e-3
        length = way_along(front)
        at = np.linspace(0, length[-1], max(int(length[-1] / 0.15e-3), 2))
        front = np.stack([np.interp(at, length, front[:, k]) for k in (0, 1)], axis=1)
        columns, rows = chart.pixels(chart.lift(model, front)).round().astype(int).T
        along = at / length[-1]
        ends = smoothstep(0, 0.25, along) * smoothstep(1, 0.85, along)
        np.maximum.at(drawn, (rows, columns), ends.astype(np.float32))
    blurred = gaussian_filter(drawn, 0.5 * width / chart.TEXEL)
    return np.clip(blurred / max(float(blurred.max()), 1e-6), 0, 1)
