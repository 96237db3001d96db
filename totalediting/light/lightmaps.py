"""Lightmaps: environments pre-filtered with Phong lobes, and look-ups in them.

Lightmaps are one tensor (..., 5, 3, H, 2H) of linear Rec.709 light, the lobes in the order of
`LOBES`: s_d by surface normal n, then s_s(1), s_s(16), s_s(32), s_s(64) by reflected viewing
direction r (paper, eqs. int_diffuse and int_specular):

    s_d(n) = integral L(l) max(0, n.l) dl        s_s(e, r) = integral L(l) max(0, r.l)^e dl

Normalised maps, the default everywhere, are these divided by `LOBE_INTEGRALS`: a constant
environment of radiance 1 gives 1 in every texel. The first two maps are then equal; they differ in
the direction that they are looked up with.

Environments (..., H, 2H, 3) and maps are equirectangular, with the convention of
`conventions.panorama`: u = 0.5 - atan2(y, x) / 2 pi to the right, v = acos(z) / pi down,
texel centres at halves. That holds in any frame; a `rotation` R (3, 3) takes directions of the
frame wanted to those of the frame given: d_given = R d_wanted. Maps in a camera's frame, of an
environment that the dataset turned by `angle`, take R = Rz(-angle) @ camera_to_world[:3, :3].

Everything is float32 or float64, on the device of what it is given, and differentiable.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F

from assets_procedural.conventions import panorama

LOBES = ("diffuse", "specular1", "specular16", "specular32", "specular64")
"""What the five maps hold, in order."""
SHININESS = (1, 16, 32, 64)
"""Exponents of the specular lobes, in order."""
LOBE_INTEGRALS = (math.pi, *(2.0 * math.pi / (exponent + 1) for exponent in SHININESS))
"""Solid angle of each lobe: normalised maps times these are the paper's integrals."""

# Harmonics up to this degree hold the lobes of 16 to 64 whole. Of the clamped cosine, whose kink
# has no end, a bare sun shows what is lost: 1e-3 of the map (relative L2), 3e-3 of its peak.
_DEGREE = 64
_FEWEST_ROWS = 64  # texels of lower panoramas are split: a lobe must not fall between them
_BAND = 1 << 21  # texels whose Fourier transform is taken at once
_FINE_ROWS = 128  # of the maps that a bake into another frame resamples


def bake(
    environment: torch.Tensor,
    height: int = 32,
    rotation: torch.Tensor | None = None,
    normalised: bool = True,
) -> torch.Tensor:
    """Lightmaps (..., 5, 3, height, 2 height) of an environment (..., H, 2H, 3) of radiance >= 0.

    `rotation` (..., 3, 3) turns them into another frame (see above). The sums run over all texels
    with their exact solid angles; ringing below 0 becomes 0.

    Lobes are zonal, so that to convolve with one is to multiply the spherical harmonics of each
    degree by a number (Funk-Hecke; Ramamoorthi and Hanrahan 2001). The way there and back goes by
    a Fourier transform of the rows and one matrix per order, at full resolution.

    Raises:
        ValueError: the environment is not (..., H, 2H, 3), not float32 or float64, negative or not
            finite, `height` is not a positive integer, or `rotation` is no rotation.
    """
    _check_environment(environment)
    _check_height(height)
    if rotation is None:
        maps = _convolve(environment, height)
    else:
        _check_rotation(rotation, environment.shape[:-3])
        maps = _turn(_convolve(environment, max(height, _FINE_ROWS)), rotation, height)
    if normalised:
        return maps
    scale = torch.tensor(LOBE_INTEGRALS, dtype=maps.dtype, device=maps.device)
    return maps * scale[:, None, None, None]


