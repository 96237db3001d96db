"""The plausibility limit: faces beyond it are pulled back to it, not drawn again."""

from __future__ import annotations

from functools import cache

import numpy as np

from assets_procedural.people.measures import MEASURES, responses
from assets_procedural.people.shape_modes import SPREAD

# Standard deviation of each measure among people of one ancestry and sex, millimetres (Farkas,
# Anthropometry of the Head and Face, 1994; of the brows our own estimate).
DEVIATION: dict[str, float] = {
    "face width": 5.5,
    "jaw width": 6.0,
    "face height": 6.5,
    "nose width": 2.9,
    "nose length": 3.6,
    "nose depth": 2.2,
    "mouth width": 3.8,
    "between eyes": 2.7,
    "eye width": 1.6,
    "eye opening": 1.3,
    "philtrum": 2.4,
    "upper lip": 1.6,
    "lower lip": 1.6,
    "chin": 3.6,
    "brow height": 2.4,
    "forehead": 5.0,
}
LIMIT = 2.1
"""No measure is more than so many of its deviations from the average of a subject's own kind."""

# Pairs whose difference, in deviations, stays within a limit: big noses above small mouths and the
# like are seen at once, though each alone is common.
RELATIONS: tuple[tuple[str, str, float], ...] = (
    ("nose width", "mouth width", 2.0),
    ("nose width", "between eyes", 2.4),
    ("nose length", "face height", 1.8),
    ("nose length", "chin", 2.6),
    ("mouth width", "face width", 2.2),
    ("mouth width", "jaw width", 2.4),
    ("eye width", "face width", 2.2),
    ("eye width", "between eyes", 2.6),
    ("eye opening", "eye width", 2.4),
    ("face width", "jaw width", 2.2),
    ("face width", "face height", 2.8),
    ("philtrum", "chin", 2.6),
    ("upper lip", "lower lip", 2.0),
    ("philtrum", "upper lip", 2.6),
    ("forehead", "face width", 2.0),
    ("forehead", "face height", 2.6),
)
_ROUNDS = 4
_EXTREME = 3.0  # deviates of a single change


def within_norm(deviates: np.ndarray) -> np.ndarray:
    """Standard normal deviates (N,), shortened to the norm that one person in ten exceeds."""
    norm = float(np.linalg.norm(deviates))
    limit = np.sqrt(len(deviates) - 0.5) + 0.9
    return deviates * min(1.0, limit / max(norm, 1e-12))


def keep_plausible(deviates: np.ndarray) -> np.ndarray:
    """Deviates of the changes of `SPREAD`, moved as little as it takes to meet the limits.

    Each limit that is exceeded is met in turn, again and again for the worst faces; limits that
    oppose each other may stay exceeded by a little.
    """
    deviates = np.clip(deviates, -_EXTREME, _EXTREME)
    up, down, bounds = _limits()
    for _ in range(_ROUNDS):
        slopes = np.where(deviates > 0.0, up, down)
        for row in np.flatnonzero(np.abs(slopes @ deviates) > bounds):
            slope, bound = slopes[row], bounds[row]
            value = float(slope @ deviates)
            excess = value - min(max(value, -bound), bound)
            deviates = deviates - slope * (excess / float(slope @ slope))
    return np.clip(deviates, -_EXTREME, _EXTREME)


@cache
def _limits() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of slopes for deviates above and below 0, and how far from 0 their sums may be."""
    spread = np.array(list(SPREAD.values()))[:, None]
    deviation = np.array([DEVIATION[name] for name in MEASURES])
    up, down = (spread * table / deviation for table in responses())
    place = {name: k for k, name in enumerate(MEASURES)}
    pairs = [(place[a], place[b]) for a, b, _ in RELATIONS]
    rows = [np.concatenate([t.T, [t[:, a] - t[:, b] for a, b in pairs]]) for t in (up, down)]
    bounds = np.array([LIMIT] * len(MEASURES) + [limit for *_, limit in RELATIONS])
    return rows[0], rows[1], bounds
