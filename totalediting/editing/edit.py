"""`totalediting edit --engine warp`: a photograph in the motion of another, and in another light.

Of the photograph, the square around its largest face is worked on and put back; the rest stays as
it is. The motion's head turns against its camera as the photograph's then does against its own; its
expression and gaze are taken over as they are. A light is a panorama, in the axes of the trunk, or
a photograph of a face, as its camera saw it.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from assets_procedural.conventions import console, panorama_reading
from assets_procedural.conventions.colour import display, undisplay
from assets_procedural.conventions.files import replacing, write_atomically
from totalediting.data import frames
from totalediting.data.clips import VIDEOS
from totalediting.editing import relight, warp
from totalediting.editing.bust import View, bust_of, view_of
from totalediting.editing.track import Tracker, readable
from totalediting.errors import InputError
from totalediting.faces.matting import Matting
from totalediting.geometry.tracking import Tracking
from totalediting.light.lightmaps import bake

PANORAMAS = (".exr", ".hdr")
_WIDER = 1.3  # sides of the worked square, in those of the fitted one
_SIDES = (384, 1024)  # pixels that are worked on
_ROWS = 32  # of lightmaps
_RIM = 0.04  # of the square's side, over which it gives way to the picture around


@dataclass(frozen=True, eq=False)
class Subject:
    """A photograph with the square that is worked on."""

    picture: np.ndarray
    """(H, W, 3) uint8, whole."""
    square: np.ndarray
    """(3,) left, top and side, pixels of the picture."""
    tracking: Tracking
    portrait: warp.Portrait
    matte: np.ndarray
    """(S, S)."""


class WarpEngine:
    """Edits one photograph."""

    def __init__(self, appearance: Path) -> None:
        """Raises `InputError` and `NetworkError`: a file or network that cannot be used."""
        self.tracker, self.matting = Tracker(), Matting()
        self.subject = self._subject(appearance)
        self._background = _without_person(self.subject.portrait.picture, self.subject.matte)
        linear = undisplay(self.subject.portrait.picture)
        self._old = relight.light_of(self.subject.portrait, linear)
        self._new: relight.Light | None = None

    def light(self, path: Path) -> None:
        """Show all that follows in the light of a panorama or of another photograph."""
        if path.suffix.lower() in PANORAMAS:
            panorama = torch.from_numpy(panorama_reading.read(path)[0])
            self._new = relight.panorama_light(bake(panorama, _ROWS))
            return
        other = self._subject(path)
        light = relight.light_of(other.portrait, undisplay(other.portrait.picture))
        source, target = (s.portrait.view.frame[:3, :3] for s in (other, self.subject))
        self._new = relight.turned(light, source, target)

    def still(self) -> np.ndarray:
        """(H, W, 3) uint8: the photograph in its own motion."""
        return self.shown(self.subject.tracking)

    def moved(self, driver: Tracking) -> np.ndarray:
        """(H, W, 3) uint8: the photograph in the motion of a tracking (1, …)."""
        return self.shown(in_motion_of(self.subject.tracking, driver))

    def shown(self, tracking: Tracking) -> np.ndarray:
        """(H, W, 3) uint8: the photograph with the bust of a tracking (1, …)."""
        subject = self.subject
        warped = warp.repose(subject.portrait, bust_of(tracking), subject.matte)
        picture = warped.picture
        if self._new is not None or tracking is not subject.tracking:
            new = self._old if self._new is None else self._new
            linear = relight.relit(
                undisplay(picture),
                warped.raster.covered,
                (self._old, warped.normals_before),
                (new, warped.normals),
            )
            picture = display(linear)
        matte = warped.matte[..., None]
        picture = matte * picture + (1 - matte) * self._background
        return _put_back(subject, picture)

    def motions(self, path: Path, done: Callable[[int], None]) -> Iterator[Tracking | None]:
        """The motion of a photograph, or of every frame of a video; None where no face is."""
        if path.suffix.lower() not in VIDEOS:
            yield self._tracked(path)[1]
            return
        with readable(path):
            found = self.tracker.video(path.name, path, done)
            count = len(frames.index_video(path).pts)
        if not found.source:
            raise InputError(f"{path}: no face found; give a video of a face turned to it")
        rows = {int(frame): row for row, frame in enumerate(found.frame)}
        for number in range(count):
            row = rows.get(number)
            yield None if row is None else Tracking(*(f[row : row + 1] for f in found.tracking))

    def _tracked(self, path: Path) -> tuple[np.ndarray, Tracking, np.ndarray]:
        with readable(path):
            stored, turn = frames.read_picture(path)
        picture = turn.pixels(stored)
        found = self.tracker.pictures(iter([(path.name, 0, picture)]), whole=False)
        if not found.source:
            raise InputError(f"{path}: no face found; give a picture of a face turned to it")
        return picture, found.tracking, found.square[0]

    def _subject(self, path: Path) -> Subject:
        picture, tracking, fitted = self._tracked(path)
        square = np.append(fitted[:2] - (_WIDER - 1) / 2 * fitted[2], _WIDER * fitted[2])
        side = int(np.clip(round(square[2]), *_SIDES))
        view = view_of(tracking)
        cut = _cut(picture, square, side)
        portrait = warp.portrait_of(
            cut / 255, bust_of(tracking), View(view.frame, view.focal / _WIDER)
        )
        return Subject(picture, square, tracking, portrait, self.matting(cut))


def edit(appearance: Path, motion: Path | None, lighting: Path | None, out: Path) -> list[str]:
    """Write the edited photograph, or the video of its every frame; what the user should know.

    Raises:
        InputError: a file that cannot be used.
        NetworkError: a network that cannot be had.
    """
    if motion is None and lighting is None:
        raise InputError("edit: nothing to edit; give --motion, --lighting or both")
    plays = motion is not None and motion.suffix.lower() in VIDEOS
    wanted = ".mp4" if plays else ".png"
    if out.suffix.lower() != wanted:
        raise InputError(f"--out: {out}: is written as {wanted}; give a name with that ending")
    if not out.absolute().parent.is_dir():
        raise InputError(f"--out: {out}: there is no folder {out.parent}; make it first")
    engine = WarpEngine(appearance)
    if lighting is not None:
        engine.light(lighting)
    if motion is None:
        write_atomically(out, _png(engine.still()))
        return []
    with console.progress("tracking", None) as advance:
        tracked = list(engine.motions(motion, lambda done: advance(done, None)))
    if not plays:
        assert tracked[0] is not None
        write_atomically(out, _png(engine.moved(tracked[0])))
        return []
    with replacing(out) as file:
        shape = engine.subject.picture.shape
        _write_video(Path(file.name), motion, shape, _played(engine, tracked))
    missing = sum(one is None for one in tracked)
    return [f"{motion}: no face in {missing} frames; they stand still"] if missing else []


def _played(engine: WarpEngine, tracked: list[Tracking | None]) -> Iterator[np.ndarray]:
    """A picture for every frame; where no face is, the last one."""
    last = None
    for driver in console.track(tracked, "editing"):
        if last is None or driver is not None:
            last = engine.still() if driver is None else engine.moved(driver)
        yield last


def _write_video(
    path: Path, motion: Path, shape: tuple[int, ...], pictures: Iterator[np.ndarray]
) -> None:
    """H.264 at the rate of `motion`, of even width and height; silent."""
    with av.open(str(motion)) as source:
        rate = frames.best_stream(source).average_rate or 25
    with av.open(str(path), "w", format="mp4") as container:
        stream: Any = container.add_stream("h264", rate=rate, options={"crf": "18"})
        stream.pix_fmt = "yuv420p"
        height, width = (size - size % 2 for size in shape[:2])
        stream.height, stream.width = height, width
        for picture in pictures:
            shown = av.VideoFrame.from_ndarray(picture[:height, :width], format="rgb24")
            container.mux(stream.encode(shown))
        container.mux(stream.encode())


def _png(picture: np.ndarray) -> bytes:
    target = io.BytesIO()
    Image.fromarray(picture).save(target, "PNG")
    return target.getvalue()


def in_motion_of(subject: Tracking, driver: Tracking) -> Tracking:
    """A subject (1, …) with a driver's expression and gaze, its head turned against the camera as
    the driver's is."""
    from_driver = _axes(driver).T @ _turn(driver)
    head = Rotation.from_matrix(_axes(subject) @ from_driver).as_euler("xyz")
    return subject._replace(
        expression=driver.expression,
        gaze=driver.gaze,
        head=torch.from_numpy(head[None]).float(),
    )