def rotate(maps: torch.Tensor, rotation: torch.Tensor, height: int | None = None) -> torch.Tensor:
    """Maps (..., 5, 3, H, 2H) resampled into another frame, at their own or another height.

    The new map at direction d is the old map at `rotation` d; `rotation` (..., 3, 3). If the
    environment is available, `bake` gives sharper maps in another frame.

    Raises:
        ValueError: `maps` has another shape, `rotation` is no rotation, or `height` is bad.
    """
    if maps.ndim < 4 or maps.shape[-4:-2] != (len(LOBES), 3):
        raise ValueError(f"maps must be (..., {len(LOBES)}, 3, H, 2H), not {tuple(maps.shape)}")
    height = maps.shape[-2] if height is None else height
    _check_height(height)
    _check_rotation(rotation, maps.shape[:-4])
    return _turn(maps, rotation, height)


def sample(maps: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Maps (..., C, H, 2H) at directions (..., N, 3), as (..., N, C); leading axes broadcast.

    Bilinear between texel centres, without seams: columns wrap, and beyond a pole lies the pole's
    row turned by half a circle. Only the directions count, lengths may be anything above 1e-15; a
    zero vector reads the upper pole and NaN gives NaN. At the poles themselves, where a map has no
    derivative by direction, the gradient is 0.

    Raises:
        ValueError: `maps` or `directions` has another shape, or they do not broadcast.
    """
    if maps.ndim < 3 or maps.shape[-1] != 2 * maps.shape[-2] or not maps.shape[-2]:
        raise ValueError(f"maps must be (..., C, H, 2H), not {tuple(maps.shape)}")
    if directions.ndim < 2 or directions.shape[-1] != 3:
        raise ValueError(f"directions must be (..., N, 3), not {tuple(directions.shape)}")
    try:
        lead = torch.broadcast_shapes(maps.shape[:-3], directions.shape[:-2])
    except RuntimeError:
        raise ValueError(
            f"directions {tuple(directions.shape)} do not broadcast to maps {tuple(maps.shape)}"
        ) from None
    channels, height, width = maps.shape[-3:]
    padded = _pad(maps).expand(*lead, -1, -1, -1).reshape(-1, channels, height + 2, width + 2)
    grid = _grid(directions, height).expand(*lead, -1, -1).reshape(len(padded), 1, -1, 2)
    found = F.grid_sample(padded, grid.to(padded.dtype), align_corners=True)
    return found[:, :, 0].mT.reshape(*lead, -1, channels)


def encode(maps: torch.Tensor) -> torch.Tensor:
    """log(1 + maps), the scale that maps are predicted and compared in; maps >= 0."""
    return torch.log1p(maps)


def decode(code: torch.Tensor) -> torch.Tensor:
    """The inverse of `encode`; negative codes give 0."""
    return torch.expm1(code.clamp_min(0.0))


def texel_directions(
    height: int, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> torch.Tensor:
    """(height, 2 height, 3) unit directions of the texel centres."""
    return torch.from_numpy(panorama.texel_directions(height)).to(device, dtype)


def brute_force(environment: torch.Tensor, directions: torch.Tensor, exponent: int) -> torch.Tensor:
    """The integral that `bake` computes, written out: slow, exact, for comparison.

    Sum over all texels of L(l) max(0, d.l)^exponent times their solid angles, not normalised, for
    an environment (..., H, 2H, 3) and unit directions (N, 3) in its frame: (..., N, 3) float64.
    """
    _check_environment(environment)
    height = environment.shape[-3]
    device = environment.device
    angles = torch.from_numpy(panorama.texel_solid_angles(height)).to(device)
    light = (environment.double() * angles[:, None, None]).flatten(-3, -2).movedim(-2, 0)
    texels = texel_directions(height, torch.float64, device).flatten(0, 1)
    columns = light.flatten(1)
    chunks = [
        (chunk @ texels.T).clamp_min(0.0).pow(exponent) @ columns
        for chunk in directions.double().split(16)
    ]
    return torch.cat(chunks).unflatten(1, light.shape[1:]).movedim(0, -2)


def _convolve(environment: torch.Tensor, height: int) -> torch.Tensor:
    """Normalised maps (..., 5, 3, height, 2 height) in the environment's own frame."""
    lead, rows = environment.shape[:-3], environment.shape[-3]
    light = environment.reshape(-1, *environment.shape[-3:])
    split = -(-_FEWEST_ROWS // rows)
    if split > 1:
        light = light.repeat_interleave(split, 1).repeat_interleave(split, 2)
    analysis, synthesis, waves = _transforms(height, rows * split, light.dtype, light.device)
    # A band of rows at a time: of a large panorama neither a copy nor the whole spectrum is held.
    bands = light.movedim(-1, 1).split(max(1, _BAND // light.shape[2]), 2)
    spectrum = torch.cat(
        [torch.fft.rfft(band.contiguous())[..., : _DEGREE + 1].clone() for band in bands], 2
    )
    parts = torch.view_as_real(spectrum).permute(3, 2, 0, 1, 4)  # order, row, batch, colour, part
    with torch.autocast(light.device.type, enabled=False):
        rings = (synthesis @ (analysis @ parts.flatten(2))).unflatten(2, parts.shape[2:])
        rings = rings.unflatten(1, (len(SHININESS), height))
        maps = torch.einsum("mehbcp,mpw->bechw", rings, waves).clamp_min(0.0)
    maps = torch.cat([maps[:, :1], maps], dim=1)
    return maps.reshape(*lead, *maps.shape[1:])


@lru_cache(maxsize=8)
def _transforms(
    height: int, rows: int, dtype: torch.dtype, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """From the Fourier orders of a panorama's rows to maps, in three steps.

    Analysis (order, degree, row): to spherical harmonics. Synthesis (order, 4 height, degree): to
    the Fourier orders of the maps' rows, the lobes applied. Waves (order, 2, column): to texels,
    by real and imaginary part.
    """
    analysis = _legendre(rows) * panorama.texel_solid_angles(rows)
    synthesis = _legendre(height)[:, None].swapaxes(-1, -2) * _zonal()[:, None]
    # The sum over texels is not quite the integral; correct it so that constant light is exact.
    constant = analysis[0].sum(1) * 2 * rows
    synthesis /= (synthesis[0] @ constant)[..., None]

    # Both grids have their texels' centres at halves, but of different widths.
    column = (np.arange(2 * height) + 0.5) / (2 * height) - 0.25 / rows
    phase = 2.0 * np.pi * np.arange(_DEGREE + 1)[:, None] * column
    waves = np.stack([np.cos(phase), -np.sin(phase)], axis=1)
    waves[1:] *= 2.0  # negative orders
    # Without inference_mode(False), a first call in inference mode would spoil later training.
    with torch.inference_mode(False):
        first, second, third = (
            torch.from_numpy(table).to(device, dtype)
            for table in (analysis, synthesis.reshape(_DEGREE + 1, -1, _DEGREE + 1), waves)
        )
    return first, second, third


def _legendre(rows: int) -> np.ndarray:
    """(order, degree, row) orthonormal associated Legendre functions at the rows of a panorama."""
    polar = (np.arange(rows) + 0.5) * (np.pi / rows)
    values = np.zeros((_DEGREE + 1, _DEGREE + 1, rows))
    values[0, 0] = math.sqrt(0.25 / math.pi)
    for n in range(1, _DEGREE + 1):
        m = np.arange(n)[:, None]
        back = np.sqrt(((n - 1) ** 2 - m**2) / (4 * (n - 1) ** 2 - 1))
        rise = np.sqrt((4 * n**2 - 1) / (n**2 - m**2))
        values[:n, n] = rise * (np.cos(polar) * values[:n, n - 1] - back * values[:n, n - 2])
        values[n, n] = math.sqrt(1 + 0.5 / n) * np.sin(polar) * values[n - 1, n - 1]
    return values


def _zonal() -> np.ndarray:
    """(4, degree) what the lobe of each exponent multiplies harmonics with, up to a factor."""
    factors = np.zeros((len(SHININESS), _DEGREE + 1))
    for lobe, s in enumerate(SHININESS):
        factors[lobe, :2] = 1 / (s + 1), 1 / (s + 2)
        for n in range(2, _DEGREE + 1):
            factors[lobe, n] = factors[lobe, n - 2] * (s - n + 2) / (s + n + 1)
    return factors


def _turn(maps: torch.Tensor, rotation: torch.Tensor, height: int) -> torch.Tensor:
    wanted = texel_directions(height, maps.dtype, maps.device).flatten(0, 1)
    with torch.autocast(maps.device.type, enabled=False):
        turned = sample(maps.flatten(-4, -3), wanted @ rotation.to(maps).mT)
    return turned.mT.unflatten(-1, (height, 2 * height)).unflatten(-3, maps.shape[-4:-2])


def _pad(maps: torch.Tensor) -> torch.Tensor:
    """(..., H, W) to (..., H + 2, W + 2), continued over the seam and over the poles."""
    opposite = maps.roll(maps.shape[-1] // 2, -1)
    tall = torch.cat([opposite[..., :1, :], maps, opposite[..., -1:, :]], dim=-2)
    return torch.cat([tall[..., -1:], tall, tall[..., :1]], dim=-1)


def _grid(directions: torch.Tensor, height: int) -> torch.Tensor:
    """Directions (..., 3) to (..., 2) coordinates of `grid_sample` in a padded map."""
    x, y, z = directions.unbind(-1)
    # At a pole the azimuth is anything and has no derivative; 0 has.
    pole = torch.hypot(x, y) <= torch.finfo(x.dtype).eps * z.abs()
    x, y = torch.where(pole, 1.0, x), torch.where(pole, 0.0, y)
    azimuth = torch.atan2(y, x)
    polar = torch.atan2(torch.where(pole, 0.0, torch.hypot(x, y)), z)
    # -1 and 1 are the centres of the padding's outermost texels.
    right = azimuth * (-2.0 * height / (math.pi * (2.0 * height + 1.0)))
    down = (polar * (2.0 / math.pi) - 1.0) * (height / (height + 1.0))
    return torch.stack([right, down], dim=-1)


def _check_environment(environment: torch.Tensor) -> None:
    shape = tuple(environment.shape)
    if len(shape) < 3 or shape[-1] != 3 or shape[-2] != 2 * shape[-3] or not environment.numel():
        raise ValueError(f"environment must be (..., H, 2H, 3) radiance, not {shape}")
    if environment.dtype not in (torch.float32, torch.float64):
        raise ValueError(
            f"environment {shape} is {environment.dtype}; linear radiance in float32 or float64 is "
            "needed, integers are low dynamic range"
        )
    low, high = (float(end) for end in torch.aminmax(environment.detach()))
    if not (math.isfinite(low) and math.isfinite(high)):
        raise ValueError(f"environment {shape} holds NaN or Inf")
    if low < 0.0:
        raise ValueError(f"environment {shape} is negative ({low:g}); clamp it at 0")


def _check_height(height: int) -> None:
    if not isinstance(height, int) or height < 1:
        raise ValueError(f"height must be a whole number of rows, 1 or more, not {height!r}")


def _check_rotation(rotation: torch.Tensor, lead: tuple[int, ...]) -> None:
    shape = tuple(rotation.shape)
    if shape[-2:] != (3, 3):
        raise ValueError(f"rotation must be (..., 3, 3), not {shape}")
    exact = rotation.detach().double()
    square = exact @ exact.mT - torch.eye(3, dtype=exact.dtype, device=exact.device)
    if not (square.abs().max() < 1e-4 and torch.linalg.det(exact).min() > 0.0):
        raise ValueError(f"rotation {shape} is not orthonormal with determinant 1")
    try:
        torch.broadcast_shapes(shape[:-2], lead)
    except RuntimeError:
        raise ValueError(
            f"rotation {shape} does not broadcast to the batch {tuple(lead)}"
        ) from None
