"""What the page of `totalediting demo` does, without the page: files in, pictures and lines out.

Foreign files are checked as they come in, within limits that keep an answer quick; what is kept of
a photograph is no larger than `SIDE`. All that is made lies in one folder, whose owner deletes it.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError
from PIL import Image

from assets_procedural.conventions import panorama_files, panorama_reading
from assets_procedural.conventions.colour import display, to_bytes
from assets_procedural.conventions.errors import UserError, one_line
from totalediting.data import frames
from totalediting.data.clips import VIDEOS
from totalediting.editing import decompose, output
from totalediting.editing.edit import Job, edit, held
from totalediting.editing.editor import Edited, Editor
from totalediting.editing.sources import PANORAMAS, read_photograph
from totalediting.editing.track import readable
from totalediting.errors import InputError

SIDE = 1280
"""Pixels of the longer side of a photograph, or panorama, that is worked on."""
MOST_BYTES = 64 << 20
"""Of an upload."""
MOST_FRAMES, MOST_FRAME_PIXELS = 300, 4096 * 2304
"""Of a clip, and of each of its frames."""
EXPRESSIONS = {
    "Open the mouth": ("jawOpen",),
    "Smile": ("mouthSmileLeft", "mouthSmileRight"),
    "Pucker": ("mouthPucker",),
    "Close the eyes": ("eyeBlinkLeft", "eyeBlinkRight"),
    "Raise the brows": ("browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    "Lower the brows": ("browDownLeft", "browDownRight"),
}
"""Of each slider, the coefficients."""
MOVES = ("the clip", "a turning light", "a swinging camera")
"""What a video may show."""
_MOST_DECODED = 1 << 30  # bytes of a panorama
_GREY = 0.35  # display-referred light that the middle of a shown panorama gets


@dataclass(frozen=True)
class Wish:
    """What a picture is to show; files as `Playground` accepted them."""

    appearance: Path | None = None
    motion: Path | None = None
    lighting: Path | None = None
    moment: float = 0.0
    """Of a clip, from 0 to 1."""
    rotate_light: float = 0.0
    exposure: float = 0.0
    view: tuple[float, float] = (0.0, 0.0)
    expression: dict[str, float] = field(default_factory=dict)
    """By slider."""
    background: str = "keep"

    @property
    def coefficients(self) -> dict[str, float]:
        """What the sliders add, by ARKit name."""
        return {
            name: amount
            for slider, amount in self.expression.items()
            if amount
            for name in EXPRESSIONS[slider]
        }

    @property
    def turn(self) -> float:
        """Degrees of the light, if there is one."""
        return self.rotate_light if self.lighting else 0.0

    @property
    def behind(self) -> str:
        """The background; that of a light is kept until there is one."""
        return "keep" if self.background == "light" and not self.lighting else self.background


class Playground:
    """An editor with what was put into it. One call at a time."""

    def __init__(self, editor: Editor, folder: Path) -> None:
        """`folder` is empty and takes what is made."""
        self.editor, self.folder = editor, folder
        self._numbers = itertools.count()

    def appearance(self, path: Path) -> tuple[Path, Path]:
        """A photograph to edit: what to edit from now on, and what to show of it.

        Raises:
            UserError: it cannot be used; so do all that follow.
        """
        kept = self._photograph(path)
        self.editor.subject(kept)
        return kept, kept

    def motion(self, path: Path) -> tuple[Path, Path]:
        """A photograph or clip that drives: what to use from now on, and what to show of it."""
        if path.suffix.lower() not in VIDEOS:
            kept = self._photograph(path)
            self.editor.face(kept)
            return kept, kept
        with readable(path):
            _check_clip(path)
            picture = next(frames.play_video(path, frames.index_video(path)))[1]
        self.editor.clip(path)
        return path, self._write(_small(picture), path.stem)

    def lighting(self, path: Path) -> tuple[Path, Path]:
        """A portrait or panorama that lights: what to use from now on, and what to show of it."""
        if path.suffix.lower() not in PANORAMAS:
            kept = self._photograph(path)
            self.editor.subject(kept)
            return kept, kept
        light, _ = panorama_reading.read(path, max_width=SIDE, largest=_MOST_DECODED)
        kept = self._new(f"{path.stem}.exr")
        panorama_files.write(kept, light, {})
        return kept, self._write(_shown(light), path.stem)

    def thumbnail(self, path: Path) -> Path:
        """What to show of an example, which may be a panorama."""
        if path.suffix.lower() not in PANORAMAS:
            return path
        return self._write(_shown(panorama_reading.load(path)), path.stem)

    def picture(self, wish: Wish) -> tuple[Path | None, list[str]]:
        """The edited picture, None without a photograph, and what the user should know."""
        if wish.appearance is None:
            return None, []
        edited = self._edited(wish)
        return self._write(edited.picture, "edited"), list(edited.notes)

    def layers(self, wish: Wish) -> list[tuple[Path, str]]:
        """What an edited picture is made of, each with its name."""
        if wish.appearance is None:
            raise InputError("appearance: there is no picture to take apart; give one")
        layers = decompose.layers(self._edited(wish))
        return [(self._write(to_bytes(layer), name), name) for name, layer in layers.items()]

    def video(self, wish: Wish, move: str) -> Path:
        """A video of one of `MOVES`."""
        if wish.appearance is None:
            raise InputError("appearance: there is no picture to move; give one")
        played = wish.motion is not None and wish.motion.suffix.lower() in VIDEOS
        if move == MOVES[0] and not played:
            raise InputError("motion: there is no clip; give a video")
        if move == MOVES[1] and wish.lighting is None:
            raise InputError("lighting: there is no light to turn; give a portrait or panorama")
        target = self._new("edited.mp4")
        job = Job(
            wish.appearance,
            target,
            wish.motion if move == MOVES[0] or not played else None,
            wish.lighting,
            background=wish.behind,
            view=wish.view,
            orbit=move == MOVES[2],
            rotate_light=wish.turn,
            spin=move == MOVES[1],
            expression=wish.coefficients,
            exposure=wish.exposure,
        )
        edit(job, self.editor)
        return target

    def _edited(self, wish: Wish) -> Edited:
        motion, rest = wish.motion, None
        if motion is not None and motion.suffix.lower() in VIDEOS:
            clip, rest = self.editor.clip(motion)
            trackings = held(clip.trackings)
            motion = trackings[round(wish.moment * (len(trackings) - 1))]
        assert wish.appearance is not None
        return self.editor.edit(
            wish.appearance,
            motion,
            wish.lighting,
            rest=rest,
            expression=wish.coefficients,
            view=wish.view,
            rotate_light=wish.turn,
            exposure=wish.exposure,
            background=wish.behind,
        )

    def _photograph(self, path: Path) -> Path:
        """A copy that is no larger than is worked on."""
        return self._write(_small(read_photograph(path).picture), path.stem)

    def said(self, error: UserError, path: Path | None = None) -> str:
        """An error as a line for who sees the page: without the folders of this machine."""
        line = re.sub(rf"{re.escape(str(self.folder))}/\d+/", "", one_line(error))
        return line if path is None else line.replace(str(path), path.name)

    def _write(self, picture: np.ndarray, name: str) -> Path:
        target = self._new(f"{name}.png")
        output.write_picture(target, picture)
        return target

    def _new(self, name: str) -> Path:
        """A file of this name, which may occur again."""
        folder = self.folder / f"{next(self._numbers):06d}"
        folder.mkdir()
        return folder / name


def _shown(light: np.ndarray) -> np.ndarray:
    """A panorama (H, 2H, 3), linear, as a picture, uint8."""
    middle = np.exp(np.log(light.mean(-1) + 1e-4).mean())
    return to_bytes(display(_GREY * light / middle))


def _small(picture: np.ndarray) -> np.ndarray:
    image = Image.fromarray(picture)
    image.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    return np.asarray(image)


def _check_clip(path: Path) -> None:
    """Raises `InputError`: it is longer or larger than is worked on."""
    try:
        with av.open(str(path)) as container:
            stream = frames.best_stream(container)
            width, height = stream.width, stream.height
    except FFmpegError as error:
        raise ValueError(f"{path.name}: {error.strerror}") from None
    if width * height > MOST_FRAME_PIXELS:
        raise InputError(
            f"{path}: its frames are {width} x {height} pixels; give at most 4096 x 2304"
        )
    count = len(frames.index_video(path).pts)
    if count > MOST_FRAMES:
        raise InputError(f"{path}: has {count:,} frames; cut it to at most {MOST_FRAMES}")
