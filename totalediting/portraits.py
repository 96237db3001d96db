"""Single pictures with their light and motion: for the lightmap estimator and the tracker.

Everything is in the camera's frame (x right, y up, looks along -z), the only one that a picture
shows. S = side of pictures, h = rows of a lightmap.

A mirrored portrait is the picture of the mirrored person in mirrored light: columns are flipped,
x of camera-space directions changes sign, left and right parts and expressions change places, and
angles that turn to the left turn to the right.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from assets_procedural.motion import ARKIT_NAMES
from assets_procedural.person import Person
from totalediting import shots
from totalediting.data import DAMAGE, reason
from totalediting.identity import IdentityBasis, identity_basis
from totalediting.motion import Tracking
from totalediting.numbered import Numbered, Unreadable
from totalediting.presets import Preset
from totalediting.shots import Shots


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


class Portraits(Numbered[Portrait]):
    """`Portrait`s of a dataset's split: every shot once per epoch, in one of its environments."""

    def __init__(
        self,
        folder: Path | str,
        preset: Preset,
        split: str = "train",
        seed: int = 0,
        subset: str | None = None,
        mirror: bool = False,
    ) -> None:
        """`mirror` mirrors every second one, at random.

        Raises:
            InputError: no dataset, one of another format, no such split or subset, an empty one.
            RuntimeError: there is no head model and it cannot be built.
        """
        self.shots = Shots(folder, split, subset)
        super().__init__(self.shots.keys, seed)
        self.side, self.rows, self.mirror = preset.image, preset.lightmap_height, mirror
        self.basis = identity_basis()
        self._identities: dict[str, Tensor] = {}

    def make(self, item: int, rng: np.random.Generator) -> Portrait:
        """Shot number `item` under a random environment; raises `Unreadable`."""
        light = int(rng.integers(self.shots.environments(item)))
        turn = self.mirror and bool(rng.random() < 0.5)
        rgb, side = f"rgb_{light:02d}", self.side
        try:
            stored = self.shots.read(item, rgb, "normal", "alpha", "parts", "meta")
            meta, parts = stored["meta"], stored["parts"]
            frame = torch.tensor(meta["camera"]["camera_to_world"])[:3, :3]
            portrait = Portrait(
                image=shots.picture(stored[rgb], side),
                lightmaps=self.shots.lightmaps(meta, light, self.rows, frame),
                normal=shots.normals(stored["normal"], parts, side),
                alpha=shots.alpha(stored["alpha"], side),
                parts=shots.parts(parts, side),
                truth=shots.tracking(meta, self._identity(item, meta["person"])),
                key=self.keys[item],
            )
        except DAMAGE as error:
            raise Unreadable(item, reason(error)) from error
        return mirrored(portrait, self.basis) if turn else portrait

    def _identity(self, item: int, person: dict) -> Tensor:
        subject = self.shots.subjects[item]
        if subject not in self._identities:
            found = self.basis.coefficients(Person.model_validate(person))
            self._identities[subject] = found
        return self._identities[subject]


def mirrored(portrait: Portrait, basis: IdentityBasis) -> Portrait:
    """A portrait as a mirror shows it; twice gives what it was."""
    return Portrait(
        image=portrait.image.flip(-1),
        lightmaps=mirrored_lightmaps(portrait.lightmaps),
        normal=portrait.normal.flip(-1) * _MIRROR[:, None, None],
        alpha=portrait.alpha.flip(-1),
        parts=_PARTS[portrait.parts.long()].flip(-1),
        truth=mirrored_tracking(portrait.truth, basis),
        key=portrait.key,
    )


def mirrored_lightmaps(maps: Tensor) -> Tensor:
    """Maps (..., H, 2H) whose value at (x, y, z) is the old one at (-x, y, z), exactly.

    The azimuth becomes pi less it, so that column j takes column H - 1 - j, modulo 2H.
    """
    return maps.flip(-1).roll(maps.shape[-2], -1)


def mirrored_tracking(truth: Tracking, basis: IdentityBasis) -> Tracking:
    """Left for right; fields (..., C)."""
    return Tracking(
        expression=truth.expression[..., _EXPRESSIONS],
        gaze=truth.gaze * truth.gaze.new_tensor([-1.0, 1.0]),
        head=truth.head * truth.head.new_tensor([1.0, -1.0, -1.0]),
        identity=basis.mirrored(truth.identity),
        camera_yaw_pitch_roll=truth.camera_yaw_pitch_roll
        * truth.head.new_tensor([-1.0, 1.0, -1.0]),
        log_focal=truth.log_focal,
        log_fill=truth.log_fill,
        shift=truth.shift * truth.shift.new_tensor([-1.0, 1.0]),
    )


def _other_side(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    return name.removesuffix("Right") + "Left" if name.endswith("Right") else name


_MIRROR = torch.tensor([-1.0, 1.0, 1.0])
_EXPRESSIONS = [ARKIT_NAMES.index(_other_side(name)) for name in ARKIT_NAMES]
_PARTS = torch.arange(256, dtype=torch.uint8)
_PARTS[[3, 4, 5, 6, 7, 8]] = torch.tensor(
    [4, 3, 6, 5, 8, 7], dtype=torch.uint8
)  # eyes, brows, ears
