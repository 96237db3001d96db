"""Edits from Python: a person's appearance, another's motion, another light.

    editor = Editor.load()
    edited = editor.edit("me.jpg", motion="smile.jpg", lighting="sunset.exr", rotate_light=40)
    Image.fromarray(edited.picture)

What does not change from one call to the next is kept: faces that were found, the warped picture,
lights that were read. So turning the light costs only shading.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from totalediting.editing import backgrounds, compose
from totalediting.editing.lights import OfPhotograph, Panorama
from totalediting.editing.motion import Rest, moved_off, rest_of, taken_over, with_expression
from totalediting.editing.sources import (
    PANORAMAS,
    Clip,
    Found,
    NoFaceError,
    face_of,
    read_clip,
    read_photograph,
)
from totalediting.editing.subject import Matting, Subject, subject_of
from totalediting.editing.track import Tracker
from totalediting.editing.warping import relight, warp
from totalediting.editing.warping.bust import View, bust_of
from totalediting.errors import InputError
from totalediting.faces.cameras import camera_angles, camera_axes
from totalediting.faces.matting import Matting as SelfieMatting
from totalediting.geometry.tracking import Tracking

Source = str | Path | np.ndarray
"""A picture's file, "DIR:KEY" for a shot of a dataset, or pixels (H, W, 3) uint8, sRGB."""
WIDEST_VIEW = 45.0
"""Degrees that a camera may be moved about the head."""
MOST_STOPS = 4.0
"""By which a person may be lit brighter or darker."""
_KEPT = 4  # of each kind
Made = TypeVar("Made")


class Pose(NamedTuple):
    """A subject in a motion, before a camera; light is not in it."""

    warped: warp.Warped
    was: np.ndarray
    """(S, S, 3) the light that its points were taken in."""
    view: View
    moved: bool


@dataclass(frozen=True, eq=False)
class Edited:
    """An edited photograph."""

    subject: Subject
    pose: Pose
    edit: compose.Edit
    light: relight.Levelled
    """What it is shown in."""
    source: Panorama | OfPhotograph | None
    """The light that was asked for; None: the photograph's own."""
    background: np.ndarray | None
    notes: tuple[str, ...]
    """What the user should know, in lines."""

    @cached_property
    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8, of the photograph's size."""
        return compose.composed(self.subject, self.edit, self.background)

    @cached_property
    def alpha(self) -> np.ndarray:
        """(H, W) uint8: where the person is."""
        return compose.alpha_of(self.subject, self.edit)


