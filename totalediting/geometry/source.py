"""The picture that appearance is taken from, and all that is known of it."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from totalediting.geometry.field import Control
from totalediting.geometry.mirroring import MIRROR, mirrored_code, mirrored_lightmaps


class Source(NamedTuple):
    """I_app; a batch has a leading axis B in all. S = side of pictures, h = rows of a lightmap."""

    image: Tensor
    """(3, S, S) display-referred, in [0, 1], before whatever was behind the subject."""
    alpha: Tensor
    """(1, S, S) coverage."""
    code: Tensor
    """e_app (54,)"""
    control: Control
    """(V, 3) each, model space: posed as the picture shows it; the canonical points are those of
    the bust to show, so that both lead to the same canonical space."""
    camera_to_world: Tensor
    """(4, 4) to model space."""
    intrinsics: Tensor
    """(3, 3) in pixels of side S."""
    lightmaps: Tensor
    """(5, 3, h, 2h) normalised, exposed as the picture is."""
    to_light: Tensor
    """(3, 3) rotation of model space into the lightmaps' frame."""


def mirrored_source(source: Source) -> Source:
    """A source as a mirror shows it; its light must be in model space. Twice gives the same."""
    camera_to_world, intrinsics = mirrored_camera(
        source.camera_to_world, source.intrinsics, source.image.shape[-1]
    )
    return Source(
        image=source.image.flip(-1),
        alpha=source.alpha.flip(-1),
        code=mirrored_code(source.code),
        control=Control(*(a * MIRROR for a in source.control)),
        camera_to_world=camera_to_world,
        intrinsics=intrinsics,
        lightmaps=mirrored_lightmaps(source.lightmaps),
        to_light=source.to_light,
    )


def mirrored_camera(
    camera_to_world: Tensor, intrinsics: Tensor, side: int
) -> tuple[Tensor, Tensor]:
    """A camera (4, 4), (3, 3) for the mirror image of its picture of `side`."""
    plane = MIRROR.new_ones(4)
    plane[:3] = MIRROR
    turned = intrinsics.clone()
    turned[..., 0, 2] = side - turned[..., 0, 2]
    return plane[:, None] * camera_to_world * plane, turned
