"""The Parquet manifest: a row per shot with its provenance, quality, cost and place in a shard.

Every shard has its part; `merge` joins the parts of a subset into `manifest/<subset>.parquet`.
Columns: identity (key, subject, subset, kind, split, …), place (shard, offset, size, members),
`environment*` lists, `camera_*`, `head_*`, `gaze_*`, `expression_<ARKit name>`, `person_*`,
`quality_*`, and `cost_*` in seconds: the only columns that differ between two runs of a job.
"""

from __future__ import annotations

import errno
import json
import os
import types
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from assets_procedural.motion import ARKIT_NAMES
from assets_procedural.person import Person
from synthgen import ledger
from synthgen.camera import CameraSample
from synthgen.shards import encode_json, replacing

if TYPE_CHECKING:
    import duckdb

PHENOTYPES = (
    *("gender", "age", "muscle", "weight", "height", "proportions", "cupsize", "firmness"),
    *("african", "asian", "caucasian"),
)
ROWS_PER_GROUP = 20_000
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
}


# ---------------------------------------------------------------- rows


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


def _flatten(prefix: str, value: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, item in value.items():
        # Dictionaries of free keys (shape, asymmetry) become maps, parts of a person columns.
        if isinstance(item, dict) and name not in ("shape", "asymmetry"):
            flat |= _flatten(f"{prefix}_{name}", item)
        elif item is not None:
            flat[f"{prefix}_{name}"] = item
    return flat


def schema(quality: Iterable[str], cost: Iterable[str]) -> dict[str, str]:
    """Column name -> DuckDB type of a manifest with these quality figures and timings."""
    columns = IDENTITY | PLACE | LIGHT | _columns("camera", CameraSample)
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


def _schema_of(rows: list[dict[str, Any]]) -> dict[str, str]:
    names = dict.fromkeys(name for r in rows for name in r)
    quality = [n.removeprefix("quality_") for n in names if n.startswith("quality_")]
    cost = [n.removeprefix("cost_") for n in names if n.startswith("cost_")]
    columns = schema(quality, cost)
    if unknown := set(names) - set(columns):
        raise ValueError(f"the manifest has no column for {sorted(unknown)}")
    return columns


# ---------------------------------------------------------------- files


def encode_rows(rows: list[dict[str, Any]]) -> bytes:
    """Rows as JSON lines, the form in which they wait for their shard."""
    return b"".join(encode_json(r) + b"\n" for r in rows)


def decode_rows(path: Path) -> list[dict[str, Any]]:
    """The inverse of `encode_rows`."""
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def write_part(path: Path, rows: list[dict[str, Any]]) -> None:
    """Commit the rows of one shard; `ValueError` if a row has a column that the schema lacks."""
    source = path.with_name(f".{path.name}.{os.getpid()}.rows.tmp")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        source.write_bytes(encode_rows(rows))
        _write_parquet(path, _json_source([source], _schema_of(rows)))
    finally:
        source.unlink(missing_ok=True)


def read_rows(path: Path, shard: str | None = None) -> list[dict[str, Any]]:
    """The rows of a Parquet file, or those of one shard, as dictionaries."""
    where, values = ("", []) if shard is None else (" WHERE shard = ?", [shard])
    with _database() as connection:
        result = connection.execute(
            f"SELECT * FROM read_parquet({_literal([path])}){where}", values
        )
        names = [column[0] for column in result.description or ()]
        return [dict(zip(names, values, strict=True)) for values in result.fetchall()]


def merge(out: Path, subset: str) -> Path:
    """Join the parts of all committed shards into manifest/<subset>.parquet; bounded memory."""
    target = out / "manifest" / f"{subset}.parquet"
    if parts := _parts(out, subset):
        _write_parquet(target, f"SELECT * FROM {_parquet_source(parts)}")
    else:
        columns = ", ".join(f'NULL::{kind} AS "{n}"' for n, kind in schema((), ()).items())
        _write_parquet(target, f"SELECT {columns} LIMIT 0")
    return target


def files(out: Path, subset: str) -> list[Path]:
    """The Parquet files that describe a subset: merged, or the parts while it is rendered."""
    merged = out / "manifest" / f"{subset}.parquet"
    if ledger.read_dataset_json(out).get("complete") and merged.exists():
        return [merged]
    return _parts(out, subset)


def _parts(out: Path, subset: str) -> list[Path]:
    names = [Path(r["tar"]).stem for r in ledger.shard_records(out, subset) if r["subjects"]]
    return [path for name in names if (path := ledger.part_file(out, subset, name)).exists()]


def _write_parquet(target: Path, query_text: str) -> None:
    import duckdb

    try:
        with replacing(target) as file, _database() as connection:
            # The open handle stays that of the file DuckDB writes, so that it gets its fsync.
            connection.execute(
                f"COPY ({query_text}) TO '{_escape(file.name)}' (FORMAT parquet, "
                f"COMPRESSION zstd, ROW_GROUP_SIZE {ROWS_PER_GROUP}, USE_TMP_FILE false)"
            )
    except duckdb.IOException as error:
        if "No space left" in str(error) or "quota" in str(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target)) from None
        raise


