"""Motions of real people, as `totalediting track` writes them, played by synthetic ones.

A folder holds tables (Parquet): a row per frame with `source`, `seconds`, `expression` (52,) in the
order of `ARKIT_NAMES`, `gaze` (2,), `head` (3,) and `camera_yaw_pitch_roll` (3,), as in `Pose` and
`CameraSample`. Other columns, such as who the person is, are not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets_procedural.conventions.errors import UserError
from assets_procedural.motion.poses import ARKIT_NAMES, Pose, PoseSettings, as_pose, draw_head
from assets_procedural.settings import Parameters

COLUMNS = {
    "source": "VARCHAR",
    "seconds": "FLOAT",
    "expression": "FLOAT[52]",
    "gaze": "FLOAT[2]",
    "head": "FLOAT[3]",
    "camera_yaw_pitch_roll": "FLOAT[3]",
}
MOST_FRAMES = 200_000
"""Of all tables of a folder."""
_GAP = 0.5  # seconds without a face, beyond which a recording ends
_SHORTEST = 0.5  # seconds of a recording
_SMOOTH = 0.03  # seconds, deviation: what a fit jitters by, well below a blink
_OWN_TURN = 0.5  # of the head that a pose is drawn with, about which a recorded one moves
_LOOKS = np.array([name.startswith("eyeLook") for name in ARKIT_NAMES])
# Columns right, up and towards the subject of a camera in front of it.
_FRONT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


class RecordingError(UserError):
    """A folder or table of recorded motion cannot be used."""


class Motion(Parameters):
    """Where the poses of a subject come from: a table of the folder, a source in it, and the
    moment of each pose in it, seconds."""

    table: str
    source: str
    seconds: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Recording:
    """A face that is seen throughout, T frames."""

    table: str
    source: str
    seconds: np.ndarray
    """(T,), rising."""
    values: np.ndarray
    """(T, 57): expression in [0, 1], gaze, and the head as (pitch, roll, yaw) off its own rest."""

    @property
    def span(self) -> float:
        return float(self.seconds[-1] - self.seconds[0])


def read(folder: Path) -> tuple[Recording, ...]:
    """All recordings of a folder, in the order of its tables' names.

    Raises:
        RecordingError: there is none, or a table is none or holds what is no motion.
    """
    try:
        tables = sorted(path for path in folder.iterdir() if path.suffix == ".parquet")
    except OSError as error:
        raise RecordingError(f"{folder}: {error.strerror}; give a folder of tracks") from None
    if not tables:
        raise RecordingError(f"{folder}: has no .parquet; fill it with `totalediting track`")
    found: list[Recording] = []
    frames = 0
    for path in tables:
        source, seconds, values = _read_table(path)
        frames += len(seconds)
        if frames > MOST_FRAMES:
            raise RecordingError(f"{folder}: has more than {MOST_FRAMES:,} frames; take some out")
        for name in dict.fromkeys(source):
            here = np.flatnonzero(source == name)
            order = here[np.argsort(seconds[here], kind="stable")]
            found += _stretches(path.name, str(name), seconds[order], values[order])
    if not found:
        raise RecordingError(
            f"{folder}: no face in it is seen for {_SHORTEST:g} s; track longer clips"
        )
    return tuple(found)


def copy(folder: Path, path: Path) -> None:
    """Copy a table into a folder, but only what is read of it."""
    import duckdb

    with duckdb.connect() as connection:
        connection.execute(
            f"COPY (SELECT {_selection()} FROM read_parquet([{_quoted(path, pattern=True)}])) "
            f"TO {_quoted(folder / path.name)} "
            "(FORMAT parquet, COMPRESSION zstd, USE_TMP_FILE true)"
        )


def same(some: Sequence[Recording], others: Sequence[Recording]) -> bool:
    """Whether these are the same recordings."""
    return len(some) == len(others) and all(
        (a.table, a.source) == (b.table, b.source)
        and np.array_equal(a.seconds, b.seconds)
        and np.array_equal(a.values, b.values)
        for a, b in zip(some, others, strict=True)
    )


def play(
    rng: np.random.Generator,
    recordings: Sequence[Recording],
    frames: int,
    settings: PoseSettings,
) -> tuple[tuple[Pose, ...], Motion]:
    """`frames` poses, 1 / settings.frames_per_second apart: a drawn stretch of a recording.

    The longer a recording, the likelier it is drawn. One that is too short goes back and forth.
    Gaze and head stay in the ranges of `settings`; the head moves about a turn of the subject's
    own. Lids follow the gaze, as in every pose.
    """
    spans = np.array([one.span for one in recordings])
    one = recordings[int(rng.choice(len(recordings), p=spans / spans.sum()))]
    wanted = (frames - 1) / settings.frames_per_second
    start = float(rng.uniform(0, max(one.span - wanted, 0)))
    at = start + np.arange(frames) / settings.frames_per_second
    at = one.span - np.abs(at % (2 * one.span) - one.span)  # back and forth
    at = one.seconds[0] + at
    values = np.stack([np.interp(at, one.seconds, column) for column in one.values.T], 1)
    expression, gaze, head = values[:, :52], values[:, 52:54], values[:, 54:]
    bounds, ranges = settings.gaze_bounds(), settings.head_ranges()
    own = _OWN_TURN * draw_head(rng, settings)
    gaze = gaze.clip(bounds[:, 0], bounds[:, 1])
    head = (own + head).clip(ranges[:, 0], ranges[:, 1])
    poses = tuple(as_pose(*pose) for pose in zip(expression, gaze, head, strict=True))
    moments = tuple(round(float(second), 4) for second in at)
    return poses, Motion(table=one.table, source=one.source, seconds=moments)


def _read_table(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every row: source, seconds (R,), and (R, 60): expression, gaze, head, camera."""
    import duckdb

    try:
        with duckdb.connect() as connection:
            found = connection.execute(
                f"SELECT {_selection()} FROM read_parquet([{_quoted(path, pattern=True)}]) "
                f"LIMIT {MOST_FRAMES + 1}"
            ).fetchnumpy()
    except duckdb.Error as error:
        reason = str(error).splitlines()[0][:200]
        raise RecordingError(f"{path}: no table of `totalediting track`: {reason}") from None
    rows = len(found["source"])
    columns = []
    for name in list(COLUMNS)[1:]:
        column = np.ma.filled(found[name], np.nan)
        stacked = np.stack(list(column)) if column.dtype == object and rows else column
        values = np.asarray(np.ma.filled(stacked, np.nan), float).reshape(rows, -1)
        if not np.isfinite(values).all():
            raise RecordingError(f"{path}: {name}: a value is missing or not finite; track again")
        columns.append(values)
    seconds, expression, gaze, *angles = columns
    if rows and (expression.min() < -1e-3 or expression.max() > 1 + 1e-3):
        raise RecordingError(f"{path}: expression: values are from 0 to 1; track again")
    if rows and max(np.abs(part).max() for part in (gaze, *angles)) > 2 * np.pi:
        raise RecordingError(f"{path}: gaze, head or camera: angles are in radians; track again")
    return (
        np.asarray([str(text) for text in found["source"]]),
        seconds[:, 0],
        np.hstack([expression.clip(0, 1), gaze, *angles]) if rows else np.zeros((0, 60)),
    )


