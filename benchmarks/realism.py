"""How far rendered people are from photographs and from each other, to networks and statistics.

    synthgen render realism --out out/realism
    python benchmarks/realism.py out/realism

The first picture of each person of the subset `portraits` is measured as a photograph would be; its
other views and lights say whether a person stays the same; the subset `identities` says how
different people are. The networks were trained by others on photographs: YuNet finds the face,
SFace and dlib's ResNet recognise it, MediaPipe reads its landmarks. `photographs` are five public
pictures of three people, for direction only.

Skin is measured in faces that are scaled to so many pixels between the eyes, in L* and a*b* on both
cheeks and the forehead: fine detail is finer than 1 pixel (sigma), mid detail from there to a tenth
of the distance of the eyes. A spread is 1.4826 times the median absolute deviation.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import report
from detectors import (
    MEDIAPIPE_70,
    MEDIAPIPE_LOWER_BROWS,
    FaceLandmarker,
    Frame,
    frames_of,
)

from assets_procedural.conventions import console
from assets_procedural.motion.poses import PoseSettings, sample_pose
from synthgen.dataset import open_dataset
from synthgen.dataset.reading import Dataset
from totalediting.pretrained.fetch import fetch

ONE_PERSON = 0.363  # cosine of SFace's features from which on OpenCV calls two faces one person
DLIB_ONE_PERSON = 0.6  # distance of dlib's features, likewise
POSES = 1500
FINE, MID, CHROMA = "fine detail of skin", "mid detail", "mid chroma"


@dataclass
class Aim:
    """A figure's place in the table, as text: of photographs, and what is to be reached."""

    photographs: str
    hold: str
    low: float = -np.inf
    high: float = np.inf
    digits: int = 2
    percent: bool = False

    def show(self, value: float) -> str:
        return f"{100 * value:.1f} %" if self.percent else f"{value:.{self.digits}f}"


AIMS = {
    f"{FINE}, 38 px": Aim("1.04", ">= .50", low=0.50),
    f"{MID}, 38 px": Aim("2.47", ">= 1.6", low=1.6),
    f"{MID}, 76 px": Aim("", ">= 2.1", low=2.1),
    f"{CHROMA}, 38 px": Aim("1.93", ">= 1.4", low=1.4),
    "darkest 1 % of a picture, L*, median": Aim(".4", "<= 5", high=5, digits=1),
    "pictures with over 10 % clipped pixels": Aim("", "<= 5 %", high=0.05, percent=True),
    "brow slope": Aim("-.010", "-.025 to .02", -0.025, 0.02, digits=3),
    "brow to lid": Aim(".182", ".18 to .23", 0.18, 0.23, digits=3),
    "default poses that read negative": Aim("", "<= 15 %", high=0.15, percent=True),
    "SFace, different people: mean": Aim("~ .05", "<= .20", high=0.20, digits=3),
    f"SFace, pairs above {ONE_PERSON}": Aim("", "<= 8 %", high=0.08, percent=True),
    "SFace, largest of all pairs": Aim("", "<= .55", high=0.55),
    f"dlib, pairs below {DLIB_ONE_PERSON}": Aim("", "<= 10 %", high=0.10, percent=True),
    "SFace, one person, other light": Aim(".60 to .79", ">= .72", low=0.72),
    "SFace, one person, other view": Aim("", ">= .68", low=0.68),
    "SFace, one person against others: AUC": Aim("", ">= .99", low=0.99, digits=4),
    "YuNet's mean score": Aim("", ">= .92", low=0.92, digits=3),
    "found by MediaPipe": Aim("", "100 %", low=1.0, percent=True),
}
"""Every row of the table, in order."""


@dataclass
class Face:
    """A face that YuNet found: box, five points and score (15,), and SFace's features."""

    person: str
    view: int
    light: int
    image: np.ndarray
    box: np.ndarray
    features: np.ndarray


