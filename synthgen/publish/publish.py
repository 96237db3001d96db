"""What surrounds the shards: dataset.json first, and all else once the last shard is there.

`begin` opens a folder for a job, `complete` writes what only a finished dataset has.
"""

from __future__ import annotations

import functools
import json
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import synthgen
from assets_procedural.conventions.files import sha256, write_atomically
from synthgen.dataset import ledger, manifest
from synthgen.dataset.codecs import encode_json
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import SPLITS, Plan
from synthgen.publish import card, croissant, licences

FORMAT = 1


@functools.cache
def code_version() -> dict[str, str]:
    """Package version, and the commit if this is a checkout."""
    version = {"package": "synthgen", "version": synthgen.__version__}
    root = Path(synthgen.__file__).parents[1]
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


def begin(
    out: Path, plan: Plan, environments: list[dict[str, Any]], renderer: str
) -> dict[str, Any]:
    """Write dataset.json for a new dataset, or `check` that the folder holds this very job."""
    job = plan.job.model_dump(mode="json")
    info = check(out, plan, environments, renderer)
    if info is None:
        info = {
            "format": FORMAT,
            "name": plan.job.name,
            "complete": False,
            "job": job,
            "renderer": renderer,
            "environments": environments,
            "plan": {
                name: {
                    "kind": spec.kind,
                    "subjects": spec.subjects,
                    "shots_per_subject": spec.shots,
                    "frames_per_subject": spec.shots * spec.environments,
                }
                for name, spec in plan.job.subsets.items()
            },
            "code": code_version(),
            "created": datetime.now(UTC).date().isoformat(),
            "licences": licences.LICENCES,
        }
        write_atomically(out / "dataset.json", _pretty(info))
    return info


def check(
    out: Path, plan: Plan, environments: list[dict[str, Any]], renderer: str
) -> dict[str, Any] | None:
    """Whether `out` may be filled with this job: its dataset.json, None if there is none yet.

    `environments` is the provenance of the pool, one entry with an "id" per panorama. Raises
    `StorageError` that names the differing fields if the folder holds another job, is a file, has
    something else in it, or was left unfinished by another version of the code. Writes nothing.
    """
    path = out / "dataset.json"
    if out.exists() and not out.is_dir():
        raise ledger.StorageError(f"{out}: is a file; give a folder that --out may fill")
    foreign = sorted(_foreign(out))
    if not path.exists():  # asked after the listing: another slice may just be writing it
        if foreign:
            raise ledger.StorageError(
                f"{out}: holds other files ({foreign[0]}, …) and no dataset; give an empty folder"
            )
        return None
    info = ledger.read_dataset_json(out)
    if info.get("format") != FORMAT:
        raise ledger.StorageError(
            f"{path}: format {info.get('format')}, this version writes {FORMAT}; use a new folder"
        )
    stored = info["job"] | {"renderer": info["renderer"]}
    wanted = plan.job.model_dump(mode="json") | {"renderer": renderer}
    differing = list(_differences("", stored, wanted))
    if not differing:
        if not info.get("complete"):
            _check_code(out, info)
        there, here = ({e["id"]: e for e in pool} for pool in (info["environments"], environments))
        differing = [
            f"environment {name} {_how_differs(there.get(name), here.get(name))}"
            for name in [*there, *(here.keys() - there.keys())]
            if there.get(name) != here.get(name)
        ]
        if not differing and list(there) != list(here):
            differing = ["environments in another order"]
    if differing:
        shown = "; ".join(differing[:6]) + ("; …" if len(differing) > 6 else "")
        raise ledger.StorageError(
            f"{out}: holds another job ({shown}); give another --out folder, or that job"
        )
    return info


def _foreign(out: Path) -> Iterator[str]:
    """What a folder without dataset.json holds that no start of a run can have left there."""
    for path in out.iterdir() if out.is_dir() else ():
        if path.name == "work" and path.is_dir():
            yield from (f"work/{p.name}" for p in path.iterdir() if p.name != "locks")
        elif not fnmatch(path.name, ".dataset.json.*.tmp"):
            yield path.name


def _how_differs(there: dict[str, Any] | None, here: dict[str, Any] | None) -> str:
    if there is None or here is None:
        return "is new here" if there is None else "is missing here"
    if there.get("sha256") != here.get("sha256"):
        return f"has another content than when the dataset was begun ({here['source']})"
    return "is described otherwise"


def _check_code(out: Path, info: dict[str, Any]) -> None:
    """Another version may make other people of the same seeds: it must not render the rest."""
    there, here = info["code"], code_version()
    if there != here:
        raise ledger.StorageError(
            f"{out}: begun by synthgen {_version(there)}, this is {_version(here)}, and a dataset "
            "never mixes versions; check out that one to continue, or give another --out folder"
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


def stored_plan(out: Path) -> Plan:
    """The plan of a dataset from its dataset.json alone.

    Raises `StorageError` if the recorded job is not valid for this version.
    """
    info = ledger.read_dataset_json(out)
    try:
        return Plan(JobSpec.model_validate(info["job"]), [e["id"] for e in info["environments"]])
    except (KeyError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ledger.StorageError(f"{out / 'dataset.json'}: unusable job: {reason}") from None


# ---------------------------------------------------------------- complete


def reopen(out: Path) -> None:
    """Mark a dataset incomplete before its shards are touched again.

    Raises `StorageError` if another version of the code rendered it.
    """
    info = ledger.read_dataset_json(out)
    if info["complete"]:
        _check_code(out, info)
        write_atomically(out / "dataset.json", _pretty(info | {"complete": False}))


def complete(out: Path) -> bool:
    """If all shards are there: merge manifests, write card, Croissant and the full dataset.json.

    Returns whether the dataset is complete. Deterministic, and safe to repeat.
    """
    plan, info = stored_plan(out), ledger.read_dataset_json(out)
    shards, counts, files = [], {}, {}
    for subset in plan.job.subsets:
        counts[subset] = {split: {"subjects": 0, "shots": 0, "frames": 0} for split in SPLITS}
        for planned in plan.shards(subset):
            record = ledger.shard_record(out, subset, Path(planned.name).stem)
            if record is None:
                return False
            for what in ("shots", "frames"):
                counts[subset][planned.split][what] += record[what]
            counts[subset][planned.split]["subjects"] += len(record["subjects"])
            if record["subjects"]:
                shards.append({k: record[k] for k in ("tar", "bytes", "sha256")})
    for subset in plan.job.subsets:
        path = manifest.merge(out, subset)
        files[f"manifest/{path.name}"] = sha256(path)
    for identifier in plan.environment_ids:
        name = f"environments/{identifier}.exr"
        if (out / name).exists():
            files[name] = sha256(out / name)
    quarantined = [
        {k: entry[k] for k in ("subset", "key", "reason")}
        for entry in ledger.failures(out)
        if entry["attempts"] >= ledger.ATTEMPTS
    ]
    info |= {
        "complete": True,
        "counts": counts,
        "quarantined": quarantined,
        "shards": shards,
        "files": files,
    }
    write_atomically(out / "croissant.json", _pretty(croissant.croissant(info)))
    write_atomically(out / "README.md", card.card(info).encode())
    write_atomically(out / "dataset.json", _pretty(info))
    return True


def _pretty(value: Any) -> bytes:
    json.loads(encode_json(value))  # refuses NaN before a file is touched
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()
