"""`JobSpec`: what a job file may say, and the one line a user gets when it says something else."""

from __future__ import annotations

import difflib
import json
import math
import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator

from assets_procedural.environment import EnvironmentSettings
from assets_procedural.motion import PoseSettings
from assets_procedural.person_sampling import PeopleSettings
from assets_procedural.settings import Interval, Settings, interval


class JobError(Exception):
    """Bad input, found before anything is rendered; `str()` is one line for the user.

    `file` is the job file, folder or command-line option, `field` the key in it, `value` what it
    says (already printable) and `remedy` what is wrong and what to do about it.
    """

    def __init__(self, file: str | Path, field: str, value: str, remedy: str) -> None:
        self.file, self.field, self.value, self.remedy = str(file), field, value, remedy
        where = f"{field} = {value}" if field and value else field or value
        super().__init__(": ".join(part for part in (self.file, where, remedy) if part))


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

    @model_validator(mode="after")
    def _count(self) -> SubsetSpec:
        wanted, other = ("views", "frames") if self.kind == "multiview" else ("frames", "views")
        if getattr(self, wanted) is None:
            raise ValueError(f'kind = "{self.kind}" needs {wanted}; add it')
        if getattr(self, other) is not None:
            raise ValueError(f'kind = "{self.kind}" has no {other}; remove it')
        return self

    @property
    def shots(self) -> int:
        """Shots per subject."""
        return (self.views if self.kind == "multiview" else self.frames) or 0


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
    splits: SplitSettings = SplitSettings()

    @field_validator("subsets")
    @classmethod
    def _subset_names(cls, value: dict[str, SubsetSpec]) -> dict[str, SubsetSpec]:
        for name in value:
            if not re.fullmatch(r"[a-z][a-z0-9_]{0,31}", name):
                raise ValueError(f'"{name}" is no subset name; use a-z, 0-9 and _')
        return value


