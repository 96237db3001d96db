"""Videos for tests."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np


def write_video(path: Path, levels: list[int], size: tuple[int, int] = (64, 48)) -> None:
    """A grey video whose k-th frame has the k-th level, all frames but the first predicted."""
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for level in levels:
            # Noise, so that the file has bytes to lose.
            noise = np.random.default_rng(level).integers(-8, 9, (size[1], size[0], 1))
            grey = np.broadcast_to(np.clip(level + noise, 0, 255), (size[1], size[0], 3))
            frame = av.VideoFrame.from_ndarray(grey.astype(np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
