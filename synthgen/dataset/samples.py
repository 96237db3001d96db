"""Shots as plain arrays for training: a map-style view, and a decoder for streams of shards.

    samples = open_dataset("out/demo").samples(("rgb_00", "parts", "camera"))
    stream = WebDataset(shards).decode(decoder).to_tuple("rgb_00.png", "parts.png", "aov.exr")
    loader = DataLoader(samples, batch_size=8, num_workers=2)  # or of the stream

torch's default collate takes both as they are; torch itself is not imported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np

from assets_procedural.motion.poses import ARKIT_NAMES
from synthgen.dataset.folder import StorageError
from synthgen.dataset.passes import AOV_MEMBER, PASSES
from synthgen.dataset.shards import MEMBER_OF, decode_fields

Sample = dict[str, Any]

GEOMETRY = (
    "landmarks",
    "landmarks_canonical",
    "control_points",
    "control_points_canonical",
    "control_normals",
    "control_normals_canonical",
    "joints",
)
"""Arrays of `shot.geometry` that are fields of their own."""


def _floats(value: Any) -> np.ndarray:
    return np.asarray(value, np.float32)


_OF_META: dict[str, Callable[[dict[str, Any]], Any]] = {
    "key": lambda m: f"{m['subset']}/{m['key']}",
    "camera": lambda m: {
        "camera_to_world": _floats(m["camera"]["camera_to_world"]),
        "intrinsics": _floats(m["camera"]["intrinsics"]),
    },
    "expression": lambda m: _floats([m["expression"][name] for name in ARKIT_NAMES]),
    "head": lambda m: _floats([m["head"][axis] for axis in ("pitch", "roll", "yaw")]),
    "gaze": lambda m: _floats([m["gaze"][axis] for axis in ("yaw", "pitch")]),
    "landmarks_2d": lambda m: _floats(m["landmarks"]["points"]),
    "landmarks_visible": lambda m: np.asarray(m["landmarks"]["visible"], bool),
    "exposures": lambda m: _floats(m["exposures"]),
}
FIELDS = (
    *("rgb", "hdr", "rgb_00", "hdr_00"),
    *(p.name for p in PASSES),
    *GEOMETRY,
    *_OF_META,
)
"""What a sample may hold, and `rgb_01`, `hdr_01` … as far as there are environments."""
_LIGHT = re.compile(r"(rgb|hdr)_(\d{2,})")


class Shots(Protocol):
    """What samples are made of: `synthgen.dataset.Dataset`."""

    def __len__(self) -> int: ...

    def read(self, which: int | str, fields: tuple[str, ...]) -> dict[str, Any]: ...

    def lights(self) -> int: ...


class Samples:
    """Chosen fields of every shot, as arrays that own their memory; made by `Dataset.samples`.

    `samples[i]` is a dictionary of the fields in the order in which they were asked for. All
    samples of a subset have the same shapes and types, so that they can be stacked:

    rgb_00, hdr_00 …       the picture in one light, as in `Shot`; rgb, hdr: (E, …), in all lights
    albedo, depth, parts … every pass, as in `Shot`: ids stay ids, depth stays metres
    landmarks, joints …    the arrays of `shot.geometry` by their names (`GEOMETRY`)
    camera                 {"camera_to_world": (4, 4), "intrinsics": (3, 3)} float32
    expression             (52,) float32, in the order of ARKIT_NAMES
    head, gaze             (3,) pitch, roll, yaw and (2,) yaw, pitch, radians, float32
    landmarks_2d           (70, 2) float32, pixels; landmarks_visible: (70,) bool
    exposures              (E,) float32
    key                    "<subset>/<key>", a str

    Only what the fields take is read and decoded. Instances may be sent to other processes.
    Raises `StorageError` for a field that there is not.
    """

    def __init__(self, shots: Shots, fields: tuple[str, ...]) -> None:
        if not fields:
            raise StorageError(f"fields: none is named; choose from {', '.join(FIELDS)}")
        for field in fields:
            _check(field, shots.lights())
        self.shots, self.fields = shots, fields
        lights = range(shots.lights())
        self._parts = {f: _parts(f, lights) for f in fields}
        self._read = tuple(dict.fromkeys(part for parts in self._parts.values() for part in parts))

    def __len__(self) -> int:
        return len(self.shots)

    def __getitem__(self, position: int) -> Sample:
        read = self.shots.read(position, self._read)
        return {f: _value(f, [read[part] for part in self._parts[f]]) for f in self.fields}

    def __iter__(self) -> Iterator[Sample]:
        return (self[position] for position in range(len(self)))


def _check(field: str, lights: int) -> None:
    if light := _LIGHT.fullmatch(field):
        if int(light[2]) < lights:
            return
        raise StorageError(f"fields: no {field}; these shots have {lights} lights, from 00 on")
    if field not in FIELDS:
        raise StorageError(f"fields: no {field}; choose from {', '.join(FIELDS)}")


def _parts(field: str, lights: range) -> tuple[str, ...]:
    """The fields of `Dataset.read` that one of a sample is made of."""
    if field in ("rgb", "hdr"):
        return tuple(f"{field}_{light:02d}" for light in lights)
    if field in GEOMETRY:
        return ("geometry",)
    return ("meta",) if field in _OF_META else (field,)


def _value(field: str, parts: list[Any]) -> Any:
    if field in ("rgb", "hdr"):
        return np.stack(parts)
    if field in _OF_META:
        return _OF_META[field](parts[0])
    return _owned(parts[0][field] if field in GEOMETRY else parts[0])


def _owned(array: np.ndarray) -> np.ndarray:
    """The array, or a copy where it may not be written: torch warns of such memory."""
    return np.require(array, requirements=["C", "W"])


_MEMBERS = {*MEMBER_OF.values()}


def decoder(name: str, data: bytes) -> Any:
    """Decode one member of a sample; None for a name that is none of a dataset's.

    `name` is what follows the key, such as "rgb_00.png", with or without a dot before it, so that
    `webdataset.WebDataset(...).decode(decoder)` takes it. Pictures and passes become arrays as
    `Shot` has them, aov.exr and geometry.npz dictionaries of named arrays, meta.json a dictionary.

    Raises `ValueError` for damaged bytes.
    """
    member = name.removeprefix(".")
    stem, _, extension = member.rpartition(".")
    picture = _LIGHT.fullmatch(stem) and extension in ("png", "exr")
    if not picture and member not in _MEMBERS:
        return None
    fields = decode_fields({member: bytes(data)})
    if member == AOV_MEMBER:
        return {field: _owned(array) for field, array in fields.items()}
    value = fields[stem]
    return _owned(value) if isinstance(value, np.ndarray) else value
