"""Verifying one shard against its record, the plan and the manifest."""

from __future__ import annotations

import functools
import math
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from assets_procedural.conventions import console
from assets_procedural.conventions.files import open_regular, read_regular, sha256
from synthgen.dataset import columns, manifest
from synthgen.dataset.folder import DatasetFolder
from synthgen.dataset.gate import inspect
from synthgen.dataset.records import FORMAT, LARGEST_RECORD, ShardRecord, read_description
from synthgen.dataset.shards import decode
from synthgen.dataset.shot import Shot, shown_expression
from synthgen.planning.plan import ShardPlan, SubjectPlan, subject_key
from synthgen.publish import publish

LINES_PER_SHARD = 20
UNCHECKED = "cannot be checked"


def check_shard(
    job: tuple[DatasetFolder, ShardPlan, bool, bool],
) -> tuple[list[str], dict[str, int]]:
    """Every broken promise of one shard, and how many subjects, shots and frames it holds.

    `job` is (dataset folder, shard, whether the manifest can be read, whether the code that planned
    the dataset is this very version). One argument, so that processes can map over jobs.
    """
    folder, shard, has_table, same_code = job
    name = folder.relative(folder.shard(shard.name).tar)
    counts = {"subjects": 0, "shots": 0, "frames": 0}
    problems = []
    found = _shard_problems(folder, shard, has_table, same_code, counts)
    for problem in unfailing("", found):
        problems.append(f"{name}: {problem}")
        if len(problems) >= LINES_PER_SHARD:
            problems.append(f"{name}: and more")
            break
    return problems, counts


def unfailing(where: str, problems: Iterator[str]) -> Iterator[str]:
    """Yield `problems`, and one more that says why if looking for them fails.

    A damaged file may hold anything, so any access to its content may raise anything.
    """
    try:
        yield from problems
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        yield f"{where}: {UNCHECKED} ({reason})".removeprefix(": ")


def _shard_problems(
    folder: DatasetFolder,
    shard: ShardPlan,
    has_table: bool,
    same_code: bool,
    counts: dict[str, int],
) -> Iterator[str]:
    files = folder.shard(shard.name)
    path = files.tar
    try:
        content = read_regular(files.record, LARGEST_RECORD)
    except OSError:
        yield "has no record in the ledger" if path.exists() else "missing"
        return
    record = ShardRecord.parse(content, folder.relative(files.record))
    keys = [subject_key(index) for index in shard.subjects]
    if sorted(record.subjects + record.failed) != keys:
        yield "its record does not list the subjects that the plan puts there"
    counts["subjects"] = len(record.subjects)
    if not record.subjects:
        if path.exists():
            yield "is there, but its record names no subject in it"
        return
    if not path.exists():
        yield "missing"
        return
    if path.stat().st_size != record.bytes:
        yield f"{path.stat().st_size} bytes instead of {record.bytes}: truncated or overwritten"
    elif sha256(path) != record.sha256:
        yield "changed since it was written (sha256 differs)"
    if not files.rows.exists() or sha256(files.rows) != record.part_sha256:
        yield f"its part of the manifest ({folder.relative(files.rows)}) is missing or changed"
    table = folder.manifest(shard.subset)
    rows: dict[str, dict[str, Any]] | None = None
    if has_table and table.exists():
        rows = {r["key"]: r for r in manifest.read_rows(table, record.tar)}
    yield from _samples(folder, shard, path, rows, same_code, counts)
    if rows:
        yield f"lacks {console.count(len(rows), 'shot')} of the manifest, first {next(iter(rows))}"


def _samples(
    folder: DatasetFolder,
    shard: ShardPlan,
    path: Path,
    rows: dict[str, dict[str, Any]] | None,
    same_code: bool,
    counts: dict[str, int],
) -> Iterator[str]:
    """Check sample after sample; takes the rows that it meets out of `rows`."""
    subject_of = functools.lru_cache(1)(
        functools.partial(publish.stored_plan(folder).subject, shard.subset)
    )
    fields: list[str] | None = None
    gate = functools.partial(inspect, format=read_description(folder).format or FORMAT)
    # tarfile, and not our own reader: what others rely on is what is checked.
    try:
        with open_regular(path) as file, tarfile.open(fileobj=file) as archive:
            for key, members, places in _grouped(archive):
                names = [place["name"] for place in places]
                if fields is not None and names != fields:
                    missing = ", ".join(sorted(set(fields) - set(names))) or "none"
                    yield f"{key}: other members than the first sample's (missing: {missing})"
                fields = fields or names
                counts["shots"] += 1
                counts["frames"] += sum(name.startswith("rgb_") for name in names)
                row = None if rows is None else rows.pop(key, None)
                if rows is not None and row is None:
                    yield f"{key}: not in the manifest"
                try:
                    shot = decode(key, members)
                except KeyError as error:
                    yield f"{key}: {error.args[0]} is missing"
                    continue
                except ValueError as error:
                    yield f"{key}: {error}"
                    continue
                check = functools.partial(_against_plan, subject_of, shard) if same_code else None
                found = _sample(folder, shot, gate, check, row, places)
                yield from (f"{key}: {problem}" for problem in unfailing("", found))
    except (tarfile.TarError, EOFError, OSError) as error:
        yield f"truncated or damaged tar: {' '.join(str(error).split())[:120]}"


