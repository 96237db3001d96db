"""Single pictures with their light and motion: for the lightmap estimator and the tracker.

Transparent pictures are put over a background (`backgrounds`), a new one in every sample.
Everything is in the camera's frame (x right, y up, looks along -z), the only one that a picture
shows. S = side of pictures, h = rows of a lightmap.

A mirrored portrait is the picture of the mirrored person in mirrored light: columns are flipped,
x of camera-space directions changes sign, left and right parts and expressions change places, and
angles that turn to the left turn to the right.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from assets_procedural.person import Person
from totalediting.data import shots
from totalediting.data.backgrounds import draw_background, put_over
from totalediting.data.endless import EndlessDataset, Unreadable
from totalediting.data.light_mixing import draw_light
from totalediting.data.pairs import DAMAGE, reason
from totalediting.data.shots import Shots
from totalediting.geometry.identity import IdentityBasis, identity_basis
from totalediting.geometry.mirroring import (
    EXPRESSIONS,
    FACE_POINTS,
    MIRROR,
    PARTS,
    mirrored_lightmaps,
)
from totalediting.geometry.rig import reframed
from totalediting.geometry.tracking import Tracking
from totalediting.presets import Preset

_ROOM = 1 << 30  # bytes of decoded shots that a process keeps


class Portrait(NamedTuple):
    """One portrait; a batch has a leading axis B in all."""

    image: Tensor
    """(3, S, S) display-referred, in [0, 1]."""
    lightmaps: Tensor
    """(5, 3, h, 2h) normalised, in the camera's frame, exposed as the picture is."""
    normal: Tensor
    """(3, S, S) unit, camera space; 0 where nothing is."""
    alpha: Tensor
    """(1, S, S) coverage."""
    parts: Tensor
    """(1, S, S) uint8."""
    truth: Tracking
    """Motion, identity and camera."""
    key: str
    """ "<subset>/<shot>" """


class Portraits(EndlessDataset[Portrait]):
    """`Portrait`s of a dataset's split: every shot once per epoch, in one of its environments."""

    def __init__(
        self,
        folder: Path | str,
        preset: Preset,
        split: str = "train",
        seed: int = 0,
        subset: str | None = None,
        mirror: bool = False,
        mix: bool = False,
    ) -> None:
        """`mirror` mirrors half of them, at random; `mix` mixes light, see `light_mixing`.

        Raises:
            InputError: no dataset, one of another format, no such split or subset, an empty one.
        """
        self.shots = Shots(folder, split, subset)
        super().__init__(self.shots.keys, seed)
        self.side, self.rows = preset.image, preset.lightmap_height
        self.mirror, self.mix = mirror, mix
        self.basis = identity_basis()
        self._decoded: dict[tuple[str | int, ...], tuple[Tensor, ...]] = {}
        self._room = _ROOM

    def make(self, item: int, rng: np.random.Generator) -> Portrait:
        """Shot number `item` under a random environment; raises `Unreadable`."""
        light = draw_light(rng, self.shots.environments(item), self.mix)
        turn = self.mirror and bool(rng.random() < 0.5)
        try:
            lit = [self._kept(self._lit, item, e) for e in light.environments]
            labels = self._kept(self._labels, item)
        except DAMAGE as error:
            raise Unreadable(item, reason(error)) from error
        pictures, maps, transparent = zip(*lit, strict=True)
        normal, alpha, parts, lens, *truth = labels
        image, lightmaps = light.picture(pictures), light.lightmaps(maps)
        if all(transparent):
            image = put_over(image, alpha, draw_background(rng, lightmaps, lens, self.side))
        portrait = Portrait(
            image=image,
            lightmaps=lightmaps,
            normal=normal,
            alpha=alpha,
            parts=parts,
            truth=Tracking(*truth),
            key=self.keys[item],
        )
        return mirrored(portrait, self.basis) if turn else portrait

    def _lit(self, item: int, environment: int) -> tuple[Tensor, ...]:
        """Picture and lightmaps of a shot in one of its environments; whether it is transparent."""
        name = shots.rgb_name(environment)
        stored = self.shots.read(item, name, "meta")
        frame = torch.tensor(stored["meta"]["camera"]["camera_to_world"])[:3, :3]
        maps = self.shots.lightmaps(stored["meta"], environment, self.rows, frame)
        picture = self.shots.picture(stored[name], self.side)
        return picture, maps, torch.tensor(stored[name].shape[-1] == 4)

    def _labels(self, item: int) -> tuple[Tensor, ...]:
        """Normals, alpha, parts, lens and the fields of the truth, which all light shares."""
        stored = self.shots.read(item, "normal", "alpha", "parts", "meta")
        parts, side = stored["parts"], self.side
        return (
            self.shots.normals(stored["normal"], parts, side),
            shots.alpha(stored["alpha"], side),
            shots.parts(parts, side),
            shots.camera(stored["meta"], np.zeros(3), side)[1],
            *self._truth(item, stored["meta"]),
        )

    def _kept(self, make: Callable[..., tuple[Tensor, ...]], *arguments: int) -> tuple[Tensor, ...]:
        """What `make` gives, decoded once; to decode it in every epoch took a third of a step."""
        key = (make.__name__, *arguments)
        if key not in self._decoded:
            made = make(*arguments)
            self._room -= sum(tensor.nbytes for tensor in made)
            if self._room < 0:
                return made
            self._decoded[key] = made
        return self._decoded[key]

    def _truth(self, item: int, meta: dict[str, Any]) -> Tracking:
        """What a tracker should find in a shot."""
        truth = shots.tracking(meta, self.basis.coefficients(Person.model_validate(meta["person"])))
        if self.shots.moves(item):  # a video is framed by the head at rest
            batch = reframed(Tracking(*(field[None] for field in truth)))
            truth = Tracking(*(field[0] for field in batch))
        return truth


def mirrored(portrait: Portrait, basis: IdentityBasis) -> Portrait:
    """A portrait as a mirror shows it; twice gives what it was."""
    return Portrait(
        image=portrait.image.flip(-1),
        lightmaps=mirrored_lightmaps(portrait.lightmaps),
        normal=portrait.normal.flip(-1) * MIRROR[:, None, None],
        alpha=portrait.alpha.flip(-1),
        parts=PARTS[portrait.parts.long()].flip(-1),
        truth=mirrored_tracking(portrait.truth, basis),
        key=portrait.key,
    )


def mirrored_tracking(truth: Tracking, basis: IdentityBasis) -> Tracking:
    """Left for right; fields (..., C)."""
    return Tracking(
        expression=truth.expression[..., EXPRESSIONS],
        gaze=truth.gaze * MIRROR[:2].to(truth.gaze),
        head=truth.head * truth.head.new_tensor([1.0, -1.0, -1.0]),
        identity=basis.mirrored(truth.identity),
        camera_yaw_pitch_roll=truth.camera_yaw_pitch_roll
        * truth.head.new_tensor([-1.0, 1.0, -1.0]),
        log_focal=truth.log_focal,
        log_fill=truth.log_fill,
        shift=truth.shift * truth.shift.new_tensor([-1.0, 1.0]),
        face=(
            truth.face.unflatten(-1, (5, 2))[..., FACE_POINTS, :] * MIRROR[:2].to(truth.face)
        ).flatten(-2),
    )
