"""How the columns of a manifest are presented: type, kind of filter, group, label."""

from __future__ import annotations

import re
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
    "person_gender": "sex (0 female, 1 male)",
    "person_age": "age (Anny)",
    "person_age_years": "age in years",
    "environments": "environment",
    "failed": "failed",
}
_RADIANS = re.compile(r"(camera|head|gaze)_(yaw|pitch|roll)")


@dataclass(frozen=True)
class Column:
    """A column: `type` is "number", "text" or "boolean", `kind` "facet", "range" or "other".

    `listed` says that a row holds a list of values, any of which may match. `unit` is "rad", "s",
    "mm" or "".
    """

    name: str
    type: str
    kind: str
    group: str
    label: str
    unit: str
    listed: bool = False

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
    group, _, rest = name.partition("_")
    if name in _DATASET:
        group = "dataset"
    elif group.startswith("environment") or name == "exposures":
        group = "light"
    elif group == "person" and "_" in rest and rest.partition("_")[0] != "age":
        group = rest.partition("_")[0]
    elif not rest:
        group = "other"
    label = _LABELS.get(name) or (rest or name).replace("_", " ")
    return Column(name, type_, kind, group, label, _unit(name), listed)


def _unit(name: str) -> str:
    if _RADIANS.fullmatch(name) or name == "environment_rotation":
        return "rad"
    if name.startswith("cost_"):
        return "s"
    return "mm" if name.endswith("_mm") else ""
