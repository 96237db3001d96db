"""Pairs of frames from real clips: videos, or folders of frames, of one person each.

Everywhere below a folder, every video is a clip, and every folder that holds pictures is one, its
frames in the order of their names. Frames are taken as a player shows them (see `frames`): the
largest square in the middle, resized to S, the side of the model's pictures. Optional, per clip:

    talk.mp4    talk.matte.mp4 (or .mkv …): the matte, white where the person is, frame by frame
                talk.normal.mp4: camera-space normals n (x right, y up, z towards the camera) as
                colours (n + 1) / 2, grey where unknown
    0001.png    0001.matte.png and 0001.normal.png, the same for a frame

A layer without a note of its own that turns it is turned as its picture. What has no file beside
it is unknown: coverage 1 and `matted` False, normals 0.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from av.error import FFmpegError
from torch import Tensor

from totalediting.data import frames, shots
from totalediting.data.endless import EndlessDataset, Unreadable
from totalediting.data.frames import UPRIGHT
from totalediting.data.pairs import reason
from totalediting.errors import InputError
from totalediting.presets import Preset

log = logging.getLogger(__name__)

VIDEOS = (".mp4", ".mkv", ".mov", ".webm", ".avi", ".m4v")
LAYERS = ("matte", "normal")
_DAMAGE = (ValueError, OSError, FFmpegError)


class ClipPair(NamedTuple):
    """Three frames of one clip; a batch has a leading axis B in all."""

    app_image: Tensor
    """I_app (3, S, S) in [0, 1]."""
    app_alpha: Tensor
    """(1, S, S) its matte; 1 where there is none."""
    mot_image: Tensor
    """I_mot and target I* (3, S, S)."""
    light_image: Tensor
    """I_lit (3, S, S): another random frame, in the same light (paper, section 4.1)."""
    alpha: Tensor
    """(1, S, S) the matte of I_mot; 1 where there is none."""
    matted: Tensor
    """() bool: whether there is one."""
    normal: Tensor
    """(3, S, S) pseudo normals of I_mot, unit, camera space; 0 where unknown."""
    key: str
    """Of the clip: its path in the folder."""


@dataclass(frozen=True)
class Video:
    """A video file and the videos of its layers."""

    path: Path
    layers: dict[str, Path] = field(default_factory=dict)

    def count(self) -> int:
        """Number of frames; `ValueError` if there are fewer than 2, or the last is missing."""
        count = len(_index(self.path).pts)
        if count < 2:
            raise ValueError(f"has {count} frames; a pair takes 2")
        frames.read_video(self.path, _index(self.path), [count - 1])
        return count

    def read(self, numbers: Sequence[int]) -> list[Frame]:
        """Frames by number."""
        pictures, turn = frames.read_video(self.path, _index(self.path), numbers)
        return [Frame(stored, turn) for stored in pictures]

    def layer(self, name: str, number: int) -> Frame | None:
        """A frame of a layer; None if there is no such layer."""
        path = self.layers.get(name)
        if path is None:
            return None
        (stored,), turn = frames.read_video(path, _index(path), [number])
        return Frame(stored, turn)


@dataclass(frozen=True)
class Frames:
    """A folder's pictures in order."""

    paths: tuple[Path, ...]

    def count(self) -> int:
        """Number of pictures; `ValueError` if there is only one."""
        if len(self.paths) < 2:
            raise ValueError("has 1 frame; a pair takes 2")
        return len(self.paths)

    def read(self, numbers: Sequence[int]) -> list[Frame]:
        """Frames by number."""
        return [Frame(*frames.read_picture(self.paths[number])) for number in numbers]

    def layer(self, name: str, number: int) -> Frame | None:
        """A frame of a layer; None if there is no file of it."""
        path = self.paths[number]
        path = path.with_name(f"{path.stem}.{name}.png")
        return Frame(*frames.read_picture(path)) if path.exists() else None


class Frame(NamedTuple):
    """A picture (h, w, 3) uint8 as stored, and how a player turns it."""

    stored: np.ndarray
    turn: frames.Turn

    def shown(self) -> np.ndarray:
        """The picture upright."""
        return self.turn.pixels(self.stored)

    def over(self, picture: Frame) -> Frame:
        """A layer turned as its picture is, unless it says itself how it is turned.

        Programs that make mattes and normals of stored pixels lose the note that turns them.
        """
        same = self.stored.shape == picture.stored.shape
        return Frame(self.stored, picture.turn) if self.turn == UPRIGHT and same else self


@lru_cache(maxsize=512)
def _index(path: Path) -> frames.VideoIndex:
    return frames.index_video(path)


