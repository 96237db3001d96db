"""The pool of environments: bundled panoramas, a user's folder, procedural skies and studios.

The direction-pixel convention and the sign of a rotation are those of `conventions.panorama`.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import zlib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from assets_procedural.conventions.panorama_files import encode_header, read_header, write
from assets_procedural.conventions.panorama_reading import Missing, PanoramaError, read
from assets_procedural.light.sky import SkyParameters, sky, sky_rand
from assets_procedural.light.studio import StudioParameters, studio, studio_rand
from assets_procedural.settings import Interval, Settings, interval

BundledName = Literal[
    "city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset"
]

_AT_ONCE = min(4, os.cpu_count() or 1)  # panoramas that are made in parallel
_POLY_HAVEN = "https://polyhaven.com/a/"
BUNDLED: dict[str, str] = {
    "city": _POLY_HAVEN + "portland_landing_pad",
    "courtyard": _POLY_HAVEN + "courtyard",
    "forest": _POLY_HAVEN + "ninomaru_teien",
    "interior": _POLY_HAVEN + "hotel_room",
    "night": _POLY_HAVEN + "moonless_golf",
    "studio": _POLY_HAVEN + "studio_small_01",
    "sunrise": _POLY_HAVEN + "spruit_sunrise",
    "sunset": _POLY_HAVEN + "venice_sunset",
}
"""Bundled panorama to its origin, as the licence file beside them states it."""

PROCEDURAL_HEIGHT = 512
_HDR_SUFFIXES = (".exr", ".hdr")
_LDR_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")


class EnvironmentSettings(Settings):
    """The pool of environments that subjects are lit by, and how they are turned and exposed."""

    bundled: Literal["all"] | tuple[BundledName, ...] = "all"
    """Panoramas that come with the bpy wheel: "all", or a list of names; [] for none."""
    folder: Path | None = None
    """A folder of your own equirectangular .exr or .hdr files (not searched recursively)."""
    skies: int = Field(default=0, ge=0, le=10_000)
    """Number of procedural skies."""
    studios: int = Field(default=0, ge=0, le=10_000)
    """Number of procedural studio set-ups."""
    key_light: float = Field(default=0.75, ge=0.0, le=1.0)
    """Share of the uses of a panorama in which it is turned as a photographer would turn the
    sitter: its key falls on the face from a side, and the background does not glare. 0 if
    `rotation` is given and this is not."""
    rotation: Annotated[Interval, interval(-360.0, 360.0, "degrees")] = (0.0, 360.0)
    """Rotation about the vertical axis, degrees, drawn for the other uses."""
    exposure: Annotated[Interval, interval(-4.0, 4.0, "stops")] = (-0.5, 0.5)
    """Stops around the exposure metered on the face."""
    missing: Missing = "refuse"
    """What becomes of files in `folder` that leave a part of the sphere without pixels, such as a
    cropped ground: they are refused, or the part is black."""
    max_width: int = Field(default=2048, ge=64, le=16384)
    """Wider panoramas of `folder` are area-averaged down to this width, pixels."""

    @field_validator("bundled")
    @classmethod
    def _unique(cls, value: object) -> object:
        if isinstance(value, tuple) and len(set(value)) != len(value):
            raise ValueError("names a panorama twice")
        return value

    @model_validator(mode="after")
    def _as_given(self) -> EnvironmentSettings:
        """A job that says how panoramas are turned, as all did before `key_light`, means it."""
        if "rotation" in self.model_fields_set and "key_light" not in self.model_fields_set:
            object.__setattr__(self, "key_light", 0.0)  # it is frozen once it is made
        return self

    @model_validator(mode="after")
    def _some(self) -> EnvironmentSettings:
        if not (self.bundled or self.folder or self.skies or self.studios):
            raise ValueError("no environment: set bundled, folder, skies or studios")
        return self


class EnvironmentSpec(Settings):
    """One environment of a pool: what it is and where it comes from, but not its pixels."""

    id: str = Field(pattern=r"^[a-z0-9_]+$")
    """Name of its file and of its rows in a manifest."""
    kind: Literal["bundled", "file", "sky", "studio"]
    source: str
    """Web address, file name or generator."""
    author: str = ""
    licence: str
    parameters: dict[str, Any] = Field(default_factory=dict)
    """Of the generator, or how a file is read."""
    path: Path | None = Field(default=None, exclude=True)
    """Where the pixels are read from, on this machine."""


def pool(settings: EnvironmentSettings, seed: int) -> tuple[EnvironmentSpec, ...]:
    """All environments of a job, in a fixed order, each with a unique id.

    The n-th sky or studio depends on `seed` and n alone. Files are found, not read; the bundled
    ones have no `path` where bpy is not installed, so that such a pool can be planned with.

    Raises:
        PanoramaError: the folder is missing or holds no panorama.
    """
    names = tuple(BUNDLED) if settings.bundled == "all" else settings.bundled
    specs = []
    if names:
        folder = _bundled_folder()
        for name in names:
            specs.append(_bundled(name, folder))
    if settings.folder is not None:
        specs += _user_files(settings.folder, settings.max_width, settings.missing)
    for index in range(settings.skies):
        drawn: Settings = sky_rand(_stream(seed, "sky", index))
        specs.append(_procedural("sky", index, drawn))
    for index in range(settings.studios):
        drawn = studio_rand(_stream(seed, "studio", index))
        specs.append(_procedural("studio", index, drawn))
    return tuple(specs)


def panorama_of(spec: EnvironmentSpec) -> np.ndarray:
    """The pixels of an environment, (H, 2H, 3) float32 linear Rec.709.

    Raises:
        PanoramaError: its file cannot be used.
    """
    return _made(spec)[0]


def _made(spec: EnvironmentSpec) -> tuple[np.ndarray, dict[str, Any]]:
    """The pixels of an environment, and what reading its file applied."""
    if spec.kind == "sky":
        return sky(SkyParameters(**spec.parameters), PROCEDURAL_HEIGHT), {}
    if spec.kind == "studio":
        return studio(StudioParameters(**spec.parameters), PROCEDURAL_HEIGHT), {}
    return read(_file(spec), **spec.parameters)


def write_pool(specs: Iterable[EnvironmentSpec], folder: Path) -> list[Path]:
    """Store environments as `folder`/<id>.exr, each once; returns their paths.

    A file with the same provenance is kept, so an interrupted call can be repeated.

    Raises:
        PanoramaError: a user's file cannot be used.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths, rest = [], iter(specs)
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        # In batches, so that a caller who counts the specs can show progress.
        while some := list(islice(rest, _AT_ONCE)):
            paths += threads.map(partial(_store, folder), some)
    return paths


