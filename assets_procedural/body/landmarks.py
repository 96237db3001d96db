"""iBUG's 68 face landmarks and two pupils, fixed to the head model's topology.

Numbering and order of iBUG 300-W (Sagonas et al., 2013): 0-16 jaw, 17-21 and 22-26 brows, 27-35
nose, 36-41 and 42-47 eyes, 48-59 outer and 60-67 inner lips, from the picture's left, which is the
subject's right; then 68 the right and 69 the left pupil. The jaw points are anatomical (they stay
on the bone when the head turns) instead of sliding along the visible outline.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import sparse

from assets_procedural.body.eyes import eyeball
from assets_procedural.body.head import Bust, HeadModel
from assets_procedural.body.regions import mirror
from assets_procedural.mesh.subdivision import catmull_clark

COUNT = 70
PUPILS = {"eye_right": 68, "eye_left": 69}

# Landmark → base.obj id on the midline or the subject's left half, or the ids of an edge's ends
# whose midpoint it is. The right half mirrors them.
_LEFT_HALF: dict[int, int | tuple[int, int]] = {
    # Jaw: under the chin, along the mandible, in front of the ear up to the height of the eye.
    8: 5296,
    9: 11898,
    10: 7593,
    11: 7594,
    12: 7597,
    13: 7614,
    14: 11713,
    15: (7564, 12010),
    16: 12001,
    # Brow: along the middle of its hair, from the nose.
    22: (6983, 7001),
    23: (6980, 6997),
    24: (7002, 7004),
    25: (7004, 7005),
    26: 11869,
    # Nose: nasion, down the ridge to the tip; columella, sill and wing.
    27: 132,
    28: 131,
    29: 201,
    30: 5054,
    33: 317,
    34: 7054,
    35: 7088,
    # Eye: the middle of the lid margin, from the inner corner over the upper lid.
    42: 6853,
    43: 13359,
    44: 13353,
    45: 13377,
    46: 13372,
    47: 13368,
    # Lips: border of the vermilion, then where the lips part.
    51: 455,
    52: 7215,
    53: (11956, 7170),
    54: 7182,
    55: (7235, 7166),
    56: (7241, 7235),
    57: 492,
    62: 474,
    63: 7227,
    64: 7191,
    65: (7264, 7265),
    66: 493,
}

_MIRRORED_RUNS = (
    (list(range(17)), list(range(16, -1, -1))),
    (list(range(17, 27)), list(range(26, 16, -1))),
    (list(range(27, 31)), list(range(27, 31))),
    (list(range(31, 36)), list(range(35, 30, -1))),
    ([36, 37, 38, 39, 40, 41], [45, 44, 43, 42, 47, 46]),
    ([42, 43, 44, 45, 46, 47], [39, 38, 37, 36, 41, 40]),
    (list(range(48, 55)), list(range(54, 47, -1))),
    (list(range(55, 60)), list(range(59, 54, -1))),
    (list(range(60, 65)), list(range(64, 59, -1))),
    (list(range(65, 68)), list(range(67, 64, -1))),
    ([68, 69], [69, 68]),
)
# Landmark i of a mirrored picture is landmark FLIP[i] of the original.
FLIP = np.array([to for _, run in _MIRRORED_RUNS for to in run])

# The pupil lies on the iris, this many eyeball radii in front of the eye's centre.
_PUPIL = np.array([0.0, -0.855, 0.0])


def landmarks(bust: Bust) -> np.ndarray:
    """(70, 3) posed positions in metres, on the skin as it is rendered (subdivided once)."""
    points = np.empty((COUNT, 3))
    points[:68] = skin_weights(bust.model) @ bust.vertices
    for name, index in PUPILS.items():
        centre, radius = eyeball(bust.identity, name)
        pupil = centre + radius * _PUPIL
        motion = bust.bones[name]
        points[index] = motion[:3, :3] @ pupil + motion[:3, 3]
    return points


@lru_cache(maxsize=4)
def skin_weights(model: HeadModel) -> sparse.csr_matrix:
    """(68, V): the landmarks on the skin as linear combinations of the model's vertices."""
    surface = catmull_clark(model.faces["skin"], len(model.template)).matrix
    opposite = mirror(model)
    weights = np.zeros((68, len(model.template)))
    for landmark, place in _LEFT_HALF.items():
        ids = model.from_base(np.atleast_1d(place))
        weights[landmark] = surface[ids].toarray().mean(axis=0)
        weights[FLIP[landmark]] = surface[opposite[ids]].toarray().mean(axis=0)
    return sparse.csr_matrix(weights)
