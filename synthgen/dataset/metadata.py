"""meta.json of a shot as it is read: the parts that readers rely on are looked at first.

Whoever wrote a dataset may have written anything; what passes here has names where names become
paths, and finite numbers in the shapes that cameras and pictures are drawn from. Everything else is
passed on as it is.
"""

from __future__ import annotations

import json
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from synthgen.dataset.folder import NAME

_Name = Annotated[str, Field(pattern=f"^{NAME.pattern}$")]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
_Row = Annotated[list[_Number], Field(min_length=4, max_length=4)]
_Point = Annotated[list[_Pixels], Field(min_length=2, max_length=2)]
_Numbers = dict[str, _Number]


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow")


class _Sample(_Part):
    yaw: _Number
    pitch: _Number
    roll: _Number
    focal_mm: Annotated[float, Field(gt=0, le=1e6)]
    fill: Annotated[float, Field(gt=0, le=1e6)]
    shift: _Point


class _Camera(_Part):
    camera_to_world: Annotated[list[_Row], Field(min_length=4, max_length=4)]
    intrinsics: Annotated[
        list[Annotated[list[_Number], Field(min_length=3, max_length=3)]],
        Field(min_length=3, max_length=3),
    ]
    width: Annotated[int, Field(ge=1, le=1 << 16)]
    height: Annotated[int, Field(ge=1, le=1 << 16)]
    sample: _Sample


class _Environment(_Part):
    id: _Name
    rotation: _Number
    exposure: _Number


class _Landmarks(_Part):
    points: Annotated[list[_Point], Field(max_length=1000)]
    visible: Annotated[list[bool], Field(max_length=1000)]


class _Hair(_Part):
    style: str


class _Person(_Part):
    age_years: _Number
    hair: _Hair


class _Meta(_Part):
    key: _Name
    subject: _Name
    subset: _Name
    kind: str
    split: str
    index: int
    camera: _Camera
    environments: Annotated[list[_Environment], Field(min_length=1, max_length=1000)]
    exposures: Annotated[list[_Number], Field(max_length=1000)]
    expression: _Numbers
    head: _Numbers
    gaze: _Numbers
    landmarks: _Landmarks
    person: _Person


def parse(data: bytes) -> dict[str, Any]:
    """The metadata of a shot, `person` parsed; `ValueError` with one line for what is no such."""
    meta = json.loads(data)
    if not isinstance(meta, dict) or not isinstance(meta.get("person"), str):
        raise ValueError("is no object with a person")
    meta["person"] = json.loads(meta["person"])
    try:
        checked = _Meta.model_validate(meta)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise ValueError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    if len(checked.landmarks.points) != len(checked.landmarks.visible):
        raise ValueError("landmarks: as many points as marks of visibility")
    return meta