def _store(folder: Path, spec: EnvironmentSpec) -> Path:
    path = folder / f"{spec.id}.exr"
    header = _header(spec)
    if not (path.is_file() and _same_header(path, header)):
        pixels, facts = _made(spec)
        # How the bundled ones are read never changes.
        header |= {"environment_reading": facts} if spec.kind == "file" else {}
        write(path, pixels, header)
    return path


def provenance(spec: EnvironmentSpec) -> dict[str, Any]:
    """What is recorded about an environment, with the sha256 of its file if it comes from one.

    Raises:
        PanoramaError: its file is not on this machine.
    """
    entry = spec.model_dump(mode="json")
    if spec.kind in ("bundled", "file") and (path := _file(spec)).is_file():
        entry["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return entry


def _file(spec: EnvironmentSpec) -> Path:
    if spec.path is not None:
        return spec.path
    if spec.kind == "bundled":
        raise PanoramaError(
            "the bundled panoramas are part of bpy, which is not installed here: "
            "pip install 'totalediting[render]', or set environments.bundled = []"
        )
    raise PanoramaError(f"environment {spec.id}: its file is not known on this machine")


def _header(spec: EnvironmentSpec) -> dict[str, Any]:
    return {f"environment_{key}": value for key, value in provenance(spec).items()}


def _same_header(path: Path, header: dict[str, Any]) -> bool:
    try:
        found = read_header(path)
    except Exception:  # OpenEXR raises various types on a damaged file, which is then rewritten
        return False
    return all(found.get(key) == text for key, text in encode_header(header).items())


def _bundled_folder() -> Path | None:
    """Folder of the bpy wheel's panoramas, found without importing bpy; None without bpy."""
    module = importlib.util.find_spec("bpy")
    for root in (module.submodule_search_locations or []) if module else []:
        for folder in sorted(Path(root).glob("*/datafiles/studiolights/world")):
            return folder
    return None


def _bundled(name: str, folder: Path | None) -> EnvironmentSpec:
    return EnvironmentSpec(
        id=name,
        kind="bundled",
        source=BUNDLED[name],
        author="Greg Zaal (Poly Haven)",
        licence="CC0-1.0",
        path=None if folder is None else folder / f"{name}.exr",
    )


def _user_files(folder: Path, max_width: int, missing: Missing) -> list[EnvironmentSpec]:
    if not folder.is_dir():
        raise PanoramaError(f"{folder}: no such folder; environments.folder must be a folder")
    files = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    usable = [p for p in files if p.suffix.lower() in _HDR_SUFFIXES]
    if not usable:
        ldr = [p.name for p in files if p.suffix.lower() in _LDR_SUFFIXES]
        found = f"; {ldr[0]} is low dynamic range and cannot light a face" if ldr else ""
        raise PanoramaError(f"{folder}: holds no .exr or .hdr panorama{found}")
    specs: list[EnvironmentSpec] = []
    taken: set[str] = set()
    for path in usable:
        slug = re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_") or "panorama"
        name = f"user_{slug}"
        if name in taken:  # "a.exr" beside "a.hdr", or names that differ in punctuation only
            name += f"_{zlib.crc32(path.name.encode()):08x}"
        taken.add(name)
        specs.append(
            EnvironmentSpec(
                id=name,
                kind="file",
                source=path.name,
                licence="unspecified (supplied by the user)",
                parameters={"max_width": max_width} | _unless_default(missing),
                path=path,
            )
        )
    return specs


def _unless_default(missing: Missing) -> dict[str, str]:
    """Nothing by default, so that provenance reads as before there was a choice."""
    return {} if missing == "refuse" else {"missing": missing}


def _procedural(
    kind: Literal["sky", "studio"], index: int, parameters: Settings
) -> EnvironmentSpec:
    return EnvironmentSpec(
        id=f"{kind}_{index:04d}",
        kind=kind,
        source=f"assets_procedural.{kind}",
        licence="CC0-1.0",
        parameters=parameters.model_dump(mode="json"),
    )


def _stream(seed: int, kind: str, index: int) -> np.random.Generator:
    key = (zlib.crc32(kind.encode()), index)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
