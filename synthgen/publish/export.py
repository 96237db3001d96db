"""Datasets for other tools: nerfstudio's transforms.json per subject and environment."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from assets_procedural.conventions import console
from assets_procedural.conventions.camera import nerfstudio_frame
from synthgen.dataset.folder import NAME, Place, StorageError, not_a_name
from synthgen.dataset.reading import Dataset, open_dataset
from synthgen.dataset.shot import Shot, camera_of

DEPTH_UNIT = 1e-3
"""Metres. nerfstudio takes the unit of 16-bit depth from its own command line, never from the file:
`depth_unit_scale_factor`, "Default value is 0.001 for a millimeter to meter conversion"
(nerfstudio/data/dataparsers/nerfstudio_dataparser.py)."""


def nerfstudio(shots: Dataset | Place, target: Path | str) -> Path:
    """Write `target`/<subset>/<subject>/<environment id>/transforms.json with what it names.

    `shots` is a dataset's folder, or what `open_dataset` chose of it. Images, mattes (white = the
    person) and planar depth (16 bit, millimetres, 0 where nothing is hit) are written as PNG;
    frames of a video carry their `time` in [0, 1]. Depth and mattes are shared by the environments
    of a subject. Returns `target`.

    Raises `StorageError` if `target` exists and is not an empty folder, if there is no shot, or if
    one is damaged; then nothing of `target` is left.
    """
    target = Path(target)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise StorageError(f"{target}: exists; give a new folder")
    dataset = shots if isinstance(shots, Dataset) else open_dataset(shots)
    if not len(dataset):
        raise StorageError(f"{dataset.folder}: no shot to export; ask for others")
    with _whole_or_absent(target):
        for (subset, subject), positions in console.track(dataset.subjects().items(), "exporting"):
            folder = target / _name(subset, "subset") / _name(subject, "key")
            _subject(folder, (dataset[i] for i in positions), len(positions))
    return target


@contextlib.contextmanager
def _whole_or_absent(target: Path) -> Iterator[None]:
    existed = target.exists()
    try:
        yield
    except BaseException:
        for path in target.iterdir() if existed else [target]:
            shutil.rmtree(path, ignore_errors=True)
        raise


def _subject(folder: Path, shots: Iterable[Shot], count: int) -> None:
    transforms: dict[str, dict] = {}
    for number, shot in enumerate(shots):
        file = f"{_name(shot.key, 'key')}.png"
        _shared(folder, shot, file)
        for i, use in enumerate(shot.meta["environments"]):
            name = _name(use["id"], "environment")
            images = folder / name / "images"
            images.mkdir(parents=True, exist_ok=True)
            Image.fromarray(shot.rgb[i]).save(images / file)
            frame = nerfstudio_frame(camera_of(shot.meta))
            frame |= {
                "file_path": f"images/{file}",
                "mask_path": f"../masks/{file}",
                "depth_file_path": f"../depth/{file}",
            }
            if shot.meta["kind"] == "video":
                frame["time"] = number / max(count - 1, 1)
            transform = transforms.setdefault(name, {"camera_model": "OPENCV", "frames": []})
            transform["frames"].append(frame)
    for name, transform in transforms.items():
        text = json.dumps(transform, indent=1)
        (folder / name / "transforms.json").write_text(text, encoding="utf-8")


def _shared(folder: Path, shot: Shot, file: str) -> None:
    """What all environments of a shot have in common."""
    for name in ("masks", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    mask = np.where(shot.alpha > 127, 255, 0).astype(np.uint8)
    Image.fromarray(mask).save(folder / "masks" / file)
    depth = np.clip(np.round(shot.depth / DEPTH_UNIT), 0, 65535).astype(np.uint16)
    Image.fromarray(depth).save(folder / "depth" / file)


def _name(text: str, what: str) -> str:
    """A part of a path: whoever wrote the dataset may have written anything."""
    if not isinstance(text, str) or not NAME.fullmatch(text):
        raise StorageError(not_a_name(str(text), what))
    return text
