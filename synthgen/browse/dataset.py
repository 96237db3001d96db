"""What `/api/dataset` says about a dataset."""

from __future__ import annotations

from typing import Any

from assets_procedural.motion.poses import ARKIT_NAMES
from synthgen.browse.table.fields import GRID, ordered
from synthgen.browse.table.snapshot import Snapshot
from synthgen.dataset.passes import PASSES, Pass
from synthgen.pictures.drawing import PALETTE

PARTS = (
    *("background", "skin", "nose", "right eye", "left eye", "right brow", "left brow"),
    *("right ear", "left ear", "mouth interior", "top lip", "bottom lip", "neck and shoulders"),
    *("hair", "beard", "clothing", "glasses", "headwear", "facewear"),
)
"""Names of the part ids from 0 on; 255 is ignored."""


def describe(snapshot: Snapshot, pictures: tuple[str, ...] = ()) -> dict[str, Any]:
    """The dataset, its columns and counts, all of it from dataset.json and the manifest; and which
    `pictures` there are of a run beside it."""
    info = snapshot.info
    environments = info.get("environments")
    panoramas = [e for e in environments or [] if isinstance(e, dict) and "id" in e]
    return {
        "name": str(info.get("name", "")),
        "format": info.get("format"),
        "complete": bool(info.get("complete")),
        "revision": snapshot.revision,
        "ready": snapshot.in_memory,
        "shots": snapshot.shots,
        "frames": snapshot.frames,
        "failures": snapshot.failures,
        "plan": info["plan"],
        "columns": [c.to_json() for c in ordered(snapshot.columns.values())],
        "grid": [n for n in GRID if n in snapshot.columns],
        "environments": [
            {k: str(e.get(k, "")) for k in ("id", "kind", "source", "author", "licence")}
            for e in panoramas
        ],
        "part_names": [
            {"id": i, "name": part, "colour": PALETTE[i].tolist()} for i, part in enumerate(PARTS)
        ],
        "passes": passes(),
        "expression_names": list(ARKIT_NAMES),
        "run": list(pictures),
    }


def passes() -> list[dict[str, Any]]:
    """What a shot's page can show: `label` of its button, `axes` and `unit` of its values.

    `lit`: there is one for each environment. What has no label is not drawn, only its values.
    """
    lit = [
        {"name": name, "label": label, "axes": list("RGBA"), "unit": "", "lit": True}
        for name, label in (("image", "Image"), ("linear", ""))
    ]
    return lit + [
        {
            "name": p.name,
            "label": p.label or p.name.capitalize(),
            "axes": _axes(p),
            "unit": p.unit,
            "lit": False,
        }
        for p in PASSES
    ]


def _axes(each: Pass) -> list[str]:
    if len(each.components) == 1:
        return []
    return list(each.components if each.drawn == "colour" else each.components.lower())