def _database() -> duckdb.DuckDBPyConnection:
    import duckdb

    return duckdb.connect(config={"threads": 1, "memory_limit": "1GB"})


def _parquet_source(paths: list[Path]) -> str:
    return f"read_parquet({_literal(paths)}, union_by_name = true)"


def _json_source(paths: list[Path], columns: dict[str, str]) -> str:
    described = ", ".join(f"\"{name}\": '{kind}'" for name, kind in columns.items())
    return (
        f"SELECT * FROM read_json({_literal(paths)}, format = 'newline_delimited', "
        f"columns = {{{described}}})"
    )


def _literal(paths: list[Path]) -> str:
    return "[" + ", ".join(f"'{_escape(path)}'" for path in paths) + "]"


def _escape(path: Path | str) -> str:
    return str(path).replace("'", "''")


# ---------------------------------------------------------------- queries


def connect(out: Path | str) -> duckdb.DuckDBPyConnection:
    """A DuckDB connection with a view per subset and `manifest` over all of them.

    Finished subjects that wait for their shard are included. Raises `StorageError` if `out` is no
    dataset or holds no finished subject.
    """
    out = Path(out)
    info = ledger.read_dataset_json(out)
    connection = _database()
    views = []
    for subset in info["plan"]:
        sources = []
        if parquet := files(out, subset):
            sources.append(f"SELECT * FROM {_parquet_source(parquet)}")
        waiting = sorted((out / "work" / subset).glob("*.json"))
        if waiting:
            sources.append(_json_source(waiting, _schema_of(decode_rows(waiting[0]))))
        if sources:
            connection.execute(f'CREATE VIEW "{subset}" AS {" UNION ALL BY NAME ".join(sources)}')
            views.append(f'SELECT * FROM "{subset}"')
    if not views:
        raise ledger.StorageError(f"{out}: no subject is finished yet")
    connection.execute(f"CREATE VIEW manifest AS {' UNION ALL BY NAME '.join(views)}")
    return connection


@dataclass(frozen=True)
class Result:
    """What a query found."""

    column_names: list[str]
    rows: list[tuple[Any, ...]]

    def to_pylist(self) -> list[dict[str, Any]]:
        """A dictionary per row."""
        return [dict(zip(self.column_names, row, strict=True)) for row in self.rows]


def query(out: Path | str, sql: str) -> Result:
    """Run SQL over the manifest: tables `manifest` (all subsets) and one per subset.

    Raises `StorageError` with one line for a wrong query or a folder that is no dataset.
    """
    import duckdb

    with connect(out) as connection:
        try:
            result = connection.execute(sql)
            names = [column[0] for column in result.description or ()]
            return Result(names, result.fetchall())
        except duckdb.Error as error:
            raise ledger.StorageError(f"query: {' '.join(str(error).split())}") from None
