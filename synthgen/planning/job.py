"""`JobSpec`: what a job file may say. What it gets when it says something else: `JobError`."""

from __future__ import annotations

import contextlib
import difflib
import json
import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from assets_procedural.conventions.camera import LANDMARK_MARGIN, SENSOR_MM
from assets_procedural.conventions.errors import one_line
from assets_procedural.light.pool import EnvironmentSettings
from assets_procedural.motion.poses import Mood, PoseSettings
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.settings import Interval, Settings, interval
from synthgen.errors import JobError, explain
from synthgen.planning.shipped_jobs import job_file


class SubsetSpec(Settings):
    """One subset of the dataset: S subjects, each under E environments."""

    kind: Literal["multiview", "video"]
    """multiview: one pose seen from `views` cameras; video: one camera, a track of `frames`."""
    subjects: int = Field(ge=1, le=1_000_000)
    """Number of subjects."""
    environments: int = Field(ge=1, le=100)
    """Environments per subject, all different."""
    views: int | None = Field(default=None, ge=1, le=1000)
    """Cameras per subject (multiview)."""
    frames: int | None = Field(default=None, ge=1, le=1000)
    """Poses per subject (video)."""
    moods: Annotated[tuple[Mood, ...], Field(min_length=1)] | None = None
    """What the frames show in turn, each whole, instead of a drawn motion (video)."""
    people_of: str | None = None
    """Another subset whose people these are: subject i is the same person, in the same split."""

    @model_validator(mode="after")
    def _count(self) -> SubsetSpec:
        wanted, other = ("views", "frames") if self.kind == "multiview" else ("frames", "views")
        if getattr(self, wanted) is None:
            raise ValueError(f'kind = "{self.kind}" needs {wanted}; add it')
        if getattr(self, other) is not None:
            raise ValueError(f'kind = "{self.kind}" has no {other}; remove it')
        if self.moods and self.kind != "video":
            raise ValueError(f'kind = "{self.kind}" has no moods; remove them')
        return self

    @property
    def shots(self) -> int:
        """Shots per subject."""
        return (self.views if self.kind == "multiview" else self.frames) or 0


RESERVED = ("manifest", "failed", "runs", "logs", "locks")
"""No subset may be called so: a dataset has folders, and a table, of these names beside those of
its subsets."""

HEAD_METRES = 0.25
"""A typical head, chin to crown."""
_DISTANCE = (0.3, 30.0)
_LANDMARK_REACH = 0.5 + LANDMARK_MARGIN


class CameraSettings(Settings):
    """Ranges of the cameras, drawn uniformly (the focal length uniformly in its logarithm).

    Angles are of the camera about the head and relative to the trunk, degrees.
    """

    focal_mm: Annotated[Interval, interval(10.0, 1000.0, "mm")] = (50.0, 105.0)
    """Focal length on a sensor 36 mm wide."""
    yaw: Annotated[Interval, interval(-180.0, 180.0, "degrees")] = (-60.0, 60.0)
    """0 is straight in front, positive towards the subject's left."""
    pitch: Annotated[Interval, interval(-80.0, 80.0, "degrees")] = (-15.0, 25.0)
    """Positive looks from above."""
    roll: Annotated[Interval, interval(-180.0, 180.0, "degrees")] = (-5.0, 5.0)
    """About the viewing direction, positive counter-clockwise as the photographer sees it."""
    fill: Annotated[Interval, interval(0.05, 1.5, "of the frame")] = (0.45, 0.6)
    """Height of the head as a share of the frame's height."""
    shift: Annotated[Interval, interval(-0.5, 0.5, "of the frame")] = (-0.03, 0.03)
    """Displacement of the head from the frame's centre, both ways, as a share of the frame."""

    @model_validator(mode="after")
    def _distance(self) -> CameraSettings:
        for focal, fill in ((self.focal_mm[0], self.fill[1]), (self.focal_mm[1], self.fill[0])):
            distance = self._metres(focal, fill)
            if not _DISTANCE[0] <= distance <= _DISTANCE[1]:
                change = "raise" if distance < _DISTANCE[0] else "lower"
                raise ValueError(
                    f"focal_mm = {focal:g} with fill = {fill:g} puts the camera {distance:.2g} m "
                    f"from the head, not {_DISTANCE[0]:g} to {_DISTANCE[1]:g}; {change} focal_mm "
                    f"or {'lower' if change == 'raise' else 'raise'} fill"
                )
        return self

    @model_validator(mode="after")
    def _in_frame(self) -> CameraSettings:
        fill, shift = self.fill[1], max(map(abs, self.shift))
        # The farthest landmark, the chin of an open mouth, over 120 people in random poses; it is
        # nearer than the head's centre, and so larger the nearer the camera is.
        reach = fill * (0.63 + 0.045 / self._metres(self.focal_mm[0], fill)) + shift
        if reach > _LANDMARK_REACH:
            raise ValueError(
                f"fill = {fill:g} with shift = {shift:g} puts landmarks {reach:.2g} of the frame "
                f"from its middle, more than {_LANDMARK_REACH:g}; lower fill or shift"
            )
        return self

    @staticmethod
    def _metres(focal_mm: float, fill: float) -> float:
        """Camera to a typical head, as `assets_procedural.conventions.camera.resolve` puts it."""
        return focal_mm / SENSOR_MM * HEAD_METRES / fill


