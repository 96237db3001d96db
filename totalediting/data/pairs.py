"""Training pairs from synthetic shards: two shots of one subject, with all that is known of them.

Model space, camera space and resizing as in `shots`; S = side of pictures, V = control points,
h = rows of a lightmap, of `Preset.image` and `Preset.lightmap_height`. The motion shot is
the target I*: what is asked of the model is the appearance shot's person in the motion shot's pose,
view and light (paper, section 4.1). In a multi-view subset the two are two views of one pose, in a
video subset two moments.

Pictures of a transparent set are put over a background here, the same for both: a new random one
in every sample of training (`augment`), else black. In an opaque set each has its own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from totalediting.data import shots
from totalediting.data.backgrounds import draw_background, put_over
from totalediting.data.endless import EndlessDataset, Unreadable
from totalediting.data.light_mixing import Light, draw_light
from totalediting.data.misfit import misfitted
from totalediting.data.shots import Shots
from totalediting.geometry.field import Control
from totalediting.geometry.mirroring import (
    FACE_POINTS,
    MIRROR,
    PARTS,
    mirrored_code,
    mirrored_lightmaps,
)
from totalediting.geometry.source import Source, mirrored_camera, mirrored_source
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
    foreground: Tensor
    """(3, S, S)"""
    lightmaps: Tensor
    """(5, 3, h, 2h), as `PortraitPair.lightmaps`."""


class PortraitPair(NamedTuple):
    """Two shots of one subject, all that is known of them; a batch has a leading axis B in all."""

    app: Source
    """I_app, and what is known of it; its light is in model space."""
    app_depth: Tensor
    """(1, S, S) planar, metres, of the appearance shot; 0 where nothing is."""
    mot_image: Tensor
    """I_mot and target I* (3, S, S)."""
    foreground: Tensor
    """(3, S, S) the same over black. In an opaque set its rims hold some of the background."""
    background: Tensor
    """(3, S, S) what is behind the subject in both pictures, display-referred; black in an opaque
    set, where it is not known."""
    transparent: Tensor
    """() bool: whether foreground and background are known."""
    albedo: Tensor
    """(3, S, S) linear, in [0, 1]; of the motion shot, as all that follows."""
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
    mot_code: Tensor
    """e_mot (54,)"""
    camera_to_world: Tensor
    """(4, 4) to model space."""
    intrinsics: Tensor
    """(3, 3) in pixels of side S."""
    control: Control
    """(V, 3) each, model space; at rest without expression where `Preset.expression` is warped."""
    lightmaps: Tensor
    """(5, 3, h, 2h) normalised, model space's axes, exposed: shading is display-exposed light."""
    seen_lightmaps: Tensor
    """The same in the frame of the motion shot's camera, what an estimator should see in I_mot; not
    turned from those, which have too few rows for that, but as exact as they."""
    relit: Relit | None
    """With `PortraitPairs(relit=True)`."""
    key: str
    """Of the motion shot, "<subset>/<shot>"."""
    app_key: str
    """Of the appearance shot."""


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
        `augment` mirrors every second pair, at random, mixes light (`light_mixing`), puts
        transparent pictures over backgrounds (`backgrounds`) and moves sources as a fit would
        (`misfit`). In `static` pairs, both shots have one pose: in a video subset they are the
        same.

        Raises:
            InputError: no dataset, one of another format, no such split or subset, an empty one.
        """
        self.shots = Shots(folder, split, subset)
        super().__init__(self.shots.keys, seed)
        self.side, self.rows = preset.image, preset.lightmap_height
        self.warped = preset.expression == "warped"
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
            source, depth = self._source(other, app_light)
        except DAMAGE as error:
            raise Unreadable(other, reason(error)) from error
        try:
            pair = self._pair(item, mot_light, another, other, source, depth)
        except DAMAGE as error:
            raise Unreadable(item, reason(error)) from error
        if self.augment:
            if pair.transparent:
                maps, lens = pair.seen_lightmaps, pair.intrinsics
                pair = before(pair, draw_background(rng, maps, lens, self.side))
            pair = pair._replace(app=misfitted(pair.app, rng))
        return mirrored(pair) if turn else pair

    def of(self, item: int, source: int, lights: tuple[int, int] = (0, 0)) -> PortraitPair:
        """The pair of two given shots, each in a given environment: the source, then the target.

        Raises `Unreadable`.
        """
        app_light, mot_light = (Light((number,), (torch.ones(3),)) for number in lights)
        try:
            made, depth = self._source(source, app_light)
            return self._pair(item, mot_light, lights[0], source, made, depth)
        except DAMAGE as error:
            raise Unreadable(item, reason(error)) from error

    def _source(self, position: int, light: Light) -> tuple[Source, Tensor]:
        """I_app, with its own expression at rest, and its depth."""
        wanted = ("alpha", "depth", "geometry", "meta")
        stored = self.shots.read(position, *light.members(), *wanted)
        meta, side = stored["meta"], self.side
        origin = head_centre(stored["geometry"]["landmarks_canonical"])
        camera_to_world, intrinsics = shots.camera(meta, origin, side)
        source = Source(
            image=self._picture(light, stored)[0],
            alpha=shots.alpha(stored["alpha"], side),
            code=shots.motion_code(meta),
            control=shots.control(stored["geometry"], origin),
            camera_to_world=camera_to_world,
            intrinsics=intrinsics,
            lightmaps=self._lightmaps(meta, light),
            to_light=torch.eye(3),
        )
        depth = stored["depth"]
        return source, shots.over_surface(depth[..., None], depth > 0, side)

    def _picture(self, light: Light, stored: dict[str, Any]) -> tuple[Tensor, bool]:
        """A shot's picture, before black if it is transparent; whether it is."""
        members = [stored[name] for name in light.members()]
        shown = [self.shots.picture(member, self.side) for member in members]
        return light.picture(shown), all(member.shape[-1] == 4 for member in members)

    def _lightmaps(self, meta: dict[str, Any], light: Light, frame: Tensor | None = None) -> Tensor:
        return light.lightmaps(
            [self.shots.lightmaps(meta, e, self.rows, frame) for e in light.environments]
        )

    def _pair(
        self,
        item: int,
        light: Light,
        another: int,
        other: int,
        app: Source,
        app_depth: Tensor,
    ) -> PortraitPair:
        labels = (
            "albedo", "normal", "depth", "canonical", "alpha", "parts", "geometry", "meta",
        )  # fmt: skip
        again = Light((another,), (torch.ones(3),))
        wanted = {*light.members(), *again.members() * self.relit, *labels}
        stored = self.shots.read(item, *sorted(wanted))
        meta, parts, side = stored["meta"], stored["parts"], self.side
        origin = head_centre(stored["geometry"]["landmarks_canonical"])
        camera_to_world, intrinsics = shots.camera(meta, origin, side)
        control = shots.control(stored["geometry"], origin)
        if self.warped:
            control = shots.neutral(control, meta, origin)
        normal = self.shots.normals(stored["normal"], parts, side)
        alpha = shots.alpha(stored["alpha"], side)
        image, transparent = self._picture(light, stored)
        relit = None
        if self.relit:
            shown = self._picture(again, stored)[0]
            over_black = shown if transparent else alpha * shown
            relit = Relit(shown, over_black, self._lightmaps(meta, again))
        return PortraitPair(
            app=app._replace(control=app.control.showing(control)),
            app_depth=app_depth,
            mot_image=image,
            foreground=image if transparent else alpha * image,
            background=torch.zeros_like(image),
            transparent=torch.tensor(transparent),
            albedo=self.shots.albedo(stored["albedo"], stored["alpha"], side),
            normal=(camera_to_world[:3, :3] @ normal.flatten(1)).view_as(normal),
            alpha=alpha,
            parts=shots.parts(parts, side),
            depth=shots.over_surface(stored["depth"][..., None], parts, side),
            canonical=shots.over_surface(stored["canonical"] - origin, parts, side),
            points=shots.five_points(meta, side),
            mot_code=shots.motion_code(meta),
            camera_to_world=camera_to_world,
            intrinsics=intrinsics,
            control=control,
            lightmaps=self._lightmaps(meta, light),
            seen_lightmaps=self._lightmaps(meta, light, camera_to_world[:3, :3]),
            relit=relit,
            key=self.keys[item],
            app_key=self.keys[other],
        )


