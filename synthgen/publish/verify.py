"""Checking a dataset again, from its bytes: every shard against every promise of the contract."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import duckdb
import numpy as np

from assets_procedural.conventions import console
from assets_procedural.conventions.files import sha256
from synthgen.dataset import columns, ledger
from synthgen.dataset.codecs import decode_exr
from synthgen.planning.plan import SPLITS, Plan, ShardPlan
from synthgen.publish import publish
from synthgen.publish.verify_shard import UNCHECKED, check_shard, unfailing

# Below this, starting processes takes longer than checking.
PARALLEL_BYTES = 300_000_000


def verify(out: Path | str, workers: int | None = None) -> list[str]:
    """Every broken promise of a dataset, one line each; empty if it is as promised.

    `workers` processes read large datasets; default: one per core. Raises `StorageError` if
    `out` is no dataset.
    """
    out = Path(out)
    info = ledger.read_dataset_json(out)
    if not isinstance(info, dict):
        return ["dataset.json: holds no table"]
    if info.get("format") != publish.FORMAT:
        return [f"dataset.json: format {info.get('format')}, not {publish.FORMAT}"]
    try:
        plan = publish.stored_plan(out)
    except ledger.StorageError as error:
        return [str(error)]
    except TypeError as error:
        return [f"dataset.json: unusable: {error}"]
    problems = list(unfailing("dataset.json", _check_files(out, info, plan)))
    # Another version may plan other people from the same seed: then only its own can tell.
    same_code = info.get("code") == publish.code_version()
    planned = [s for subset in plan.job.subsets for s in plan.shards(subset)]
    unreadable = {p.split(":")[0] for p in problems}
    tables = {}
    for subset in plan.job.subsets:
        name = f"manifest/{subset}.parquet"
        tables[subset] = name not in unreadable and (out / name).is_file()
        if tables[subset]:
            found = list(unfailing(name, _check_table(out, name, planned, same_code)))
            tables[subset] = not any(UNCHECKED in problem for problem in found)
            problems += found
    counted = {
        (subset, split): {"subjects": 0, "shots": 0, "frames": 0}
        for subset in plan.job.subsets
        for split in SPLITS
    }
    for shard, (found, counts) in zip(
        planned, _each(out, planned, tables, same_code, workers), strict=True
    ):
        problems += found
        for what, number in counts.items():
            counted[shard.subset, shard.split][what] += number
    problems += unfailing("dataset.json", _check_totals(out, info, plan, planned, counted))
    return problems


def _each(
    out: Path,
    planned: list[ShardPlan],
    tables: dict[str, bool],
    same_code: bool,
    workers: int | None,
) -> Iterator[tuple[list[str], dict[str, int]]]:
    jobs = [(out, shard, tables[shard.subset], same_code) for shard in planned]
    tars = [out / "data" / shard.name for shard in planned]
    size = sum(path.stat().st_size for path in tars if path.is_file())
    with contextlib.ExitStack() as held:
        bar = held.enter_context(console.progress())
        if size < PARALLEL_BYTES or workers == 1:
            results = map(check_shard, jobs)
        else:
            pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
            results = held.enter_context(pool).map(check_shard, jobs)
        yield from bar.track(results, len(jobs), description="verifying")


# ---------------------------------------------------------------- around the shards


def _check_files(out: Path, info: dict[str, Any], plan: Plan) -> Iterator[str]:
    if not info.get("complete"):
        yield "dataset.json: the dataset is not complete; render it to the end"
    expected = {f"environments/{i}.exr" for i in plan.environment_ids}
    expected |= {f"manifest/{subset}.parquet" for subset in plan.job.subsets}
    recorded = info.get("files", {})
    for name in sorted(expected | set(recorded)):
        path = out / name
        if not path.is_file():
            if info.get("complete") or name.startswith("environments"):
                yield f"{name}: missing"
        elif name in recorded and sha256(path) != recorded[name]:
            yield f"{name}: changed since it was written (sha256 differs from dataset.json)"
        elif name.startswith("environments"):
            yield from _check_environment(path, name)
    if info.get("complete"):
        for name in ("README.md", "croissant.json"):
            if not (out / name).is_file():
                yield f"{name}: missing"
        if (out / "croissant.json").is_file():
            try:
                json.loads((out / "croissant.json").read_bytes())
            except ValueError as error:
                yield f"croissant.json: not valid JSON ({error})"


def _check_environment(path: Path, name: str) -> Iterator[str]:
    try:
        planes = decode_exr(path.read_bytes())
        image = np.stack([planes[c] for c in "RGB"], -1)
    except Exception as error:  # OpenEXR raises what it likes on damaged bytes
        yield f"{name}: does not decode ({' '.join(str(error).split())[:120]})"
        return
    if image.shape[1] != 2 * image.shape[0]:
        yield f"{name}: {image.shape[1]}x{image.shape[0]} pixels, not 2:1"
    if not np.isfinite(image).all() or (image < 0).any():
        yield f"{name}: has values that are not finite or negative"


def _check_table(out: Path, name: str, planned: list[ShardPlan], same_code: bool) -> Iterator[str]:
    """A manifest as a whole; its rows are compared with the samples shard by shard."""
    subset = Path(name).stem
    with duckdb.connect() as connection:
        table = connection.read_parquet(str(out / name))
        names = table.columns
        shards = dict(table.aggregate("shard, count(*)").fetchall())
        repeated = table.aggregate("count(*) - count(DISTINCT key)").fetchall()[0][0]
    if same_code and (lacking := [c for c in columns.schema((), ()) if c not in names]):
        yield f"{name}: lacks the columns {', '.join(lacking[:6])}"
    known = {f"data/{s.name}" for s in planned if s.subset == subset}
    for shard, rows in shards.items():
        if shard not in known or not (out / shard).is_file():
            yield f"{name}: {rows} rows of {shard}, a shard that is not there"
    if repeated:
        yield f"{name}: {repeated} rows repeat the key of another"


def _check_totals(
    out: Path,
    info: dict[str, Any],
    plan: Plan,
    planned: list[ShardPlan],
    counted: dict[tuple[str, str], dict[str, int]],
) -> Iterator[str]:
    if info.get("complete"):
        for (subset, split), counts in counted.items():
            stated = info.get("counts", {}).get(subset, {}).get(split, {})
            for what, number in counts.items():
                if stated.get(what) != number:
                    yield (
                        f"dataset.json: counts {stated.get(what)} {what} in {subset} {split}, "
                        f"the shards hold {number}"
                    )
        for subset, spec in plan.job.subsets.items():
            stated = info.get("plan", {}).get(subset, {})
            if stated.get("subjects") != spec.subjects:
                yield f"dataset.json: plan of {subset} does not agree with its job"
        yield from _check_quarantined(out, info, plan.job.subsets)
    known = {f"data/{shard.name}" for shard in planned}
    for path in sorted((out / "data").rglob("*")):
        name = path.relative_to(out).as_posix()
        if name not in known and not path.is_dir():
            what = "shard" if path.suffix == ".tar" else "file"
            yield f"{name}: a {what} that the job does not have"


def _check_quarantined(out: Path, info: dict[str, Any], subsets: Iterable[str]) -> Iterator[str]:
    stated = {(entry["subset"], entry["key"]) for entry in info.get("quarantined", ())}
    failed = set()
    for subset in subsets:
        for record in ledger.shard_records(out, subset):
            failed |= {(subset, key) for key in record.get("failed", ())}
    for subset, key in sorted(failed - stated):
        yield f"dataset.json: quarantined lacks {subset}/{key}, which is in no shard"
    for subset, key in sorted(stated - failed):
        yield f"dataset.json: quarantined names {subset}/{key}, which no record calls failed"
