"""`totalediting evaluate --out`: asks, scores, and writes tables and a page of pictures."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torch.nn import functional

from assets_procedural.conventions.files import replacing, write_atomically
from totalediting import metrics
from totalediting.data import frames
from totalediting.data.endless import collate, to_device
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.errors import InputError
from totalediting.evaluation import tasks
from totalediting.evaluation.scores import FIGURES, Scores
from totalediting.model import Edit, TotalEditing
from totalediting.presets import Preset
from totalediting.training.reconstruction import edit_of

Row = tuple[str, list[Tensor]]
_AT_ONCE = 8
_TILE, _GAP, _ROWS = 128, 4, 4  # of the page; rows of a task
_TITLES = {
    "views": "Novel views",
    "reenactment": "Self-reenactment",
    "relighting": "Relighting",
    "cross": "Cross-reenactment",
}


@torch.no_grad()
def evaluate(
    model: TotalEditing | None,
    predictions: Path | None,
    data: Path,
    preset: Preset,
    split: str,
    out: Path,
    device: torch.device,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Path]:
    """Score a model, or the pictures of another system in a folder, and write into a folder
    tables.md, tables.json and page.png; their paths.

    `predictions` holds a PNG or JPEG "<task>/<subset>/<source>-<target>" for each question; which
    there are, and what is given for them, says questions.json, which is written first.

    Raises:
        InputError: no such dataset or split, or a picture is missing or cannot be used.
    """
    pairs = PortraitPairs(data, preset, split)
    out.mkdir(parents=True, exist_ok=True)
    asked = tasks.questions(pairs)
    listed = out / "questions.json"
    write_atomically(listed, json.dumps(_described(pairs, asked), indent=1).encode())
    scores, done = Scores(device), 0
    rows: list[Row] = []
    last: tuple[tasks.Question, Tensor, Tensor] | None = None
    for questions, samples in tasks.batches(pairs, _AT_ONCE):
        batch = to_device(collate(samples), device)
        task = questions[0].task
        if predictions is not None:
            names = [
                tasks.key_of(q, p.app_key, p.key) for q, p in zip(questions, samples, strict=True)
            ]
            answers = [_predicted(predictions, name, pairs.side) for name in names]
            made = torch.stack(answers).to(device)
        else:
            assert model is not None
            edit = edit_of(model, batch, None)
            made = edit.image
            if task != "cross":
                scores.add(task, "result", **_layers(edit, batch))
        points = torch.stack([tasks.source_points(pairs, question) for question in questions])
        _score(scores, task, made, batch, points.to(device))
        if task == "reenactment":
            shown = _over_black(batch, made)
            for k, question in enumerate(questions):
                now = (question, shown[k], batch.foreground[k])
                if last is not None and last[0].person == question.person:
                    changes = (now[1] - last[1]) - (now[2] - last[2])
                    share = batch.alpha[k].mean().clamp_min(1e-6)
                    scores.add(task, "result", flicker=float(changes.abs().mean() / share))
                last = now
        if sum(task == name for name, _ in rows) < _ROWS:
            rows += _rows(questions, batch, made)
        progress(done := done + len(questions), len(asked))
    written = [listed, out / "tables.json", out / "tables.md", out / "page.png"]
    means = scores.means()
    counts = {name: sum(q.task == name for q in asked) for name in means}
    found = {"split": split, "side": pairs.side, "questions": counts, "tables": means}
    write_atomically(written[1], json.dumps(found | {"notes": scores.notes}, indent=1).encode())
    write_atomically(written[2], markdown(means, counts, scores.notes).encode())
    _page(rows, written[3])
    return written


def markdown(
    means: dict[str, dict[str, dict[str, float]]], counts: dict[str, int], notes: list[str]
) -> str:
    """A table for each task."""
    lines = []
    for task, systems in means.items():
        names = [name for name in FIGURES if any(name in found for found in systems.values())]
        heads = [f"{_TITLES[task]}, {counts[task]} pictures", *(FIGURES[name] for name in names)]
        lines += [f"| {' | '.join(heads)} |"]
        lines += ["|---" * (1 + len(names)) + "|"]
        for system, found in systems.items():
            cells = (f"{found[name]:.3g}" if name in found else "" for name in names)
            lines += [f"| {system} | " + " | ".join(cells) + " |"]
        lines += [""]
    return "\n".join([*lines, *notes]) + "\n"


def _score(
    scores: Scores, task: str, made: Tensor, batch: PortraitPair, source_points: Tensor
) -> None:
    source, truth, matte = batch.app.image, batch.foreground, batch.alpha
    if task == "cross":
        points = (batch.points, source_points)
        scores.recognise(task, "result", (made, source), points)
        scores.recognise(task, "the driver itself", (batch.mot_image, source), points)
        return
    systems = {"result": _over_black(batch, made), "the source itself": matte * source}
    for system, picture in systems.items():
        scores.compare(task, system, picture, truth, matte)
    scores.recognise(task, "result", (made, batch.mot_image), (batch.points, batch.points))


def _over_black(batch: PortraitPair, made: Tensor) -> Tensor:
    """(B, 3, S, S): of a transparent set, answers are before black; of an opaque one, cut out."""
    known = batch.transparent[:, None, None, None]
    return torch.where(known, made, batch.alpha * made)


def _layers(edit: Edit, batch: PortraitPair) -> dict[str, Tensor]:
    """Errors (B,) of normals and albedo against the truth, by its matte."""
    size = batch.normal.shape[-2:]
    normal, albedo = (
        functional.interpolate(part, size, mode="bilinear")
        for part in (edit.rendering.normal, edit.rendering.albedo)
    )
    error = (albedo - batch.alpha * batch.albedo).abs() * batch.alpha
    return {
        "normal_error": metrics.normal_error(normal, batch.normal, batch.alpha),
        "albedo_error": error.mean((1, 2, 3)) / batch.alpha.mean((1, 2, 3)),
    }


def _described(pairs: PortraitPairs, asked: list[tasks.Question]) -> list[dict[str, str | int]]:
    """What is given for each picture, by keys and environments of the dataset."""
    return [
        {
            "picture": tasks.key_of(q, pairs.keys[q.source], pairs.keys[q.target]),
            "appearance": pairs.keys[q.source],
            "motion": pairs.keys[q.target],
            "appearance_environment": q.lights[0],
            "light_environment": q.lights[1],
        }
        for q in asked
    ]


def _predicted(folder: Path, name: str, side: int) -> Tensor:
    """(3, S, S) in [0, 1]: another system's answer."""
    for suffix in (".png", ".jpg"):
        path = folder / f"{name}{suffix}"
        if path.is_file():
            try:
                stored, turn = frames.read_picture(path)
            except (ValueError, OSError) as error:
                raise InputError(f"{path}: {error}; write it again") from None
            picture = Image.fromarray(turn.pixels(stored))
            if picture.width != picture.height:
                raise InputError(f"{path}: is {picture.width} x {picture.height}; give a square")
            picture = picture.resize((side, side), Image.Resampling.BOX)
            return torch.from_numpy(np.asarray(picture).copy()).movedim(-1, 0).float() / 255
    raise InputError(f"{folder / name}.png: is missing; questions.json says what is asked for")