class Editor:
    """Edits photographs; made by `load`."""

    def __init__(self, tracker: Tracker, matting: Matting) -> None:
        self.tracker, self.matting = tracker, matting
        self._kept: dict[str, OrderedDict[Hashable, Any]] = {}

    @classmethod
    def load(cls, run: Path | str | None = None) -> Editor:
        """With the networks that find faces and people, fetched on first use.

        Raises:
            InputError: LiteRT is not installed; a trained `run` is given, which cannot edit yet.
            NetworkError: a network cannot be had.
        """
        if run is not None:
            raise InputError(f"run: {run}: trained runs do not edit photographs yet; leave it out")
        return cls(Tracker(), SelfieMatting())

    def edit(
        self,
        appearance: Source,
        motion: Source | Tracking | None = None,
        lighting: Source | None = None,
        *,
        rest: Rest | None = None,
        relative: bool = True,
        expression: Mapping[str, float] | None = None,
        view: tuple[float, float] = (0.0, 0.0),
        rotate_light: float = 0.0,
        exposure: float = 0.0,
        background: backgrounds.Background = "keep",
    ) -> Edited:
        """The person of `appearance` in another motion, light and view; what is None is its own.

        Args:
            appearance: the photograph; of several faces, the largest.
            motion: a photograph, or a frame's tracking out of `clip`.
            lighting: a panorama (.exr, .hdr), in the axes of the trunk, or a photograph.
            rest: how the motion's person looks at rest, as `Editor.clip` says.
            relative: the person moves off its own look as the motion's person does off its rest;
                without, it takes over expression and gaze as they are.
            expression: what is added to coefficients in [0, 1], by ARKit name, such as jawOpen.
            view: degrees that the camera goes to the person's left, and up, about the head.
            rotate_light: degrees that the light is turned about the vertical, counter-clockwise
                from above.
            exposure: stops by which the person is lit brighter.
            background: "keep", "blur", "light" (the panorama as the camera sees it, or the
                background of the photograph whose light it is), a colour, or a picture.

        Raises:
            InputError: one of these cannot be used.
        """
        subject = self.subject(appearance)
        notes = list(subject.notes)
        driver = None
        if isinstance(motion, Tracking):
            driver = motion
        elif motion is not None:
            found = self.face(motion)
            driver, notes = found.tracking, notes + found.notes
        light = None
        if lighting is not None:
            light = self._light(lighting, subject).turned(float(np.radians(rotate_light)))
            if isinstance(light, OfPhotograph):
                notes += self._lit(lighting).notes
        elif rotate_light:
            raise InputError("rotate_light: there is no light to turn; give lighting, too")
        backgrounds.check(background, light is not None)
        check_exposure("exposure", exposure)
        moved = with_expression(_moved(subject, driver, rest, relative), expression or {})
        pose = self._pose(subject, moved, view)
        shown_in = subject.light
        if light is not None:
            shown_in = relight.Levelled(light, subject.face_normals)
        shown = light if isinstance(light, Panorama) else None
        if light is not None and shown is None and lighting is not None:
            shown = self._lit(lighting)
        return Edited(
            subject,
            pose,
            _relit(pose, None if light is None and not pose.moved else shown_in, exposure),
            shown_in,
            light,
            self._background(background, subject, shown, pose.view),
            tuple(dict.fromkeys(notes)),
        )

    def clip(
        self, source: Path | str, done: Callable[[int, int], None] = lambda done, total: None
    ) -> tuple[Clip, Rest]:
        """The motion of a video, or of a folder of pictures, and how its person looks at rest: the
        median of its frames. `done` is called with the frames that are done, and all.

        Raises:
            InputError: it cannot be used.
        """

        def made() -> tuple[Clip, Rest]:
            clip = read_clip(self.tracker, Path(source), done)
            return clip, rest_of([one for one in clip.trackings if one is not None])

        return self._keep("clip", _identity(source), made)

    def face(self, source: Source) -> Found:
        """The largest face of a photograph."""
        return self._keep(
            "face",
            _identity(source),
            lambda: face_of(self.tracker, read_photograph(_as_source(source))),
        )

    def subject(self, source: Source) -> Subject:
        """A photograph, taken apart.

        Raises:
            InputError: it cannot be used, or shows no face.
        """

        def made() -> Subject:
            photograph = read_photograph(_as_source(source))
            return subject_of(photograph, face_of(self.tracker, photograph), self.matting)

        return self._keep("subject", _identity(source), made)

    def _light(self, source: Source, subject: Subject) -> Panorama | OfPhotograph:
        if not isinstance(source, np.ndarray) and Path(source).suffix.lower() in PANORAMAS:
            key = _identity(source)
            return self._keep("panorama", key, lambda: Panorama.read(Path(source)))
        other = self._lit(source)
        return OfPhotograph(other.light.light, other.axes @ subject.axes.T)

    def _lit(self, source: Source) -> Subject:
        """A photograph whose light is taken."""
        try:
            return self.subject(source)
        except NoFaceError as error:
            raise InputError(
                f"{error}; a panorama, whose light has no upper end, is an .exr or .hdr"
            ) from None

    def _pose(self, subject: Subject, tracking: Tracking, view: tuple[float, float]) -> Pose:
        moved = tracking is not subject.tracking or any(view)
        posed = b"".join(field.numpy().tobytes() for field in tracking) if moved else b""

        def made() -> Pose:
            camera = viewed(subject.portrait.view, *view)
            if moved:
                warped = warp.repose(subject.portrait, bust_of(tracking), camera)
            else:
                warped = warp.unmoved(subject.portrait)
            return Pose(warped, subject.light(warped.normals_before), camera, moved)

        return self._keep("pose", (subject, posed, view), made)

    def _background(
        self,
        background: backgrounds.Background,
        subject: Subject,
        light: Panorama | Subject | None,
        view: View,
    ) -> np.ndarray | None:
        lit = None
        if isinstance(background, str) and background == "light":
            lit = (light.path, light.turn) if isinstance(light, Panorama) else light
        key = (_identity(background), subject, lit, lit and view.frame.tobytes())
        return self._keep(
            "background", key, lambda: backgrounds.behind(background, subject, light, view)
        )

    def _keep(self, kind: str, key: Hashable, make: Callable[[], Made]) -> Made:
        """What was made before, or is made now; of a kind the last few are kept."""
        kept = self._kept.setdefault(kind, OrderedDict())
        if key not in kept:
            kept[key] = make()
            while len(kept) > _KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        return kept[key]