class Clips(EndlessDataset[ClipPair]):
    """`ClipPair`s: every clip of a folder once per epoch, its frames at random."""

    def __init__(self, folder: Path | str, preset: Preset, seed: int = 0) -> None:
        """Raises `InputError`: there is no such folder, or no clip in it. Opens no clip yet."""
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder; give one with videos or folders of frames")
        found = _clips(folder)
        if not found:
            raise InputError(
                f"{folder}: no clip in it; videos end in {', '.join(VIDEOS)}, frames in "
                f"{', '.join(frames.PICTURES)}"
            )
        super().__init__(list(found), seed)
        self.clips = list(found.values())
        self.side = preset.image
        self._counts: dict[int, int | str] = {}  # frames of a clip, or what is wrong with it

    def make(self, item: int, rng: np.random.Generator) -> ClipPair:
        """Random frames of clip number `item`, two at least; raises `Unreadable`."""
        clip = self.clips[item]
        # Counted once, from the clip alone, so that its samples do not depend on earlier ones.
        if item not in self._counts:
            try:
                self._counts[item] = clip.count()
            except _DAMAGE as error:
                self._counts[item] = reason(error)
        count = self._counts[item]
        if isinstance(count, str):
            raise Unreadable(item, count)
        app, mot, lit = (int(n) for n in rng.choice(count, size=3, replace=count < 3))
        if app == mot:
            app = (mot + 1) % count
        try:
            pictures = clip.read([app, mot, lit])
            matte, normal = (clip.layer(layer, mot) for layer in LAYERS)
            app_matte = clip.layer("matte", app)
        except _DAMAGE as error:
            raise Unreadable(item, reason(error)) from error
        app_image, mot_image, light_image = (_fit(frame.shown(), self.side) for frame in pictures)
        matte, normal = (layer and layer.over(pictures[1]) for layer in (matte, normal))
        return ClipPair(
            app_image,
            self._coverage(app_matte and app_matte.over(pictures[0])),
            mot_image,
            light_image,
            alpha=self._coverage(matte),
            matted=torch.tensor(matte is not None),
            normal=torch.zeros(3, self.side, self.side)
            if normal is None
            else _normals(_fit(normal.turn.normals(normal.stored), self.side)),
            key=self.keys[item],
        )

    def _coverage(self, matte: Frame | None) -> Tensor:
        if matte is None:
            return torch.ones(1, self.side, self.side)
        return _fit(matte.shown(), self.side).mean(0, keepdim=True)


def _clips(folder: Path) -> dict[str, Video | Frames]:
    """Path in the folder → clip, sorted; links are followed, each folder once."""
    found: dict[str, Video | Frames] = {}
    visited = set()
    for place, folders, names in os.walk(folder, onerror=_unreadable, followlinks=True):
        if (real := os.path.realpath(place)) in visited:
            folders.clear()
            continue
        visited.add(real)
        here, kept = Path(place), sorted(name for name in names if not frames.is_litter(name))
        videos = [here / name for name in kept if Path(name).suffix.lower() in VIDEOS]
        pictures = [here / name for name in kept if Path(name).suffix.lower() in frames.PICTURES]
        videos, beside = _layered(videos)
        for path in videos:
            found[str(path.relative_to(folder))] = Video(path, beside.get(path.stem, {}))
        pictures, _ = _layered(pictures)
        if pictures:
            found[str(here.relative_to(folder))] = Frames(tuple(pictures))
    return dict(sorted(found.items()))


def _layered(paths: list[Path]) -> tuple[list[Path], dict[str, dict[str, Path]]]:
    """Files that are no layer of another one, and layers by the stem of what they belong to."""
    stems = {path.stem for path in paths}
    layers: dict[str, dict[str, Path]] = {}
    bases = []
    for path in paths:
        stem, _, layer = path.stem.rpartition(".")
        if layer in LAYERS and stem in stems:
            layers.setdefault(stem, {})[layer] = path
        else:
            bases.append(path)
    return bases, layers


def _unreadable(error: OSError) -> None:
    log.warning("%s: %s; the clips in it are left out", error.filename, error.strerror)


def _fit(picture: np.ndarray, side: int) -> Tensor:
    """The middle square of (H, W, 3) uint8 as (3, side, side) in [0, 1]."""
    height, width = picture.shape[:2]
    edge = min(height, width)
    top, left = (height - edge) // 2, (width - edge) // 2
    return shots.picture(picture[top : top + edge, left : left + edge], side)


def _normals(colours: Tensor) -> Tensor:
    """Colours (3, S, S) to unit normals; 0 where they are nearer to grey than to any direction."""
    vectors = 2.0 * colours - 1.0
    length = vectors.norm(dim=0, keepdim=True)
    return torch.where(length > 0.5, vectors / length.clamp_min(1e-6), 0.0)
