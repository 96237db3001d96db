"""How good results are, against the truth: pictures, normals, light.

Pictures are (B, C, H, W) in [0, 1]. With a `matte` (B, 1, H, W), always the truth's, both are put
over black first, so that backgrounds do not count; the mean is over all pixels all the same. Every
figure is per sample, (B,): a data set's figure is the mean over its samples, whatever the batches.
LPIPS is `totalediting.pretrained.lpips`, likeness `totalediting.pretrained.sface`.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from assets_procedural.conventions import panorama
from totalediting.light.lightmaps import LOBES, texel_directions

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear Rec.709."""
_WINDOW, _SIGMA = 11, 1.5
_NEAR = math.cos(math.radians(25.0))  # farther texels are another light's


def psnr(prediction: Tensor, truth: Tensor, matte: Tensor | None = None) -> Tensor:
    """Peak signal-to-noise ratio (B,) in dB for a range of 1; infinite for equal pictures."""
    a, b = _over_black(prediction, truth, matte)
    return -10.0 * (a - b).square().mean((1, 2, 3)).log10()


def psnr_within(prediction: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
    """The same by a weight (B, 1, H, W) of pixels alone: black around a subject counts nothing.

    NaN where no pixel counts.
    """
    _check(prediction, truth, weight)
    error = ((prediction - truth).square().mean(1, keepdim=True) * weight).sum((1, 2, 3))
    return -10.0 * (error / weight.sum((1, 2, 3))).log10()


def picture_figures(prediction: Tensor, truth: Tensor, matte: Tensor) -> dict[str, Tensor]:
    """PSNR and SSIM (B,) of pictures over black by all pixels, and PSNR by the matte's alone.

    The former is higher by the share of the frame that is black: 3 to 5 dB for a portrait.
    """
    return {
        "psnr": psnr(prediction, truth),
        "matte_psnr": psnr_within(prediction, truth, matte),
        "ssim": ssim(prediction, truth),
    }


def source_figures(source: Tensor, truth: Tensor, matte: Tensor) -> dict[str, Tensor]:
    """The same of returning the source within the truth's matte, but SSIM."""
    found = picture_figures(matte * source, truth, matte)
    return {f"source_{name}": found[name] for name in ("psnr", "matte_psnr")}


def ssim(prediction: Tensor, truth: Tensor, matte: Tensor | None = None) -> Tensor:
    """Structural similarity (B,), at most 1, of Wang et al. 2004, for a range of 1.

    Gaussian window of 11 pixels and a deviation of 1.5, k1 = 0.01, k2 = 0.03; where the window
    lies within the picture; the mean over channels.

    Raises:
        ValueError: a shape does not fit, or a side is below 11.
    """
    a, b = _over_black(prediction, truth, matte)
    if min(a.shape[2:]) < _WINDOW:
        raise ValueError(f"pictures must have sides of at least {_WINDOW}, not {tuple(a.shape)}")
    places = torch.arange(_WINDOW, dtype=a.dtype, device=a.device) - _WINDOW // 2
    window = torch.softmax(-0.5 * (places / _SIGMA).square(), 0)

    def blur(x: Tensor) -> Tensor:
        flat = x.flatten(0, 1)[:, None]
        flat = F.conv2d(F.conv2d(flat, window[None, None, None]), window[None, None, :, None])
        return flat[:, 0].unflatten(0, x.shape[:2])

    mean_a, mean_b = blur(a), blur(b)
    variance_a, variance_b = blur(a * a) - mean_a * mean_a, blur(b * b) - mean_b * mean_b
    covariance = blur(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    top = (2.0 * mean_a * mean_b + c1) * (2.0 * covariance + c2)
    bottom = (mean_a.square() + mean_b.square() + c1) * (variance_a + variance_b + c2)
    return (top / bottom).mean((1, 2, 3))


def normal_error(normal: Tensor, truth: Tensor, matte: Tensor) -> Tensor:
    """Mean angle (B,) in degrees between normals (B, 3, H, W) of any length, by the matte.

    Pixels whose true normal is 0 do not count; where none counts the result is NaN.

    Raises:
        ValueError: a shape does not fit.
    """
    _check(normal, truth, matte)
    angle = _angle(normal.movedim(1, -1), truth.movedim(1, -1))
    weight = matte[:, 0] * (truth.square().sum(1) > 1e-6)
    return (weight * angle).sum((1, 2)) / weight.sum((1, 2))


def dominant_light(lightmaps: Tensor, lobe: str = "specular64") -> Tensor:
    """Unit direction (B, 3) of the strongest light in lightmaps (B, 5, 3, H, 2H), linear.

    The brightest texel of that lobe by luminance, then, finer than texels, the centroid by solid
    angle of what exceeds half its luminance within 25 degrees of it. In the maps' frame.

    Raises:
        ValueError: the maps have another shape, or there is no such lobe.
    """
    _check_maps(lightmaps)
    if lobe not in LOBES:
        raise ValueError(f"lobe must be one of {', '.join(LOBES)}, not {lobe!r}")
    height = lightmaps.shape[-2]
    colour = lightmaps[:, LOBES.index(lobe)]
    luminance = torch.einsum("c,bchw->bhw", colour.new_tensor(LUMINANCE), colour).flatten(1)
    texels = texel_directions(height, colour.dtype, colour.device).flatten(0, 1)
    peak, place = luminance.max(1, keepdim=True)
    near = texels[place[:, 0]] @ texels.T > _NEAR
    angles = _solid_angles(height, colour)[:, None].expand(-1, 2 * height).flatten()
    weight = (luminance - 0.5 * peak).clamp_min(0.0) * near * angles
    # Alone in a black map: the texel itself.
    return F.normalize(weight @ texels, dim=-1, eps=1e-30)


def light_error(prediction: Tensor, truth: Tensor, lobe: str = "specular64") -> Tensor:
    """Angle (B,) in degrees between the `dominant_light` of lightmaps (B, 5, 3, H, 2H), linear."""
    return _angle(dominant_light(prediction, lobe), dominant_light(truth, lobe))


def lightmap_error(prediction: Tensor, truth: Tensor) -> Tensor:
    """L1 (B,) between lightmaps (B, 5, 3, H, 2H), linear, of log(1 + light), by solid angle.

    Relative to knowing nothing: a data set's mean, divided by its mean for `mean_lightmaps` of the
    training set as the prediction.

    Raises:
        ValueError: the maps have another shape, or shapes that do not broadcast.
    """
    _check_maps(prediction)
    _check_maps(truth)
    difference = (prediction.log1p() - truth.log1p()).abs().mean((1, 2, 4))
    height = truth.shape[-2]
    return difference @ (_solid_angles(height, difference) * (height / (2.0 * math.pi)))


def mean_lightmaps(lightmaps: Tensor) -> Tensor:
    """(1, 5, 3, H, 2H): exp(mean log(1 + light)) - 1 of lightmaps (B, 5, 3, H, 2H), linear."""
    _check_maps(lightmaps)
    return lightmaps.log1p().mean(0, keepdim=True).expm1()


def _solid_angles(height: int, like: Tensor) -> Tensor:
    return torch.from_numpy(panorama.texel_solid_angles(height)).to(like)


def _angle(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between vectors (..., 3), exact also where they are nearly parallel."""
    sine = torch.linalg.cross(a, b, dim=-1).norm(dim=-1)
    return torch.rad2deg(torch.atan2(sine, (a * b).sum(-1)))


def _over_black(a: Tensor, b: Tensor, matte: Tensor | None) -> tuple[Tensor, Tensor]:
    _check(a, b, matte)
    return (a, b) if matte is None else (matte * a, matte * b)


def _check(a: Tensor, b: Tensor, matte: Tensor | None) -> None:
    if a.ndim != 4 or a.shape != b.shape:
        raise ValueError(f"both must be (B, C, H, W), not {tuple(a.shape)} and {tuple(b.shape)}")
    if matte is not None and matte.shape != (len(a), 1, *a.shape[2:]):
        raise ValueError(f"matte must be {(len(a), 1, *a.shape[2:])}, not {tuple(matte.shape)}")


def _check_maps(maps: Tensor) -> None:
    shape = tuple(maps.shape)
    if len(shape) != 5 or shape[1:3] != (len(LOBES), 3) or shape[4] != 2 * shape[3]:
        raise ValueError(f"lightmaps must be (B, {len(LOBES)}, 3, H, 2H), not {shape}")
