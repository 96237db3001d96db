"""Total-Editing (paper, figure 2): appearance, motion and light of a portrait, each from a source.

    I_app -- `shown` --> a sheet: what the source shows of any point of canonical space
    sheet -- E_app --> F_app, detail            e_app, e_mot: codes of motion (E_mot: `motion`)
    F = F_re(F_de(F_app, e_app), e_mot)         appearance, neutralised, with the other expression
    T_geo = E_geo(F), T_shd = E_shd(F)          canonical tri-planes
    T, R from the posed bust                    where samples lie in canonical space, how n turns
    S_d, S_s(n)                                 light: baked (`lightmaps`) or seen (`illumination`)
    D_geo, D_shd, volume rendering              sigma, a, n, k_d, k_s, delta, w -> raw picture
    background, super-resolution, D_shd once more at every pixel's surface -> the edited picture

Symbols: B batch, S = preset.image, h = preset.neural, V control points, H rows of a lightmap.
Model space: metres, Z up, the head at rest looks along -Y, its centre is the origin.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry import moving_least_squares
from totalediting.geometry.bust_view import skin_near
from totalediting.geometry.field import Control, Field, Table, tabulate
from totalediting.geometry.projection import unproject
from totalediting.geometry.shown import Shown, sheet_of
from totalediting.geometry.source import Source
from totalediting.geometry.surface_field import surface_field
from totalediting.geometry.volume import resize_intrinsics
from totalediting.light import phong
from totalediting.networks.appearance import AppearanceEncoder
from totalediting.networks.decoders import Decoders, ToPosed
from totalediting.networks.reenactment import Deenactor, Reenactor, fuse
from totalediting.networks.rendering import Rendering, render, shading_features
from totalediting.networks.superresolution import Background, SuperResolution, fine_structure, over
from totalediting.networks.triplanes import TriplaneEncoder
from totalediting.presets import Preset


class Planes(NamedTuple):
    """A person with an expression, in canonical space."""

    geometry: Tensor
    """(B, 3, plane_channels, P, P), T_geo."""
    shading: Tensor
    """The same of T_shd."""
    shown: Shown
    """What the source shows of canonical points."""


class Tables(NamedTuple):
    """The deformations that an edit takes."""

    there: Table
    """From the pose to show to canonical space, T and R."""
    back: Table
    """From canonical space to the pose in the source."""


class Edit(NamedTuple):
    """The result, and what it was made from."""

    image: Tensor
    """(B, 3, S, S), display-referred; in [0, 1] in evaluation."""
    raw: Tensor
    """(B, 3, h, h), display-referred, before super-resolution, over the background."""
    foreground: Tensor
    """(B, 3, h, h), display-referred, the subject over black."""
    behind: Tensor
    """(B, 3, h, h), display-referred, what the model takes to be behind the subject."""
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
        source: Source,
        e_mot: Tensor,
        control: Control | None,
        camera_to_world: Tensor,
        intrinsics: Tensor,
        lightmaps: Tensor,
        to_light: Tensor | None = None,
        background: Tensor | None = None,
        generator: torch.Generator | None = None,
        window: Window | None = None,
        tables: Tables | None = None,
    ) -> Edit:
        """Show the person of `source` with another expression, pose, view and light.

        Args:
            source: I_app (B, ...), and what is known of it.
            e_mot: (B, 54) code of the motion to show.
            control: the bust in the pose to show and at rest (B, V, 3), model space; None where it
                is at rest.
            camera_to_world: (B, 4, 4) into model space.
            intrinsics: (B, 3, 3) in pixels of side S.
            lightmaps: (B, 5, 3, H, 2H), normalised, exposed as the result should be.
            to_light: (B, 3, 3) rotation of model space into the lightmaps' frame; None if it is
                their own.
            background: (B, 3, S, S) what is behind the subject, display-referred; None for what the
                source shows of it.
            generator: scatters the samples of training.
            window: the part of the picture to render; None for all of it.
            tables: what `deformation` makes of `control` and of `source.control.back()`, if that
                is known.

        Raises:
            ValueError: a shape does not fit.
        """
        planes = self.encode(source, e_mot, tables and tables.back)
        behind = self.background(source.image)
        if control is None:
            rest = source.control.back()
            control, table = rest._replace(canonical=rest.posed), None
        else:
            table = self.deformation(control) if tables is None else tables.there
        return self.show(
            planes,
            control.posed,
            control.posed_normals,
            table,
            camera_to_world,
            intrinsics,
            lightmaps,
            to_light,
            behind,
            background,
            generator,
            window,
        )

    def encode(self, source: Source, e_mot: Tensor, warp: Table | None = None) -> Planes:
        """Appearance and expression to canonical tri-planes; arguments as of `forward`."""
        if warp is None:
            warp = self.deformation(source.control.back())
        with torch.autocast(source.image.device.type, enabled=False):
            sheet = sheet_of(source, warp)
        f_app, detail, shown = self.appearance(sheet)
        f = fuse(self.deenactor, self.reenactor, f_app, source.code, e_mot)
        geometry, shading = self.geometry_encoder(f, detail), self.shading_encoder(f, detail)
        return Planes(geometry, shading, shown)

    def show(
        self,
        planes: Planes,
        posed: Tensor,
        normals: Tensor,
        table: Table | None,
        camera_to_world: Tensor,
        intrinsics: Tensor,
        lightmaps: Tensor,
        to_light: Tensor | None,
        behind: Tensor,
        background: Tensor | None = None,
        generator: torch.Generator | None = None,
        window: Window | None = None,
    ) -> Edit:
        """Tri-planes in a pose, view and light; arguments as of `forward`. The bust's points and
        normals (B, V, 3) are where `table` leads to canonical space from, None where they are at
        rest. `behind` (B, 3 + F, h, h) is of `Background`; where the `background` is known, only
        its features count."""
        preset, side = self.preset, self.preset.neural
        skin = None
        if preset.samples == "surface":
            skin = skin_near(posed, normals, camera_to_world, intrinsics, preset.image, side)
        if background is not None:
            small = functional.interpolate(background, (side, side), mode="area")
        else:
            small = behind[:, :3]
        intrinsics = resize_intrinsics(intrinsics, (preset.image, preset.image), (side, side))
        if window is not None:
            side = window.side
            intrinsics = intrinsics - intrinsics.new_tensor(
                [[0, 0, window.column], [0, 0, window.row], [0, 0, 0]]
            )
            behind, small = window.of(behind), window.of(small)
            skin = None if skin is None else window.of(skin)
        if to_light is None:
            to_light = torch.eye(3).to(lightmaps).expand(len(lightmaps), 3, 3)
        rendering = render(
            planes.geometry,
            planes.shading,
            planes.shown.sheet.relief,
            planes.shown,
            self.decoders,
            camera_to_world,
            intrinsics,
            lightmaps,
            to_light,
            table,
            preset,
            generator,
            skin,
            side=side,
        )
        light, linear = rendering.colour, preset.colour == "linear"
        foreground = phong.display(light, 1) if linear else light
        seen = torch.cat([small, behind[:, 3:]], 1)
        raw, features = over(light, rendering.features, rendering.opacity, seen, linear)
        image = self.superresolution(raw, features)
        shaded, opacity = self._surface(
            planes, rendering, table, camera_to_world, intrinsics, lightmaps, to_light
        )
        scale = image.shape[-1] // side
        image = image * fine_structure(shaded, opacity, scale)
        if not self.training:
            image = image.clamp(0, 1)
        return Edit(image, raw, foreground, behind[:, :3], rendering, planes)

    def _surface(
        self,
        planes: Planes,
        rendering: Rendering,
        table: Table | None,
        camera_to_world: Tensor,
        intrinsics: Tensor,
        lightmaps: Tensor,
        to_light: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The surface at every pixel of the final picture, shaded (B, 3, S, S) display-referred,
        and its opacity (B, 1, S, S). No gradient flows into where it is."""
        small = rendering.depth.shape[-1]
        side = small * self.preset.image // self.preset.neural
        with torch.autocast(rendering.depth.device.type, enabled=False):
            both = torch.cat([rendering.opacity, rendering.opacity * rendering.depth], 1).detach()
            both = functional.interpolate(both.float(), (side, side), mode="bilinear")
            opacity, depth = both[:, :1], both[:, 1:] / both[:, :1].clamp_min(1e-4)
            lens = resize_intrinsics(intrinsics.float(), (small, small), (side, side))
            points = unproject(depth, camera_to_world.float(), lens).flatten(1, 2)
            view = functional.normalize(camera_to_world[:, None, :3, 3] - points, dim=-1)
            turned: ToPosed = lambda directions: directions  # noqa: E731
            if table is not None:
                field = table(points)
                points = field.position
                if self.preset.rotation != "none":
                    turned = field.to_posed
            shown = planes.shown
            relief = shown.sheet.relief.float()
            features = shading_features(planes.shading.float(), relief, points, shown(points))
            shading = self.decoders.shading(
                features, turned, view, lightmaps.float(), to_light.float()
            )
            colour = shading.colour.mT.unflatten(-1, (side, side))
            return (phong.display(colour, 1) if self.preset.colour == "linear" else colour), opacity

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

        lead = control.posed.shape[:-2]
        with torch.autocast(control.posed.device.type, enabled=False):
            return tabulate(field, preset.deformation_nodes, control.posed, lead)