_HEX = re.compile(r"#[0-9a-fA-F]{6}")


class ImageSettings(Settings):
    """What is stored of a picture."""

    background: str = "environment"
    """"environment", "transparent", or a colour as "#rrggbb"."""
    linear: bool = True
    """Store linear half-float EXR beside the 8-bit picture."""

    @field_validator("background")
    @classmethod
    def _background(cls, value: str) -> str:
        if value not in ("environment", "transparent") and not _HEX.fullmatch(value):
            raise ValueError('give "environment", "transparent" or a colour such as "#808080"')
        return value

    @property
    def background_colour(self) -> tuple[float, float, float] | None:
        """Display-referred sRGB in [0, 1] of a composited background, else None."""
        if not self.background.startswith("#"):
            return None
        r, g, b = bytes.fromhex(self.background[1:])
        return r / 255.0, g / 255.0, b / 255.0


class LensSettings(Settings):
    """What lens and sensor add to pictures; all off, so that linear light and pictures agree.

    Labels stay sharp, and `hdr_*.exr` is what it was before all but `f_number`.
    """

    f_number: float | None = Field(default=None, ge=0.5, le=64.0)
    """Depth of field, the focus on the pupils; unset: the subject is in focus everywhere."""
    bloom: float = Field(default=0.0, ge=0.0, le=0.5)
    """Share of the light that is scattered around bright places."""
    blur: float = Field(default=0.0, ge=0.0, le=5.0)
    """Standard deviation of the lens's softness, pixels."""
    grain: float = Field(default=0.0, ge=0.0, le=0.2)
    """Noise of a pixel of linear light 1."""
    sharpen: float = Field(default=0.0, ge=0.0, le=2.0)
    """Strength of the unsharp mask that cameras apply."""

    @property
    def changes_pictures(self) -> bool:
        """Whether a picture is more than D of each pixel's linear light."""
        return bool(self.bloom or self.blur or self.grain or self.sharpen)


