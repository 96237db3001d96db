"""Checking a dataset again, from its bytes: every shard against every promise of the contract."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from synthgen import console, ledger, publish
from synthgen.atomic import sha256
from synthgen.codecs import decode_exr
from synthgen.plan import SPLITS, Plan, ShardPlan
from synthgen.verify_shard import check_shard

# Below this, starting processes takes longer than checking.
PARALLEL_BYTES = 300_000_000


def verify(out: Path | str, workers: int | None = None) -> list[str]:
    """Every broken promise of a dataset, one line each; empty if it is as promised.

    `workers` processes read large datasets; default: one per core. Raises `StorageError` if
    `out` is no dataset.
    """
    out = Path(out)
    info = ledger.read_dataset_json(out)
    if info.get("format") != publish.FORMAT:
        return [f"dataset.json: format {info.get('format')}, not {publish.FORMAT}"]
    try:
        plan = publish.stored_plan(out)
    except ledger.StorageError as error:
        return [str(error)]
    problems = list(_check_files(out, info, plan))
    planned = [s for subset in plan.job.subsets for s in plan.shards(subset)]
    unreadable = {p.split(":")[0] for p in problems}
    tables = {subset: f"manifest/{subset}.parquet" not in unreadable for subset in plan.job.subsets}
    counted = {
        (subset, split): {"subjects": 0, "shots": 0, "frames": 0}
        for subset in plan.job.subsets
        for split in SPLITS
    }
    for shard, (found, counts) in zip(
        planned, _each(out, planned, tables, info, workers), strict=True
    ):
        problems += found
        for what, number in counts.items():
            counted[shard.subset, shard.split][what] += number
    problems += _check_totals(out, info, plan, planned, counted)
    return problems


def _each(
    out: Path,
    planned: list[ShardPlan],
    tables: dict[str, bool],
    info: dict[str, Any],
    workers: int | None,
) -> Iterator[tuple[list[str], dict[str, int]]]:
    # Another version may plan other people from the same seed: then only its own can tell.
    same_code = info["code"] == publish.code_version()
    jobs = [(out, shard, tables[shard.subset], same_code) for shard in planned]
    size = sum(entry["bytes"] for entry in info.get("shards", ()))
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
    known = {f"data/{shard.name}" for shard in planned}
    for path in sorted((out / "data").rglob("*.tar")):
        name = path.relative_to(out).as_posix()
        if name not in known:
            yield f"{name}: a shard that the job does not have"
