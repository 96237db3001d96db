"""What the page of one shot is made of: metadata, members, siblings, the command."""

from __future__ import annotations

import shlex
from typing import Any
from urllib.parse import quote

from synthgen.browse.folder import Folder
from synthgen.browse.shot.decoded import Decoder
from synthgen.browse.shot.samples import Broken, Sample
from synthgen.browse.table.snapshot import Snapshot
from synthgen.dataset.passes import PASSES
from synthgen.pictures.drawing import PICTURES


def describe(
    folder: Folder, snapshot: Snapshot, decoder: Decoder, row: dict[str, Any]
) -> dict[str, Any]:
    """The answer of `/api/shot`: of a broken shot it says why, and what the manifest knows."""
    subset, key = str(row["subset"]), str(row["key"])
    siblings = snapshot.sandbox.ask(
        'SELECT "key" FROM manifest WHERE subset = ? AND subject = ? AND NOT failed LIMIT 5000',
        [subset, row["subject"]],
    )
    folder_name, address = shlex.quote(folder.shown), shlex.quote(f"{subset}/{key}")
    answer: dict[str, Any] = {
        "key": key,
        "subset": subset,
        "subject": row["subject"],
        "meta": row,
        "row": row,
        "members": [],
        "passes": [],
        "environments": [],
        "siblings": [name for (name,) in siblings],
        "command": f"synthgen rerender {folder_name} {address}",
        "broken": None,
    }
    try:
        sample = Sample(folder, row)
        answer["members"] = [
            {"name": m.name, "bytes": m.size, "url": _member(subset, key, m.name)}
            for m in sample.members.values()
        ]
        shot = decoder.shot(sample)
        answer["environments"] = environments(snapshot, shot.meta)
        answer["meta"] = shot.meta
        linear = ["linear"] if any(n.startswith("hdr_") for n in sample.members) else []
        answer["passes"] = ["image", *PICTURES]
        answer["values"] = [*linear, "image", *(p.name for p in PASSES)]
    except Broken as reason:
        answer["broken"] = folder.without_paths(str(reason))
    return answer


def environments(snapshot: Snapshot, meta: dict[str, Any]) -> list[dict[str, Any]]:
    """The environments of a shot with what dataset.json says about them.

    Raises `Broken` if the metadata do not hold together.
    """
    try:
        listed = snapshot.info.get("environments") or []
        known = {e["id"]: e for e in listed if isinstance(e, dict) and "id" in e}
        return [
            {
                "id": str(use["id"]),
                "rotation": float(use["rotation"]),
                "exposure": float(use["exposure"]),
                "factor": float(meta["exposures"][i]),
                "bundled": known.get(use["id"], {}).get("kind") == "bundled",
            }
            for i, use in enumerate(meta["environments"])
        ]
    except (KeyError, TypeError, ValueError, IndexError):
        raise Broken("meta.json does not describe its environments") from None


def _member(subset: str, key: str, name: str) -> str:
    return "/member/" + "/".join(quote(part, safe="") for part in (subset, key, name))