class Recogniser:
    """YuNet and SFace through OpenCV, as their makers publish them."""

    SIDE = 512  # what pictures are scaled to before detection

    def __init__(self) -> None:
        import cv2  # pyright: ignore[reportMissingImports]

        self._cv2 = cv2
        size = (self.SIDE, self.SIDE)
        self._yunet = cv2.FaceDetectorYN.create(str(fetch("yunet")), "", size, 0.5)
        self._sface = cv2.FaceRecognizerSF.create(str(fetch("sface")), "")

    def find(self, image: np.ndarray) -> np.ndarray | None:
        """The best face (15,): box, five points, score, in pixels of `image`."""
        side = (self.SIDE, self.SIDE)
        resized = self._cv2.resize(image[..., ::-1], side, interpolation=self._cv2.INTER_CUBIC)
        _, found = self._yunet.detect(resized)
        if found is None:
            return None
        best = found[found[:, 14].argmax()].astype(np.float64)
        best[:14] *= len(image) / self.SIDE
        return best

    def features(self, image: np.ndarray, box: np.ndarray) -> np.ndarray:
        """SFace's features, of length 1."""
        bgr = np.ascontiguousarray(image[..., ::-1])
        features = self._sface.feature(self._sface.alignCrop(bgr, box.astype(np.float32))).ravel()
        return features / np.linalg.norm(features)

    def align(self, image: np.ndarray, box: np.ndarray, between: float) -> np.ndarray:
        """CIELAB (S, S, 3) of the upright face with `between` pixels between the eyes."""
        right, left = box[4:6], box[6:8]
        scale = float(between / np.linalg.norm(left - right))
        source = image[..., ::-1].astype(np.float32) / 255
        if scale < 1:
            source = self._cv2.GaussianBlur(source, (0, 0), 0.45 / scale)
        angle = np.arctan2(*(left - right)[::-1])
        cos, sin = scale * np.cos(-angle), scale * np.sin(-angle)
        side = int(between * 4)
        turn = np.array([[cos, -sin], [sin, cos]])
        shift = side * np.array([0.5, 0.4]) - turn @ ((left + right) / 2)
        matrix = np.column_stack([turn, shift])
        flags = self._cv2.INTER_LANCZOS4
        aligned = self._cv2.warpAffine(source, matrix, (side, side), flags=flags)
        return self._cv2.cvtColor(np.clip(aligned, 0, 1), self._cv2.COLOR_BGR2LAB)

    def lightness(self, image: np.ndarray) -> np.ndarray:
        """L* (H, W) in [0, 100]."""
        bgr = np.ascontiguousarray(image[..., ::-1]).astype(np.float32) / 255
        return self._cv2.cvtColor(bgr, self._cv2.COLOR_BGR2LAB)[..., 0]


class Dlib:
    """dlib's ResNet (King 2017) on faces that YuNet found."""

    def __init__(self) -> None:
        # An extension without types.
        self._dlib: Any = importlib.import_module("dlib")
        dlib = self._dlib
        self._shape = dlib.shape_predictor(str(fetch("dlib_points")))
        self._network = dlib.face_recognition_model_v1(str(fetch("dlib_recognition")))

    def recognise(self, image: np.ndarray, box: np.ndarray) -> np.ndarray:
        """Features (128,)."""
        picture = np.ascontiguousarray(image)
        # dlib's boxes are square, from the brows to below the lips.
        x, y, width, height = box[:4]
        middle, half = (x + width / 2, y + 0.55 * height), 0.46 * height
        corners = (middle[0] - half, middle[1] - half, middle[0] + half, middle[1] + half)
        points = self._shape(picture, self._dlib.rectangle(*(round(c) for c in corners)))
        return np.array(self._network.compute_face_descriptor(picture, points))


def pictures(
    dataset: Dataset, name: str, recogniser: Recogniser
) -> Iterator[tuple[Frame, Face | None]]:
    """Every picture of a dataset, and the face that is found in it."""
    for index in console.track(range(len(dataset)), name):
        meta = dataset.read(index, ("meta",))["meta"]
        for light, frame in enumerate(frames_of(dataset, index)):
            face, box = None, recogniser.find(frame.image)
            if box is not None:
                features = recogniser.features(frame.image, box)
                face = Face(meta["subject"], meta["view"], light, frame.image, box, features)
            yield frame, face