def _sample(
    folder: DatasetFolder,
    shot: Shot,
    gate: Callable[[Shot], tuple[list[str], dict[str, float]]],
    against_plan: Callable[[str, dict[str, Any]], Iterator[str]] | None,
    row: dict[str, Any] | None,
    places: list[dict[str, Any]],
) -> Iterator[str]:
    problems, quality = gate(shot)
    yield from problems
    if shot.meta.get("key") != shot.key:
        yield f"its meta.json is of {str(shot.meta.get('key'))[:40]}"
    if problems:
        return
    if against_plan is not None:
        yield from against_plan(shot.key, shot.meta)
    if row is not None:
        yield from _against_row(folder, row, shot.meta, quality, places)


def _grouped(
    archive: tarfile.TarFile,
) -> Iterator[tuple[str, dict[str, bytes], list[dict[str, Any]]]]:
    """Consecutive members of one key: (key, content by field, places by field)."""
    current, members, places = None, {}, []
    for info in archive:
        key, _, name = info.name.partition(".")
        if key != current:
            if current is not None:
                yield current, members, places
            current, members, places = key, {}, []
        file = archive.extractfile(info)
        content = b"" if file is None else file.read()
        members[name] = content
        places.append({"name": name, "offset": info.offset_data, "size": info.size})
    if current is not None:
        yield current, members, places


def _against_plan(
    subject_of: Callable[[int], SubjectPlan], shard: ShardPlan, key: str, meta: dict[str, Any]
) -> Iterator[str]:
    index = meta.get("index", -1)
    if index not in shard.subjects:
        yield f"subject {index} does not belong in this shard"
        return
    subject = subject_of(index)
    shot = next((s for s in subject.shots if s.key == key), None)
    if shot is None:
        yield "the plan has no such shot"
        return
    pose = subject.poses[shot.pose]
    expected = {
        "seeds": {"subject": subject.seed, "shot": shot.seed},
        "split": subject.split,
        "environments": [use.model_dump(mode="json") for use in subject.environments],
        "person": subject.person.model_dump(mode="json"),
        "expression": shown_expression(pose),
    }
    for name, value in expected.items():
        if not _same(meta.get(name), value):
            yield f"{name} in meta.json is not what the job plans"


def _against_row(
    folder: DatasetFolder,
    row: dict[str, Any],
    meta: dict[str, Any],
    quality: dict[str, float],
    places: list[dict[str, Any]],
) -> Iterator[str]:
    last = places[-1]
    end = last["offset"] + last["size"] + (-last["size"] % tarfile.BLOCKSIZE)
    start = places[0]["offset"] - tarfile.BLOCKSIZE
    place = {name: row[name] for name in ("shard", "mesh", "mesh_sha256")}
    place |= {"offset": start, "size": end - start, "members": places}
    expected = columns.row(meta, quality, {}, place)
    for name in expected | row:
        if not name.startswith("cost_") and not _same(row.get(name), expected.get(name)):
            there, here = str(row.get(name))[:40], str(expected.get(name))[:40]
            yield f"the manifest's {name} is {there}, not {here}"
    mesh = folder.inside(row["mesh"])
    if not mesh.is_file():
        yield f"{row['mesh']} is missing"
    elif meta["key"].endswith("_p00") and sha256(mesh) != row["mesh_sha256"]:
        yield f"{row['mesh']} changed since it was written"
    if not mesh.with_suffix(".json").is_file():
        yield f"{row['mesh'].removesuffix('.glb')}.json is missing"


def _same(a: Any, b: Any) -> bool:
    """Equality of JSON-like values, but for the last digits of floats."""
    if isinstance(a, float | int) and isinstance(b, float | int):
        return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-6)
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    return a == b
