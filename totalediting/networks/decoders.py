"""Point-wise decoders: what a point of the volume is, from the tri-planes' features there.

Symbols: B batch, N points, C = preset.plane_channels, L = `shown_channels`, h rows of a lightmap;
t_geo features of the geometry's tri-plane (B, N, C), i how far points are inside the skin, t_shd
features of the shading's tri-plane, the skin's canonical normal (`relief.skin_normal`) and what the
source shows (`shown.Shown`) (B, N, C + 3 + L). Vectors
are unit and in model space (metres, Z up), posed unless called canonical: normal n, view v (from
the point to the viewer), r = v reflected at n. Lightmaps have a frame of their own, into which
`to_light` takes model space. Light, colour and shadings are linear Rec.709, or display-referred
where `preset.colour` is "srgb".

    sigma = D_geo([t_geo, i, shown])            n', a', w = D_f(t_shd)
    n^c = (n^skin + n') / |n^skin + n'|         a = sigmoid(logit(source) + a')
    k_d = D_d([t_shd, n])                       k_s(e) = D_s([t_shd, r])
    delta = D_delta(a, n, t_shd) . [s_d, s_s(e) ...]
    c = k_d a * s_d + sum_e k_s(e) s_s(e) + delta                (paper, section 3.3, eq. render)

The source is the colour that I_app shows at the point, its light divided out: the albedo starts
there, as the normal does at the skin's, and D_f takes off what that leaves. The residual is a sum
of shadings, so that all is linear in light; `preset.residual` "paper" is the paper's
D_delta([a, s_d, s_s(e) ...]) instead.
With `preset.occlusion` "lobes", diffuse light is gathered through a few lobes more, a s' with

    s' = k_d s_d + sum_j sum_e c_j(e) s_s(e) at R^-1 b_j         c_j >= 0, b_j canonical axes

as low-frequency radiance transfer (Sloan et al. 2002) in the lightmaps that there are: what is
shaded from one side lowers k_d and looks to the other. It stays linear in light.

Hidden layers are Softplus, as in EG3D (Chan et al. 2022). First and last layers are drawn so that a
fresh network is the bust, with hair and clothes beside it (`HAIR`), in a translucent fog (`FRESH`)
where the source covers its background, with the bust's normals, the source's colour, k_d = 1, small
k_s and no residual. These networks are small and must become steep, so they learn at `PACE` times
the rate of the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry.shown import COVERAGE, OFF, SIGHT, colour_of
from totalediting.light.lightmaps import LOBES, SHININESS, encode, sample
from totalediting.light.phong import display, reflect, undisplay
from totalediting.networks.blocks import linear
from totalediting.presets import Preset

DENSITY_SCALE = 50.0
"""1/metre: density is this times softplus(x - 1).

EG3D's density is per side of its box, ours of 0.6 m, which would be a scale of 1.7 / m. With 50 / m
a surface that stops 95 % of the light within 5 mm (600 / m) needs only x = 13.
"""
FRESH = -3.0
"""Mean of a fresh x: about 0.9 / m, which stops two fifths of the light across a box of 0.6 m."""
FULL = 12.0
"""How much larger a fresh x is inside the skin: 400 / m, which stops all light within 1 cm."""
CLEAR = 6.0
"""How much smaller it is where the source shows that nothing covers its background."""
HAIR = 4.0
"""How much larger it is where the source shows hair or clothes off the bust."""
SKIN = 0.016
"""Thickness over which that rises, in places: 2 mm at the face, see `space`."""
PACE = 6.0
"""Their learning rate relative to the rest; instant-NGP's for such networks is 1e-2."""
LOBES_OF_TRANSFER = 3
"""Axes b_j of a point, with `occlusion` "lobes"."""
_FAINT = -4.0  # before Softplus: fresh weights c_j of 0.018
FRESH_SPECULAR = 0.01
"""A fresh specular coefficient: the four add up to the reflectance of skin, 0.04."""

