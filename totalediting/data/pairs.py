"""Training pairs from synthetic shards: two shots of one subject, with all that is known of them.

Model space, camera space and resizing as in `shots`; S = side of pictures, V = control points,
h = rows of a lightmap, of `Preset.image` and `Preset.lightmap_height`. The motion shot is
the target I*: what is asked of the model is the appearance shot's person in the motion shot's pose,
view and light (paper, section 4.1). In a multi-view subset the two are two views of one pose, in a
video subset two moments.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from totalediting.data import shots
from totalediting.data.endless import EndlessDataset, Unreadable
from totalediting.data.light_mixing import Light, draw_light
from totalediting.data.shots import Shots
from totalediting.geometry.field import Control
from totalediting.geometry.frontal import frontalise
from totalediting.geometry.mirroring import (
    FACE_POINTS,
    MIRROR,
    PARTS,
    mirrored_code,
    mirrored_lightmaps,
)
from totalediting.geometry.space import head_centre
from totalediting.presets import Preset

MIRRORED = " mirrored"
"""Suffix of the key of a mirrored pair."""
DAMAGE = (ValueError, KeyError, OSError)
"""What a damaged or missing file makes readers raise."""


class Relit(NamedTuple):
    """The motion shot in another of its environments; all else is the same."""

    image: Tensor
    """(3, S, S)"""
    lightmaps: Tensor
    """(5, 3, h, 2h), as `PortraitPair.lightmaps`."""


class PortraitPair(NamedTuple):
    """Two shots of one subject, all that is known of them; a batch has a leading axis B in all."""

    app_image: Tensor
    """I_app (3, S, S), display-referred in [0, 1]."""
    app_frontal: Tensor
    """(6, S, S) what `frontal.frontalise` makes of it."""
    mot_image: Tensor
    """I_mot and target I* (3, S, S)."""
    albedo: Tensor
    """(3, S, S) linear, in [0, 1]; of the motion shot, as all that follows but `app_code`."""
    normal: Tensor
    """(3, S, S) unit, model space; 0 where nothing is."""
    alpha: Tensor
    """(1, S, S) coverage."""
    parts: Tensor
    """(1, S, S) uint8, the ids of docs/conventions.md."""
    depth: Tensor
    """(1, S, S) planar, metres; 0 where nothing is."""
    canonical: Tensor
    """(3, S, S) canonical positions in model space; 0 where nothing is."""
    points: Tensor
    """(5, 2) pixels of side S: eyes, nose, corners of the mouth, see `sface.five_points`."""
    app_code: Tensor
    """e_app (54,)"""
    mot_code: Tensor
    """e_mot (54,)"""
    camera_to_world: Tensor
    """(4, 4) to model space."""
    intrinsics: Tensor
    """(3, 3) in pixels of side S."""
    control: Control
    """(V, 3) each, model space."""
    lightmaps: Tensor
    """(5, 3, h, 2h) normalised, model space's axes, exposed: shading is display-exposed light."""
    relit: Relit | None
    """With `PortraitPairs(relit=True)`."""
    key: str
    """Of the motion shot, "<subset>/<shot>"."""
    app_key: str
    """Of the appearance shot."""


class _Source(NamedTuple):
    """I_app, and where it was taken from."""

    image: Tensor
    code: Tensor
    control: Control
    camera_to_world: Tensor
    intrinsics: Tensor

    def frontal(self, shown: Control) -> Tensor:
        """What `frontalise` makes of it, with the expression of another bust."""
        control = self.control.showing(shown)
        batch = Control(*(a[None] for a in control))
        frames = self.camera_to_world[None], self.intrinsics[None]
        return frontalise(self.image[None], batch, *frames)[0]


