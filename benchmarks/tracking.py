"""How well a trained head tracker tracks: rendered people against their truth, a clip by ranges.

    python benchmarks/tracking.py RUN DATA [--split test] [--clip FILE] [--every 4]

First table: mean absolute errors of the stage `tracker` in RUN on every picture of a split of DATA,
beside those of one constant answer, the median of the split `train` that it was trained on. Second
table: correlations with the truth over those pictures. Head angles "against the trunk" are what is
tracked; those "in the picture" are as the camera sees the face: yaw to the picture's right, pitch
up, roll counter-clockwise.

With `--clip`: every n-th frame of a video, cut to a square around the face that YuNet finds there
(to the middle square where OpenCV is not installed), and the range of what is tracked over it. With
MediaPipe, whose blendshapes and head angles are of the same squares, also those and correlations.

MediaPipe wants protobuf below 5, tensorboard above: the extras `benchmarks` and `train` clash. This
needs neither as a whole, and no tensorboard. An environment of its own with MediaPipe:

    python3.11 -m venv ENV
    ENV/bin/pip install torch==2.13.0 safetensors av attrs 'matplotlib>=3.9,<4' \\
        'opencv-python-headless>=4.9,<4.12' 'protobuf>=4.25,<5' --editable .
    ENV/bin/pip install --no-deps mediapipe==0.10.21
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import av
import numpy as np
import report
import torch
from av.error import FFmpegError
from detectors import ANGLES, BLENDSHAPES, FaceLandmarker, Frame, angles_of
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from torch import Tensor

from assets_procedural.motion.poses import ARKIT_NAMES
from assets_procedural.person import Person
from totalediting.data import shots
from totalediting.data.shots import Shots
from totalediting.errors import InputError
from totalediting.geometry.identity import identity_basis
from totalediting.geometry.rig import camera_of
from totalediting.geometry.tracking import Tracking
from totalediting.networks.head_tracker import HeadTracker
from totalediting.pretrained.fetch import fetch
from totalediting.training import checkpoints

AT_ONCE = 16  # pictures
MOST_USED = 10  # expression coefficients of their own row
TURNS = (
    "head yaw, ° against the trunk",
    "head pitch, ° against the trunk",
    "head roll, ° against the trunk",
    "gaze yaw, °",
    "gaze pitch, °",
)
# A square around YuNet's box: its side in heights of the box, and how far its middle is above the
# box's, likewise. Medians of 250 pictures of train_demo, so that a clip is framed as they are.
SQUARE, RAISED = 1.9, 0.11
# The face's axes (subject's left, up, forward) in the head model's frame.
FACE_AXES = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


class Pictures:
    """Pictures of a split as the tracker takes them, with their truth."""

    def __init__(self, folder: Path, split: str) -> None:
        self.shots = Shots(folder, split)
        self._identities: dict[str, Tensor] = {}

    def truth(self) -> Tracking:
        """Of every shot once, (N, …)."""
        metas = [self.shots.read(k, "meta")["meta"] for k in range(len(self.shots.keys))]
        return joined([self._tracking(k, meta) for k, meta in enumerate(metas)])

    def batches(self, side: int) -> Iterator[tuple[Tensor, Tracking]]:
        """(B, 3, side, side) and truth, a shot in all its environments at a time."""
        for k in range(len(self.shots.keys)):
            names = [shots.rgb_name(light) for light in range(self.shots.environments(k))]
            stored = self.shots.read(k, "meta", *names)
            truth = self._tracking(k, stored["meta"])
            images = torch.stack([shots.picture(stored[name], side) for name in names])
            yield images, joined([truth] * len(names))

    def _tracking(self, position: int, meta: dict) -> Tracking:
        subject = self.shots.subjects[position]
        if subject not in self._identities:
            person = Person.model_validate(meta["person"])
            self._identities[subject] = identity_basis().coefficients(person)
        found = shots.tracking(meta, self._identities[subject])
        return Tracking(*(field[None] for field in found))


def joined(parts: list[Tracking]) -> Tracking:
    return Tracking(*map(torch.cat, zip(*parts, strict=True)))


def trained(run: Path) -> tuple[HeadTracker, Path]:
    """The tracker that validated best, and the dataset that it was trained on."""
    config = checkpoints.read_config(run / "tracker")
    network = HeadTracker(checkpoints.preset_of(run / "tracker"))
    checkpoints.load_best(run / "tracker", network)
    return network.eval(), Path(config["data"])


@torch.no_grad()
def track(network: HeadTracker, images: Tensor) -> Tracking:
    return joined([network(part) for part in images.split(AT_ONCE)])


def figures_of(tracking: Tracking) -> dict[str, np.ndarray]:
    """(N,) of each figure that has a row, in the unit that the row says."""
    degrees, camera = torch.rad2deg, tracking.camera_yaw_pitch_roll
    found = {
        "gaze yaw, °": degrees(tracking.gaze[:, 0]),
        "gaze pitch, °": degrees(tracking.gaze[:, 1]),
        "head pitch, ° against the trunk": degrees(tracking.head[:, 0]),
        "head roll, ° against the trunk": degrees(tracking.head[:, 1]),
        "head yaw, ° against the trunk": degrees(tracking.head[:, 2]),
        "camera yaw, °": degrees(camera[:, 0]),
        "camera pitch, °": degrees(camera[:, 1]),
        "camera roll, °": degrees(camera[:, 2]),
        "focal length, mm": tracking.focal_mm[:, 0],
        "fill, % of the frame": 100 * tracking.fill[:, 0],
        "shift right, % of the frame": 100 * tracking.shift[:, 0],
        "shift up, % of the frame": 100 * tracking.shift[:, 1],
    }
    return {name: value.numpy() for name, value in found.items()}


def head_angles(tracking: Tracking) -> np.ndarray:
    """(N, 3) yaw, pitch, roll of the head as the camera sees it, degrees; see `angles_of`."""
    cameras = camera_of(tracking, 1)[0][:, :3, :3].numpy()
    heads = Rotation.from_euler("xyz", tracking.head.numpy()).as_matrix()
    return np.stack([angles_of(c.T @ h @ FACE_AXES) for c, h in zip(cameras, heads, strict=True)])


def seen_of(tracking: Tracking) -> dict[str, np.ndarray]:
    """(N,) of what MediaPipe tells as well."""
    expression, angles = tracking.expression.numpy(), head_angles(tracking)
    found = {
        name: expression[:, [ARKIT_NAMES.index(part) for part in parts]].mean(1)
        for name, parts in BLENDSHAPES.items()
    }
    return found | {f"{name} in the picture": angles[:, k] for k, name in enumerate(ANGLES)}


def accuracy(network: HeadTracker, folder: Path, split: str, training: Path) -> None:
    """Print the tables of a rendered split."""
    images, truths = zip(*Pictures(folder, split).batches(network.image), strict=True)
    truth, known = joined(list(truths)), Pictures(training, "train").truth()
    found = track(network, torch.cat(images))
    print(f"{len(found.gaze)} pictures of {folder}, split {split}\n")
    rows: list[list[str]] = []

    def row(name: str, ours: np.ndarray, theirs: ArrayLike, true: np.ndarray) -> None:
        error, constant = np.abs(ours - true).mean(), np.abs(theirs - true).mean()
        rows.append([name, f"{error:.3f}", f"{constant:.3f}"])

    ours, true, all_known = (t.expression.numpy() for t in (found, truth, known))
    median = np.median(all_known, axis=0)
    row("expression, all 52", ours, median, true)
    for k in np.argsort(-all_known.var(axis=0))[:MOST_USED]:
        row(f"… {ARKIT_NAMES[k]}", ours[:, k], median[k], true[:, k])
    ours, true, all_known = (t.identity.numpy() for t in (found, truth, known))
    row("identity, in deviations", ours, np.median(all_known, axis=0), true)
    ours, true, all_known = (100 * t.face.numpy() for t in (found, truth, known))
    row("points of the face, % of the frame", ours, np.median(all_known, axis=0), true)
    ours, true, all_known = (figures_of(t) for t in (found, truth, known))
    for name in ours:
        row(name, ours[name], np.median(all_known[name]), true[name])
    report.table(["mean absolute error", "tracker", "the training set's median"], rows)

    ours, true = ours | seen_of(found), true | seen_of(truth)
    names = (*seen_of(found), *TURNS)
    report.table(
        ["correlation with the truth", ""],
        [[name, correlation(ours[name], true[name])] for name in names],
    )


def frames_of(path: Path, every: int) -> list[np.ndarray]:
    """Every n-th frame (H, W, 3) uint8 of a video.

    Raises:
        InputError: it cannot be read, or n is below 1.
    """
    if every < 1:
        raise InputError(f"--every {every}: give 1 for every frame, or more")
    try:
        with av.open(str(path)) as container:
            frames = islice(container.decode(video=0), 0, None, every)
            return [frame.to_ndarray(format="rgb24") for frame in frames]
    except (OSError, IndexError, FFmpegError) as error:
        raise InputError(f"{path}: no video that can be read ({error}); give another") from None


def middle_square(frame: np.ndarray) -> np.ndarray:
    height, width = frame.shape[:2]
    edge = min(height, width)
    top, left = (height - edge) // 2, (width - edge) // 2
    return frame[top : top + edge, left : left + edge]


class FaceSquare:
    """Cuts the square around the largest face; beyond the frame its border goes on."""

    def __init__(self) -> None:
        import cv2  # pyright: ignore[reportMissingImports]

        self._detector = cv2.FaceDetectorYN.create(str(fetch("yunet")), "", (0, 0), 0.6)

    def __call__(self, frame: np.ndarray) -> np.ndarray | None:
        """The square (E, E, 3), None where there is no face."""
        height, width = frame.shape[:2]
        self._detector.setInputSize((width, height))
        _, found = self._detector.detect(np.ascontiguousarray(frame[..., ::-1]))
        if found is None:
            return None
        x, y, wide, tall = max(found, key=lambda face: face[2] * face[3])[:4]
        edge = round(float(SQUARE * tall))
        left = round(float(x + wide / 2 - edge / 2))
        top = round(float(y + tall / 2 - RAISED * tall - edge / 2))
        padded = np.pad(frame, ((edge, edge), (edge, edge), (0, 0)), "edge")
        return padded[top + edge : top + 2 * edge, left + edge : left + 2 * edge]


def clip(network: HeadTracker, path: Path, every: int) -> None:
    """Print the table of a video."""
    frames = frames_of(path, every)
    if find_spec("cv2"):
        cut, how = FaceSquare(), "around the face"
    else:
        cut, how = middle_square, "in the middle (OpenCV, which finds faces, is not installed)"
    squares = [square for square in map(cut, frames) if square is not None]
    print(f"\n{path.name}: {len(frames)} frames, {len(squares)} with a face; the square {how}")
    if len(squares) < 3:
        raise InputError(f"{path}: too few faces; give a video that shows one face")
    images = torch.stack([shots.picture(square, network.image) for square in squares])
    ours = seen_of(track(network, images))
    if not find_spec("mediapipe"):
        print("MediaPipe is not installed: no comparison; see the docstring for how to have it\n")
        rows = [[name, spread(values)] for name, values in ours.items()]
        report.table(["5 % … median … 95 % of frames", "tracker"], rows)
        return
    landmarker = FaceLandmarker(fetch("face_landmarker"))
    readings = [landmarker.read(whole(square)) for square in squares]
    seen = [k for k, reading in enumerate(readings) if reading is not None]
    known = [reading for reading in readings if reading is not None]
    print(f"MediaPipe sees a face in {len(seen)}\n")
    theirs = {
        name: np.array([np.mean([r.blendshapes[part] for part in parts]) for r in known])
        for name, parts in BLENDSHAPES.items()
    }
    angles = np.stack([reading.angles for reading in known])
    theirs |= {f"{name} in the picture": angles[:, k] for k, name in enumerate(ANGLES)}
    report.table(
        ["5 % … median … 95 % of frames", "tracker", "MediaPipe", "correlation"],
        [
            [
                name,
                spread(values[seen]),
                spread(theirs[name]),
                correlation(values[seen], theirs[name]),
            ]
            for name, values in ours.items()
        ],
    )


def whole(square: np.ndarray) -> Frame:
    """A square as a detector's frame in which the face may be anywhere."""
    edge = len(square)
    corners = np.array([[0.0, 0.0], [edge, edge]])
    return Frame("", square, np.resize(corners, (70, 2)), {}, np.zeros(3))


def spread(values: np.ndarray) -> str:
    return " … ".join(f"{value:.2f}" for value in np.percentile(values, (5, 50, 95)))


def correlation(ours: np.ndarray, theirs: np.ndarray) -> str:
    if np.ptp(ours) == 0 or np.ptp(theirs) == 0:
        return "undefined (constant)"
    return f"{np.corrcoef(ours, theirs)[0, 1]:.3f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", choices=shots.SPLITS, default="test")
    parser.add_argument("--clip", type=Path, help="a video of one face")
    parser.add_argument("--every", type=int, default=4, help="take every n-th of its frames (4)")
    options = parser.parse_args()
    network, training = trained(options.run)
    accuracy(network, options.data, options.split, training)
    if options.clip is not None:
        clip(network, options.clip, options.every)
    return 0


if __name__ == "__main__":
    sys.exit(report.in_one_line(main))
