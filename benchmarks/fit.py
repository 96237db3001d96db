"""How well busts fitted to landmarks fit: rendered people against their truth, photographs and
clips against the landmarks themselves.

    python benchmarks/fit.py [--data DATA [--split test]] [--real FILE]... [--overlay FOLDER]

Of every picture of a dataset (all splits by default): how far the head's turn against the camera,
and the places of the face's vertices that the camera sees, are from the truth; mean absolute errors
beside those of the blendshapes as they are, of the curves that they are read by, and of one
constant answer, the medians of these pictures. The dataset's people must not be those that
`totalediting.faces.calibrate` has seen; which these were is printed.

Of each `--real` picture or video: the distance of landmarks from the bust's, and how expressions
go with MediaPipe's blendshapes. With
`--overlay`, pictures of fitted busts over what they were fitted to. Where MediaPipe is installed,
its own landmarks and turns of the head are compared, too. Needs the extra `edit`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import report
import torch
from detectors import FaceLandmarker, Frame
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from assets_procedural.conventions.errors import UserError
from assets_procedural.motion.poses import ARKIT_NAMES
from synthgen.dataset import open_dataset
from totalediting.data import frames, shots
from totalediting.editing.track import track
from totalediting.faces import correspondences, table
from totalediting.faces.fitting import BustFitter, Fits
from totalediting.faces.framing import on_grey
from totalediting.faces.landmarker import Face, Landmarker
from totalediting.geometry.rig import camera_of, constants, control_of
from totalediting.geometry.space import head_centre
from totalediting.geometry.tracking import Tracking
from totalediting.pretrained.fetch import fetch

SHOWN = (
    *("jawOpen", "mouthSmileLeft", "mouthSmileRight", "eyeBlinkLeft", "eyeBlinkRight"),
    *("browInnerUp", "browDownLeft", "mouthFrownLeft", "mouthPucker", "mouthFunnel"),
)
ANGLES = ("yaw", "pitch", "roll")
OVERLAYS, OVERLAY_SIDE = 6, 512  # of a video or dataset; pixels
MEDIAPIPE_EVERY = 8  # frames of a video


class Rendered:
    """Pictures of a dataset with their truth, and what was found in them."""

    def __init__(self, folder: Path, split: str | None) -> None:
        self.folder = folder
        fitter, landmarker = BustFitter(correspondences.load()), Landmarker()
        self.curves = fitter.found.shown
        self.pictures: list[np.ndarray] = []
        self.faces: list[Face] = []
        self.metas: list[dict[str, Any]] = []
        self.points: list[dict[str, np.ndarray]] = []
        fits: list[Fits] = []
        self.landmarks_ms: list[float] = []
        self.fit_ms: list[float] = []
        dataset = open_dataset(folder, split=split)
        for number in range(len(dataset)):
            stored = dataset.read(number, ("meta", "geometry"))
            names = tuple(f"rgb_{k:02d}" for k in range(len(stored["meta"]["environments"])))
            for picture in dataset.read(number, names).values():
                picture = on_grey(picture)
                with report.clock() as took:
                    found = landmarker.find(picture)
                if not found:
                    continue
                self.landmarks_ms.append(1e3 * took.cpu_seconds)
                points, blendshapes = found[0].landmarks[None], found[0].blendshapes[None]
                with report.clock() as took:
                    fits.append(fitter.fit(points, blendshapes, float(len(picture))))
                self.fit_ms.append(1e3 * took.cpu_seconds)
                self.pictures.append(picture)
                self.faces.append(found[0])
                self.metas.append(stored["meta"])
                self.points.append(stored["geometry"])
        self.found = joined([one.tracking for one in fits])
        self.residual = np.concatenate([one.residual for one in fits])
        truth = [shots.tracking(meta, torch.zeros(32)) for meta in self.metas]
        self.truth = Tracking(*(torch.stack(field) for field in zip(*truth, strict=True)))

    def show(self) -> None:
        """Print the tables."""
        people = {(meta["subset"], meta["subject"]) for meta in self.metas}
        print(f"{len(self.faces)} pictures of {len(people)} people of {self.folder}\n")
        turns, true_turns = turns_of(self.found), np.stack([true_turn(m) for m in self.metas])
        between = Rotation.from_matrix(turns.swapaxes(1, 2) @ true_turns).magnitude()
        ours, true = angles_of(turns), angles_of(true_turns)
        report.table(
            ["error", "mean", "median", "95 %"],
            [
                ["head against camera, °", *spread(np.degrees(between))],
                *([f"… {n}", *spread(abs(ours[:, k] - true[:, k]))] for k, n in enumerate(ANGLES)),
                [
                    "visible vertices of the face, % of the frame",
                    *spread(misplaced(self.found, self.metas, self.points)),
                ],
                ["landmarks from the bust's, % of the frame", *spread(100 * self.residual)],
            ],
        )
        self._show_fields()
        rows = []
        shown, fitted, read = self._expressions()
        for name in SHOWN:
            k = ARKIT_NAMES.index(name)
            rows.append([name, *(correlation(x[:, k], shown[:, k]) for x in (fitted, read))])
        for k, name in enumerate(ANGLES):
            rows.append([f"head {name} in the picture", correlation(ours[:, k], true[:, k]), ""])
        for k, name in enumerate(ANGLES[:2]):
            gazes = (self.found.gaze[:, k].numpy(), self.truth.gaze[:, k].numpy())
            rows.append([f"gaze {name}", correlation(*gazes), ""])
        report.table(["correlation with the truth", "fit", "MediaPipe"], rows)
        print(
            f"CPU ms a picture: landmarks {np.mean(self.landmarks_ms):.1f}, "
            f"fit {np.mean(self.fit_ms):.1f}\n"
        )

    def draw(self, folder: Path) -> None:
        for k in np.linspace(0, len(self.faces) - 1, OVERLAYS).astype(int):
            shown = Image.fromarray(self.pictures[k]).resize((OVERLAY_SIDE, OVERLAY_SIDE))
            draw(np.array(shown), row(self.found, k), folder / f"{self.folder.name}_{k:04d}.png")

    def _expressions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(B, 52) shown, fitted, and as MediaPipe reads them."""
        read = np.stack([face.blendshapes for face in self.faces])
        return self.truth.expression.numpy(), self.found.expression.numpy(), read

    def _show_fields(self) -> None:
        shown, fitted, read = self._expressions()
        answers = (fitted, self.curves(read), read, np.median(shown, 0))
        rows = [["expression, all 52", *(f"{abs(x - shown).mean():.4f}" for x in answers)]]
        for name in SHOWN:
            k = ARKIT_NAMES.index(name)
            errors = [f"{abs(x[..., k] - shown[:, k]).mean():.3f}" for x in answers]
            rows.append([f"… {name}", *errors])
        degrees = np.degrees(1.0)
        fields = {"gaze": degrees, "head": degrees, "camera_yaw_pitch_roll": degrees}
        fields |= {"focal_mm": 1.0, "fill": 100.0, "shift": 100.0}
        units = ("°", "°", "°", "mm", "% of the frame", "% of the frame")
        for (field, factor), unit in zip(fields.items(), units, strict=True):
            x, y = (factor * getattr(of, field).numpy() for of in (self.found, self.truth))
            constant = abs(y - np.median(y, 0)).mean()
            name = field.replace("_", " ")
            rows.append([f"{name}, {unit}", f"{abs(x - y).mean():.2f}", "", "", f"{constant:.2f}"])
        report.table(["mean absolute error", "fit", "curves", "MediaPipe", "median"], rows)


