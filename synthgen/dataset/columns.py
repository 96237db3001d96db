"""Columns of the manifest: a row from a shot's metadata, and their SQL types.

Identity (key, subject, subset, kind, split, …), place (shard, offset, size, members),
`environments`, their `environment_rotation` (radians) and `environment_exposure` (stops), the
linear factors `exposures`, `camera_*`, `head_*`, `gaze_*`, `expression_<ARKit name>`, `person_*`,
`quality_*`, and `cost_*` in seconds: the only columns that differ between two runs of a job.
"""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel

from assets_procedural.conventions.camera import CameraSample
from assets_procedural.motion.poses import ARKIT_NAMES
from assets_procedural.person import Person
from synthgen.dataset.database import COLUMN
from synthgen.dataset.folder import brief

PHENOTYPES = (
    *("gender", "age", "muscle", "weight", "height", "proportions", "cupsize", "firmness"),
    *("african", "asian", "caucasian"),
)
# Column name -> DuckDB type.
IDENTITY = {
    "key": "VARCHAR",
    "subject": "VARCHAR",
    "subset": "VARCHAR",
    "kind": "VARCHAR",
    "split": "VARCHAR",
    "index": "BIGINT",
    "pose": "INTEGER",
    "view": "INTEGER",
    "seed_subject": "BIGINT",
    "seed_shot": "BIGINT",
    "width": "INTEGER",
    "height": "INTEGER",
}
PLACE = {
    "shard": "VARCHAR",
    "offset": "BIGINT",
    "size": "BIGINT",
    "members": 'STRUCT("name" VARCHAR, "offset" BIGINT, "size" BIGINT)[]',
    "mesh": "VARCHAR",
    "mesh_sha256": "VARCHAR",
}
LIGHT = {
    "environments": "VARCHAR[]",
    "environment_rotation": "DOUBLE[]",
    "environment_exposure": "DOUBLE[]",
    "exposures": "DOUBLE[]",
}

MOTION = {"motion_table": "VARCHAR", "motion_source": "VARCHAR", "motion_seconds": "DOUBLE"}


def row(
    meta: dict[str, Any],
    quality: dict[str, float],
    cost: dict[str, float],
    place: dict[str, Any],
) -> dict[str, Any]:
    """The manifest row of a shot from its metadata; `place` gives the columns of `PLACE`."""
    camera = meta["camera"]
    result = {name: meta[name] for name in IDENTITY if name in meta}
    result |= {f"seed_{name}": meta["seeds"][name] for name in ("subject", "shot")}
    result |= {"width": camera["width"], "height": camera["height"]} | place
    uses = meta["environments"]
    result["environments"] = [use["id"] for use in uses]
    result["environment_rotation"] = [use["rotation"] for use in uses]
    result["environment_exposure"] = [use["exposure"] for use in uses]
    result["exposures"] = meta["exposures"]
    result |= _flatten("motion", meta.get("motion", {}))
    result |= _flatten("camera", camera["sample"])
    result["camera_position"] = [line[3] for line in camera["camera_to_world"][:3]]
    result["camera_focal_px"] = camera["intrinsics"][0][0]
    for group in ("head", "gaze"):
        result |= {f"{group}_{name}": value for name, value in meta[group].items()}
    result |= {f"expression_{name}": meta["expression"].get(name, 0.0) for name in ARKIT_NAMES}
    person = dict(meta["person"])
    phenotypes = person.pop("phenotypes")
    result |= {f"person_{name}": phenotypes.get(name) for name in PHENOTYPES}
    result |= _flatten("person", person)
    result |= {f"quality_{name}": value for name, value in quality.items()}
    result |= {f"cost_{name}": value for name, value in cost.items()}
    return result


def misfits(row: Any) -> list[str]:
    """What keeps a row out of the manifest, a line each: DuckDB refuses a table for one value."""
    if not isinstance(row, dict):
        return ["is no row of the manifest"]
    try:
        columns = schema_of([row])
    except ValueError as error:
        return [str(error)]
    missing = [
        f"the manifest's {name} is missing" for name in (*IDENTITY, *PLACE) if name not in row
    ]
    return missing + [
        f"the manifest's {name} must be {columns[name]}, not {str(value)[:40]!r}"
        for name, value in row.items()
        if not (value is None and name not in (*IDENTITY, *PLACE))
        and not _fits(value, columns[name])
    ]


