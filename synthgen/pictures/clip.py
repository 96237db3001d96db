"""The frames of one subject as an animated picture."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from assets_procedural.conventions import console
from assets_procedural.conventions.files import replacing
from synthgen.dataset.folder import Place, StorageError
from synthgen.dataset.reading import open_dataset
from synthgen.pictures.page import fit


def clip(
    out: Place, subject: str, target: Path | str, environment: int = 0, fps: float = 25.0
) -> Path:
    """Write the shots of `subject` ("<subset>/<subject>") in order as animated WebP.

    `environment` is one of the subject's, from 0. Returns `target`. Raises `StorageError` if there
    is no such subject or environment.
    """
    subset, _, name = subject.rpartition("/")
    dataset = open_dataset(out, subset=subset or None)
    found = {key: shots for key, shots in dataset.subjects().items() if key[1] == name}
    if len(found) != 1:
        reason = "is in several subsets; write SUBSET/SUBJECT" if found else "is no subject of it"
        raise StorageError(f"{out}: {subject} {reason}")
    frames: list[Image.Image] = []
    for position in console.track(next(iter(found.values())), "reading frames"):
        pictures = dataset[position].rgb
        if environment >= len(pictures):
            raise StorageError(
                f"{out}: {subject} has environments 0 to {len(pictures) - 1}, not {environment}"
            )
        frames.append(fit(pictures[environment], pictures.shape[2], pictures.shape[1]))
    with replacing(Path(target)) as file:
        frames[0].save(
            file,
            "WEBP",
            save_all=True,
            append_images=frames[1:],
            duration=round(1000 / fps),
            loop=0,
            quality=80,
            method=4,
        )
    return Path(target)