def of_real(path: Path, folder: Path | None) -> list[list[str]]:
    """Rows of a photograph or video; overlays into `folder`."""
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "fits.parquet"
        with report.clock() as took:
            track(path, out)
        found = table.read(out)
    mean, median, worst = spread(100 * found.residual)
    rows = [
        ["faces", str(len(found.source))],
        ["CPU ms a picture, start and all", f"{1e3 * took.cpu_seconds / len(found.frame):.0f}"],
        ["landmarks from the bust's, % of the frame: mean", mean],
        ["… median … 95 %", f"{median} … {worst}"],
    ]
    if len(found.source) > 2:
        fitted, read = found.tracking.expression.numpy(), found.blendshapes
        for name in SHOWN:
            k = ARKIT_NAMES.index(name)
            rows.append([f"{name}: correlation, 5 % … 95 %", *both(fitted[:, k], read[:, k])])
    if find_spec("mediapipe"):
        rows += beside_mediapipe(path, found)
    if folder is not None:
        chosen = np.linspace(0, len(found.frame) - 1, OVERLAYS).astype(int)
        for k, picture in pictures_of(path, found, set(chosen.tolist())).items():
            shown = cut(picture, found.square[k], OVERLAY_SIDE)
            draw(shown, row(found.tracking, k), folder / f"{path.stem}_{found.frame[k]:04d}.png")
    return rows


