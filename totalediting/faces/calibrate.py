"""Measures on rendered people what `correspondences` says about landmarks and blendshapes.

    python -m totalediting.faces.calibrate OUT.npz DATASET... [--split train]

Every picture's landmarks are found as in use. The pass `canonical` tells which point of the skin is
under each; the points of all people, carried to the mean head, have a geometric median, which is
the landmark's place on the bust. A landmark that is too seldom on the skin has none. How far it
strays is measured from there, in metres at the head, with the true bust and camera. Of each
blendshape a rising curve says what is shown on average where it is read.

`totalediting/faces/data/landmarks.npz` was made by it; the file names its datasets.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import KDTree

from assets_procedural.conventions import console
from assets_procedural.conventions.errors import UserError
from assets_procedural.motion.poses import ARKIT_NAMES
from synthgen.dataset import open_dataset
from totalediting.faces import correspondences
from totalediting.faces.correspondences import Correspondences, looks
from totalediting.faces.framing import on_grey
from totalediting.faces.landmarker import LEFT_IRIS, RIGHT_IRIS, Face, Landmarker
from totalediting.geometry.identity import identity_basis
from totalediting.geometry.rig import constants
from totalediting.geometry.tracking import FOCAL_MM

_ON_SKIN = 4e-3  # metres from it within which a pixel shows skin
_LEAST = 0.2  # share of pictures in which a landmark must be there
_LOOSEST = 8e-3  # metres of median scatter over people, beyond which a landmark has no place
_FINEST = 5e-4  # metres, below which the mesh tells nothing
_MISREAD = 2.5  # of the median distance, from which a picture's landmarks are no face's
_LEVELS = np.linspace(0, 1, 11)
_SMOOTH = 3.0  # pictures that speak for a curve without steps
_LEAST_SCATTER = 0.02
_SUBDIVIDED = 4  # points along an edge of a triangle


@dataclass(frozen=True, eq=False)
class Example:
    """A picture's landmarks and its truth."""

    face: Face
    under: np.ndarray
    """(478, 3) canonical position under each landmark, metres; NaN where there is none."""
    canonical: np.ndarray
    """(V, 3) the true canonical bust."""
    posed: np.ndarray
    """(V, 3) the true posed bust."""
    meta: dict[str, Any]


def examples(folder: Path, split: str | None, landmarker: Landmarker) -> Iterator[Example]:
    """Every picture of a dataset in which a face is found."""
    dataset = open_dataset(folder, split=split)
    for number in console.track(range(len(dataset)), f"reading {folder.name}"):
        stored = dataset.read(number, ("meta", "geometry", "canonical", "alpha"))
        meta, geometry = stored["meta"], stored["geometry"]
        names = tuple(f"rgb_{k:02d}" for k in range(len(meta["environments"])))
        for picture in dataset.read(number, names).values():
            faces = landmarker.find(on_grey(picture))
            if faces:
                yield Example(
                    faces[0],
                    _under(faces[0], stored["canonical"], stored["alpha"]),
                    geometry["control_points_canonical"].astype(np.float64),
                    geometry["control_points"].astype(np.float64),
                    meta,
                )


def calibrated(found: list[Example], source: str) -> Correspondences:
    """What the examples say."""
    corners, shares, known = _places(found)
    landmarks = np.flatnonzero(known)
    corners, shares = corners[known], shares[known]
    missed = _missed(found, landmarks, corners, shares)
    whole = np.median(missed, axis=1)
    trusted = whole < _MISREAD * np.median(whole)
    found, missed = list(compress(found, trusted)), missed[trusted]
    read = np.stack([example.face.blendshapes for example in found])
    shown = np.array([[e.meta["expression"][name] for name in ARKIT_NAMES] for e in found])
    curves = np.stack([_rising(x, y) for x, y in zip(read.T, shown.T, strict=True)])
    rows = zip(read.T, curves, strict=True)
    off = shown - np.stack([np.interp(x, _LEVELS, curve) for x, curve in rows], 1)
    looking = np.array([[e.meta["gaze"][name] for name in ("yaw", "pitch")] for e in found])
    left = looks(read)
    gaze = np.linalg.solve(left.T @ left + 0.1 * np.eye(left.shape[1]), left.T @ looking)
    turned = looking - left @ gaze
    return Correspondences(
        landmarks=landmarks,
        corners=corners,
        shares=shares,
        # A median: what is hidden in some pictures does not count. Of one coordinate.
        deviations=np.median(missed, axis=0).clip(_FINEST) / np.sqrt(np.log(4)),
        blendshapes=curves,
        levels=_LEVELS,
        scatter=np.sqrt((off**2).mean(0)).clip(_LEAST_SCATTER),
        gaze=gaze,
        priors=_priors(found) | {"gaze": ([0.0, 0.0], turned.std(0).round(4).tolist())},
        source=source,
    )