def _axes(tracking: Tracking) -> np.ndarray:
    return view_of(tracking).frame[:3, :3]


def _turn(tracking: Tracking) -> np.ndarray:
    return Rotation.from_euler("xyz", tracking.head[0].double().numpy()).as_matrix()


def _cut(picture: np.ndarray, square: np.ndarray, side: int) -> np.ndarray:
    """(side, side, 3) uint8: a square of a picture, whose border goes on beyond it."""
    left, top, edge = square
    height, width = picture.shape[:2]
    beyond = max(-left, -top, left + edge - width, top + edge - height, 0)
    margin = int(np.ceil(beyond)) + 2
    padded = np.pad(picture, ((margin, margin), (margin, margin), (0, 0)), "edge")
    box = (left + margin, top + margin, left + margin + edge, top + margin + edge)
    image = Image.fromarray(padded).resize((side, side), Image.Resampling.BICUBIC, box=box)
    return np.asarray(image)


def _put_back(subject: Subject, picture: np.ndarray) -> np.ndarray:
    """The whole photograph (H, W, 3) uint8 with a square (S, S, 3) in [0, 1] put into it."""
    left, top, edge = subject.square
    whole = subject.picture.astype(np.float64)
    height, width = whole.shape[:2]
    x0, y0 = max(int(np.ceil(left)), 0), max(int(np.ceil(top)), 0)
    x1, y1 = min(int(left + edge), width), min(int(top + edge), height)
    side = len(picture)
    corners = np.array([x0, y0, x1, y1]) - [left, top, left, top]
    box = tuple((corners * side / edge).tolist())
    planes = [
        Image.fromarray(picture[..., k].astype(np.float32)).resize(
            (x1 - x0, y1 - y0), Image.Resampling.BICUBIC, box=box
        )
        for k in range(3)
    ]
    inside = np.stack([np.asarray(plane) for plane in planes], -1)
    x, y = np.arange(x0, x1) + 0.5 - left, np.arange(y0, y1) + 0.5 - top
    rim = np.minimum.outer(np.minimum(y, edge - y), np.minimum(x, edge - x)) / edge
    share = np.clip(rim / _RIM, 0, 1)[..., None]
    part = whole[y0:y1, x0:x1]
    whole[y0:y1, x0:x1] = (1 - share) * part + share * 255 * inside.clip(0, 1)
    return np.rint(whole).astype(np.uint8)


def _without_person(picture: np.ndarray, matte: np.ndarray) -> np.ndarray:
    """(S, S, 3) the background; behind the person, what is around, ever softer."""
    known = (matte < 0.02).astype(np.float64)
    found, trust = picture.copy(), np.ones(matte.shape)
    side = len(picture)
    for width in (side / 6, side / 12, side / 24, side / 48, side / 96):
        share = gaussian_filter(known, width)
        mean = np.stack([gaussian_filter(known * picture[..., k], width) for k in range(3)], -1)
        mean /= share.clip(1e-9)[..., None]
        found += trust[..., None] * (mean - found)
        trust = np.clip(share / 0.3, 0, 1)
    return known[..., None] * picture + (1 - known[..., None]) * found
