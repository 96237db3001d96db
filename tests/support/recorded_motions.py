"""Tables of motion as `totalediting track` writes them."""

from __future__ import annotations

from pathlib import Path

import duckdb
import numpy as np

from assets_procedural.motion.poses import ARKIT_NAMES

RATE = 25.0
JAW, BLINK = (ARKIT_NAMES.index(name) for name in ("jawOpen", "eyeBlinkLeft"))


def write_motion(path: Path, source: str = "clip.mp4", frames: int = 100, **changed) -> Path:
    """A jaw that opens steadily, eyes that look to the left, a head that turns by 0.3 off a
    camera which stands at 0.2; `changed` replaces columns, (frames, …)."""
    share = np.linspace(0, 1, frames)
    expression = np.zeros((frames, 52))
    expression[:, JAW], expression[:, BLINK] = share, 1 - share
    still = np.zeros(frames)
    columns = {
        "seconds": np.arange(frames) / RATE,
        "expression": expression,
        "gaze": np.stack([still + 0.1, still], 1),
        "head": np.stack([still, still, 0.2 + 0.3 * (share - 0.5)], 1),
        "camera_yaw_pitch_roll": np.stack([still + 0.2, still, still], 1),
        "identity": np.ones((frames, 2)),
        **changed,
    }
    rows = [[source, *(values[k].tolist() for values in columns.values())] for k in range(frames)]
    kinds = ", ".join(
        f"{name} FLOAT" + (f"[{values.shape[1]}]" if values.ndim > 1 else "")
        for name, values in columns.items()
    )
    with duckdb.connect() as connection:
        connection.execute(f"CREATE TABLE t (source VARCHAR, {kinds})")
        connection.executemany(
            f"INSERT INTO t VALUES ({', '.join('?' * (1 + len(columns)))})", rows
        )
        quoted = str(path).replace("'", "''")
        connection.execute(f"COPY t TO '{quoted}' (FORMAT parquet)")
    return path
