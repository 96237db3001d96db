"""The Phong reflection model and the display transform, in torch.

    c = k_d a * s_d + sum_e k_s(e) s_s(e) + residual        (paper, section 3.1)

Colours are linear Rec.709, (..., 3) with the channels last. Normals n, viewing directions v (from
the surface to the viewer) and reflected directions r share the frame of the lightmaps that they are
looked up in. Everything is differentiable, float32 or float64, and batched over leading axes.

`display` is the dataset's transform D of `conventions.colour`, differentiable. It works on whole
pixels: the axis of the channels is the last one, or `dim`.
"""

from __future__ import annotations

import torch

from assets_procedural.conventions.colour import (
    BLACK,
    CLIP,
    DARKEST,
    DARKEST_TONE,
    DEPTH,
    PALING,
    PIVOT,
    RANGE,
    SHOULDER,
    TOE,
)
from totalediting.light.lightmaps import SHININESS, sample


def reflect(view: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """Viewing directions (..., 3) mirrored at normals (..., 3), as long as they were.

    r = 2 (n.v) n - v (paper, eq. reflect) for unit normals. Of others only the direction counts,
    down to a length of 1e-6; a zero normal gives -v.

    Raises:
        ValueError: a last axis is not 3, or the leading axes do not broadcast.
    """
    _check({"view": (view, (3,)), "normal": (normal, (3,))})
    square = (normal * normal).sum(-1, keepdim=True).clamp_min(1e-12)
    return 2.0 * (normal * view).sum(-1, keepdim=True) / square * normal - view


def compose(
    albedo: torch.Tensor,
    k_d: torch.Tensor,
    s_d: torch.Tensor,
    k_s: torch.Tensor,
    s_s: torch.Tensor,
    residual: torch.Tensor | None = None,
) -> torch.Tensor:
    """Colour (..., 3) of shaded points, in linear light; leading axes broadcast.

    c = k_d a * s_d + sum_e k_s(e) s_s(e) + residual, over the exponents of `lightmaps.SHININESS`.

    Args:
        albedo: (..., 3) in [0, 1].
        k_d: (..., 1) diffuse coefficient, >= 0.
        s_d: (..., 3) diffuse shading.
        k_s: (..., 4) specular coefficients, >= 0.
        s_s: (..., 4, 3) specular shadings.
        residual: (..., 3), what the model adds beyond Phong.

    Raises:
        ValueError: a shape does not end like this, or the leading axes do not broadcast.
    """
    lobes = len(SHININESS)
    shapes = {
        "albedo": (albedo, (3,)),
        "k_d": (k_d, (1,)),
        "s_d": (s_d, (3,)),
        "k_s": (k_s, (lobes,)),
        "s_s": (s_s, (lobes, 3)),
    }
    _check(shapes if residual is None else shapes | {"residual": (residual, (3,))})
    colour = k_d * albedo * s_d + (k_s[..., None] * s_s).sum(-2)
    return colour if residual is None else colour + residual


def shade(
    lightmaps: torch.Tensor,
    normal: torch.Tensor,
    view: torch.Tensor,
    albedo: torch.Tensor,
    k_d: torch.Tensor,
    k_s: torch.Tensor,
) -> torch.Tensor:
    """Colour (..., N, 3) of surface points under lightmaps, in linear light.

    Looks s_d up at the normal and s_s at the reflected viewing direction, and composes them.

    Args:
        lightmaps: (..., 5, 3, H, 2H), as `lightmaps.bake` makes them; the leading axes of the rest
            broadcast with theirs.
        normal: (..., N, 3) in the frame of the lightmaps; only the direction counts.
        view: (..., N, 3) from the surface to the viewer, same frame, any length.
        albedo: (..., N, 3).
        k_d: (..., N, 1).
        k_s: (..., N, 4).

    Raises:
        ValueError: a shape does not end like this, or the leading axes do not broadcast.
    """
    if lightmaps.ndim < 4 or lightmaps.shape[-4:-2] != (1 + len(SHININESS), 3):
        raise ValueError(f"lightmaps must be (..., 5, 3, H, 2H), not {tuple(lightmaps.shape)}")
    s_d = sample(lightmaps[..., 0, :, :, :], normal)
    s_s = sample(lightmaps[..., 1:, :, :, :].flatten(-4, -3), reflect(view, normal))
    return compose(albedo, k_d, s_d, k_s, s_s.unflatten(-1, (len(SHININESS), 3)))


def display(linear: torch.Tensor, dim: int = -1) -> torch.Tensor:
    """D: linear light to display-referred values in [0, 1]; axis `dim` has the three channels.

    Light below 0 gives 0 without gradient, NaN a pixel of NaN; above `CLIP` only colour counts.
    """
    x = linear.clamp_min(0.0)
    x = x / (x.amax(dim, keepdim=True) / CLIP).clamp_min(1.0)
    # The bound keeps the gain and its gradient finite.
    brightest = x.amax(dim, keepdim=True).clamp_min(DARKEST)
    ratio = ((brightest + TOE) / PIVOT) ** SHOULDER
    tone = ((ratio / (1.0 + ratio)) ** DEPTH - BLACK) / RANGE
    colour = 1.0 - PALING * tone**6
    bent = tone * (1.0 - colour) + colour * (tone / brightest) * x
    power = 1.055 * bent.clamp_min(0.0031308) ** (1.0 / 2.4) - 0.055
    return torch.where(bent <= 0.0031308, 12.92 * bent, power).clamp_max(1.0)


def undisplay(shown: torch.Tensor, dim: int = -1) -> torch.Tensor:
    """The inverse of `display`: values in [0, 1] to linear light in [0, CLIP]; others clamp.

    Colours that D never shows, brilliant and bright at once, give the nearest that has no negative
    channel.
    """
    y = shown.clamp(0.0, 1.0)
    power = ((y + 0.055) / 1.055) ** 2.4
    bent = torch.where(y <= 0.04045, y / 12.92, power)
    tone = bent.amax(dim, keepdim=True).clamp_min(DARKEST_TONE)
    share = (tone * RANGE + BLACK) ** (1.0 / DEPTH)
    brightest = PIVOT * (share / (1.0 - share)) ** (1.0 / SHOULDER) - TOE
    colour = 1.0 - PALING * tone**6
    return (brightest / tone * (bent - tone * (1.0 - colour)) / colour).clamp(0.0, CLIP)


def _check(arguments: dict[str, tuple[torch.Tensor, tuple[int, ...]]]) -> None:
    """Each tensor must end in its shape, and what leads must broadcast."""
    leads = []
    for name, (tensor, tail) in arguments.items():
        shape = tuple(tensor.shape)
        if shape[-len(tail) :] != tail:
            raise ValueError(f"{name} must be (..., {', '.join(map(str, tail))}), not {shape}")
        leads.append(shape[: -len(tail)])
    try:
        torch.broadcast_shapes(*leads)
    except RuntimeError:
        named = ", ".join(f"{name} {tuple(t.shape)}" for name, (t, _) in arguments.items())
        raise ValueError(f"the leading axes of {named} do not broadcast") from None