_TRIPOD = (0.8, 0.0, -0.4, -0.8, 0.0, -0.4, 0.0, 0.0, 0.8)
"""Added to n^c, fresh axes b_j: to both sides and up."""

ToPosed = Callable[[Tensor], Tensor]
"""Turns canonical directions (B, N, 3) into posed ones: `Field.to_posed` at the points."""


class Shading(NamedTuple):
    """How points look; colours and directions (B, N, 3). See the module for symbols."""

    colour: Tensor
    """c, the sum of diffuse, specular and residual; the residual may make it negative."""
    albedo: Tensor
    """a in [0, 1]."""
    normal: Tensor
    """n, unit, posed."""
    canonical_normal: Tensor
    """n^c, unit."""
    diffuse: Tensor
    """k_d a * s_d, and what transfer lobes add."""
    specular: Tensor
    """The sum of k_s(e) s_s(e)."""
    residual: Tensor
    """delta."""
    features: Tensor
    """w (B, N, preset.features), for super-resolution."""
    k_d: Tensor
    """(B, N, 1) in [0, 2]."""
    s_d: Tensor
    """The diffuse map at n."""
    k_s: Tensor
    """(B, N, 4) in [0, 1], by exponents."""
    s_s: Tensor
    """(B, N, 4, 3): the specular maps at r."""


