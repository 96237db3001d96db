"""Lightmaps for the canvas of a shot: baked by the model's own code, where that is installed.

This room alone of `synthgen` knows `totalediting`, and only inside one function: what a page shows
must be what a model learns, so there is no second baker.
"""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets_procedural.conventions import panorama
from synthgen.browse.folder import Folder, Refused, name

if TYPE_CHECKING:
    from types import ModuleType

LARGEST_UPLOAD = 128 << 20
"""Bytes of a panorama that a user may send."""
HEIGHTS = (8, 128)
"""Fewest and most rows of the maps."""
_LARGEST = 1 << 30  # bytes of a panorama once it is decoded
_one_at_a_time = threading.Lock()


def of_dataset(folder: Folder, identifier: str, height: int) -> np.ndarray:
    """Lightmaps (5, 3, height, 2 height) float32 of a panorama of the dataset, in its own frame.

    Raises `Refused` if there is none of that name, it does not decode, or torch is missing.
    """
    path = folder.file(folder.layout.environment(name(identifier, "environment")))
    with _one_at_a_time:
        light = _model()
        try:
            _check_size(path)
            return light.environment_lightmaps(path, height, 0.0, 1.0).numpy()
        except panorama.PanoramaError as error:
            raise Refused(str(error).replace(str(path), f"environment {identifier}"), 422) from None


def of_upload(content: bytes, height: int) -> np.ndarray:
    """Lightmaps of the bytes of an .exr or .hdr file; raises as `of_dataset`."""
    ending = ".exr" if content[:4] == b"\x76\x2f\x31\x01" else ".hdr"
    if ending == ".hdr" and not content.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise Refused("the file is neither .exr nor .hdr; export the panorama as one of them", 422)
    with _one_at_a_time, tempfile.TemporaryDirectory() as temporary:
        light = _model()
        path = Path(temporary) / f"panorama{ending}"
        path.write_bytes(content)
        try:
            _check_size(path)
            # At most as wide as what maps of 128 rows need by far.
            return light.bake(panorama.load(path, max_width=2048), height)
        except (panorama.PanoramaError, ValueError) as error:
            raise Refused(str(error).replace(str(path), "the file"), 422) from None


class _Model:
    """The two functions of `totalediting` that are asked."""

    def __init__(self, environments: ModuleType, lightmaps: ModuleType) -> None:
        self.environment_lightmaps = environments.environment_lightmaps
        self._bake = lightmaps.bake

    def bake(self, pixels: np.ndarray, height: int) -> np.ndarray:
        import torch

        return self._bake(torch.from_numpy(pixels), height).numpy()


def _model() -> _Model:
    try:
        from totalediting.light import environments, lightmaps
    except ModuleNotFoundError as error:
        raise Refused(
            f"light needs {error.name}, which is not installed: pip install 'synthgen[model]'", 501
        ) from None
    return _Model(environments, lightmaps)


def _check_size(path: Path) -> None:
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    if image is None:
        oiio.geterror()
        return  # `panorama.load` says what is wrong
    try:
        spec = image.spec()
    finally:
        image.close()
    if 4 * spec.width * spec.height * spec.nchannels > _LARGEST:
        raise panorama.PanoramaError(
            f"{path}: is {spec.width} x {spec.height} with {spec.nchannels} channels, more than "
            f"{_LARGEST >> 30} GB once decoded; make it smaller"
        )