class SplitSettings(Settings):
    """Shares of the subjects that are held out; the rest is for training."""

    validation: float = Field(default=0.05, ge=0.0, le=1.0)
    test: float = Field(default=0.05, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _sum(self) -> SplitSettings:
        if self.validation + self.test > 1.0:
            raise ValueError("validation + test exceed 1; lower one of them")
        return self


class JobSpec(Settings):
    """A whole job. Everything in the dataset follows from it and from the code's version."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_\-]{0,63}$")
    """Letters, digits, - and _; names the dataset in its card."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """The only source of randomness."""
    resolution: int = Field(default=512, ge=32, le=4096)
    """Width and height of the pictures, pixels."""
    samples: int = Field(default=16, ge=2, le=16384)
    """Light samples per pixel, before denoising."""
    light_basis: Literal["auto"] | bool = "auto"
    """Whether one pass serves all environments of a shot: auto where that costs less."""
    shard_megabytes: int = Field(default=1000, ge=1, le=100_000)
    """A shard holds as many whole subjects as are expected to fit in this."""
    shard_subjects: int | None = Field(default=None, ge=1)
    """Subjects per shard; overrides shard_megabytes."""
    subsets: dict[str, SubsetSpec] = Field(min_length=1)
    """Name to what it holds."""
    environments: EnvironmentSettings = EnvironmentSettings()
    people: PeopleSettings = PeopleSettings()
    poses: PoseSettings = PoseSettings()
    camera: CameraSettings = CameraSettings()
    image: ImageSettings = ImageSettings()
    lens: LensSettings = LensSettings()
    splits: SplitSettings = SplitSettings()

    @property
    def different_people(self) -> int:
        """How many there are: those that subsets share count once."""
        return sum(s.subjects for s in self.subsets.values() if s.people_of is None)

    @model_validator(mode="after")
    def _whole_pictures(self) -> JobSpec:
        if self.lens.changes_pictures and self.image.background != "environment":
            raise ValueError(
                'lens: bloom, blur, grain and sharpen need image.background = "environment"; '
                "leave them out"
            )
        return self

    @field_validator("subsets")
    @classmethod
    def _subset_names(cls, value: dict[str, SubsetSpec]) -> dict[str, SubsetSpec]:
        for name in value:
            if not re.fullmatch(r"[a-z][a-z0-9_]{0,31}", name):
                raise ValueError(f'"{name}" is no subset name; use a-z, 0-9 and _')
            if name in RESERVED:
                raise ValueError(f'"{name}" is no subset name: it has another meaning in a dataset')
        for name, subset in value.items():
            _check_people_of(name, subset, value)
        return value


def _check_people_of(name: str, subset: SubsetSpec, subsets: dict[str, SubsetSpec]) -> None:
    source = subset.people_of
    if source is None:
        return
    said = f'{name}.people_of = "{source}"'
    others = [n for n, s in subsets.items() if n != name and s.people_of is None]
    if source not in others:
        choose = f"choose from {', '.join(others)}" if others else "remove it"
        raise ValueError(f"{said} is no other subset with people of its own; {choose}")
    if subset.subjects > subsets[source].subjects:
        raise ValueError(
            f"{said} has {subsets[source].subjects} subjects, fewer than {subset.subjects}; "
            f"lower {name}.subjects to that, or raise the other"
        )


def load_job(job: str | Path, overrides: Sequence[str] = ()) -> JobSpec:
    """Read and validate a job: the path of a .toml file, or the name of a shipped one ("demo").

    `overrides` are "key=value" as `--set` takes them. A relative `environments.folder` or
    `poses.tracks` is taken from the job file's own folder and made absolute.

    Raises `JobError` on the first thing that is wrong.
    """
    path = job_file(job)
    try:
        data = _toml(path.read_text(encoding="utf-8-sig"))  # Windows' editors begin with a mark
    except FileNotFoundError:
        raise JobError(path, "", "no such job file", _nearest_job(path)) from None
    except OSError as error:
        raise JobError(path, "", "cannot be read", error.strerror or one_line(error)) from None
    except UnicodeDecodeError as error:
        raise JobError(path, "", "cannot be read as text", f"save it as UTF-8 ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise JobError(path, "", "is not valid TOML", one_line(error)) from None
    overridden = [_override(data, text) for text in overrides]
    spec = parse_job(data, path, overridden)
    folder = spec.environments.folder
    if folder is not None:
        folder = _absolute(folder, path, "environments.folder")
        spec = spec.model_copy(
            update={"environments": spec.environments.model_copy(update={"folder": folder})}
        )
    if spec.poses.tracks is not None:
        tracks = _absolute(spec.poses.tracks, path, "poses.tracks")
        spec = spec.model_copy(update={"poses": spec.poses.model_copy(update={"tracks": tracks})})
    return spec


def parse_job(data: dict[str, Any], file: str | Path, overridden: Iterable[str] = ()) -> JobSpec:
    """Validate plain data. Keys in `overridden` are reported as coming from `--set`."""
    try:
        # JSON mode, because strict mode would refuse TOML's lists where tuples are wanted.
        text = json.dumps(data, default=str)
    except (ValueError, RecursionError):  # hexadecimal may have more digits than decimal
        where = next(iter(overridden), "") and "--set"
        remedy = "a number is too long, or a value is nested too deeply"
        raise JobError(where or file, "", "", remedy) from None
    try:
        return JobSpec.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise explain(error, data, file, JobSpec, tuple(overridden)) from None


def _toml(text: str) -> dict[str, Any]:
    """`tomllib.loads`, which lets other errors through; this one raises `TOMLDecodeError` alone."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError("brackets are nested too deeply") from None
    except ValueError as error:  # a number of more than 4300 digits, a date that there is not
        reason = "a number is too long" if "digits" in str(error) else str(error)
        raise tomllib.TOMLDecodeError(reason) from None


def _absolute(folder: Path, job: Path, field: str) -> Path:
    """A folder that a job names: from the home of a user (~), or else from the job's own folder."""
    try:
        return (job.parent / folder.expanduser()).resolve()
    except RuntimeError:
        remedy = "there is no such user; give the folder's full path"
    except ValueError:
        remedy = "holds a null byte; give another"
    except OSError as error:  # links in a circle, a name that is too long
        remedy = error.strerror or one_line(error)
    raise JobError(job, field, json.dumps(str(folder)), remedy)


def _override(data: dict[str, Any], text: str) -> str:
    """Put "a.b=value" into `data`, return "a.b". The value is TOML, or else a bare string."""
    key, equals, raw = text.partition("=")
    key, raw = key.strip(), raw.strip()
    if not equals or not re.fullmatch(r"[\w\-]+(\.[\w\-]+)*", key):
        raise JobError("--set", "", text, "write key=value, for example --set samples=8")
    value: Any = raw
    with contextlib.suppress(tomllib.TOMLDecodeError):
        found = _toml(f"value = {raw}")
        value = found["value"] if len(found) == 1 else raw
    *tables, last = key.split(".")
    table = data
    for name in tables:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise JobError("--set", key, raw, f'"{name}" is a value, not a table')
    table[last] = value
    return key


def _nearest_job(path: Path) -> str:
    candidates = sorted(str(p) for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
    near = difflib.get_close_matches(str(path), candidates, n=1, cutoff=0.5)
    if near:
        return f'did you mean "{near[0]}"?'
    return "give the path of a .toml file, such as render_jobs/demo.toml"