class GeometryDecoder(nn.Module):
    """D_geo: features (B, N, C), `relief.inside` (B, N) and what the source shows (B, N, L) to
    density sigma (B, N) in 1/metre, positive.

    What the source covers there tells hair and clothes from nothing (space carving, Kutulakos and
    Seitz 2000). Fresh, it has them where `shown` finds them off the bust.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.net = _mlp(preset.plane_channels + 1 + shown_channels(preset), preset.hidden, 1)
        _start(self.net, [FRESH], 1.0)

    def forward(self, features: Tensor, inside: Tensor, seen: Tensor) -> Tensor:
        skin = torch.sigmoid(inside / SKIN)
        known = torch.cat([features, 2 * skin[..., None] - 1, seen], -1)
        covered, off = ((1 + seen[..., channel]) / 2 for channel in (COVERAGE, OFF))
        x = self.net(known)[..., 0] + FULL * skin
        x = x + (1 - skin) * (HAIR * off - CLEAR * (1 - covered))
        return DENSITY_SCALE * functional.softplus(x - 1.0)


class ShadingDecoder(nn.Module):
    """D_shd of the paper's figure "Shading module": D_f, D_d, D_s and D_delta around lightmaps.

    The paper's D_delta sees shadings as log(1 + s), the scale that lightmaps are predicted in:
    beside a sun of 1000, an albedo would be nothing to it.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        channels, hidden = preset.plane_channels + 3 + shown_channels(preset), preset.hidden
        self.shown = shown_channels(preset)
        self.linear = preset.residual == "linear"
        self.surface = _surface(preset)
        self.diffuse = _mlp(channels + 3, hidden, 1)
        _start(self.diffuse, [0.0], 0.05)
        self.specular = _mlp(channels + 3, hidden, len(SHININESS))
        self.transfer = None
        if preset.occlusion == "lobes":
            count = LOBES_OF_TRANSFER * len(SHININESS)
            self.transfer = _mlp(channels, hidden, 3 * LOBES_OF_TRANSFER + count)
            _start(self.transfer, [*_TRIPOD, *[_FAINT] * count], 0.05)
        unlit = math.log(FRESH_SPECULAR / (1.0 - FRESH_SPECULAR))
        _start(self.specular, [unlit] * len(SHININESS), 0.05)
        if self.linear:
            self.residual = _mlp(channels + 6, hidden, 3 * len(LOBES))
        else:
            self.residual = _mlp(3 + 3 * len(LOBES), hidden, 3)
        _start(self.residual, [0.0] * (3 * len(LOBES) if self.linear else 3), 0.0)

    def forward(
        self, features: Tensor, to_posed: ToPosed, view: Tensor, lightmaps: Tensor, to_light: Tensor
    ) -> Shading:
        """Shading of points.

        Args:
            features: (B, N, C + 3 + L), t_shd.
            to_posed: turns n^c into n.
            view: (B, N, 3), v.
            lightmaps: (B, 5, 3, h, 2h), normalised and >= 0, as `lightmaps.bake` makes them.
            to_light: (B, 3, 3) rotation from model space into the lightmaps' frame.

        Raises:
            ValueError: a shape does not fit.
        """
        _check(features, view, lightmaps, to_light)
        direction, added, w = self.surface(features).tensor_split((3, 6), -1)
        albedo = torch.sigmoid(torch.logit(_source(features, self.shown)) + added)
        canonical = functional.normalize(_skin(features, self.shown) + direction, dim=-1)
        normal = to_posed(canonical)
        reflected = reflect(view, normal)

        s_d = sample(lightmaps[:, 0], _turn(to_light, normal))
        s_s = sample(lightmaps[:, 1:].flatten(1, 2), _turn(to_light, reflected))
        k_d = 2.0 * torch.sigmoid(self.diffuse(torch.cat([features, normal], -1)))
        k_s = torch.sigmoid(self.specular(torch.cat([features, reflected], -1)))
        if self.linear:
            shares = self.residual(torch.cat([features, albedo, normal], -1))
            shadings = torch.cat([s_d, s_s], -1).unflatten(-1, (len(LOBES), 3))
            residual = (shares.unflatten(-1, (len(LOBES), 3)) * shadings).sum(-2)
        else:
            residual = self.residual(torch.cat([albedo, encode(s_d), encode(s_s)], -1))

        s_s = s_s.unflatten(-1, (len(SHININESS), 3))
        gathered = k_d * s_d
        if self.transfer is not None:
            axes, c = self.transfer(features).tensor_split([3 * LOBES_OF_TRANSFER], -1)
            axes = axes.unflatten(-1, (LOBES_OF_TRANSFER, 3)) + canonical[..., None, :]
            c = functional.softplus(c).unflatten(-1, (LOBES_OF_TRANSFER, len(SHININESS), 1))
            for j in range(LOBES_OF_TRANSFER):
                axis = to_posed(functional.normalize(axes[..., j, :], dim=-1))
                seen = sample(lightmaps[:, 1:].flatten(1, 2), _turn(to_light, axis))
                gathered = gathered + (c[..., j, :, :] * seen.unflatten(-1, (-1, 3))).sum(-2)
        diffuse, specular = gathered * albedo, (k_s[..., None] * s_s).sum(-2)
        return Shading(
            colour=diffuse + specular + residual,
            albedo=albedo,
            normal=normal,
            canonical_normal=canonical,
            diffuse=diffuse,
            specular=specular,
            residual=residual,
            features=w,
            k_d=k_d,
            s_d=s_d,
            k_s=k_s,
            s_s=s_s,
        )


