"""`totalediting track`: the busts of a picture, a folder, a video or a dataset, as one table.

Work is cut into units: a video is one, as its frames share a person; pictures and shots go by
`_AT_ONCE`. Every finished unit lies as a table in the folder OUT.parts; run again, only what is not
there yet is done, then all are joined and the folder goes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from av.error import FFmpegError

from assets_procedural.conventions import console
from assets_procedural.conventions.files import sha256, write_atomically
from synthgen.dataset import Dataset, open_dataset
from totalediting.data import frames
from totalediting.data.clips import VIDEOS
from totalediting.data.pairs import reason
from totalediting.errors import InputError
from totalediting.faces import correspondences, table
from totalediting.faces.clips import fit_clip
from totalediting.faces.fitting import BustFitter
from totalediting.faces.framing import on_grey, square_around
from totalediting.faces.landmarker import Face, Landmarker

_AT_ONCE = 16  # pictures or shots
_NAMED = 5  # pictures without a face that are named
_DAMAGE = (ValueError, OSError, FFmpegError)


@dataclass(frozen=True)
class Unit:
    """What is done at once: its pictures' number, and how."""

    name: str
    pictures: int
    make: Callable[[Callable[[int], None]], table.FitTable]
    """Fits all; calls what it gets with the number of pictures that are done."""


class Tracker:
    """Landmarker and fitter, and what they make of pictures and clips."""

    def __init__(self) -> None:
        """Raises `InputError` and `NetworkError` as `Landmarker`."""
        self.landmarker = Landmarker()
        self.fitter = BustFitter(correspondences.load())

    def pictures(
        self, pictures: Iterator[tuple[str, int, np.ndarray]], whole: bool
    ) -> table.FitTable:
        """Of pictures (source, frame, (H, W, 3) uint8), each by itself; `whole` ones are square,
        of others a square around the face is taken."""
        keys, faces, squares, counts = [], [], [], []
        for source, frame, picture in pictures:
            if not (found := self.landmarker.find(picture)):
                continue
            keys.append((source, frame))
            faces.append(found[0])
            counts.append(len(found))
            square = np.array([0.0, 0.0, len(picture)]) if whole else square_around(found[:1])
            squares.append(square)
        if not faces:
            return table.joined([])
        square = np.stack(squares)
        landmarks = np.stack([face.landmarks for face in faces]).astype(np.float64)
        landmarks[..., :2] -= square[:, None, :2]
        landmarks /= square[:, None, 2:]
        fits = self.fitter.fit(landmarks, np.stack([face.blendshapes for face in faces]), 1.0)
        return table.rows_of(keys, counts, faces, square, fits)

    def video(self, source: str, path: Path, done: Callable[[int], None]) -> table.FitTable:
        """Of a video of one person; frames without a face have no row."""
        index = frames.index_video(path)
        last: Face | None = None
        numbers, times, faces, counts = [], [], [], []
        for number, (seconds, picture) in enumerate(frames.play_video(path, index)):
            face, count = self.landmarker.follow(picture, last) if last else None, 1
            if face is None:
                found = self.landmarker.find(picture)
                face, count = (found[0] if found else None), len(found)
            if face is not None:
                numbers.append(number)
                times.append(seconds)
                faces.append(face)
                counts.append(count)
            last = face
            done(number + 1)
        if not faces:
            return table.joined([])
        square, fits = fit_clip(self.fitter, faces, times)
        squares = np.tile(square, (len(faces), 1))
        keys = [(source, n) for n in numbers]
        return table.rows_of(keys, counts, faces, squares, fits, times)


def track(source: Path, out: Path) -> list[str]:
    """Write the table of all that `source` shows to `out`; what the user should know, in lines.

    Raises:
        InputError: `source` or `out` cannot be used, or no face is found.
        NetworkError: as `Landmarker`.
    """
    if out.suffix.lower() != ".parquet":
        raise InputError(f"--out: {out}: is written as .parquet; give a name with that ending")
    if out.exists():
        raise InputError(f"--out: {out}: is there already; delete it or give another name")
    if not source.exists():
        raise InputError(f"{source}: no such file or folder; check the path")
    tracker = Tracker()
    units, keys = _units(tracker, source)
    parts = out.with_name(out.name + ".parts")
    _claim(parts, source, units)
    total, done = sum(unit.pictures for unit in units), 0
    with console.progress("tracking", total) as advance:
        for number, unit in enumerate(units):
            part = parts / f"{number:06d}.parquet"
            if not part.exists():
                start = done
                made = unit.make(lambda n, start=start: advance(start + n, total))
                table.write(part, made)
            done += unit.pictures
            advance(done, total)
    found = table.joined([table.read(parts / f"{n:06d}.parquet") for n in range(len(units))])
    if not found.source:
        shutil.rmtree(parts)
        raise InputError(f"{source}: no face found; give a picture of a face that is turned to it")
    table.write(out, found)
    shutil.rmtree(parts)
    return _notes(found, keys)


