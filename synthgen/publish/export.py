"""Datasets for other tools: nerfstudio's transforms.json per subject and environment."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from assets_procedural.conventions import console
from assets_procedural.conventions.camera import nerfstudio_frame
from synthgen.dataset.folder import Place, StorageError
from synthgen.dataset.reading import open_dataset
from synthgen.dataset.shot import Shot, camera_of

# nerfstudio reads 16-bit depth; a tenth of a millimetre reaches to 6.5 m.
DEPTH_UNIT = 1e-4


def nerfstudio(out: Place, target: Path | str) -> Path:
    """Write `target`/<subset>/<subject>/<environment id>/transforms.json with what it names.

    Images, mattes (white = the person) and 16-bit depth are written as PNG; frames of a video
    carry their `time` in [0, 1]. Depth and mattes are shared by the environments of a subject.
    Returns `target`. Raises `StorageError` if it exists and is not an empty folder.
    """
    target = Path(target)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise StorageError(f"{target}: exists; give a new folder")
    dataset = open_dataset(out)
    subjects = list(dataset.subjects().items())
    with console.progress() as bar:
        for (subset, subject), positions in bar.track(subjects, description="exporting"):
            shots = (dataset[i] for i in positions)
            _subject(target / subset / subject, shots, len(positions))
    return target


def _subject(folder: Path, shots: Iterable[Shot], count: int) -> None:
    transforms: dict[str, dict] = {}
    for number, shot in enumerate(shots):
        _shared(folder, shot)
        for i, use in enumerate(shot.meta["environments"]):
            name = use["id"]
            images = folder / name / "images"
            images.mkdir(parents=True, exist_ok=True)
            Image.fromarray(shot.rgb[i]).save(images / f"{shot.key}.png")
            frame = nerfstudio_frame(camera_of(shot.meta))
            frame |= {
                "file_path": f"images/{shot.key}.png",
                "mask_path": f"../masks/{shot.key}.png",
                "depth_file_path": f"../depth/{shot.key}.png",
            }
            if shot.meta["kind"] == "video":
                frame["time"] = number / max(count - 1, 1)
            transform = transforms.setdefault(
                name,
                {
                    "camera_model": "OPENCV",
                    "depth_unit_scale_factor": DEPTH_UNIT,
                    "frames": [],
                },
            )
            transform["frames"].append(frame)
    for name, transform in transforms.items():
        text = json.dumps(transform, indent=1)
        (folder / name / "transforms.json").write_text(text, encoding="utf-8")


def _shared(folder: Path, shot: Shot) -> None:
    for name in ("masks", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    mask = np.where(shot.alpha > 127, 255, 0).astype(np.uint8)
    Image.fromarray(mask).save(folder / "masks" / f"{shot.key}.png")
    depth = np.clip(np.round(shot.depth / DEPTH_UNIT), 0, 65535).astype(np.uint16)
    Image.fromarray(depth).save(folder / "depth" / f"{shot.key}.png")
