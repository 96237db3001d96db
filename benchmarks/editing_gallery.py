"""The pictures of docs/editing.md: one photograph, driven, turned, relit and put elsewhere.

    python benchmarks/editing_gallery.py astronaut.png --clip CLIP.mp4 --panorama sunset.exr \
        --other docs/portrait.png --out docs

Of the clip, only the bust that was fitted to its frames is shown. Needs the extra `edit`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from totalediting import Editor
from totalediting.editing.editor import Edited
from totalediting.editing.warping.bust import bust_of, triangles, view_of
from totalediting.editing.warping.numbers import unit
from totalediting.geometry.tracking import Tracking

_TILE = 224  # pixels
_QUALITY = 84
_FRAMES = 6  # of the clip


def tile(edited: Edited) -> np.ndarray:
    """The square around the face."""
    left, top, side = edited.subject.square
    shown = Image.fromarray(edited.picture)
    box = [max(left, 0), max(top, 0), min(left + side, shown.width), min(top + side, shown.height)]
    square = min(box[2] - box[0], box[3] - box[1])
    middle = (box[0] + box[2]) / 2
    box = (middle - square / 2, box[1], middle + square / 2, box[1] + square)
    return np.asarray(shown.resize((_TILE, _TILE), Image.Resampling.LANCZOS, box=box))


def clay(tracking: Tracking) -> np.ndarray:
    """A tracking's bust, grey."""
    bust, view = bust_of(tracking), view_of(tracking)
    raster = bust.raster(view, 2 * _TILE)
    normals = unit(raster.interpolate(bust.normals, triangles()))
    light = (normals @ view.frame[:3, :3] @ unit(np.array([0.4, 0.5, 0.8]))).clip(0, 1)
    shade = np.where(raster.covered, 40 + 180 * light, 250).astype(np.uint8)
    return np.repeat(np.asarray(Image.fromarray(shade).reduce(2))[..., None], 3, -1)


def sheet(rows: list[list[np.ndarray]], path: Path) -> None:
    """A JPEG of rows of tiles."""
    picture = np.concatenate([np.concatenate(row, 1) for row in rows])
    Image.fromarray(picture).save(path, quality=_QUALITY, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} KB")


def strongest(trackings: list[Tracking]) -> list[int]:
    """Numbers of frames that differ most: each is the farthest from those before it."""
    codes = [
        np.concatenate([t.expression[0].numpy(), 3 * t.head[0].numpy(), t.gaze[0].numpy()])
        for t in trackings
    ]
    values = np.stack(codes)
    chosen = [int(np.linalg.norm(values - np.median(values, 0), axis=1).argmin())]
    while len(chosen) < _FRAMES:
        away = np.linalg.norm(values[:, None] - values[chosen], axis=-1).min(1)
        chosen.append(int(away.argmax()))
    return chosen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("portrait", type=Path)
    for name in ("clip", "panorama", "other", "out"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    arguments = parser.parse_args()
    editor, person = Editor.load(), arguments.portrait
    light, out = arguments.panorama, arguments.out

    clip, rest = editor.clip(arguments.clip)
    seen = [one for one in clip.trackings if one is not None]
    chosen = [seen[number] for number in strongest(seen)]
    driven = [tile(editor.edit(person, one, rest=rest)) for one in chosen]
    sheet([[clay(one) for one in chosen], driven], out / "editing_motion.jpg")

    views = [(0, 0), (-25, 0), (25, 0), (0, 15), (0, -15), (20, 10)]
    sheet(
        [[tile(editor.edit(person, view=view)) for view in views]],
        out / "editing_view.jpg",
    )

    turns = [tile(editor.edit(person, None, light, rotate_light=d)) for d in range(0, 360, 60)]
    places = [
        tile(editor.edit(person)),
        tile(editor.edit(person, None, arguments.other)),
        tile(editor.edit(person, background="blur")),
        tile(editor.edit(person, background="#31546b")),
        tile(editor.edit(person, None, light, rotate_light=180, background="light")),
        tile(editor.edit(person, chosen[1], light, rest=rest, background="light")),
    ]
    sheet([turns, places], out / "editing_light.jpg")


if __name__ == "__main__":
    main()
