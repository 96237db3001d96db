"""`totalediting edit`: from files to a picture, a video or a folder of pictures."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from assets_procedural.conventions import console
from totalediting.editing import backgrounds, decompose, output, sources
from totalediting.editing.editor import (
    WIDEST_VIEW,
    Edited,
    Editor,
    check_exposure,
    check_view,
)
from totalediting.editing.motion import Rest, check_expression
from totalediting.errors import InputError
from totalediting.geometry.tracking import Tracking

_ROUND = 100  # frames that an orbit or a turn of the light takes
_RATE = 25.0  # frames a second of these
_ORBIT = (25.0, 8.0)  # degrees that an orbit goes to either side, and up and down


@dataclass(frozen=True)
class Job:
    """What to make of which files."""

    appearance: Path
    out: Path
    motion: Path | None = None
    lighting: Path | None = None
    relative: bool = True
    background: str = "keep"
    view: tuple[float, float] = (0.0, 0.0)
    orbit: bool = False
    rotate_light: float = 0.0
    spin: bool = False
    decompose: Path | None = None
    expression: Mapping[str, float] = field(default_factory=dict)
    exposure: float = 0.0

    @property
    def plays(self) -> bool:
        """Whether there is more than one picture to show."""
        return self.orbit or self.spin or (self.motion is not None and sources.plays(self.motion))


@dataclass(frozen=True, eq=False)
class Frame:
    """What one picture of a sequence is to show."""

    seconds: float
    driver: Tracking | None
    view: tuple[float, float]
    rotate_light: float


def edit(job: Job, editor: Editor | None = None) -> list[str]:
    """Write what `job` asks for; what the user should know, in lines.

    Raises:
        InputError: a file or option that cannot be used.
        NetworkError: a network that cannot be had.
    """
    _check(job)
    editor = editor or Editor.load()
    if not job.plays:
        with console.progress("editing", 1) as advance:
            edited = _edited(editor, job, Frame(0.0, None, job.view, job.rotate_light), None)
            output.write_picture(job.out, edited.picture)
            advance(1, 1)
        if job.decompose is not None:
            decompose.write(job.decompose, edited)
        return list(edited.notes)
    return _played(editor, job)


def _played(editor: Editor, job: Job) -> list[str]:
    # Everything is read before the first picture is made.
    subject = editor.subject(job.appearance)
    rest, notes = None, []
    drivers: Sequence[Tracking | None] = [None]
    seconds = [k / _RATE for k in range(_ROUND)]
    if job.motion is not None and sources.plays(job.motion):
        with console.progress("tracking", None) as advance:
            clip, rest = editor.clip(job.motion, advance)
        drivers, seconds, notes = held(clip.trackings), clip.seconds, list(clip.notes)
    elif job.motion is not None:
        found = editor.face(job.motion)
        drivers, notes = [found.tracking], list(found.notes)
    plan = list(_plan(job, drivers, seconds))
    first = _edited(editor, job, plan[0], rest)

    def pictures() -> Iterator[np.ndarray]:
        for frame in console.track(plan, "editing"):
            yield _edited(editor, job, frame, rest).picture

    if job.out.suffix.lower() == ".mp4":
        sound = job.motion if job.motion is not None and job.motion.is_file() else None
        output.write_video(job.out, pictures(), seconds, subject.picture.shape, sound)
    else:
        output.write_folder(job.out, pictures())
    return list(dict.fromkeys([*first.notes, *notes]))


def _edited(editor: Editor, job: Job, frame: Frame, rest: Rest | None) -> Edited:
    motion = frame.driver
    if motion is None and job.motion is not None and not sources.plays(job.motion):
        motion = job.motion
    return editor.edit(
        job.appearance,
        motion,
        job.lighting,
        rest=rest,
        relative=job.relative,
        expression=job.expression,
        view=frame.view,
        rotate_light=frame.rotate_light,
        exposure=job.exposure,
        background=job.background,
    )


def _plan(job: Job, drivers: Sequence[Tracking | None], seconds: list[float]) -> Iterator[Frame]:
    for number, second in enumerate(seconds):
        share = number / len(seconds)
        yaw, pitch = job.view
        if job.orbit:
            yaw += _ORBIT[0] * np.sin(2 * np.pi * share)
            pitch += _ORBIT[1] * np.sin(4 * np.pi * share)
        view = tuple(float(np.clip(angle, -WIDEST_VIEW, WIDEST_VIEW)) for angle in (yaw, pitch))
        turn = job.rotate_light + (360.0 * share if job.spin else 0.0)
        driver = drivers[min(number, len(drivers) - 1)]
        yield Frame(second, driver, (view[0], view[1]), turn)


def held(trackings: list[Tracking | None]) -> list[Tracking]:
    """Of a clip: where there is no face, the last one; before the first, that one."""
    last = next(one for one in trackings if one is not None)
    every: list[Tracking] = []
    for one in trackings:
        last = last if one is None else one
        every.append(last)
    return every


def _check(job: Job) -> None:
    """What can be said before any network runs."""
    unchanged = job.motion is None and job.lighting is None and job.background == "keep"
    unchanged &= not (job.expression or job.exposure or any(job.view) or job.orbit)
    if unchanged and job.decompose is None:
        raise InputError(
            "edit: nothing to edit; give --motion, --lighting, --background, --expression, "
            "--exposure, --view, --orbit or --decompose"
        )
    if job.lighting is None and (job.spin or job.rotate_light):
        raise InputError("--rotate-light, --spin: there is no light to turn; give --lighting")
    check_view("--view", job.view)
    check_exposure("--exposure", job.exposure)
    check_expression("--expression", job.expression)
    backgrounds.check(job.background, job.lighting is not None)
    for path in (job.appearance, job.motion, job.lighting):
        if path is not None and not path.exists() and ":" not in str(path):
            raise InputError(f"{path}: no such file; check the path")
    suffix = job.out.suffix.lower()
    if job.plays and suffix not in (".mp4", ""):
        raise InputError(f"--out: {job.out}: is a sequence; give a name in .mp4, or of a folder")
    if not job.plays and suffix != ".png":
        raise InputError(f"--out: {job.out}: is one picture; give a name in .png")
    if job.plays and job.decompose is not None:
        raise InputError("--decompose: takes one picture apart; leave out what moves")
    _check_new("--out", job.out, folder=suffix == "")
    if job.decompose is not None:
        _check_new("--decompose", job.decompose, folder=True)
    for path in (job.appearance, job.motion, job.lighting):
        if path is not None and path.resolve() == job.out.resolve():
            raise InputError(f"--out: {job.out}: is also an input; give another name")


def _check_new(option: str, path: Path, folder: bool) -> None:
    parent = path.absolute().parent
    if not parent.is_dir():
        raise InputError(f"{option}: {path}: there is no folder {parent}; make it first")
    if not os.access(parent, os.W_OK):
        raise InputError(f"{option}: {path}: {parent} is not writable; give another folder")
    if folder and path.exists():
        raise InputError(f"{option}: {path}: is there already; delete it or give another name")
    if not folder and path.is_dir():
        raise InputError(f"{option}: {path}: is a folder; give a file's name")