def _under(face: Face, canonical: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    height, width = alpha.shape
    column, row = (np.floor(face.landmarks[:, k]).astype(int) for k in (0, 1))
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    row, column = row.clip(0, height - 1), column.clip(0, width - 1)
    covered = inside & (alpha[row, column] > 250)
    return np.where(covered[:, None], canonical[row, column].astype(np.float64), np.nan)


def _triangles() -> np.ndarray:
    quads = constants().quads.numpy()
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _inside() -> np.ndarray:
    """(S, 3) barycentric coordinates of points all over a triangle."""
    n = _SUBDIVIDED
    return np.array([(a, b, n - a - b) for a in range(n + 1) for b in range(n + 1 - a)]) / n


def _places(found: list[Example]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles' corners (478, 3) and shares (478, 3), and which landmarks have a place (478,)."""
    triangles, inside = _triangles(), _inside()
    skin = constants().skin
    mean = identity_basis().mean.double()[skin].numpy()

    def all_over(vertices: np.ndarray) -> np.ndarray:
        return np.einsum("sk,tki->tsi", inside, vertices[triangles]).reshape(-1, 3)

    template = all_over(mean)
    count = len(found[0].under)
    on_template = np.full((len(found), count, 3), np.nan)
    for k, example in enumerate(console.track(found, "placing landmarks")):
        seen = np.flatnonzero(np.isfinite(example.under).all(1))
        distance, nearest = KDTree(all_over(example.canonical)).query(example.under[seen])
        near = distance < _ON_SKIN
        on_template[k, seen[near]] = template[np.asarray(nearest)[near]]
    known, places = np.zeros(count, bool), np.zeros((count, 3))
    for number in range(RIGHT_IRIS[0]):  # irises lie on no skin
        points = on_template[:, number]
        points = points[np.isfinite(points).all(1)]
        if len(points) < max(3, _LEAST * len(found)):
            continue
        places[number], scatter = _geometric_median(points)
        known[number] = scatter < _LOOSEST
    _, nearest = KDTree(template).query(places)
    return triangles[nearest // len(inside)], inside[nearest % len(inside)], known


def _geometric_median(points: np.ndarray) -> tuple[np.ndarray, float]:
    """The point nearest to all (N, 3) (Weiszfeld 1937), and their median distance from it."""
    middle = np.median(points, axis=0)
    for _ in range(30):
        weights = 1 / np.linalg.norm(points - middle, axis=1).clip(_FINEST)
        middle = (points * weights[:, None]).sum(0) / weights.sum()
    return middle, float(np.median(np.linalg.norm(points - middle, axis=1)))


def _missed(
    found: list[Example], landmarks: np.ndarray, corners: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """(B, N + 2) metres by which landmarks miss their place on the true bust, irises theirs."""
    numbers = np.append(landmarks, [RIGHT_IRIS[0], LEFT_IRIS[0]])
    off = np.empty((len(found), len(numbers)))
    for k, example in enumerate(found):
        camera = example.meta["camera"]
        frame, lens = np.array(camera["camera_to_world"]), np.array(camera["intrinsics"])
        own = (example.posed - frame[:3, 3]) @ frame[:3, :3]
        points = np.einsum("nkc,nk->nc", own[corners], shares)
        pixels = lens[[0, 1], 2] + lens[0, 0] * points[:, :2] * [1, -1] / -points[:, 2:]
        truth = np.concatenate([pixels, np.array(example.meta["landmarks"]["points"])[68:70]])
        metres = -points[:, 2].mean() / lens[0, 0]  # of a pixel, at the face
        off[k] = metres * np.linalg.norm(example.face.landmarks[numbers, :2] - truth, axis=1)
    return off


def _rising(read: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(L,) means of what is shown at each level of what is read, by least squares, rising from 0.

    Where little is known it rises as what is read. That it starts from 0 makes it depend less on
    how often the examples show what detectors do not see.
    """
    hats = np.stack([np.interp(read, _LEVELS, row) for row in np.eye(len(_LEVELS))], 1)
    steps = np.tril(np.ones((len(_LEVELS), len(_LEVELS))))  # a curve as the sum of its steps
    slope = np.diff(np.eye(len(_LEVELS)), axis=0)
    bend = np.diff(slope, axis=0)
    left = np.concatenate([hats, np.sqrt(_SMOOTH) * bend, np.sqrt(_SMOOTH) * slope]) @ steps
    even = np.sqrt(_SMOOTH) * np.diff(_LEVELS)
    right = np.concatenate([shown, np.zeros(len(bend)), even])
    return (steps[:, 1:] @ nnls(left[:, 1:], right)[0]).clip(0, 1)


def _priors(found: list[Example]) -> dict[str, tuple[list[float], list[float]]]:
    drawn = [example.meta["camera"]["sample"] for example in found]
    angles = ("pitch", "roll", "yaw")
    values = {
        "head": [[e.meta["head"][name] for name in angles] for e in found],
        "camera": [[one[name] for name in ("yaw", "pitch", "roll")] for one in drawn],
        "log_focal": [[np.log(one["focal_mm"] / FOCAL_MM)] for one in drawn],
    }
    found_of = {}
    for name, rows in values.items():
        table = np.array(rows)
        mean = np.where(table.std(0) > 0, table.mean(0), 0)
        found_of[name] = (mean.round(4).tolist(), table.std(0).clip(0.02).round(4).tolist())
    return found_of


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--split", choices=("train", "validation", "test"), help="all by default")
    options = parser.parse_args()
    try:
        landmarker = Landmarker()
        found = [
            example
            for folder in options.datasets
            for example in examples(folder, options.split, landmarker)
        ]
    except (UserError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    people = {(e.meta["subset"], e.meta["subject"]) for e in found}
    names = ", ".join(folder.name for folder in options.datasets)
    source = f"{len(found)} pictures of {len(people)} people: {names}"
    correspondences.write(options.out, calibrated(found, source))
    print(source)
    return 0


if __name__ == "__main__":
    sys.exit(main())
