"""The lightmap estimator: from a portrait to the light that falls on it (paper, section 3.4).

    picture -- E_lit (U-Net) --> tokens z_lit ------------------+
                          +----> normals N (E_nor) -- E_face ---+
    lobes max(0, d.l)^e -- E_lobe --> queries z(e, d) -- D_lit --> lightmaps S

Every token knows which way its surface faces: E_face embeds its normal n as E_lobe
embeds a direction, by max(0, n.l) over the same light directions l, so that the query for light
from d finds what faces d. No gradient of light reaches the normals. And it knows the light that the
picture shows there, which the norms of a U-Net lose.

Symbols: B batch, S side of a picture, H rows of a lightmap, L light directions, D width, K tokens,
Q queries. A query is one texel of one lobe: its direction d, its exponent e. As diffuse light and
specular light of exponent 1 have one kernel, four lobes are asked and the first is used twice.

Lightmaps are normalised, in the camera's frame (OpenGL axes), and predicted as log(1 + light).
Normals are unit, in camera space.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from totalediting.geometry import camera_jitter
from totalediting.geometry.mirroring import mirrored_lightmaps
from totalediting.light import lightmaps, phong
from totalediting.networks.blocks import (
    Attention,
    FeedForward,
    ResidualBlock,
    TransformerBlock,
    conv,
    norm,
    position_grid,
    to_grid,
    to_tokens,
)
from totalediting.presets import Preset

_PATCH = 8  # pixels along a side that a token is of
_DARK = 0.02  # linear light below which a logarithm tells little
_AUGMENTATIONS = ((0.0, 0.0), (0.15, 0.0), (-0.15, 0.0), (0.0, 0.1), (0.0, -0.1))
"""Rolls, radians, and logarithms of scales that `LightmapEstimator.lightmaps` averages over."""


class Illumination(NamedTuple):
    """What a picture tells of its light: `code` (B, Q, 3) log(1 + light), `normal` (B, 3, s, s)."""

    code: Tensor
    normal: Tensor


class LightmapEstimator(nn.Module):
    """E_lit, E_nor, E_lobe and D_lit, and what is ours: E_face, and the light shown at a token."""

    coarse_position: Tensor
    position: Tensor
    directions: Tensor
    light: Tensor

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        dim, self.height = preset.lobe_dim, preset.lightmap_height
        self.side = preset.image
        # E_lit: patches of 8, a halving of the grid, and back up.
        self.stem = nn.Sequential(
            nn.PixelUnshuffle(_PATCH), conv(3 * _PATCH**2, dim // 2, 1), norm(dim // 2), nn.ReLU()
        )
        self.fine = nn.Sequential(*[ResidualBlock(dim // 2, dim // 2) for _ in range(2)])
        self.down = ResidualBlock(dim // 2, dim, stride=2)
        grid = self.side // _PATCH
        self.register_buffer("coarse_position", position_grid(grid // 2, dim), persistent=False)
        self.bottleneck = TransformerBlock(dim, preset.heads)
        self.up = ResidualBlock(dim + dim // 2, dim // 2)
        self.token = nn.Linear(dim // 2, dim)
        self.register_buffer("position", position_grid(grid, dim), persistent=False)
        # E_nor and E_face.
        self.to_normal = conv(dim // 2, 3 * (_PATCH // 2) ** 2, 1)
        self.face = nn.Linear(preset.light_directions + 1, dim)
        self.shown = nn.Linear(6, dim)
        # E_lobe and D_lit.
        self.lobe = nn.Linear(preset.light_directions, dim)
        self.decoder = nn.ModuleList(
            _LobeBlock(dim, preset.heads) for _ in range(preset.lobe_blocks)
        )
        answer = nn.Linear(dim, 3)
        nn.init.constant_(answer.bias, math.log1p(0.5))
        self.out = nn.Sequential(nn.LayerNorm(dim), answer)
        device = torch.get_default_device()
        directions = lightmaps.texel_directions(self.height, device=device).flatten(0, 1)
        self.register_buffer("directions", directions, persistent=False)
        light = sphere(preset.light_directions).float()
        self.register_buffer("light", light, persistent=False)

    @property
    def queries(self) -> int:
        """Q of all texels: four lobes, one after the other, row by row."""
        return len(lightmaps.SHININESS) * 2 * self.height**2

    def forward(self, image: Tensor, texels: Tensor | None = None) -> Illumination:
        """The code of some queries, or of all, for pictures (B, 3, S, S) in [0, 1].

        `texels` (Q,) int64 are places among `queries`: training need not ask all of them.
        """
        tokens, normal = self.encode(image)
        return Illumination(self.decode(tokens, texels), normal)

    def lightmaps(self, image: Tensor) -> Tensor:
        """Lightmaps (B, 5, 3, H, 2H), linear, of pictures (B, 3, S, S).

        The mean, as log(1 + light), over test-time augmentations: the picture as it is, rolled and
        scaled a little, and its mirror images. Rolls and mirrors turn light exactly, and the
        answers err differently.
        """
        found = [self._augmented(image, *by) for by in _AUGMENTATIONS]
        return lightmaps.decode(torch.stack(found).mean(0))

    def _augmented(self, image: Tensor, by_roll: float, by_log_scale: float) -> Tensor:
        """log(1 + light) (B, 5, 3, H, 2H) in the picture's frame, found in the picture and its
        mirror image as a rolled camera with a longer lens would have taken them."""
        roll, log_scale = (image.new_full((len(image),), x) for x in (by_roll, by_log_scale))
        image = camera_jitter.resampled(image, roll, log_scale)
        straight, turned = (unfold(self(i).code, self.height) for i in (image, image.flip(-1)))
        light = lightmaps.decode((straight + mirrored_lightmaps(turned)) / 2)
        return lightmaps.encode(lightmaps.rotate(light, camera_jitter.rolled_axes(roll).mT))

    def encode(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """z_lit (B, K, D) and normals (B, 3, S / 2, S / 2).

        Raises:
            ValueError: the pictures are not (B, 3, S, S).
        """
        if image.ndim != 4 or image.shape[1:] != (3, self.side, self.side):
            raise ValueError(
                f"image must be (B, 3, {self.side}, {self.side}), got {tuple(image.shape)}"
            )
        fine = self.fine(self.stem(2 * image - 1))
        coarse = self.bottleneck(to_tokens(self.down(fine)) + self.coarse_position)
        grid = functional.interpolate(to_grid(coarse), scale_factor=2.0, mode="bilinear")
        seen = self.up(torch.cat([grid, fine], 1))
        rough = functional.pixel_shuffle(self.to_normal(seen), _PATCH // 2)
        normal = functional.normalize(rough.float(), dim=1)
        known = self.face(self._facing(normal)) + self.shown(_light_shown(image))
        return self.token(to_tokens(seen)) + self.position + known, normal

    def _facing(self, normal: Tensor) -> Tensor:
        """(B, K, L + 1) lobes of the mean normal of a token's patch, and how flat the patch is."""
        mean = to_tokens(functional.avg_pool2d(normal.detach(), _PATCH // 2))
        flat = mean.norm(dim=-1, keepdim=True)
        lobes = (mean / flat.clamp_min(1e-3) @ self.light.T).clamp_min(0)
        return torch.cat([4 * lobes, flat], -1)  # their mean is 1, as that of `lobes`

    def decode(self, tokens: Tensor, texels: Tensor | None = None) -> Tensor:
        """D_lit: log(1 + light) (B, Q, 3) at queries, from tokens (B, K, D)."""
        places = torch.arange(self.queries, device=tokens.device) if texels is None else texels
        queries = self.lobe(self.lobes(places)).expand(len(tokens), -1, -1)
        for block in self.decoder:
            queries = block(queries, tokens)
        return self.out(queries)

    def lobes(self, places: Tensor) -> Tensor:
        """(Q, L) max(0, d.l)^e over the light directions l, scaled to a mean of 1."""
        lobe, texel = places // len(self.directions), places % len(self.directions)
        exponent = places.new_tensor(lightmaps.SHININESS)[lobe]
        cosine = (self.directions[texel] @ self.light.T).clamp_min(0)
        response = cosine ** exponent[:, None]
        return response / response.mean(1, keepdim=True)


class _LobeBlock(nn.Module):
    """Queries attend to the picture's tokens, not to each other."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.norm_query, self.norm_tokens = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.attention = Attention(dim, heads)
        self.norm_mlp, self.mlp = nn.LayerNorm(dim), FeedForward(dim)

    def forward(self, queries: Tensor, tokens: Tensor) -> Tensor:
        queries = queries + self.attention(self.norm_query(queries), self.norm_tokens(tokens))
        return queries + self.mlp(self.norm_mlp(queries))


def _light_shown(image: Tensor) -> Tensor:
    """(B, K, 6) two logarithms of the mean linear light of the patches of pictures."""
    light = to_tokens(functional.avg_pool2d(phong.undisplay(image.float(), 1), _PATCH))
    return torch.cat([light.log1p(), (light + _DARK).log()], -1)


def fold(maps: Tensor) -> Tensor:
    """Lightmaps (B, 5, 3, H, 2H) as answers to all queries (B, Q, 3)."""
    return maps[:, 1:].flatten(-2).mT.flatten(1, 2)


def unfold(answers: Tensor, height: int) -> Tensor:
    """The inverse of `fold`: (B, Q, 3) to lightmaps (B, 5, 3, H, 2H)."""
    maps = answers.unflatten(1, (len(lightmaps.SHININESS), -1)).mT
    maps = maps.unflatten(-1, (height, 2 * height))
    return torch.cat([maps[:, :1], maps], 1)


def texel_weights(height: int) -> Tensor:
    """(Q,) share of the sphere that the texel of each query covers, scaled to a mean of 1."""
    polar = torch.arange(height + 1, dtype=torch.float64) * (math.pi / height)
    rows = -polar.cos().diff()
    weights = (rows / rows.mean())[:, None].expand(-1, 2 * height).flatten()
    return weights.repeat(len(lightmaps.SHININESS)).float()


def sphere(count: int) -> Tensor:
    """(count, 3) unit directions spread evenly: a Fibonacci lattice, float64."""
    index = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1 - 2 * index / count
    azimuth = index * (math.pi * (3 - math.sqrt(5)))
    radius = (1 - z * z).sqrt()
    return torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], -1)
