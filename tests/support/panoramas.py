"""Panoramas to test with, and files of any format and channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def hdr(height: int = 16, seed: int = 0) -> np.ndarray:
    """(height, 2 height, 3) float32: noise with a high dynamic range."""
    return np.random.default_rng(seed).gamma(0.5, 2.0, (height, 2 * height, 3)).astype(np.float32)


def save(path: Path, image: np.ndarray, kind: str = "half") -> Path:
    """Write (H, W, C) as it is: "half", "float" or "uint8", the format by the name's ending."""
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], kind)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(image), output.geterror()
    output.close()
    return path
