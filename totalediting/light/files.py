"""Lightmaps as files: one EXR holds the five maps of an environment.

A tensor (5, 3, H, 2H) float32, lobes in the order of `lightmaps.LOBES`, becomes the fifteen float32
channels <lobe>.R, <lobe>.G and <lobe>.B. Row, column and world axes follow
`conventions.panorama`; values are linear Rec.709. String attributes record what was baked
(`lightmaps_source`, a file name, and its `lightmaps_sha256`), whether a constant environment of
radiance 1 gives maps of 1 (`lightmaps_normalised`, "true" or "false") and the convention.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch

from assets_procedural.conventions import console, panorama_files
from totalediting.errors import InputError
from totalediting.light.lightmaps import LOBES

CONVENTION = (
    "equirectangular, linear Rec.709, Z up; a unit direction (x, y, z) lies at "
    "u = 0.5 - atan2(y, x) / 2 pi to the right and v = acos(z) / pi down; "
    "diffuse.* along the normal, specular<n>.* along the reflected viewing direction"
)


def write_lightmaps(path: Path, lightmaps: torch.Tensor, source: Path, normalised: bool) -> None:
    """Store lightmaps (5, 3, H, 2H) atomically as EXR; `source` is the file they were baked from.

    Equal input gives equal bytes.

    Raises:
        InputError: a value is not finite.
    """
    pixels = lightmaps.movedim(-3, -1).cpu().numpy().astype(np.float32)
    if not np.isfinite(pixels).all():
        raise InputError(f"{source}: its maps are not finite; it holds values that are no light")
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    header = {
        "lightmaps_source": source.name,
        "lightmaps_sha256": digest,
        "lightmaps_normalised": normalised,
        "lightmaps_convention": CONVENTION,
    }
    panorama_files.write_channels(path, dict(zip(LOBES, pixels, strict=True)), header)


def read_lightmaps(path: Path) -> torch.Tensor:
    """The lightmaps that `write_lightmaps` stored, (5, 3, H, 2H) float32.

    `panorama_files.read_header(path)["lightmaps_normalised"]` says whether they are normalised.

    Raises:
        InputError: no such file, or one that does not hold exactly the five maps.
    """
    import OpenEXR  # here: slow to import

    if not path.is_file():
        raise InputError(f"{path}: no such file; `totalediting bake` writes lightmaps")
    try:
        with console.without_chatter(), OpenEXR.File(str(path)) as file:
            layers = {name: channel.pixels for name, channel in file.channels().items()}
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: cannot be read ({reason}); bake it again") from None
    height = len(next(iter(layers.values())))
    if set(layers) != set(LOBES) or {p.shape for p in layers.values()} != {(height, 2 * height, 3)}:
        found = ", ".join(f"{name} {p.shape}" for name, p in layers.items())
        raise InputError(
            f"{path}: holds {found}; lightmaps are {', '.join(LOBES)}, each twice as wide as high, "
            "in R, G and B; write them with `totalediting bake`"
        )
    pixels = np.stack([layers[lobe] for lobe in LOBES]).astype(np.float32)
    return torch.from_numpy(pixels).movedim(-1, -3).contiguous()
