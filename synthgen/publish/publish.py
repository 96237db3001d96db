"""Everything around the shards: dataset.json first, the rest once the last shard is there.

`begin` opens a folder for a job, `complete` writes what only a finished dataset has.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from assets_procedural import __version__
from assets_procedural.conventions.files import sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import (
    FORMAT,
    Counts,
    Description,
    PlannedSubset,
    Quarantined,
    ShardRecord,
    ShardSeal,
    read_description,
)
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import SPLITS, Plan, ShardPlan, subject_key
from synthgen.publish import card, checksums, croissant, licences


@functools.cache
def code_version() -> dict[str, str]:
    """Package version, and the commit if this is a checkout."""
    version = {"package": "synthgen", "version": __version__}
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():  # an installed package may lie in somebody else's checkout
        return version
    try:
        commit = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=root,
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return version
    if commit.returncode == 0:
        version["commit"] = commit.stdout.strip()
    return version


# ---------------------------------------------------------------- begin


def begin(out: Place, plan: Plan, environments: list[dict[str, Any]], renderer: str) -> Description:
    """Write dataset.json for a new dataset, or `check` that the folder holds this very job."""
    info = check(out, plan, environments, renderer)
    if info is None:
        info = Description(
            format=FORMAT,
            name=plan.job.name,
            complete=False,
            job=plan.job.model_dump(mode="json"),
            renderer=renderer,
            environments=environments,
            plan=planned(plan.job),
            code=code_version(),
            created=datetime.now(UTC).date().isoformat(),
            licences=licences.LICENCES,
        )
        write_description(DatasetFolder(out), info)
    return info


def planned(job: JobSpec) -> dict[str, PlannedSubset]:
    """What a job asks of its subsets."""
    return {
        name: PlannedSubset(
            kind=spec.kind,
            subjects=spec.subjects,
            shots_per_subject=spec.shots,
            frames_per_subject=spec.shots * spec.environments,
        )
        for name, spec in job.subsets.items()
    }


def check(
    out: Place, plan: Plan, environments: list[dict[str, Any]], renderer: str
) -> Description | None:
    """Whether `out` may be filled with this job: its dataset.json, None if there is none yet.

    `environments` is the provenance of the pool, one entry with an "id" per panorama. Raises
    `StorageError` that names the differing fields if the folder holds another job, is a file, has
    something else in it, or was left unfinished by another version of the code. Writes nothing.
    """
    folder = DatasetFolder(out)
    if folder.root.exists() and not folder.root.is_dir():
        raise StorageError(f"{folder}: is a file; give a folder that --out may fill")
    foreign = sorted(_foreign(folder))
    # Asked after the listing: another slice may just be writing it.
    if not folder.description.exists():
        if foreign:
            raise StorageError(
                f"{folder}: holds other files ({foreign[0]}, …) and no dataset; "
                "give an empty folder"
            )
        return None
    info = read_description(folder)
    check_whole(folder, info)
    if info.format != FORMAT:
        raise StorageError(
            f"{folder.description}: format {info.format}, this version writes {FORMAT}; "
            "use a new folder"
        )
    # With the defaults of settings that the job did not have yet.
    with contextlib.suppress(ValueError):
        info = info.model_copy(
            update={"job": JobSpec.model_validate(info.job).model_dump(mode="json")}
        )
    stored = info.job | {"renderer": info.renderer}
    wanted = plan.job.model_dump(mode="json") | {"renderer": renderer}
    differing = list(_differences("", stored, wanted))
    if not differing:
        if not info.complete:
            check_code(folder, info)
        there, here = ({e["id"]: e for e in pool} for pool in (info.environments, environments))
        differing = [
            f"environment {name} {_how_differs(there.get(name), here.get(name))}"
            for name in [*there, *(here.keys() - there.keys())]
            if there.get(name) != here.get(name)
        ]
        if not differing and list(there) != list(here):
            differing = ["environments in another order"]
    if differing:
        shown = "; ".join(differing[:6]) + ("; …" if len(differing) > 6 else "")
        raise StorageError(
            f"{folder}: holds another job ({shown}); give another --out folder, or that job"
        )
    return info


def check_whole(folder: DatasetFolder, info: Description) -> None:
    """Raise `StorageError` for a selection of another dataset: nothing is rendered into one."""
    if info.selections:
        raise StorageError(
            f"{folder}: is a selection of another dataset (synthgen subset), into which nothing "
            "is rendered; select again from that one"
        )


def _foreign(folder: DatasetFolder) -> Iterator[str]:
    """What a folder without dataset.json holds that no start of a run can have left there."""
    for path in folder.root.iterdir() if folder.root.is_dir() else ():
        if path == folder.work and path.is_dir():
            yield from (folder.relative(p) for p in path.iterdir() if p != folder.locks)
        elif not fnmatch(path.name, f".{folder.description.name}.*.tmp"):
            yield path.name


def _how_differs(there: dict[str, Any] | None, here: dict[str, Any] | None) -> str:
    if there is None or here is None:
        return "is new here" if there is None else "is missing here"
    if there.get("sha256") != here.get("sha256"):
        return f"has another content than when the dataset was begun ({here['source']})"
    return "is described otherwise"


def check_code(folder: DatasetFolder, info: Description) -> None:
    """Another version may make other people of the same seeds: it must not render the rest.

    Raises `StorageError` that names both.
    """
    here = code_version()
    if info.code != here:
        raise StorageError(
            f"{folder}: begun by synthgen {_version(info.code)}, this is {_version(here)}, and a "
            "dataset never mixes versions; check out that one to continue, or give another --out "
            "folder"
        )


def _version(code: dict[str, str]) -> str:
    return code["version"] + (f" ({code['commit']})" if "commit" in code else "")


def _differences(name: str, there: Any, here: Any) -> Iterator[str]:
    """ "image.linear: true there, false here" for every leaf of the jobs that differs."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted(there.keys() | here.keys()):
            yield from _differences(f"{name}.{key}".lstrip("."), there.get(key), here.get(key))
    elif there != here:
        yield f"{name}: {json.dumps(there)[:40]} there, {json.dumps(here)[:40]} here"


