"""Lightmaps for the canvas of a shot, baked by what is registered as an entry point.

What a page shows must be what a model learns, so there is no second baker here: the package of the
model registers its own in the group `synthgen.lightmaps`, a module with `of_file` and `of_pixels`.
"""

from __future__ import annotations

import tempfile
import threading
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol, cast

import numpy as np

from assets_procedural.conventions import panorama_reading
from synthgen.browse.folder import Folder, Refused, name

ENTRY_POINTS = "synthgen.lightmaps"
"""The group of entry points that bakers are registered in."""
LARGEST_UPLOAD = 128 << 20
"""Bytes of a panorama that a user may send."""
HEIGHTS = (8, 128)
"""Fewest and most rows of the maps."""
_LARGEST = 1 << 30  # bytes of a panorama once it is decoded
_one_at_a_time = threading.Lock()


def of_dataset(folder: Folder, identifier: str, height: int) -> np.ndarray:
    """Lightmaps (5, 3, height, 2 height) float32 of a panorama of the dataset, in its own frame.

    Raises `Refused` if there is none of that name, it does not decode, or no baker is installed.
    """
    path = folder.file(folder.layout.environment(name(identifier, "environment")))
    with _one_at_a_time:
        baker = _baker()
        try:
            panorama_reading.check_size(path, _LARGEST)
            return baker.of_file(path, height)
        except panorama_reading.PanoramaError as error:
            raise Refused(str(error).replace(str(path), f"environment {identifier}"), 422) from None


def of_upload(content: bytes, height: int) -> np.ndarray:
    """Lightmaps of the bytes of an .exr or .hdr file; raises as `of_dataset`."""
    ending = ".exr" if content[:4] == b"\x76\x2f\x31\x01" else ".hdr"
    if ending == ".hdr" and not content.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise Refused("the file is neither .exr nor .hdr; export the panorama as one of them", 422)
    with _one_at_a_time, tempfile.TemporaryDirectory() as temporary:
        baker = _baker()
        path = Path(temporary) / f"panorama{ending}"
        path.write_bytes(content)
        try:
            # At most as wide as what maps of 128 rows need by far.
            pixels, _ = panorama_reading.read(path, max_width=2048, largest=_LARGEST)
            return baker.of_pixels(pixels, height)
        except (panorama_reading.PanoramaError, ValueError) as error:
            raise Refused(str(error).replace(str(path), "the file"), 422) from None


class Baker(Protocol):
    """What an entry point of the group offers; the maps are (5, 3, height, 2 height) float32."""

    def of_file(self, path: Path, height: int) -> np.ndarray:
        """The lightmaps of a panorama's file in its own frame; raises `PanoramaError`."""
        ...

    def of_pixels(self, pixels: np.ndarray, height: int) -> np.ndarray:
        """The lightmaps of linear radiance (H, 2H, 3) float32; raises `ValueError`."""
        ...


def _baker() -> Baker:
    missing = "a package that bakes lightmaps"
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            return cast(Baker, entry.load())
        except ModuleNotFoundError as error:
            missing = str(error.name)
    raise Refused(
        f"light needs {missing}, which is not installed: pip install 'totalediting[model]'", 501
    )
