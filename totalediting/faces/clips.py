"""Busts of a clip: one person, trunk and lens in all frames, and motion without jitter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from totalediting.faces.fitting import MOVING, BustFitter, Fits
from totalediting.faces.framing import square_around
from totalediting.faces.landmarker import Face
from totalediting.faces.smoothing import one_euro

_SAMPLED = 24  # frames that identity, trunk and lens are solved from
# Of the One Euro filter: Hz at rest, and Hz per unit of what moves and second.
_CUTOFF, _BETA = 2.0, 4.0


def fit_clip(
    fitter: BustFitter, faces: Sequence[Face], times: Sequence[float]
) -> tuple[np.ndarray, Fits]:
    """The square (left, top, side) that all frames are fitted in, and the fits of `faces`.

    `times` are in seconds and rise.
    """
    square = square_around(faces)
    landmarks = np.stack([face.landmarks for face in faces]).astype(np.float64)
    landmarks[..., :2] -= square[:2]
    landmarks /= square[2]
    blendshapes = np.stack([face.blendshapes for face in faces])
    sampled = np.unique(np.linspace(0, len(faces) - 1, _SAMPLED).round().astype(int))
    known = fitter.fit_person(landmarks[sampled], blendshapes[sampled], 1.0).state
    states = []
    for k in range(len(faces)):
        here = slice(k, k + 1)
        last = states[-1] if states else known[:1]
        states.append(fitter.follow(landmarks[here], blendshapes[here], 1.0, last))
    states = np.concatenate(states)
    states[:, MOVING] = one_euro(states[:, MOVING], np.asarray(times), _CUTOFF, _BETA)
    return square, fitter.fits_of(landmarks, blendshapes, 1.0, states)