def beside_mediapipe(path: Path, found: table.FitTable) -> list[list[str]]:
    """Rows: our landmarks and turns of the head beside those of MediaPipe itself."""
    theirs, ours = FaceLandmarker(fetch("face_landmarker")), Landmarker()
    turns, angles, apart, scores = angles_of(turns_of(found.tracking)), [], [], []
    chosen = range(0, len(found.frame), MEDIAPIPE_EVERY)
    pictures = pictures_of(path, found, set(chosen))
    seen = []
    for k, picture in pictures.items():
        height, width = picture.shape[:2]
        anywhere = np.resize(np.array([[0.0, 0.0], [width, height]]), (70, 2))
        reading = theirs.read(Frame("", picture, anywhere, {}, np.zeros(3)))
        if reading is None or not (faces := ours.find(picture)):
            continue
        seen.append(k)
        angles.append(reading.angles)
        apart.append(np.linalg.norm(faces[0].landmarks[:, :2] - reading.mesh, axis=1))
        names = zip(ARKIT_NAMES, faces[0].blendshapes, strict=True)
        scores.append([abs(reading.blendshapes.get(name, 0.0) - score) for name, score in names])
    if not seen:
        return [["MediaPipe sees no face", ""]]
    rows = [
        ["pictures beside MediaPipe", str(len(seen))],
        ["landmarks from MediaPipe's own, px: mean", f"{np.mean(apart):.4f}"],
        ["… largest", f"{np.max(apart):.4f}"],
        ["blendshapes from MediaPipe's own: largest", f"{np.max(scores):.4f}"],
    ]
    if len(seen) > 2:
        for k, name in enumerate(ANGLES):
            rows.append(
                [f"head {name}, °: correlation", *both(turns[seen, k], np.stack(angles)[:, k])]
            )
    return rows


def pictures_of(path: Path, found: table.FitTable, chosen: set[int]) -> dict[int, np.ndarray]:
    """Pictures (H, W, 3) of a file, by row of its table."""
    if path.suffix.lower() in frames.PICTURES:
        stored, turn = frames.read_picture(path)
        return {0: turn.pixels(stored)}
    numbers = {int(found.frame[k]): k for k in sorted(chosen)}
    played = enumerate(frames.play_video(path, frames.index_video(path)))
    return {numbers[n]: picture for n, (_, picture) in played if n in numbers}


def both(ours: np.ndarray, theirs: np.ndarray) -> list[str]:
    """Correlation, and ranges of the fit and of MediaPipe."""
    ranges = ["{:.2f} … {:.2f}".format(*np.percentile(x, (5, 95))) for x in (ours, theirs)]
    return [correlation(ours, theirs), *ranges]


def cut(picture: np.ndarray, square: np.ndarray, side: int) -> np.ndarray:
    """(side, side, 3): a square (left, top, side) of a picture, black beyond it."""
    left, top, edge = square
    affine = (edge / side, 0, left, 0, edge / side, top)
    image = Image.fromarray(picture)
    return np.array(
        image.transform((side, side), Image.Transform.AFFINE, affine, Image.Resampling.BICUBIC)
    )


def draw(picture: np.ndarray, tracking: Tracking, path: Path) -> None:
    """The picture (S, S, 3), and the bust's visible quads over it."""
    control = control_of(tracking)
    frame, lens = (array[0].double().numpy() for array in camera_of(tracking, len(picture)))
    vertices = control.posed[0].double().numpy()
    places = projected(vertices, frame, lens)
    towards = ((frame[:3, 3] - vertices) * control.posed_normals[0].double().numpy()).sum(1)
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for quad in constants().quads.tolist():
        if (towards[quad] > 0).all():
            pen.polygon([tuple(places[i]) for i in quad], outline=(0, 255, 0))
    Image.fromarray(np.concatenate([picture, np.array(image)], 1)).save(path)