def _rows(questions: list[tasks.Question], batch: PortraitPair, made: Tensor) -> list[Row]:
    return [
        (q.task, [batch.app.image[k].cpu(), batch.mot_image[k].cpu(), made[k].cpu()])
        for k, q in enumerate(questions)
    ]


def _page(rows: list[Row], target: Path) -> None:
    """Source, what is given or true, and the result, of a few questions of each task."""
    here = {task: [pictures for t, pictures in rows if t == task][:_ROWS] for task, _ in rows}
    wide, high = 3 * (_TILE + _GAP) + 2 * _GAP, _ROWS * (_TILE + _GAP) + 24
    page = Image.new("RGB", (len(here) * wide, high), "white")
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(13)
    for column, (task, found) in enumerate(here.items()):
        given = "driver" if task == "cross" else "truth"
        title = f"{_TITLES[task]}: source, {given}, result"
        pen.text((column * wide + _GAP, 4), title, "black", font)
        for row, pictures in enumerate(found):
            for k, picture in enumerate(pictures):
                large = functional.interpolate(picture[None], (_TILE, _TILE), mode="area")[0]
                pixels = (255 * large.clamp(0, 1)).round().byte().movedim(0, -1).numpy()
                place = (column * wide + _GAP + k * (_TILE + _GAP), 24 + row * (_TILE + _GAP))
                page.paste(Image.fromarray(np.ascontiguousarray(pixels)), place)
    with replacing(target) as file:
        page.save(file, "PNG")
