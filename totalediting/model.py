"""Total-Editing (paper, figure 2): appearance, motion and light of a portrait, each from a source.

    I_app -- E_app --> F_app, detail            e_app, e_mot: codes of motion (E_mot: `motion`)
    F = F_re(F_de(F_app, e_app), e_mot)         appearance, neutralised, with the other expression
    T_geo = E_geo(F), T_shd = E_shd(F)          canonical tri-planes
    T, R from the posed bust                    where samples lie in canonical space, how n turns
    S_d, S_s(n)                                 light: baked (`lightmaps`) or seen (`illumination`)
    D_geo, D_shd, volume rendering              sigma, a, n, k_d, k_s, delta, w -> raw picture
    background, super-resolution, fine structure of I_app -> the edited picture

Symbols: B batch, S = preset.image, h = preset.neural, V control points, H rows of a lightmap.
Model space: metres, Z up, the head at rest looks along -Y, its centre is the origin.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from totalediting.geometry import moving_least_squares
from totalediting.geometry.field import Control, Field, Table, tabulate
from totalediting.geometry.frontal import both_sides
from totalediting.geometry.space import box
from totalediting.geometry.surface_field import surface_field
from totalediting.geometry.volume import resize_intrinsics
from totalediting.light import phong
from totalediting.networks.appearance import AppearanceEncoder
from totalediting.networks.decoders import Decoders
from totalediting.networks.reenactment import Deenactor, Reenactor, fuse
from totalediting.networks.rendering import Rendering, render
from totalediting.networks.superresolution import Background, SuperResolution, fine_structure, over
from totalediting.networks.triplanes import TriplaneEncoder
from totalediting.presets import Preset


class Planes(NamedTuple):
    """A person with an expression, in canonical space."""

    geometry: Tensor
    """(B, 3, plane_channels, P, P), T_geo."""
    shading: Tensor
    """The same of T_shd."""
    laid: Tensor
    """(B, LAID, S, S) what the source shows, see `frontal.both_sides`."""


class Edit(NamedTuple):
    """The result, and what it was made from."""

    image: Tensor
    """(B, 3, S, S), display-referred; in [0, 1] in evaluation."""
    raw: Tensor
    """(B, 3, h, h), display-referred, before super-resolution, over the background."""
    foreground: Tensor
    """(B, 3, h, h), display-referred, the subject over black."""
    rendering: Rendering
    planes: Planes


class Window(NamedTuple):
    """A square of the h x h picture, in its pixels from the upper left."""

    row: int
    column: int
    side: int

    def of(self, picture: Tensor, scale: int = 1) -> Tensor:
        """That part of a picture (B, C, scale h, scale h)."""
        row, column, side = (scale * n for n in self)
        return picture[..., row : row + side, column : column + side]


class TotalEditing(nn.Module):
    """The model; its `forward` is the paper's figure 2."""

    def __init__(self, preset: Preset, faces: Tensor | None = None) -> None:
        """`faces` (F, 3), triangles of the bust's control points: only for the surface field.

        Raises:
            ValueError: the preset takes the surface field, and there are no faces.
        """
        super().__init__()
        if "surface_field" in (preset.deformation, preset.rotation) and faces is None:
            raise ValueError("the surface field needs faces, the triangles of the control points")
        self.preset = preset
        self.faces = faces
        self.appearance = AppearanceEncoder(preset)
        self.deenactor, self.reenactor = Deenactor(preset), Reenactor(preset)
        self.geometry_encoder, self.shading_encoder = (
            TriplaneEncoder(preset),
            TriplaneEncoder(preset),
        )
        self.decoders = Decoders(preset)
        self.background = Background(preset)
        self.superresolution = SuperResolution(preset)

    def forward(
        self,
        app_image: Tensor,
        app_frontal: Tensor,
        e_app: Tensor,
        e_mot: Tensor,
        control: Control | Table | None,
        camera_to_world: Tensor,
        intrinsics: Tensor,
        lightmaps: Tensor,
        to_light: Tensor | None = None,
        background: Tensor | None = None,
        generator: torch.Generator | None = None,
        window: Window | None = None,
    ) -> Edit:
        """Show the person of `app_image` with another expression, pose, view and light.

        Args:
            app_image: I_app (B, 3, S, S) in [0, 1].
            app_frontal: what `frontal.frontalise` makes of it (B, 6, S, S).
            e_app, e_mot: (B, 54) codes of the motion in I_app and of the motion to show.
            control: the bust in the pose to show and at rest (B, V, 3), model space, or what
                `deformation` makes of it; None where it is at rest.
            camera_to_world: (B, 4, 4) into model space.
            intrinsics: (B, 3, 3) in pixels of side S.
            lightmaps: (B, 5, 3, H, 2H), normalised, exposed as the result should be.
            to_light: (B, 3, 3) rotation of model space into the lightmaps' frame; None if it is
                their own.
            background: (B, 3 + features, h, h) behind the subject; None for that of I_app.
            generator: scatters the samples of training.
            window: the part of the picture to render; None for all of it.

        Raises:
            ValueError: a shape does not fit.
        """
        planes = self.encode(app_image, app_frontal, e_app, e_mot)
        behind = self.background(app_image) if background is None else background
        return self.show(
            planes,
            control,
            camera_to_world,
            intrinsics,
            lightmaps,
            to_light,
            behind,
            generator,
            window,
        )

    def encode(
        self, app_image: Tensor, app_frontal: Tensor, e_app: Tensor, e_mot: Tensor
    ) -> Planes:
        """Appearance and expression to canonical tri-planes."""
        f_app, detail = self.appearance(app_image, app_frontal)
        f = fuse(self.deenactor, self.reenactor, f_app, e_app, e_mot)
        geometry, shading = self.geometry_encoder(f, detail), self.shading_encoder(f, detail)
        return Planes(geometry, shading, both_sides(app_frontal))

    def show(
        self,
        planes: Planes,
        control: Control | Table | None,
        camera_to_world: Tensor,
        intrinsics: Tensor,
        lightmaps: Tensor,
        to_light: Tensor | None,
        background: Tensor,
        generator: torch.Generator | None = None,
        window: Window | None = None,
    ) -> Edit:
        """Tri-planes in a pose, view and light; arguments as of `forward`."""
        preset, side = self.preset, self.preset.neural
        intrinsics = resize_intrinsics(intrinsics, (preset.image, preset.image), (side, side))
        if window is not None:
            side = window.side
            intrinsics = intrinsics - intrinsics.new_tensor(
                [[0, 0, window.column], [0, 0, window.row], [0, 0, 0]]
            )
            background = window.of(background)
        if to_light is None:
            to_light = torch.eye(3).to(lightmaps).expand(len(lightmaps), 3, 3)
        if isinstance(control, Control):
            control = self.deformation(control)
        rendering = render(
            planes.geometry,
            planes.shading,
            planes.laid,
            self.decoders,
            camera_to_world,
            intrinsics,
            lightmaps,
            to_light,
            control,
            preset,
            generator,
            side=side,
        )
        light = rendering.colour
        foreground = phong.display(light, 1) if preset.colour == "linear" else light
        raw, features = over(foreground, rendering.features, rendering.opacity, background)
        image = self.superresolution(raw, features)
        size = image.shape[-1]
        image = image * fine_structure(planes.laid, rendering.canonical, rendering.opacity, size)
        if not self.training:
            image = image.clamp(0, 1)
        return Edit(image, raw, foreground, rendering, planes)

    def deformation(self, control: Control) -> Table:
        """T and R of posed busts (B, V, 3), as a table over the rendered box."""
        preset = self.preset

        def one(name: str, points: Tensor) -> Field:
            if name == "surface_field":
                assert self.faces is not None  # the constructor checks it
                return surface_field(points, control, self.faces.to(points.device))
            return moving_least_squares.mls(
                points, control, preset.alpha, clusters=moving_least_squares.CLUSTERS
            )

        def field(points: Tensor) -> Field:
            moved = one(preset.deformation, points)
            if preset.rotation in ("none", preset.deformation):
                return moved
            return Field(moved.position, one(preset.rotation, points).quaternion)

        low, high = box(control.posed)
        with torch.autocast(low.device.type, enabled=False):
            return tabulate(
                field, low, high, preset.deformation_nodes, lead=control.posed.shape[:-2]
            )