def skin(lab: np.ndarray, between: float) -> dict[str, float]:
    """Fine, mid and chroma detail of an aligned face: medians over cheeks and forehead."""
    from scipy.ndimage import gaussian_filter

    eyes, middle = 0.4 * len(lab), 0.5 * len(lab)
    patches = [
        tuple(
            slice(int(start + a * between), int(start + b * between))
            for start, (a, b) in ((eyes, rows), (middle, columns))
        )
        for columns, rows in (
            ((-0.75, -0.3), (0.35, 0.8)),
            ((0.3, 0.75), (0.35, 0.8)),
            ((-0.4, 0.4), (-0.75, -0.45)),
        )
    ]
    smooth = [gaussian_filter(lab[..., c], 1.0) for c in range(3)]
    fine = lab[..., 0] - smooth[0]
    mid = smooth[0] - gaussian_filter(lab[..., 0], between / 10)
    chroma = np.hypot(*(smooth[c] - gaussian_filter(lab[..., c], between / 8) for c in (1, 2)))
    return {
        FINE: float(np.median([_spread(fine[p]) for p in patches])),
        MID: float(np.median([_spread(mid[p]) for p in patches])),
        CHROMA: float(np.median([np.median(chroma[p]) for p in patches])),
    }


def brow_slope(mesh: np.ndarray) -> float:
    """How far a brow's inner end lies above its middle, both on its upper contour: negative is a
    frown. From MediaPipe's mesh (478, 2), in distances of the outer corners of the eyes."""
    upper = MEDIAPIPE_70[17:27]
    return float((_heights(mesh, upper[[4, 5]]) - _heights(mesh, upper[[2, 7]])).mean())


def brow_to_lid(mesh: np.ndarray) -> float:
    """Height of the middle of the brows above the upper lids, in the same unit."""
    brows = [MEDIAPIPE_70[[19, 24]], MEDIAPIPE_LOWER_BROWS[[2, 7]]]
    brow = np.mean([_heights(mesh, points).mean() for points in brows])
    return float(brow - _heights(mesh, MEDIAPIPE_70[[37, 38, 43, 44]]).mean())


def _heights(mesh: np.ndarray, points: np.ndarray) -> np.ndarray:
    right, left = mesh[MEDIAPIPE_70[[36, 45]]]
    across = left - right
    return (mesh[points] - right) @ np.array([across[1], -across[0]]) / (across @ across)


def reads_negative(expression: dict[str, float]) -> bool:
    """Whether a pose frowns, sneers, worries or pulls the mouth down."""
    names = ("browDownLeft", "mouthFrownLeft", "noseSneerLeft", "browInnerUp")
    return max(expression.get(name, 0.0) for name in names) > 0.3


Figures = dict[str, float]
"""Values of rows of `AIMS`."""


def rows(figures: Figures) -> Iterator[tuple[str, str, str, str, str]]:
    for name, aim in AIMS.items():
        if name in figures:
            value = figures[name]
            held = aim.low <= value <= aim.high
            yield name, aim.photographs, aim.hold, aim.show(value), "yes" if held else "no"