def _stretches(table: str, source: str, seconds: np.ndarray, values: np.ndarray) -> list[Recording]:
    """The parts of a source in which a face is seen throughout."""
    ends = np.flatnonzero(np.diff(seconds) > _GAP) + 1
    made = []
    for here in np.split(np.arange(len(seconds)), ends):
        here = here[np.append(True, np.diff(seconds[here]) > 0)] if len(here) else here
        if len(here) < 2 or seconds[here[-1]] - seconds[here[0]] < _SHORTEST:
            continue
        times, part = seconds[here], values[here]
        moved = np.hstack([part[:, :54], _turns(part[:, 54:57], part[:, 57:])])
        moved[:, :52][:, _LOOKS] = 0.0  # lids follow the gaze
        made.append(Recording(table, source, times, _smoothed(times, moved)))
    return made


def _turns(head: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """(T, 3) pitch, roll, yaw of heads (T, 3) before cameras (T, 3) off the most typical of them.

    A picture tells how a head is turned to the camera, hardly how to the trunk.
    """
    axes = _about("z", camera[:, 0]) @ _about("x", -camera[:, 1]) @ _about("y", -camera[:, 2])
    turned = _about("z", head[:, 2]) @ _about("y", head[:, 1]) @ _about("x", head[:, 0])
    seen = (axes @ _FRONT).swapaxes(1, 2) @ turned
    some = seen[np.linspace(0, len(seen) - 1, min(len(seen), 200)).round().astype(int)]
    likeness = np.einsum("iab,jab->ij", some, some).sum(1)
    rest = some[int(likeness.argmax())]
    off = _FRONT @ seen @ rest.T @ _FRONT.T
    return np.stack(
        [
            np.arctan2(off[:, 2, 1], off[:, 2, 2]),
            -np.arcsin(off[:, 2, 0].clip(-1, 1)),
            np.arctan2(off[:, 1, 0], off[:, 0, 0]),
        ],
        1,
    )


def _about(axis: str, angles: np.ndarray) -> np.ndarray:
    """(T, 3, 3) turns about an axis by angles (T,)."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turns = np.tile(np.eye(3), (len(angles), 1, 1))
    turns[:, first, first] = turns[:, second, second] = np.cos(angles)
    turns[:, second, first] = np.sin(angles)
    turns[:, first, second] = -turns[:, second, first]
    return turns


def _smoothed(seconds: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(T, C) weighted by how near in time, within three deviations."""
    smooth = np.empty_like(values)
    low = np.searchsorted(seconds, seconds - 3 * _SMOOTH)
    high = np.searchsorted(seconds, seconds + 3 * _SMOOTH, side="right")
    for k, (start, end) in enumerate(zip(low, high, strict=True)):
        weight = np.exp(-0.5 * ((seconds[start:end] - seconds[k]) / _SMOOTH) ** 2)
        smooth[k] = weight @ values[start:end] / weight.sum()
    return smooth


def _selection() -> str:
    return ", ".join(f'"{name}"::{kind} AS "{name}"' for name, kind in COLUMNS.items())


def _quoted(path: Path, pattern: bool = False) -> str:
    """A path for DuckDB, which takes some characters of a pattern for wildcards."""
    text = str(path.absolute())
    if pattern:
        text = "".join(f"[{c}]" if c in "*?[" else c for c in text)
    return "'" + text.replace("'", "''") + "'"