def stored_plan(out: Place) -> Plan:
    """The plan of a dataset from its dataset.json alone.

    Jobs that say nothing of it were rendered without a light basis.

    Raises `StorageError` if the recorded job is not valid for this version.
    """
    info = read_description(out)
    try:
        job = JobSpec.model_validate({"light_basis": False} | info.job)
        if job.poses.tracks is not None:  # those that the dataset holds itself
            poses = job.poses.model_copy(update={"tracks": DatasetFolder(out).tracks})
            job = job.model_copy(update={"poses": poses})
        return Plan(job, [e["id"] for e in info.environments])
    except (KeyError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        path = DatasetFolder(out).description
        raise StorageError(f"{path}: unusable job: {reason}") from None


def shards(folder: DatasetFolder, info: Description, plan: Plan) -> list[ShardPlan]:
    """The shards that a dataset is to hold: all of its plan, or those of a selection's records."""
    every = [shard for subset in plan.job.subsets for shard in plan.shards(subset)]
    if not info.selections:
        return every
    held = []
    for shard in every:
        if record := ledger.record_of(folder, shard.name):
            here = {*record.subjects, *record.failed}
            chosen = tuple(i for i in shard.subjects if subject_key(i) in here)
            held.append(replace(shard, subjects=chosen))
    return held


def record_files(folder: DatasetFolder, hashes: dict[str, str]) -> None:
    """Record the sha256 of stored panoramas and tracks by path."""
    info = read_description(folder)
    files = info.files | hashes
    if files != info.files:
        write_description(folder, info.model_copy(update={"files": files}))


# ---------------------------------------------------------------- complete


def reopen(folder: DatasetFolder) -> None:
    """Mark a dataset incomplete before its shards are touched again.

    Raises `StorageError` if another version of the code rendered it.
    """
    info = read_description(folder)
    if info.complete:
        check_code(folder, info)
        write_description(folder, info.model_copy(update={"complete": False}))


def complete(out: Place) -> bool:
    """If all shards are there: merge manifests, write card, Croissant, hashes of all files and the
    full dataset.json.

    Returns whether the dataset is complete. Deterministic, and safe to repeat.
    """
    folder = DatasetFolder(out)
    plan, info = stored_plan(folder), read_description(folder)
    seals, counts, files, hashes = [], {}, {}, {}
    held = shards(folder, info, plan)
    people: dict[str, set[str]] = {}  # who is there, by the subset that they come from
    for subset in plan.job.subsets:
        tally = {split: {"subjects": 0, "shots": 0, "frames": 0} for split in SPLITS}
        for shard in (shard for shard in held if shard.subset == subset):
            record = ledger.shard_record(folder, shard.name)
            if record is None or lacks_subjects(record, shard):
                return False
            hashes |= _hashes(folder, shard, record)
            tally[shard.split]["subjects"] += len(record.subjects)
            tally[shard.split]["shots"] += record.shots
            tally[shard.split]["frames"] += record.frames
            people.setdefault(plan.people_of(subset), set()).update(record.subjects)
            if record.subjects:
                seals.append(ShardSeal(tar=record.tar, bytes=record.bytes, sha256=record.sha256))
        counts[subset] = {split: Counts(**tally[split]) for split in SPLITS}
    for subset in plan.job.subsets:
        path = manifest.merge(folder, subset)
        files[folder.relative(path)] = sha256(path)
    tracks = sorted({folder.tracks / recording.table for recording in plan.recordings})
    for path in (*map(folder.environment, plan.environment_ids), *tracks):
        if path.exists():
            name = folder.relative(path)
            files[name] = info.files.get(name) or sha256(path)
    quarantined = [
        Quarantined(subset=entry.subset, key=entry.key, reason=entry.reason)
        for entry in ledger.failures(folder)
        if entry.attempts >= ledger.ATTEMPTS
    ]
    info = info.model_copy(
        update={
            "complete": True,
            "counts": counts,
            "quarantined": quarantined,
            "shards": seals,
            "files": files,
            "checksums": folder.checksums.name,
        }
    )
    description = _pretty(info.to_json())
    shown = sum(map(len, people.values()))
    write_atomically(folder.croissant, _pretty(croissant.croissant(info, shown)))
    write_atomically(folder.card, card.card(info, shown).encode("utf-8", "replace"))
    write_atomically(folder.description_copy, description)
    for path in (folder.croissant, folder.card, *folder.failure_notes()):
        hashes[folder.relative(path)] = sha256(path)
    for path in (folder.description, folder.description_copy):
        hashes[folder.relative(path)] = hashlib.sha256(description).hexdigest()
    checksums.write(folder.checksums, hashes | files)
    write_atomically(folder.description, description)
    return True


def lacks_subjects(record: ShardRecord, shard: ShardPlan) -> bool:
    """Whether a shard was committed before subjects came on top that belong into it."""
    there = {*record.subjects, *record.failed}
    return any(subject_key(index) not in there for index in shard.subjects)


def _hashes(folder: DatasetFolder, shard: ShardPlan, record: ShardRecord) -> dict[str, str]:
    """Path -> sha256 of all that a committed shard consists of, as it was when it was stored."""
    files = folder.shard(shard.name)
    found = {folder.relative(files.record): sha256(files.record)}
    if not record.subjects:
        return found
    found |= {record.tar: record.sha256, folder.relative(files.rows): record.part_sha256}
    for key in record.subjects:
        subject = folder.subject(shard.subset, key)
        for path in (subject.mesh, subject.parameters):
            name = folder.relative(path)
            if name in record.files:
                found[name] = record.files[name]
            elif path.exists():  # records of older versions say nothing of them
                found[name] = sha256(path)
    return found


def write_description(folder: DatasetFolder, info: Description) -> None:
    """Write dataset.json."""
    write_atomically(folder.description, _pretty(info.to_json()))


def _pretty(value: Any) -> bytes:
    json.loads(encode_json(value))  # refuses NaN before a file is touched
    # A lone surrogate, which may come with words of somebody else, becomes an escape of JSON.
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode(
        "utf-8", "backslashreplace"
    )