def check_view(name: str, angles: tuple[float, float]) -> None:
    """Raises `InputError` for yaw and pitch, degrees, beyond `WIDEST_VIEW`."""
    if not all(abs(angle) <= WIDEST_VIEW for angle in angles):
        raise InputError(
            f"{name}: {angles[0]:g},{angles[1]:g}: give degrees from {-WIDEST_VIEW:g} to "
            f"{WIDEST_VIEW:g}"
        )


def check_exposure(name: str, stops: float) -> None:
    """Raises `InputError` for stops beyond `MOST_STOPS`."""
    if not abs(stops) <= MOST_STOPS:
        raise InputError(f"{name}: {stops:g}: give stops from {-MOST_STOPS:g} to {MOST_STOPS:g}")


def viewed(view: View, yaw: float, pitch: float) -> View:
    """A camera moved about the head by degrees to the person's left, and up.

    Raises:
        InputError: farther than `WIDEST_VIEW`.
    """
    check_view("view", (yaw, pitch))
    if not yaw and not pitch:
        return view
    before = view.frame[:3, :3]
    angles = camera_angles(before) + np.radians([yaw, pitch, 0])
    after = camera_axes(angles[None])[0]
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = after, after @ before.T @ view.frame[:3, 3]
    return View(frame, view.focal)


def _moved(
    subject: Subject, driver: Tracking | None, rest: Rest | None, relative: bool
) -> Tracking:
    if driver is None:
        return subject.tracking
    if relative:
        return moved_off(subject.tracking, driver, rest)
    return taken_over(subject.tracking, driver)


def _relit(pose: Pose, light: relight.Levelled | None, exposure: float) -> compose.Edit:
    warped, ratio = pose.warped, None
    if light is not None:
        becomes = light(warped.normals)
        ratio = relight.ratio_of(warped.raster.covered, warped.skin, pose.was, becomes)
    if exposure:
        even = np.ones((*warped.matte.shape, 3)) if ratio is None else ratio
        ratio = even * 2.0**exposure
    return compose.Edit(warped.person if pose.moved else None, warped.matte, ratio)


def _as_source(source: Source) -> Path | np.ndarray:
    return source if isinstance(source, np.ndarray) else Path(source)


def _identity(source: Source) -> Hashable:
    """What tells a source from another, and from what a file was before."""
    if isinstance(source, np.ndarray):
        return source.shape, hashlib.blake2b(source.tobytes()).digest()
    path = Path(source)
    try:
        state = path.stat()
    except OSError:  # a shot of a dataset, a word, or nothing: whoever reads it says so
        return str(source)
    return str(path), state.st_mtime_ns, state.st_size