def load_job(path: str | Path, overrides: Sequence[str] = ()) -> JobSpec:
    """Read and validate a job file; `overrides` are "key=value" as `--set` takes them.

    A relative `environments.folder` is taken from the job file's own folder and made absolute.

    Raises `JobError` on the first thing that is wrong.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise JobError(path, "", "no such job file", _nearest_job(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise JobError(path, "", "cannot be read as text", _oneline(error)) from None
    except tomllib.TOMLDecodeError as error:
        raise JobError(path, "", "is not valid TOML", _oneline(error)) from None
    overridden = [_override(data, text) for text in overrides]
    job = parse_job(data, path, overridden)
    folder = job.environments.folder
    if folder is not None:
        folder = (path.parent / folder.expanduser()).resolve()
        job = job.model_copy(
            update={"environments": job.environments.model_copy(update={"folder": folder})}
        )
    return job


def parse_job(data: dict[str, Any], file: str | Path, overridden: Iterable[str] = ()) -> JobSpec:
    """Validate plain data. Keys in `overridden` are reported as coming from `--set`."""
    try:
        # JSON mode, because strict mode would refuse TOML's lists where tuples are wanted.
        return JobSpec.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        raise _first_error(error, data, file, tuple(overridden)) from None


def _override(data: dict[str, Any], text: str) -> str:
    """Put "a.b=value" into `data`, return "a.b". The value is TOML, or else a bare string."""
    key, equals, raw = text.partition("=")
    key, raw = key.strip(), raw.strip()
    if not equals or not re.fullmatch(r"[\w\-]+(\.[\w\-]+)*", key):
        raise JobError("--set", "", text, "write key=value, for example --set samples=8")
    try:
        value = tomllib.loads(f"value = {raw}")["value"]
    except tomllib.TOMLDecodeError:
        value = raw
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


# --- from pydantic's list of errors to one line ---------------------------------------------

_REMEDIES = {
    "missing": "is missing; add it",
    "int_type": "give a whole number",
    "int_from_float": "give a whole number",
    "int_parsing_size": "the number is too large",
    "float_type": "give a number",
    "finite_number": "give a finite number",
    "bool_type": "give true or false",
    "string_type": 'give a text in "quotes"',
    "tuple_type": "give a list, such as [a, b]",
    "model_type": "give a table of settings",
    "model_attributes_type": "give a table of settings",
    "dict_type": "give a table of settings",
    "greater_than_equal": "give at least {ge:g}",
    "greater_than": "give more than {gt:g}",
    "less_than_equal": "give at most {le:g}",
    "less_than": "give less than {lt:g}",
    "literal_error": "choose {expected}",
    "string_pattern_mismatch": "use letters, digits, - and _, 64 at most",
}


def _first_error(
    error: ValidationError, data: dict[str, Any], file: str | Path, overridden: Sequence[str]
) -> JobError:
    found = [(_resolve(data, e["loc"]), e) for e in error.errors(include_url=False)]
    # A union reports every branch: the branch that got deepest into the value speaks. An unknown
    # key comes first, since it is often the reason why another one is missing.
    (keys, value), first = max(
        found, key=lambda f: (f[1]["type"] == "extra_forbidden", len(f[0][0]), _fits(*f))
    )
    field = _join(keys)
    kind, context = first["type"], first.get("ctx", {})
    if kind == "extra_forbidden":
        remedy = _unknown_key(keys)
    elif isinstance(value, float) and not math.isfinite(value):
        remedy = "give a finite number"
    elif kind == "value_error":
        remedy = str(context["error"])
    elif kind == "missing" and isinstance(keys[-1], int):
        field, value = _join(keys[:-1]), _at(data, keys[:-1])
        remedy = "give two numbers, [low, high]"
    elif kind == "too_long" or (kind == "tuple_type" and len(found) == 1):
        remedy = "give two numbers, [low, high]"
    elif kind == "literal_error" and context["expected"] == "'all'":
        remedy = 'choose "all" or a list of names'
    elif kind == "too_short" and field == "subsets":
        remedy = "a job needs at least one subset, such as [subsets.multiview]"
    elif kind in _REMEDIES:
        remedy = _REMEDIES[kind].format(**context)
    else:
        remedy = first["msg"]
    if kind == "literal_error" and isinstance(value, str):
        remedy = _suggest(value, re.findall(r"'([^']*)'", context["expected"])) + remedy
    if any(field == key or field.startswith(key + ".") for key in overridden):
        file = "--set"
    # A table would fill the line, and what is wrong is in it or missing from it.
    hidden = value is None or (isinstance(value, dict) and value)
    shown = "" if hidden else _show(value)
    return JobError(file, field or "the job", shown, remedy)


def _resolve(data: Any, loc: tuple[int | str, ...]) -> tuple[tuple[int | str, ...], Any]:
    """The keys of `loc` that exist in `data` (pydantic adds names of union branches) and value."""
    keys: list[int | str] = []
    for i, key in enumerate(loc):
        if isinstance(data, dict) and key in data:
            data = data[str(key)]
        elif isinstance(data, list) and isinstance(key, int) and key < len(data):
            data = data[key]
        elif i == len(loc) - 1 and isinstance(data, dict | list) and not _is_branch(key):
            data = None  # a missing key
        else:
            continue
        keys.append(key)
    return tuple(keys), data


def _is_branch(key: int | str) -> bool:
    return isinstance(key, str) and bool(re.search(r"[\[\]()'-]|^(str|int|float|bool)$", key))


def _fits(resolved: tuple[tuple[int | str, ...], Any], error: Any) -> bool:
    """Whether an error is about the value's content, not just about it being of another type."""
    wants_list = error["type"] in ("tuple_type", "list_type")
    is_list = isinstance(resolved[1], list)
    return not (wants_list or (error["type"] == "literal_error" and is_list))


def _join(keys: Sequence[int | str]) -> str:
    return ".".join(str(k) for k in keys)


def _at(data: Any, keys: Sequence[int | str]) -> Any:
    for key in keys:
        data = data[key]
    return data


def _unknown_key(keys: Sequence[int | str]) -> str:
    model: Any = JobSpec
    for key in keys[:-1]:
        model = SubsetSpec if model is dict else _model_of(model, str(key))
    known = list(model.model_fields)
    name = str(keys[-1])
    return "unknown key; " + (_suggest(name, known).strip() or "known are " + ", ".join(known))


def _model_of(model: type[BaseModel], key: str) -> Any:
    annotation = model.model_fields[key].annotation
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate if annotation is candidate else dict
    return dict


def _suggest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f'did you mean "{near[0]}"? ' if near else ""


def _show(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


def _oneline(error: Exception) -> str:
    return " ".join(str(error).split())
