"""How the columns of a manifest are presented: type, kind of filter, group, label."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

# Too wide to keep in memory; a shot's page reads them from its sample.
LEFT_OUT = frozenset({"members", "person_shape", "person_asymmetry"})
# Different for every row or nearly so: neither a list to choose from nor a scale.
_UNIQUE = frozenset({"key", "subject", "shard", "mesh", "mesh_sha256", "offset", "size", "reason"})
_DATASET = frozenset({"subset", "split", "kind", "failed", "reason", "index", "pose", "view"})
GRID = (
    *("key", "subset", "subject", "kind", "split", "failed", "reason", "environments"),
    *("index", "pose", "view", "width", "height", "person_age_years", "person_gender"),
    *("person_hair_style", "camera_yaw", "head_yaw", "head_pitch"),
)
"""Columns that the grid always gets, as far as a manifest has them."""
_LABELS = {
    "person_gender": "build (0 feminine, 1 masculine)",
    "person_age": "age (Anny)",
    "person_age_years": "age in years",
    "environments": "environment",
    "failed": "failed",
    "light_brightness": "brightness (stops)",
    "light_kelvin": "colour (kelvin)",
    "light_azimuth": "azimuth of the key",
    "light_elevation": "elevation of the key",
}
GROUPS = (
    *("people", "light", "camera", "head", "expression", "hair", "skin", "makeup", "eyes"),
    *("clothes", "accessories", "run", "dataset", "quality", "cost", "other"),
)
"""In the order in which a researcher asks; groups that a manifest has besides come before these
last four."""
_GROUP_OF = {
    "person": "people",
    "gaze": "head",
    **dict.fromkeys(("beard", "brows"), "hair"),
    **dict.fromkeys(("top", "jacket", "scarf"), "clothes"),
    **dict.fromkeys(("glasses", "earrings", "necklace", "hat", "headphones"), "accessories"),
}
_FIRST = (
    *("person_sex", "person_age_years", "person_age_group", "person_ancestry"),
    *("light_kind", "light_brightness", "light_azimuth", "light_elevation", "light_kelvin"),
    *("camera_yaw", "camera_pitch", "head_yaw", "head_pitch", "head_roll"),
    *("person_hair_style", "person_hair_colour", "person_beard_style"),
)
_NAMES = frozenset({"environments", "key", "subject", "subset", "split", "kind", "reason"})
_RADIANS = re.compile(r"(camera|head|gaze)_(yaw|pitch|roll)|light_(azimuth|elevation)")
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")


@dataclass(frozen=True)
class Column:
    """A column: `type` is "number", "text" or "boolean", `kind` "facet", "range" or "other".

    `listed` says that a row holds a list of values, any of which may match. `unit` is "rad", "s",
    "mm" or "". `label` is read in the group, `title` alone; `words` says that values are words and
    no names; `constant`, that every shot has the same.
    """

    name: str
    type: str
    kind: str
    group: str
    label: str
    unit: str
    listed: bool = False
    title: str = ""
    words: bool = False
    constant: bool = False

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def column(name: str, sql_type: str) -> Column:
    """Describe a column of the manifest by its name and DuckDB type."""
    listed = sql_type.endswith("[]")
    element = sql_type.removesuffix("[]")
    kinds = {"VARCHAR": "text", "BOOLEAN": "boolean"}
    numeric = re.fullmatch(r"U?(TINY|SMALL|BIG|HUGE)?INT(EGER)?|FLOAT|DOUBLE|DECIMAL.*", element)
    type_ = "number" if numeric else kinds.get(element, "text")
    if name in _UNIQUE or "seed" in name.split("_"):
        kind = "other"
    elif listed:
        kind = "facet" if name == "environments" else "other"
    elif type_ == "number":
        kind = "range"
    else:
        kind = "facet" if element in kinds else "other"
    first, _, rest = name.partition("_")
    label = _LABELS.get(name) or _words(rest or name)
    group = first
    if name in _DATASET:
        group = "dataset"
    elif first.startswith("environment") or name == "exposures":
        group = "light"
    elif first == "person" and "_" in rest and rest.partition("_")[0] not in ("age", "ancestry"):
        group = rest.partition("_")[0]
    elif not rest:
        group = "other"
    elif first == "gaze":
        label = f"gaze {label}"
    prefix = f"{first} " if first in ("camera", "head", "light", "quality", "cost", "run") else ""
    words = type_ != "number" and name not in _NAMES
    group = _GROUP_OF.get(group, group)
    return Column(name, type_, kind, group, label, _unit(name), listed, prefix + label, words)


def ordered(columns: Iterable[Column]) -> list[Column]:
    """Columns in the order in which the page shows them."""
    places = {name: i for i, name in enumerate(_FIRST)}
    last = len(GROUPS) - 4

    def place(column: Column) -> tuple[float, int]:
        group = GROUPS.index(column.group) if column.group in GROUPS else last - 0.5
        return group, places.get(column.name, len(_FIRST))

    return sorted(columns, key=place)


def _words(name: str) -> str:
    return _HUMP.sub(" ", name).replace("_", " ").lower()


def _unit(name: str) -> str:
    if _RADIANS.fullmatch(name) or name == "environment_rotation":
        return "rad"
    if name.startswith("cost_"):
        return "s"
    return "mm" if name.endswith("_mm") else ""