def measure_portraits(
    frames: list[Frame], found: list[Face], recogniser: Recogniser, landmarker: FaceLandmarker
) -> Figures:
    """The figures of single pictures, one of each person."""
    values: Figures = {}
    values["YuNet's mean score"] = float(np.mean([face.box[14] for face in found]))
    eyes = np.median([np.linalg.norm(face.box[6:8] - face.box[4:6]) for face in found])
    for between in (38, 76):
        if eyes < 0.85 * between:  # nothing is learnt from pixels that are not there
            continue
        detail = [skin(recogniser.align(f.image, f.box, between), between) for f in found]
        for name in (FINE, MID, CHROMA):
            if f"{name}, {between} px" in AIMS:
                values[f"{name}, {between} px"] = float(np.median([d[name] for d in detail]))
    dark = [np.percentile(recogniser.lightness(frame.image), 1) for frame in frames]
    values["darkest 1 % of a picture, L*, median"] = float(np.median(dark))
    clipped = [(frame.image == 255).any(-1).mean() > 0.1 for frame in frames]
    values["pictures with over 10 % clipped pixels"] = float(np.mean(clipped))
    readings = [landmarker.read(frame) for frame in console.track(frames, "MediaPipe")]
    values["found by MediaPipe"] = float(np.mean([r is not None for r in readings]))
    meshes = [reading.mesh for reading in readings if reading is not None]
    values["brow slope"] = float(np.median([brow_slope(mesh) for mesh in meshes]))
    values["brow to lid"] = float(np.median([brow_to_lid(mesh) for mesh in meshes]))
    rng = np.random.default_rng(0)
    poses = [sample_pose(rng, PoseSettings()) for _ in range(POSES)]
    negative = np.mean([reads_negative(pose.expression) for pose in poses])
    values["default poses that read negative"] = float(negative)
    return values


def measure_identity(different: list[Face], same: list[Face], dlib: Dlib) -> Figures:
    """How alike `different` people are, and pictures of one person among `same`."""
    values: Figures = {}
    features = np.array([face.features for face in different])
    first, second = np.triu_indices(len(features), 1)
    others = (features @ features.T)[first, second]
    values["SFace, different people: mean"] = float(others.mean())
    values[f"SFace, pairs above {ONE_PERSON}"] = float((others > ONE_PERSON).mean())
    values["SFace, largest of all pairs"] = float(others.max())
    seen = np.array([dlib.recognise(f.image, f.box) for f in console.track(different, "dlib")])
    distance = np.linalg.norm(seen[first] - seen[second], axis=1)
    values[f"dlib, pairs below {DLIB_ONE_PERSON}"] = float((distance < DLIB_ONE_PERSON).mean())
    alike: dict[str, list[float]] = {"light": [], "view": [], "both": []}
    for i, a in enumerate(same):
        for b in same[i + 1 :]:
            if a.person == b.person:
                change = "light" if a.view == b.view else "view" if a.light == b.light else "both"
                alike[change].append(float(a.features @ b.features))
    for change in ("light", "view"):
        if alike[change]:
            values[f"SFace, one person, other {change}"] = float(np.mean(alike[change]))
    if ours := [cosine for found in alike.values() for cosine in found]:
        # The share of (same, different) pairs that are ordered right: the Mann-Whitney statistic.
        below = np.searchsorted(np.sort(others), ours) / len(others)
        values["SFace, one person against others: AUC"] = float(below.mean())
    return values


def measure(folder: Path, portraits_of: str, identities_of: str) -> Figures:
    """All figures of a dataset: of one subset single pictures, of another different people."""
    recogniser = Recogniser()
    portraits = list(pictures(open_dataset(folder, subset=portraits_of), portraits_of, recogniser))
    faces = [face for _, face in portraits if face is not None]
    subjects: dict[str, Frame] = {}
    for frame, _ in portraits:  # the first of each person comes first
        subjects.setdefault(frame.name.rpartition("_p")[0], frame)
    firsts = [face for face in faces if face.view == face.light == 0]
    landmarker = FaceLandmarker(fetch("face_landmarker"))
    figures = measure_portraits(list(subjects.values()), firsts, recogniser, landmarker)
    different = firsts
    if identities_of != portraits_of:
        identities = pictures(open_dataset(folder, subset=identities_of), identities_of, recogniser)
        different = [face for _, face in identities if face and face.view == face.light == 0]
    return figures | measure_identity(different, faces, Dlib())


def _spread(values: np.ndarray) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--portraits", default="portraits", help="the subset of single pictures")
    parser.add_argument("--identities", default="identities", help="that of different people")
    options = parser.parse_args()
    figures = measure(options.dataset, options.portraits, options.identities)
    report.table(["figure", "photographs", "hold", "measured", "held"], rows(figures))
    return 0


if __name__ == "__main__":
    sys.exit(report.in_one_line(main))