def joined(parts: list[Tracking]) -> Tracking:
    return Tracking(*map(torch.cat, zip(*parts, strict=True)))


def row(tracking: Tracking, number: int) -> Tracking:
    return Tracking(*(field[number : number + 1] for field in tracking))


def misplaced(
    tracking: Tracking, metas: list[dict[str, Any]], points: list[dict[str, np.ndarray]]
) -> np.ndarray:
    """(B,) mean distance in the picture of vertices of the face that the camera sees, %."""
    control = control_of(tracking)
    cameras, lenses = (array.double().numpy() for array in camera_of(tracking, 1))
    found = []
    for k, (meta, geometry) in enumerate(zip(metas, points, strict=True)):
        ours = projected(control.posed[k].double().numpy(), cameras[k], lenses[k])
        stored, vertices = meta["camera"], geometry["control_points"]
        frame = np.array(stored["camera_to_world"])
        true = projected(vertices, frame, np.array(stored["intrinsics"]) / stored["width"])
        towards = frame[:3, 3] - vertices
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        rest = geometry["control_points_canonical"]
        _, y, z = (rest - head_centre(geometry["landmarks_canonical"])).T
        face = (y < -0.04) & (z > -0.12) & (z < 0.06)
        seen = face & ((towards * geometry["control_normals"]).sum(1) > 0.2)
        found.append(100 * np.linalg.norm(ours - true, axis=1)[seen].mean())
    return np.array(found)


def turns_of(tracking: Tracking) -> np.ndarray:
    """(B, 3, 3) of the head, in the camera's axes."""
    cameras = camera_of(tracking, 1)[0][:, :3, :3].double().numpy()
    heads = Rotation.from_euler("xyz", tracking.head.double().numpy()).as_matrix()
    return cameras.swapaxes(1, 2) @ heads


def true_turn(meta: dict[str, Any]) -> np.ndarray:
    head = Rotation.from_euler("xyz", [meta["head"][name] for name in ("pitch", "roll", "yaw")])
    return np.array(meta["camera"]["camera_to_world"])[:3, :3].T @ head.as_matrix()


def angles_of(turns: np.ndarray) -> np.ndarray:
    """(B, 3) yaw, pitch, roll in degrees, as `detectors.angles_of`."""
    axes = turns @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    yaw = np.arctan2(axes[:, 0, 2], axes[:, 2, 2])
    pitch = np.arcsin(axes[:, 1, 2].clip(-1, 1))
    return np.degrees(np.stack([yaw, pitch, np.arctan2(axes[:, 1, 0], axes[:, 1, 1])], 1))


def projected(points: np.ndarray, frame: np.ndarray, lens: np.ndarray) -> np.ndarray:
    own = (points - frame[:3, 3]) @ frame[:3, :3]
    return lens[[0, 1], 2] + lens[0, 0] * own[:, :2] * [1, -1] / -own[:, 2:]


def spread(values: np.ndarray) -> list[str]:
    return [f"{x:.2f}" for x in (values.mean(), np.median(values), np.percentile(values, 95))]


def correlation(ours: np.ndarray, theirs: np.ndarray) -> str:
    if np.ptp(ours) == 0 or np.ptp(theirs) == 0:
        return "constant"
    return f"{np.corrcoef(ours, theirs)[0, 1]:.3f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, help="a dataset")
    parser.add_argument("--split", choices=shots.SPLITS)
    parser.add_argument("--real", type=Path, action="append", default=[], help="picture or video")
    parser.add_argument("--overlay", type=Path, help="folder of pictures to draw")
    options = parser.parse_args()
    try:
        if options.overlay is not None:
            options.overlay.mkdir(parents=True, exist_ok=True)
        print(f"landmarks' places were measured on {correspondences.load().source}\n")
        if options.data is not None:
            rendered = Rendered(options.data, options.split)
            rendered.show()
            if options.overlay is not None:
                rendered.draw(options.overlay)
        for path in options.real:
            rows = of_real(path, options.overlay)
            width = max(map(len, rows))
            header = [path.name, "", "fit", "MediaPipe"][:width]
            report.table(header, [one + [""] * (width - len(one)) for one in rows])
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
