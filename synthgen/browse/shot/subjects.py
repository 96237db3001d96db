"""A subject: the cameras of its shots, its canonical mesh, and what expressions do to it."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from assets_procedural.motion.poses import ARKIT_NAMES
from synthgen.browse.folder import Folder, Refused
from synthgen.browse.shot.decoded import metadata
from synthgen.browse.shot.samples import Broken, Sample
from synthgen.browse.table.shots import plain
from synthgen.browse.table.snapshot import Snapshot
from synthgen.dataset.database import quoted

_MOST = 5000  # shots of a subject
_LARGEST = 256 << 20  # bytes of a mesh
_building = threading.Lock()


def describe(folder: Folder, snapshot: Snapshot, subset: str, subject: str) -> dict[str, Any]:
    """Shots of a subject in the manifest's order, and the cameras of those that can be read."""
    rows = rows_of(snapshot, subset, subject)
    cameras, broken = [], []
    for row in rows:
        try:
            camera = metadata(Sample(folder, row))["camera"]
            names = ("camera_to_world", "intrinsics", "width", "height")
            cameras.append({"key": row["key"]} | {name: camera[name] for name in names})
        except (Broken, KeyError, TypeError) as reason:
            broken.append({"key": row["key"], "reason": str(reason)})
    return {
        "subject": subject,
        "subset": subset,
        "kind": rows[0].get("kind"),
        "shots": [row["key"] for row in rows],
        "environments": rows[0].get("environments") or [],
        "cameras": cameras,
        "broken": broken,
        "expression_names": list(ARKIT_NAMES),
    }


def rows_of(snapshot: Snapshot, subset: str, subject: str) -> list[dict[str, Any]]:
    """What the manifest says of a subject's shots; raises `Refused` if it knows none."""
    wanted = ("key", "kind", "environments", "shard", "offset", "size", "mesh", "failed", "reason")
    names = [n for n in wanted if n in snapshot.columns]
    found = snapshot.sandbox.ask(
        f"SELECT {', '.join(map(quoted, names))} FROM manifest "
        f"WHERE subset = ? AND subject = ? LIMIT {_MOST}",
        [subset, subject],
    )
    rows = [dict(zip(names, map(plain, row), strict=True)) for row in found]
    if not rows:
        raise Refused(f"no subject {subset}/{subject} in this dataset")
    if rows[0].get("failed"):
        raise Refused(f"{subset}/{subject} failed: {rows[0].get('reason')}", 422)
    return rows


def mesh(folder: Folder, snapshot: Snapshot, subset: str, subject: str) -> bytes:
    """The bytes of a subject's canonical mesh, binary glTF. Raises `Refused` without one."""
    name = rows_of(snapshot, subset, subject)[0].get("mesh")
    if not isinstance(name, str):
        raise Refused(f"the manifest names no mesh for {subset}/{subject}")
    path = folder.file(name)
    if folder.layout.subjects not in path.parents or path.stat().st_size > _LARGEST:
        raise Refused(f"{name[:80]} is not a subject's mesh")
    content = path.read_bytes()
    if not content.startswith(b"glTF"):
        raise Refused(f"{name[:80]} is not binary glTF", 422)
    return content


def expressions(folder: Folder, snapshot: Snapshot, subset: str, subject: str) -> np.ndarray:
    """What each expression at 1 adds to the mesh's skin, (52, V, 3) float32 metres, world axes.

    Rows are `expression_names`, columns the vertices of the mesh's geometry `skin` in its order;
    the world is Z up, so a vertex (x, y, z) of the glTF is (x, -z, y). Raises `Refused`
    where the metadata name a person that the head model cannot make.
    """
    from assets_procedural.body.head import HeadModel
    from assets_procedural.motion.poses import Pose
    from assets_procedural.person import Person

    rows = rows_of(snapshot, subset, subject)
    with _building:
        try:
            person = Person.model_validate(metadata(Sample(folder, rows[0]))["person"])
            model = HeadModel.load()
            identity = model.identity(person)
            skin = model.groups["skin"]
            moved = [
                identity.pose(Pose(expression={name: 1.0})).unposed[skin] - identity.rest[skin]
                for name in ARKIT_NAMES
            ]
        except (KeyError, ValueError, TypeError) as error:
            lines = str(error).splitlines() or [type(error).__name__]
            raise Refused(f"expressions: the head model cannot make it: {lines[0]}", 422) from None
    return np.stack(moved).astype(np.float32)