def _units(tracker: Tracker, source: Path) -> tuple[list[Unit], list[str]]:
    """What there is to do, and the sources that should be found in the end."""
    if (source / "dataset.json").exists():
        dataset = open_dataset(source)
        keys = dataset.keys()
        return [
            _shots(tracker, dataset, range(start, min(start + _AT_ONCE, len(keys))))
            for start in range(0, len(keys), _AT_ONCE)
        ], keys
    if source.is_file():
        found, root = [source], source.parent
    else:
        found, root = sorted(p for p in source.rglob("*") if p.is_file()), source
    found = [path for path in found if not frames.is_litter(path.name)]
    pictures = [path for path in found if path.suffix.lower() in frames.PICTURES]
    videos = [path for path in found if path.suffix.lower() in VIDEOS]
    if not pictures and not videos:
        raise InputError(
            f"{source}: no picture or video; pictures end in {', '.join(frames.PICTURES)}, "
            f"videos in {', '.join(VIDEOS)}"
        )
    names = {path: path.relative_to(root).as_posix() for path in pictures + videos}
    blocks = [pictures[k : k + _AT_ONCE] for k in range(0, len(pictures), _AT_ONCE)]
    units = [_pictures(tracker, {path: names[path] for path in block}) for block in blocks]
    units += [_video(tracker, path, names[path]) for path in videos]
    return units, list(names.values())


def _shots(tracker: Tracker, dataset: Dataset, numbers: range) -> Unit:
    keys = dataset.keys()

    def pictures(done: Callable[[int], None]) -> Iterator[tuple[str, int, np.ndarray]]:
        for count, number in enumerate(numbers):
            lights = len(dataset.read(number, ("meta",))["meta"]["environments"])
            stored = dataset.read(number, tuple(f"rgb_{k:02d}" for k in range(lights)))
            for light, picture in enumerate(stored.values()):
                yield keys[number], light, np.ascontiguousarray(on_grey(picture))
            done(count + 1)

    return Unit(
        f"{keys[numbers[0]]} …",
        len(numbers),
        lambda done: tracker.pictures(pictures(done), whole=True),
    )


def _pictures(tracker: Tracker, names: dict[Path, str]) -> Unit:
    def pictures(done: Callable[[int], None]) -> Iterator[tuple[str, int, np.ndarray]]:
        for count, (path, name) in enumerate(names.items()):
            with readable(path):
                stored, turn = frames.read_picture(path)
            yield name, 0, turn.pixels(stored)
            done(count + 1)

    return Unit(
        " ".join(names.values()),
        len(names),
        lambda done: tracker.pictures(pictures(done), whole=False),
    )


def _video(tracker: Tracker, path: Path, name: str) -> Unit:
    with readable(path):
        count = len(frames.index_video(path).pts)

    def make(done: Callable[[int], None]) -> table.FitTable:
        with readable(path):
            return tracker.video(name, path, done)

    return Unit(name, count, make)


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Says in one line why a file cannot be read."""
    try:
        yield
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(f"{path}: {reason(error)}; mend it or leave it out") from None


def _claim(parts: Path, source: Path, units: list[Unit]) -> None:
    """Makes the folder of finished units, or sees that it is of this work."""
    names = hashlib.sha256("\n".join(unit.name for unit in units).encode()).hexdigest()
    work = {"source": str(source.resolve()), "units": names}
    work["landmarks"] = sha256(correspondences.FILE)
    note = parts / "work.json"
    if not note.exists():
        write_atomically(note, json.dumps(work).encode())
    elif json.loads(note.read_bytes()) != work:
        raise InputError(f"{parts}: holds what was tracked of something else; delete it")


def _notes(found: table.FitTable, sources: list[str]) -> list[str]:
    """What the user should know of a finished table."""
    notes = []
    seen = set(found.source)
    missing = [name for name in sources if name not in seen]
    crowded = sorted({s for s, n in zip(found.source, found.faces, strict=True) if n > 1})
    for names, what in ((missing, "no face found"), (crowded, "several faces, the largest taken")):
        if names:
            more = f" and {len(names) - _NAMED:,} more" if len(names) > _NAMED else ""
            notes.append(f"{what}: {', '.join(names[:_NAMED])}{more}")
    return notes