class PortraitPairs(EndlessDataset[PortraitPair]):
    """`PortraitPair`s of a dataset's split; each shot is the motion shot once per epoch.

    The appearance shot is another one of the same subject, where there is one; the environments of
    the two are drawn independently of each other.
    """

    def __init__(
        self,
        folder: Path | str,
        preset: Preset,
        split: str = "train",
        seed: int = 0,
        subset: str | None = None,
        relit: bool = False,
        augment: bool = False,
        static: bool = False,
    ) -> None:
        """Make pairs.

        `relit` adds the motion shot in another environment, or the same if it has only one.
        `augment` mirrors every second pair, at random, and mixes light, see `light_mixing`. In
        `static` pairs, both shots have one pose: in a video subset they are the same.

        Raises:
            InputError: no dataset, one of another format, no such split or subset, an empty one.
        """
        self.shots = Shots(folder, split, subset)
        super().__init__(self.shots.keys, seed)
        self.side, self.rows = preset.image, preset.lightmap_height
        self.relit, self.augment, self.static = relit, augment, static
        self._of_subject: dict[str, list[int]] = {}
        for position, subject in enumerate(self.shots.subjects):
            self._of_subject.setdefault(subject, []).append(position)

    def make(self, item: int, rng: np.random.Generator) -> PortraitPair:
        """The pair whose motion shot is number `item`; raises `Unreadable`."""
        same = [other for other in self._of_subject[self.shots.subjects[item]] if other != item]
        if self.static and self.shots.moves(item):
            same = []
        other = int(rng.choice(same)) if same else item
        count = self.shots.environments(item)
        app_light, mot_light = (draw_light(rng, count, self.augment) for _ in range(2))
        another = (mot_light.environments[0] + 1 + int(rng.integers(max(count - 1, 1)))) % count
        turn = self.augment and bool(rng.random() < 0.5)
        try:
            source = self._source(other, app_light)
        except DAMAGE as error:
            raise Unreadable(other, reason(error)) from error
        try:
            pair = self._pair(item, mot_light, another, other, source)
        except DAMAGE as error:
            raise Unreadable(item, reason(error)) from error
        return mirrored(pair) if turn else pair

    def _source(self, position: int, light: Light) -> _Source:
        stored = self.shots.read(position, *light.members(), "geometry", "meta")
        origin = head_centre(stored["geometry"]["landmarks_canonical"])
        return _Source(
            self._picture(light, stored),
            shots.motion_code(stored["meta"]),
            shots.control(stored["geometry"], origin),
            *shots.camera(stored["meta"], origin, self.side),
        )

    def _picture(self, light: Light, stored: dict[str, Any]) -> Tensor:
        return light.picture([self.shots.picture(stored[m], self.side) for m in light.members()])

    def _pair(
        self, item: int, light: Light, another: int, other: int, source: _Source
    ) -> PortraitPair:
        rgb, rgb_relit = light.members(), shots.rgb_name(another)
        labels = (
            "albedo", "normal", "depth", "canonical", "alpha", "parts", "geometry", "meta",
        )  # fmt: skip
        wanted = {*rgb, rgb_relit, *labels} if self.relit else {*rgb, *labels}
        stored = self.shots.read(item, *sorted(wanted))
        meta, parts, side = stored["meta"], stored["parts"], self.side
        origin = head_centre(stored["geometry"]["landmarks_canonical"])
        camera_to_world, intrinsics = shots.camera(meta, origin, side)
        control = shots.control(stored["geometry"], origin)
        normal = self.shots.normals(stored["normal"], parts, side)
        relit = None
        if self.relit:
            relit = Relit(
                self.shots.picture(stored[rgb_relit], side),
                self.shots.lightmaps(meta, another, self.rows),
            )
        return PortraitPair(
            app_image=source.image,
            app_frontal=source.frontal(control),
            mot_image=self._picture(light, stored),
            albedo=self.shots.albedo(stored["albedo"], stored["alpha"], side),
            normal=(camera_to_world[:3, :3] @ normal.flatten(1)).view_as(normal),
            alpha=shots.alpha(stored["alpha"], side),
            parts=shots.parts(parts, side),
            depth=shots.over_surface(stored["depth"][..., None], parts, side),
            canonical=shots.over_surface(stored["canonical"] - origin, parts, side),
            points=shots.five_points(meta, side),
            app_code=source.code,
            mot_code=shots.motion_code(meta),
            camera_to_world=camera_to_world,
            intrinsics=intrinsics,
            control=control,
            lightmaps=light.lightmaps(
                [self.shots.lightmaps(meta, e, self.rows) for e in light.environments]
            ),
            relit=relit,
            key=self.keys[item],
            app_key=self.keys[other],
        )


def mirrored(pair: PortraitPair) -> PortraitPair:
    """A pair as a mirror shows it, in model space and in pictures; twice gives what it was."""
    side, m = pair.app_image.shape[-1], MIRROR
    plane = torch.diag(torch.cat([m, m.new_ones(1)]))
    flip = pair.intrinsics.new_tensor([[1.0, 1.0, -1.0], [1, 1, 1], [1, 1, 1]])
    relit = pair.relit
    if relit is not None:
        relit = Relit(relit.image.flip(-1), mirrored_lightmaps(relit.lightmaps))
    return PortraitPair(
        app_image=pair.app_image.flip(-1),
        app_frontal=pair.app_frontal.flip(-1),
        mot_image=pair.mot_image.flip(-1),
        albedo=pair.albedo.flip(-1),
        normal=pair.normal.flip(-1) * m[:, None, None],
        alpha=pair.alpha.flip(-1),
        parts=PARTS[pair.parts.long()].flip(-1),
        depth=pair.depth.flip(-1),
        canonical=pair.canonical.flip(-1) * m[:, None, None],
        points=(pair.points * m[:2] + side * (1 - m[:2]) / 2)[FACE_POINTS],
        app_code=mirrored_code(pair.app_code),
        mot_code=mirrored_code(pair.mot_code),
        camera_to_world=plane @ pair.camera_to_world @ plane,
        intrinsics=pair.intrinsics * flip + (1 - flip) / 2 * side,
        control=Control(*(a * m for a in pair.control)),
        lightmaps=mirrored_lightmaps(pair.lightmaps),
        relit=relit,
        key=pair.key + MIRRORED,
        app_key=pair.app_key,
    )


def reason(error: BaseException) -> str:
    """An error in one short line."""
    if isinstance(error, KeyError):
        return f"no {error.args[0]}"
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__
