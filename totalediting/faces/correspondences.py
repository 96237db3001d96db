"""Where a face's landmarks lie on the bust, how far they stray, and what blendshapes mean there.

Measured on rendered people, whose every pixel says where on the bust it is, by
`python -m totalediting.faces.calibrate`, which writes the file that this module reads.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from assets_procedural.motion.poses import ARKIT_NAMES

_LOOKS = [k for k, name in enumerate(ARKIT_NAMES) if name.startswith("eyeLook")]
FILE = Path(__file__).with_name("data") / "landmarks.npz"


@dataclass(frozen=True, eq=False)
class Correspondences:
    """N landmarks that have a place on the bust's skin, and statistics for a fit."""

    landmarks: np.ndarray
    """(N,) numbers of MediaPipe's 478."""
    corners: np.ndarray
    """(N, 3) vertices of the skin, in the order of `control_points`."""
    shares: np.ndarray
    """(N, 3) barycentric, of the corners."""
    deviations: np.ndarray
    """(N + 2,) metres that a landmark is off by, and both irises: of the least squares' weights."""
    blendshapes: np.ndarray
    """(52, L) what is shown on average where MediaPipe reads `levels`: rises from 0."""
    levels: np.ndarray
    """(L,) from 0 to 1."""
    scatter: np.ndarray
    """(52,) deviation of what is shown from `blendshapes`."""
    gaze: np.ndarray
    """(9, 2) the gaze, radians, by MediaPipe's eight `eyeLook…` in their order and by 1."""
    priors: dict[str, tuple[list[float], list[float]]]
    """Mean and deviation over people and cameras, by the field of `Tracking`."""
    source: str
    """What it was measured on."""

    def shown(self, read: np.ndarray) -> np.ndarray:
        """(B, 52) coefficients of the bust that blendshapes (B, 52) stand for."""
        rows = zip(read.T, self.blendshapes, strict=True)
        return np.stack([np.interp(values, self.levels, curve) for values, curve in rows], 1)

    def looking(self, read: np.ndarray) -> np.ndarray:
        """(B, 2) gaze that blendshapes (B, 52) stand for."""
        return looks(read) @ self.gaze


def looks(read: np.ndarray) -> np.ndarray:
    """(B, 9) of blendshapes (B, 52), what the gaze is linear in."""
    return np.concatenate([read[:, _LOOKS], np.ones((len(read), 1))], 1)


def write(path: Path, found: Correspondences) -> None:
    """The file, without pickles."""
    arrays = {name: value for name, value in vars(found).items() if name not in _TEXTS}
    texts = {name: np.array(json.dumps(getattr(found, name))) for name in _TEXTS}
    path.parent.mkdir(exist_ok=True)
    np.savez_compressed(path, **arrays, **texts)


@lru_cache(maxsize=1)
def load(path: Path = FILE) -> Correspondences:
    """Read what ships with the package."""
    with np.load(path) as archive:
        texts = {name: json.loads(str(archive[name])) for name in _TEXTS}
        return Correspondences(**{k: archive[k] for k in archive.files if k not in _TEXTS}, **texts)


_TEXTS = ("priors", "source")