_INTEGERS = {"BIGINT": 2**63, "INTEGER": 2**31}


def _fits(value: Any, kind: str) -> bool:
    if kind.endswith("[]"):
        return isinstance(value, list | tuple) and all(_fits(v, kind[:-2]) for v in value)
    if kind in _INTEGERS:
        whole = isinstance(value, int) and not isinstance(value, bool)
        return whole and -_INTEGERS[kind] <= value < _INTEGERS[kind]
    if kind == "DOUBLE":
        return (
            isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        )
    if kind == "BOOLEAN":
        return isinstance(value, bool)
    if kind == "VARCHAR":
        return isinstance(value, str) and not any("\ud800" <= c <= "\udfff" for c in value)
    if not isinstance(value, dict) or not all(_fits(name, "VARCHAR") for name in value):
        return False
    if kind.startswith("MAP"):
        return all(_fits(v, "DOUBLE") for v in value.values())
    return value.keys() == {"name", "offset", "size"} and all(
        _fits(v, "VARCHAR" if n == "name" else "BIGINT") for n, v in value.items()
    )


def _flatten(prefix: str, value: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, item in value.items():
        # Dictionaries of free keys become maps, parts of a person columns.
        if isinstance(item, dict) and name not in ("shape", "asymmetry", "ancestry_mix"):
            flat |= _flatten(f"{prefix}_{name}", item)
        elif item is not None:
            flat[f"{prefix}_{name}"] = item
    return flat


def schema(quality: Iterable[str], cost: Iterable[str]) -> dict[str, str]:
    """Column name -> DuckDB type of a manifest with these quality figures and timings."""
    columns = IDENTITY | PLACE | LIGHT | MOTION | _columns("camera", CameraSample)
    columns |= {"camera_position": "DOUBLE[]", "camera_focal_px": "DOUBLE"}
    names = [f"head_{n}" for n in ("pitch", "roll", "yaw")]
    names += [f"gaze_{n}" for n in ("yaw", "pitch")]
    names += [f"expression_{n}" for n in ARKIT_NAMES]
    names += [f"person_{n}" for n in PHENOTYPES]
    columns |= dict.fromkeys(names, "DOUBLE")
    columns |= {k: v for k, v in _columns("person", Person).items() if k != "person_phenotypes"}
    columns |= {f"quality_{n}": "DOUBLE" for n in quality}
    return columns | {f"cost_{n}": "DOUBLE" for n in sorted(cost)}


def _columns(prefix: str, model: type[BaseModel]) -> dict[str, str]:
    columns: dict[str, str] = {}
    for name, info in model.model_fields.items():
        kind = info.annotation
        if typing.get_origin(kind) in (types.UnionType, typing.Union):
            kind = next(k for k in typing.get_args(kind) if k is not types.NoneType)
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            columns |= _columns(f"{prefix}_{name}", kind)
        else:
            columns[f"{prefix}_{name}"] = _sql_type(kind)
    return columns


def _sql_type(kind: Any) -> str:
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        return _sql_type(typing.get_args(kind)[0])
    if origin in (tuple, list):
        return _sql_type(typing.get_args(kind)[0]) + "[]"
    if origin is dict:
        return "MAP(VARCHAR, DOUBLE)"
    return {float: "DOUBLE", int: "BIGINT", bool: "BOOLEAN"}.get(kind, "VARCHAR")


def schema_of(rows: list[dict[str, Any]]) -> dict[str, str]:
    """The schema that holds these rows; `ValueError` if one has a column that it lacks."""
    if not all(isinstance(r, dict) for r in rows):
        raise ValueError("a row of the manifest must be an object")
    names = dict.fromkeys(name for r in rows for name in r)
    quality = [n.removeprefix("quality_") for n in names if n.startswith("quality_")]
    cost = [n.removeprefix("cost_") for n in names if n.startswith("cost_")]
    columns = schema(quality, cost)
    if wrong := [name for name in names if not COLUMN.fullmatch(name)]:
        raise ValueError(f"a column of the manifest cannot be called {brief(wrong[0])}")
    if unknown := set(names) - set(columns):
        raise ValueError(f"the manifest has no column for {sorted(unknown)}")
    return columns