def before(pair: PortraitPair, background: Tensor) -> PortraitPair:
    """A transparent pair, which is before black, before another background (3, S, S)."""
    app, relit = pair.app, pair.relit
    if relit is not None:
        relit = relit._replace(image=put_over(relit.foreground, pair.alpha, background))
    return pair._replace(
        app=app._replace(image=put_over(app.image, app.alpha, background)),
        mot_image=put_over(pair.foreground, pair.alpha, background),
        background=background,
        relit=relit,
    )


def mirrored(pair: PortraitPair) -> PortraitPair:
    """A pair as a mirror shows it, in model space and in pictures; twice gives what it was."""
    side, m = pair.mot_image.shape[-1], MIRROR
    relit = pair.relit
    if relit is not None:
        relit = Relit(
            relit.image.flip(-1), relit.foreground.flip(-1), mirrored_lightmaps(relit.lightmaps)
        )
    camera_to_world, intrinsics = mirrored_camera(pair.camera_to_world, pair.intrinsics, side)
    return PortraitPair(
        app=mirrored_source(pair.app),
        app_depth=pair.app_depth.flip(-1),
        mot_image=pair.mot_image.flip(-1),
        foreground=pair.foreground.flip(-1),
        background=pair.background.flip(-1),
        transparent=pair.transparent,
        albedo=pair.albedo.flip(-1),
        normal=pair.normal.flip(-1) * m[:, None, None],
        alpha=pair.alpha.flip(-1),
        parts=PARTS[pair.parts.long()].flip(-1),
        depth=pair.depth.flip(-1),
        canonical=pair.canonical.flip(-1) * m[:, None, None],
        points=(pair.points * m[:2] + side * (1 - m[:2]) / 2)[FACE_POINTS],
        mot_code=mirrored_code(pair.mot_code),
        camera_to_world=camera_to_world,
        intrinsics=intrinsics,
        control=Control(*(a * m for a in pair.control)),
        lightmaps=mirrored_lightmaps(pair.lightmaps),
        seen_lightmaps=mirrored_lightmaps(pair.seen_lightmaps),
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
