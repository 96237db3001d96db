"""What each local change does to the measures of a face, as a table beside this module.

    python -m assets_procedural.people.measures

writes it. `plausibility` limits faces by it without the head model, which takes longer to load.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets_procedural.people.shape_modes import SPREAD
from assets_procedural.person import Person

if TYPE_CHECKING:
    from assets_procedural.body.head import Bust

FILE = Path(__file__).with_name("measures.json")

# Ends by iBUG landmark (70 is the top of the head), and the axis along which they are measured, None for the distance.
_ENDS: dict[str, tuple[tuple[int, int], int | None]] = {
    "face width": ((1, 15), None),
    "jaw width": ((4, 12), None),
    "face height": ((27, 8), 2),
    "nose width": ((31, 35), None),
    "nose length": ((27, 33), 2),
    "nose depth": ((31, 30), 1),
    "mouth width": ((48, 54), None),
    "between eyes": ((39, 42), None),
    "eye width": ((36, 39), None),
    "eye opening": ((37, 41), 2),
    "philtrum": ((33, 51), 2),
    "upper lip": ((51, 62), 2),
    "lower lip": ((66, 57), 2),
    "chin": ((57, 8), 2),
    "brow height": ((19, 37), 2),
    "forehead": ((70, 27), 2),
}
MEASURES = tuple(_ENDS)


def measure(points: np.ndarray) -> np.ndarray:
    """(len(MEASURES),) in millimetres, of `face_points` (71, 3) in metres of a face at rest."""
    found = []
    for (first, second), axis in _ENDS.values():
        gap = points[first] - points[second]
        found.append(1e3 * (np.linalg.norm(gap) if axis is None else gap[axis]))
    return np.array(found)


def face_points(bust: Bust) -> np.ndarray:
    """(71, 3) of a bust in metres: its landmarks, and the top of the head."""
    from assets_procedural.body.landmarks import landmarks

    skin = bust.vertices[bust.model.groups["skin"]]
    return np.vstack([landmarks(bust), skin[np.argmax(skin[:, 2])]])


@cache
def responses() -> tuple[np.ndarray, np.ndarray]:
    """Millimetres per unit of each change of `SPREAD`, upwards and downwards: (changes, measures).

    Raises:
        OSError: the table is missing or cannot be read.
    """
    table = json.loads(FILE.read_text())
    up, down = (np.array([table[n][k] for n in SPREAD], float) for k in ("up", "down"))
    return up, down


def table() -> dict[str, dict[str, list[float]]]:
    """The table, from the head model."""
    from assets_procedural.body.head import HeadModel

    model = HeadModel.load()
    plain = measure(face_points(model.identity(Person()).neutral))
    found = {}
    for name in SPREAD:
        labels = ["l-" + name[1:], "r-" + name[1:]] if name.startswith("±") else [name]
        rows = {}
        for key, sign in (("up", 1.0), ("down", -1.0)):
            person = Person(shape=dict.fromkeys(labels, 0.5 * sign))
            change = measure(face_points(model.identity(person).neutral)) - plain
            rows[key] = [round(float(v), 3) for v in 2.0 * sign * change]
        found[name] = rows
    return found


if __name__ == "__main__":
    lines = [f"{json.dumps(name)}: {json.dumps(rows)}" for name, rows in table().items()]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
