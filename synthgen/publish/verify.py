"""Verifying a dataset from its bytes: every shard against the whole contract."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions import console
from assets_procedural.conventions.files import read_regular, sha256
from synthgen.dataset import columns, database, ledger, manifest
from synthgen.dataset.codecs import LARGEST, decode_exr
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import FORMATS, description_json, read_description
from synthgen.planning.plan import SPLITS, Plan, ShardPlan
from synthgen.publish import checksums, publish
from synthgen.publish.verify_shard import UNCHECKED, check_shard, unfailing

# Below this, starting processes takes longer than checking.
PARALLEL_BYTES = 300_000_000


def verify(out: Place, workers: int | None = None) -> list[str]:
    """Every broken promise of a dataset, one line each; empty if it is as promised.

    `workers` processes read large datasets; default: one per core. Raises `StorageError` if
    `out` is no dataset.
    """
    folder = DatasetFolder(out)
    info = description_json(folder)
    if not isinstance(info, dict):
        return ["dataset.json: not a JSON object"]
    if info.get("format") not in FORMATS:
        return [f"dataset.json: format {info.get('format')}, not {' or '.join(map(str, FORMATS))}"]
    try:
        plan = publish.stored_plan(folder)
    except StorageError as error:
        return [str(error)]
    problems = list(unfailing("dataset.json", _check_files(folder, info, plan)))
    unreadable = {p.split(":")[0] for p in problems}
    name = folder.checksums.name
    problems += [p for p in unfailing(name, _check_list(folder, info, plan)) if p not in problems]
    # Another version may plan other people from the same seed: then only its own can tell.
    same_code = info.get("code") == publish.code_version()
    planned = publish.shards(folder, read_description(folder), plan)
    tables = {}
    for subset in console.track(plan.job.subsets, "verifying manifests"):
        path = folder.manifest(subset)
        name = folder.relative(path)
        tables[subset] = name not in unreadable and path.is_file()
        if tables[subset]:
            found = list(unfailing(name, _check_table(folder, subset, planned, same_code)))
            tables[subset] = not any(UNCHECKED in problem for problem in found)
            problems += found
    counted = {
        (subset, split): {"subjects": 0, "shots": 0, "frames": 0}
        for subset in plan.job.subsets
        for split in SPLITS
    }
    for shard, (found, counts) in zip(
        planned, _each(folder, planned, tables, same_code, workers), strict=True
    ):
        problems += found
        for what, number in counts.items():
            counted[shard.subset, shard.split][what] += number
    problems += unfailing("dataset.json", _check_totals(folder, info, plan, planned, counted))
    return problems


def _each(
    folder: DatasetFolder,
    planned: list[ShardPlan],
    tables: dict[str, bool],
    same_code: bool,
    workers: int | None,
) -> Iterator[tuple[list[str], dict[str, int]]]:
    jobs = [(folder, shard, tables[shard.subset], same_code) for shard in planned]
    tars = [folder.shard(shard.name).tar for shard in planned]
    size = sum(path.stat().st_size for path in tars if path.is_file())
    with contextlib.ExitStack() as held:
        if size < PARALLEL_BYTES or workers == 1:
            results = map(check_shard, jobs)
        else:
            pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
            results = held.enter_context(pool).map(check_shard, jobs)
        yield from console.track(results, "verifying shards", len(jobs))


# ---------------------------------------------------------------- around the shards


def _check_files(folder: DatasetFolder, info: dict[str, Any], plan: Plan) -> Iterator[str]:
    if not info.get("complete"):
        yield "dataset.json: the dataset is not complete; render it to the end"
    panoramas = {folder.relative(folder.environment(i)) for i in plan.environment_ids}
    manifests = {folder.relative(folder.manifest(subset)) for subset in plan.job.subsets}
    recorded = info.get("files", {})
    if info.get("selections"):  # which has those of its own shots alone
        panoramas &= recorded.keys()
    names = sorted(panoramas | manifests | set(recorded))
    for name in console.track(names, "verifying panoramas and manifests"):
        path = folder.inside(name)
        if not path.is_file():
            if info.get("complete") or name in panoramas:
                yield f"{name}: missing"
        elif name in recorded and sha256(path) != recorded[name]:
            yield f"{name}: changed since it was written (sha256 differs from dataset.json)"
        elif name in panoramas:
            yield from _check_environment(path, name)
    if info.get("complete"):
        for path in (folder.card, folder.croissant):
            if not path.is_file():
                yield f"{path.name}: missing"
        if folder.croissant.is_file():
            try:
                json.loads(read_regular(folder.croissant, 256 << 20))
            except ValueError as error:
                yield f"{folder.croissant.name}: not valid JSON ({error})"


def _check_list(folder: DatasetFolder, info: dict[str, Any], plan: Plan) -> Iterator[str]:
    """Every file against the list of hashes, and no others; older datasets have no list."""
    if not info.get("complete"):
        return
    if not folder.checksums.is_file():
        if info.get("checksums"):
            yield f"{folder.checksums.name}: missing"
        return
    try:
        listed = checksums.read(folder.checksums)
    except ValueError as error:
        yield f"{folder.checksums.name}: {error}"
        return
    # What other checks read and hash anyway need only be listed with the same hash.
    elsewhere: dict[str, str] = dict(info.get("files", {}))
    for subset in plan.job.subsets:
        for _, record in ledger.committed(folder, subset):
            elsewhere[record.tar] = record.sha256
    for name, digest in console.track(listed.items(), "verifying hashes"):
        path = folder.inside(name)
        if not path.is_file():
            yield f"{name}: missing"
        elif (elsewhere[name] if name in elsewhere else sha256(path)) != digest:
            yield f"{name}: changed since it was written (sha256 differs from SHA256SUMS)"
    for path in folder.published():
        if (name := folder.relative(path)) not in listed:
            yield f"{name}: a file that the dataset does not have"


def _check_environment(path: Path, name: str) -> Iterator[str]:
    try:
        planes = decode_exr(read_regular(path, LARGEST))
        image = np.stack([planes[c] for c in "RGB"], -1)
    except Exception as error:  # OpenEXR raises what it likes on damaged bytes
        yield f"{name}: does not decode ({' '.join(str(error).split())[:120]})"
        return
    if image.shape[1] != 2 * image.shape[0]:
        yield f"{name}: {image.shape[1]}x{image.shape[0]} pixels, not 2:1"
    if not np.isfinite(image).all() or (image < 0).any():
        yield f"{name}: has negative, NaN or infinite values"


def _check_table(
    folder: DatasetFolder, subset: str, planned: list[ShardPlan], same_code: bool
) -> Iterator[str]:
    """A manifest as a whole; its rows are compared with the samples shard by shard."""
    path = folder.manifest(subset)
    name = folder.relative(path)
    with database.locked([path]) as connection:
        table = connection.sql(f"SELECT * FROM {manifest.parquet_source([path])}")
        names = table.columns
        shards = dict(table.aggregate("shard, count(*)").fetchall())
        repeated = table.aggregate("count(*) - count(DISTINCT key)").fetchall()[0][0]
    if same_code and (lacking := [c for c in columns.schema((), ()) if c not in names]):
        yield f"{name}: lacks the columns {', '.join(lacking[:6])}"
    tars = (folder.shard(s.name).tar for s in planned if s.subset == subset)
    known = {folder.relative(tar): tar for tar in tars}
    for shard, rows in shards.items():
        if shard not in known or not known[shard].is_file():
            yield f"{name}: {console.count(rows, 'row')} of {shard}, a shard that is not there"
    if repeated:
        yield f"{name}: {console.count(repeated, 'row')} with the key of another"


def _check_totals(
    folder: DatasetFolder,
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
            planned_counts = {
                "kind": spec.kind,
                "subjects": spec.subjects,
                "shots_per_subject": spec.shots,
                "frames_per_subject": spec.shots * spec.environments,
            }
            if any(stated.get(name) != value for name, value in planned_counts.items()):
                yield f"dataset.json: plan of {subset} does not agree with its job"
        if info.get("plan", {}).keys() != plan.job.subsets.keys():
            yield "dataset.json: plan has other subsets than its job"
        if info.get("name") != plan.job.name:
            yield "dataset.json: name does not agree with its job"
        yield from _check_seals(folder, info, planned)
        yield from _check_quarantined(folder, info, plan.job.subsets)
    known = {folder.shard(shard.name).tar for shard in planned}
    for path in sorted(folder.data.rglob("*")):
        if path not in known and not path.is_dir():
            what = "shard" if path.suffix == ".tar" else "file"
            yield f"{folder.relative(path)}: a {what} that the job does not have"


def _check_seals(
    folder: DatasetFolder, info: dict[str, Any], planned: list[ShardPlan]
) -> Iterator[str]:
    """What dataset.json says of the shards against their records."""
    stated = [(s["tar"], s["bytes"], s["sha256"]) for s in info.get("shards", ())]
    records = [record for s in planned if (record := ledger.record_of(folder, s.name))]
    recorded = [(r.tar, r.bytes, r.sha256) for r in records if r.subjects]
    for tar, *_ in sorted(set(stated) ^ set(recorded)):
        yield f"dataset.json: bytes and sha256 of {tar} are not those of its record"
    if len(stated) != len(set(stated)):
        yield "dataset.json: shards repeats a shard"


def _check_quarantined(
    folder: DatasetFolder, info: dict[str, Any], subsets: Iterable[str]
) -> Iterator[str]:
    stated = {(entry["subset"], entry["key"]) for entry in info.get("quarantined", ())}
    failed = set()
    for subset in subsets:
        for _, record in ledger.committed(folder, subset):
            failed |= {(subset, key) for key in record.failed}
    for subset, key in sorted(failed - stated):
        yield f"dataset.json: quarantined lacks {subset}/{key}, which is in no shard"
    for subset, key in sorted(stated - failed):
        yield f"dataset.json: quarantined names {subset}/{key}, which no record calls failed"