class PlainDecoder(nn.Module):
    """The baseline's colour decoder: colour from t_shd alone, the same in any light.

    Called like `ShadingDecoder`. Colour is what the network adds to the source's, before Softplus
    in linear light, sigmoid in display-referred. Albedo is the colour, the normal an output of its
    own; what only light makes is 0.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.surface = _surface(preset)
        self.shown = shown_channels(preset)
        self.linear = preset.colour == "linear"

    def forward(
        self, features: Tensor, to_posed: ToPosed, view: Tensor, lightmaps: Tensor, to_light: Tensor
    ) -> Shading:
        """As `ShadingDecoder.forward`; of view, lightmaps and to_light only the shapes count."""
        _check(features, view, lightmaps, to_light)
        direction, added, w = self.surface(features).tensor_split((3, 6), -1)
        canonical = functional.normalize(_skin(features, self.shown) + direction, dim=-1)
        source = _source(features, self.shown, False)
        if self.linear:
            colour = functional.softplus(source.expm1().log() + added)
        else:
            colour = torch.sigmoid(torch.logit(display(source)) + added)
        zero = torch.zeros_like(colour)
        k_s = zero.new_zeros(*zero.shape[:-1], len(SHININESS))
        return Shading(
            colour=colour,
            albedo=colour,
            normal=to_posed(canonical),
            canonical_normal=canonical,
            diffuse=zero,
            specular=zero,
            residual=zero,
            features=w,
            k_d=zero[..., :1],
            s_d=zero,
            k_s=k_s,
            s_s=k_s[..., None].expand(*k_s.shape, 3),
        )


class Decoders(nn.Module):
    """D_geo as `geometry` and D_shd as `shading`, the kind that `preset.decoder` names."""

    pace = PACE

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.geometry = GeometryDecoder(preset)
        plain = preset.decoder == "plain"
        self.shading = PlainDecoder(preset) if plain else ShadingDecoder(preset)


def shown_channels(preset: Preset) -> int:
    """Channels of what `shown.Shown` gives."""
    return 2 * (SIGHT + preset.aligned_channels)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(linear(inputs, hidden), nn.Softplus(), linear(hidden, outputs))


def _source(features: Tensor, shown: int, unlit: bool = True) -> Tensor:
    """(B, N, 3) linear colour that the source shows, from t_shd whose last `shown` channels tell
    it; within (0, 1). Unlit it is about the albedo."""
    return undisplay(colour_of(features[..., -shown:], unlit)).clamp(0.01, 0.99)


def _skin(features: Tensor, shown: int) -> Tensor:
    """(B, N, 3) the skin's canonical normal, from t_shd whose last `shown` channels follow it."""
    return features[..., -shown - 3 : -shown]


def _surface(preset: Preset) -> nn.Sequential:
    """Features to what is added to the skin's normal and to the source's colour before the
    activation, and w: 3 + 3 + preset.features."""
    inputs = preset.plane_channels + 3 + shown_channels(preset)
    net = _mlp(inputs, preset.hidden, 6 + preset.features)
    _start(net, [0.0] * (6 + preset.features), 1.0)
    last = net[-1]
    assert isinstance(last, nn.Linear)
    nn.init.zeros_(last.weight[:6])
    return net


@torch.no_grad()
def _start(net: nn.Sequential, values: list[float], spread: float) -> None:
    """Let a fresh `net` give about `values`; `spread` scales what its last layer adds to them."""
    last = net[-1]
    assert isinstance(last, nn.Linear)
    # Softplus is log 2 at 0, and what all hidden units have in common would shift the values.
    last.weight.sub_(last.weight.mean(1, keepdim=True)).mul_(spread)
    last.bias.copy_(torch.tensor(values))


def _turn(to_light: Tensor, directions: Tensor) -> Tensor:
    """Directions (B, N, 3) in the lightmaps' frame. Written out: TF32 would round them."""
    x, y, z = directions.split(1, -1)
    right, up, back = to_light[:, None].unbind(-1)
    return x * right + y * up + z * back


def _check(features: Tensor, view: Tensor, lightmaps: Tensor, to_light: Tensor) -> None:
    if features.ndim != 3:
        raise ValueError(f"features must be (B, N, C), got {tuple(features.shape)}")
    batch, points = features.shape[:2]
    if view.shape != (batch, points, 3):
        raise ValueError(f"view must be {(batch, points, 3)}, got {tuple(view.shape)}")
    if lightmaps.ndim != 5 or lightmaps.shape[:3] != (batch, len(LOBES), 3):
        raise ValueError(
            f"lightmaps must be ({batch}, {len(LOBES)}, 3, h, 2h), got {tuple(lightmaps.shape)}"
        )
    if to_light.shape != (batch, 3, 3):
        raise ValueError(f"to_light must be {(batch, 3, 3)}, got {tuple(to_light.shape)}")
