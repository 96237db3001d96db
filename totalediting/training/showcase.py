"""A page of results of a trained run: source, result, truth, decomposition of held-out people.

Each row is a pair of pictures of one person held out of training. The model is given the light of
the driver's panorama; "seen light" is what the run's lightmap estimator, if there is one, finds in
the driver's picture, in the frame of its camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torch.nn import functional

from assets_procedural.conventions.files import replacing
from totalediting import metrics
from totalediting.data.endless import collate
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.geometry.identity import faces_of
from totalediting.light import phong
from totalediting.light.pictures import EDGE, FAINT, GAP, INK, PAPER
from totalediting.model import TotalEditing
from totalediting.networks.lightmap_estimator import LightmapEstimator
from totalediting.presets import Preset
from totalediting.training import checkpoints
from totalediting.training.joint import Joint
from totalediting.training.reconstruction import decomposition, edit_of, over_black
from totalediting.training.stages import STAGES

_TILE = 128
_SPECULAR = 3  # of the lightmaps, the one that is shown: n = 32


def load_model(run: Path) -> TotalEditing:
    """A run's model: the best of the stage `joint`, or else of `reconstruct`.

    Raises:
        InputError: neither was trained there.
    """
    if (joint := _joint(run)) is not None:
        return joint.model.eval()
    folder = STAGES["reconstruct"].folder(run)
    model = TotalEditing(*_built(folder))
    checkpoints.load_best(folder, model)
    return model.eval()


def load_estimator(run: Path) -> LightmapEstimator | None:
    """A run's lightmap estimator, from `joint` or `lightmaps`; None if it has none."""
    if (joint := _joint(run)) is not None:
        return joint.estimator.eval()
    folder = STAGES["lightmaps"].folder(run)
    if checkpoints.best_step(folder) is None:
        return None
    estimator = LightmapEstimator(_built(folder)[0])
    checkpoints.load_best(folder, estimator)
    return estimator.eval()


def _joint(run: Path) -> Joint | None:
    folder = STAGES["joint"].folder(run)
    if checkpoints.best_step(folder) is None:
        return None
    joint = Joint(*_built(folder))
    checkpoints.load_best(folder, joint)
    return joint


def _built(folder: Path) -> tuple[Preset, Tensor | None]:
    """The preset that a stage's folder was trained with, and the faces that it takes."""
    preset = checkpoints.preset_of(folder)
    return preset, faces_of(preset)


@torch.no_grad()
def draw(run: Path, data: Path, target: Path, rows: int = 6, split: str = "test") -> Path:
    """Draw the page, as JPEG or else PNG; gives its path.

    Raises:
        InputError: the run has no trained model, or the dataset no such split.
    """
    model, estimator = load_model(run), load_estimator(run)
    pairs = PortraitPairs(data, model.preset, split, seed=1)
    batch = collate(of_different_people(pairs, rows))
    edit = edit_of(model, batch, None)
    columns: dict[str, Tensor] = {
        "source": batch.app.image,
        "driver": batch.mot_image,
        "its light": _light(batch.lightmaps),
        "result": over_black(batch, edit),
        "truth": batch.foreground,
        **decomposition(edit, batch.camera_to_world),
    }
    if estimator is not None:
        columns["seen light"] = _light(estimator.lightmaps(batch.mot_image))
    matte, truth = batch.alpha, batch.foreground
    score = metrics.psnr(over_black(batch, edit), truth).mean()
    alone = metrics.psnr(matte * batch.app.image, truth).mean()
    title = f"PSNR {float(score):.1f} dB; of the source itself {float(alone):.1f} dB"
    return _page(columns, title, target)


def of_different_people(pairs: PortraitPairs, count: int) -> list[PortraitPair]:
    """A sample each of `count` subjects, or of all where there are fewer."""
    subject_of = dict(zip(pairs.keys, pairs.shots.subjects, strict=True))
    people = min(count, len(set(subject_of.values())))
    found: dict[str, PortraitPair] = {}
    for number in range(len(pairs)):
        if len(found) == people:
            break
        sample = pairs[number]
        found.setdefault(subject_of[sample.key], sample)
    return list(found.values())


def _light(maps: Tensor) -> Tensor:
    """The n = 32 map of lightmaps, at half its brightness."""
    return phong.display(0.5 * maps[:, _SPECULAR], 1)


def _page(columns: dict[str, Tensor], title: str, target: Path) -> Path:
    widths = {n: _TILE * p.shape[-1] // p.shape[-2] for n, p in columns.items()}
    rows = len(next(iter(columns.values())))
    width = 2 * EDGE + sum(widths.values()) + GAP * (len(columns) - 1)
    top = EDGE + 52
    page = Image.new("RGB", (width, top + rows * (_TILE + GAP) + EDGE), PAPER)
    pen = ImageDraw.Draw(page)
    pen.text((EDGE, EDGE - 8), title, INK, ImageFont.load_default(20))
    x = EDGE
    for name, pictures in columns.items():
        pen.text((x + 1, top - 20), name, FAINT, ImageFont.load_default(13))
        size = (_TILE, widths[name])
        large = functional.interpolate(pictures.cpu(), size, mode="bilinear").clamp(0, 1)
        for k, picture in enumerate(large):
            pixels = (picture * 255).round().byte().movedim(0, -1).numpy()
            page.paste(Image.fromarray(np.ascontiguousarray(pixels)), (x, top + k * (_TILE + GAP)))
        x += widths[name] + GAP
    kind = "JPEG" if target.suffix.lower() in (".jpg", ".jpeg") else "PNG"
    with replacing(target) as file:
        page.save(file, kind, quality=92)
    return target
