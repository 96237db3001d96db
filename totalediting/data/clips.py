"""Pairs of frames from real clips: videos, or folders of frames, of one person each.

Everywhere below a folder, every video is a clip, and every folder that holds pictures is one, its
frames in the order of their names. Frames are taken as they are: the largest square in the middle,
resized to S, the side of the model's pictures. Optional, per clip:

    talk.mp4    talk.matte.mp4 (or .mkv …): the matte, white where the person is, frame by frame
                talk.normal.mp4: camera-space normals n (x right, y up, z towards the camera) as
                colours (n + 1) / 2, grey where unknown
    0001.png    0001.matte.png and 0001.normal.png, the same for a frame

What has no file beside it is unknown: coverage 1 and `matted` False, normals 0.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
import torch
from av.error import FFmpegError
from PIL import Image
from torch import Tensor

from totalediting.data import shots
from totalediting.data.endless import EndlessDataset, Unreadable
from totalediting.data.pairs import reason
from totalediting.errors import InputError
from totalediting.presets import Preset

VIDEOS = (".mp4", ".mkv", ".mov", ".webm", ".avi", ".m4v")
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")
LAYERS = ("matte", "normal")
_DAMAGE = (ValueError, OSError, FFmpegError)


class ClipPair(NamedTuple):
    """Three frames of one clip; a batch has a leading axis B in all."""

    app_image: Tensor
    """I_app (3, S, S) in [0, 1]."""
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
        with av.open(str(self.path)) as container:
            frames, _ = _frames(container)
        if frames < 2:
            raise ValueError(f"has {frames} frames; a pair takes 2")
        _decode(self.path, [frames - 1])
        return frames

    def read(self, numbers: Sequence[int], layer: str | None = None) -> list[np.ndarray] | None:
        """Frames (H, W, 3) uint8 by number, None for a layer that is not there."""
        path = self.path if layer is None else self.layers.get(layer)
        return None if path is None else _decode(path, numbers)


@dataclass(frozen=True)
class Frames:
    """A folder's pictures in order."""

    paths: tuple[Path, ...]

    def count(self) -> int:
        """Number of pictures; `ValueError` if there is only one."""
        if len(self.paths) < 2:
            raise ValueError("has 1 frame; a pair takes 2")
        return len(self.paths)

    def read(self, numbers: Sequence[int], layer: str | None = None) -> list[np.ndarray] | None:
        """As of `Video`."""
        paths = [self.paths[number] for number in numbers]
        if layer is not None:
            paths = [path.with_name(f"{path.stem}.{layer}.png") for path in paths]
            if not all(path.exists() for path in paths):
                return None
        return [np.asarray(Image.open(path).convert("RGB")) for path in paths]


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
                f"{', '.join(PICTURES)}"
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
            matte, normal = (clip.read([mot], layer) for layer in LAYERS)
        except _DAMAGE as error:
            raise Unreadable(item, reason(error)) from error
        assert pictures is not None
        app_image, mot_image, light_image = (_fit(picture, self.side) for picture in pictures)
        return ClipPair(
            app_image,
            mot_image,
            light_image,
            alpha=torch.ones(1, self.side, self.side)
            if matte is None
            else _fit(matte[0], self.side).mean(0, keepdim=True),
            matted=torch.tensor(matte is not None),
            normal=torch.zeros(3, self.side, self.side)
            if normal is None
            else _normals(_fit(normal[0], self.side)),
            key=self.keys[item],
        )


def _clips(folder: Path) -> dict[str, Video | Frames]:
    """Path in the folder → clip, sorted."""
    found: dict[str, Video | Frames] = {}
    for place, _, names in os.walk(folder):
        layers = {name for name in names if any(f".{layer}." in name for layer in LAYERS)}
        here, pictures = Path(place), []
        for name in sorted(set(names) - layers):
            path = here / name
            if path.suffix.lower() in VIDEOS:
                beside = {
                    layer: here / other
                    for other in sorted(layers)
                    for layer in LAYERS
                    if other.startswith(f"{path.stem}.{layer}.")
                }
                found[str(path.relative_to(folder))] = Video(path, beside)
            elif path.suffix.lower() in PICTURES:
                pictures.append(path)
        if pictures:
            found[str(here.relative_to(folder))] = Frames(tuple(pictures))
    return dict(sorted(found.items()))


def _frames(container: Any) -> tuple[int, Any]:
    """The number of frames that a video claims to have, and its stream of them."""
    stream = container.streams.video[0] if container.streams.video else None
    if stream is None or not stream.average_rate:
        raise ValueError("has no video stream")
    if stream.frames:
        return stream.frames, stream
    if stream.duration is not None:
        seconds = float(stream.duration * stream.time_base)
    else:
        seconds = (container.duration or 0) / av.time_base
    return int(seconds * float(stream.average_rate)), stream


def _decode(path: Path, numbers: Sequence[int]) -> list[np.ndarray]:
    """Frames (H, W, 3) uint8 of a video, each by seeking to the key frame before it."""
    with av.open(str(path)) as container:
        total, stream = _frames(container)
        stream.codec_context.thread_count = 1  # the loader's workers are the threads
        period = 1.0 / float(stream.average_rate * stream.time_base)  # of a frame, in ticks
        pictures = []
        for number in numbers:
            wanted = (stream.start_time or 0) + number * period
            container.seek(int(wanted), stream=stream)
            for frame in container.decode(stream):
                if frame.pts is not None and frame.pts > wanted - 0.5 * period:
                    pictures.append(frame.to_ndarray(format="rgb24"))
                    break
            else:
                raise ValueError(f"{path.name} ends early: no frame {number} of {total}")
        return pictures


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
