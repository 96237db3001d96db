"""What an edit is made of: photographs, clips and shots of a dataset, found faces in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from scipy.spatial.transform import Rotation

from synthgen.dataset import open_dataset
from totalediting.data import frames
from totalediting.data.clips import VIDEOS
from totalediting.editing.track import Tracker, readable
from totalediting.editing.warping.bust import view_of
from totalediting.errors import InputError
from totalediting.faces.framing import FILL, on_grey
from totalediting.geometry.tracking import Tracking

PANORAMAS = (".exr", ".hdr")
MOST_FRAMES = 18_000
"""Of a clip: ten minutes at 30 frames a second."""
_SMALLEST = 40  # pixels of height of a head
_PROFILE = 50.0  # degrees that a face may be turned away
_RATE = 25.0  # frames a second of a folder of pictures


class NoFaceError(InputError):
    """A picture shows no face."""


class Photograph(NamedTuple):
    """A picture as it is shown."""

    name: str
    """For messages."""
    picture: np.ndarray
    """(H, W, 3) uint8."""
    matte: np.ndarray | None
    """(H, W) in [0, 1] where it is known."""


class Found(NamedTuple):
    """The largest face of a photograph."""

    tracking: Tracking
    square: np.ndarray
    """(3,) left, top, side in pixels: what `tracking` is about."""
    notes: list[str]
    """What the user should know, in lines."""


@dataclass(frozen=True)
class Clip:
    """A motion over time."""

    name: str
    trackings: list[Tracking | None]
    """Of every frame; None where no face was found."""
    seconds: list[float]
    """When each is shown."""
    path: Path
    notes: list[str]


def plays(source: Path) -> bool:
    """Whether a motion is a video or a folder of pictures, not one picture."""
    return source.suffix.lower() in VIDEOS or (source.is_dir() and not _is_dataset(source))


def read_photograph(source: Path | np.ndarray) -> Photograph:
    """A picture's file, a shot of a dataset by "DIR:KEY", or pixels (H, W, 3) uint8.

    Raises:
        InputError: it cannot be used.
    """
    if isinstance(source, np.ndarray):
        if source.ndim != 3 or source.shape[2] != 3 or source.dtype != np.uint8:
            raise InputError(
                f"a picture is (H, W, 3) uint8, not {source.shape} {source.dtype}; convert it"
            )
        return Photograph("the picture", source, None)
    if (shot := _shot_of(source)) is not None:
        return shot
    if source.is_dir():
        raise InputError(f"{source}: is a folder; give a picture, or DIR:KEY for a dataset's shot")
    if not source.exists():
        raise InputError(f"{source}: no such file; check the path")
    if source.suffix.lower() in VIDEOS:
        raise InputError(f"{source}: is a video; give a picture, such as one of its frames")
    with readable(source):
        stored, turn = frames.read_picture(source)
        return Photograph(str(source), turn.pixels(stored), None)


def face_of(tracker: Tracker, photograph: Photograph) -> Found:
    """Its largest face.

    Raises:
        InputError: there is none that could be worked with.
    """
    name, picture, _ = photograph
    found = tracker.pictures(iter([(name, 0, picture)]), whole=False)
    if not found.source:
        raise NoFaceError(f"{name}: no face found; give a picture of a face turned to the camera")
    square = found.square[0]
    face = FILL * float(square[2])
    if face < _SMALLEST:
        raise InputError(
            f"{name}: its head is {face:.0f} pixels high; give a picture of at least {_SMALLEST}"
        )
    notes = []
    if found.faces[0] > 1:
        notes.append(f"{name}: {found.faces[0]} faces; the largest is taken")
    away = turned_away(found.tracking)
    if away > _PROFILE:
        notes.append(f"{name}: the face is turned {away:.0f}° away; what it hides is guessed")
    return Found(found.tracking, square, notes)


def read_clip(tracker: Tracker, source: Path, done: Callable[[int, int], None]) -> Clip:
    """The motion of a video or of a folder of pictures in the order of their names.

    `done` is called with the number of frames that are done, and of all.

    Raises:
        InputError: it cannot be used.
    """
    if source.is_dir():
        return _folder(tracker, source, done)
    if not source.exists():
        raise InputError(f"{source}: no such file; check the path")
    with readable(source):
        index = frames.index_video(source)
        _check_length(source, len(index.pts))
        seconds = _times(source, index)
        found = tracker.video(source.name, source, lambda n: done(n, len(index.pts)))
    rows = {int(frame): row for row, frame in enumerate(found.frame)}
    notes = []
    if any(count > 1 for count in found.faces):
        notes.append(f"{source}: several faces; the largest is taken")
    trackings: list[Tracking | None] = [None] * len(index.pts)
    for number, row in rows.items():
        trackings[number] = Tracking(*(field[row : row + 1] for field in found.tracking))
    return _checked(Clip(str(source), trackings, seconds, source, notes))


def turned_away(tracking: Tracking) -> float:
    """Degrees between where a head (1, …) looks and its camera."""
    facing = head_in_camera(tracking) @ np.array([0.0, -1.0, 0.0])
    return float(np.degrees(np.arccos(np.clip(facing[2], -1, 1))))


def head_in_camera(tracking: Tracking) -> np.ndarray:
    """(3, 3) from the head's axes to the camera's, right, up and towards it, of a (1, …)."""
    head = Rotation.from_euler("xyz", tracking.head[0].double().numpy()).as_matrix()
    return view_of(tracking).frame[:3, :3].T @ head


def _folder(tracker: Tracker, source: Path, done: Callable[[int, int], None]) -> Clip:
    found = sorted(p for p in source.iterdir() if p.suffix.lower() in frames.PICTURES)
    found = [path for path in found if not frames.is_litter(path.name)]
    if not found:
        raise InputError(f"{source}: no picture in it; its pictures are the frames of a motion")
    _check_length(source, len(found))
    trackings: list[Tracking | None] = []
    for path in found:
        one = tracker.pictures(iter([(path.name, 0, read_photograph(path).picture)]), whole=False)
        trackings.append(one.tracking if one.source else None)
        done(len(trackings), len(found))
    seconds = [number / _RATE for number in range(len(found))]
    return _checked(Clip(str(source), trackings, seconds, source, []))


def _checked(clip: Clip) -> Clip:
    missing = sum(one is None for one in clip.trackings)
    if missing == len(clip.trackings):
        raise InputError(f"{clip.name}: no face found; give a video of a face turned to the camera")
    if missing:
        clip.notes.append(f"{clip.name}: no face in {missing} frames; there, the last one stays")
    return clip


def _check_length(source: Path, count: int) -> None:
    if not count:
        raise InputError(f"{source}: has no frames; give another file")
    if count > MOST_FRAMES:
        raise InputError(f"{source}: has {count:,} frames; cut it to at most {MOST_FRAMES:,}")


def _times(source: Path, index: frames.VideoIndex) -> list[float]:
    with av.open(str(source)) as container:
        base = container.streams[index.stream].time_base or Fraction(1, 1000)
    return [float((pts - index.pts[0]) * base) for pts in index.pts]


def _is_dataset(folder: Path) -> bool:
    return (folder / "dataset.json").is_file()


def _shot_of(source: Path) -> Photograph | None:
    """The shot that "DIR:KEY" names; None where it names none."""
    folder, colon, key = str(source).rpartition(":")
    if not colon or source.exists() or not Path(folder).is_dir():
        return None
    dataset = open_dataset(folder)
    try:
        read = dataset.read(key, ("rgb_00", "alpha"))
    except KeyError as error:
        raise InputError(
            f"{source}: {error.args[0]}; its first shot is {next(iter(dataset.keys()), 'none')}"
        ) from None
    picture = np.ascontiguousarray(on_grey(read["rgb_00"]))
    return Photograph(str(source), picture, read["alpha"].astype(np.float32) / 255)
