"""Sizes of the model: one dataclass, three presets. S, N … in comments are symbols of `model`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from totalediting.errors import InputError


@dataclass(frozen=True)
class Preset:
    """Sizes and variants of the model. Lengths in pixels or counts; `full` has the paper's
    figures."""

    name: str
    image: int
    """Side S of pictures that go in and come out."""
    neural: int
    """Side of the picture that is volume-rendered, before super-resolution."""
    window: int
    """Side of the window of it that a step of the stage `reconstruct` renders."""

    global_channels: int
    """Channels of the appearance encoder's global branch, on a grid of side S / 8."""
    detail_channels: int
    """Channels of its detail branch, on a grid of side S / 2."""
    aligned_channels: int
    """How many of its features every shaded point sees, looked up where the source shows it."""
    tokens: int
    """Side of the square grid of tokens that deenactor and reenactor work on."""
    token_dim: int
    """Width of a token."""
    heads: int
    """Attention heads of every Transformer."""
    deenact_blocks: int
    """Blocks of the deenactor."""
    reenact_blocks: int
    """Blocks of the reenactor."""
    motion_tokens: int
    """Tokens that an expression code becomes."""

    plane_size: int
    """Side of a tri-plane's planes."""
    plane_channels: int
    """Channels of one plane."""
    plane_blocks: int
    """ViT blocks of each tri-plane encoder."""
    hidden: int
    """Hidden units of the point-wise decoders."""
    features: int
    """Extra channels w that enter super-resolution along with colour."""
    coarse_samples: int
    """Samples on a ray in the first pass, with `samples` "importance"."""
    fine_samples: int
    """Samples that importance adds in the second."""
    skin_samples: int
    """Samples on a ray about the bust's skin, with `samples` "surface"."""
    hair_samples: int
    """Samples before and behind it, where hair and clothes are."""
    upsample_channels: int
    """Channels of the super-resolution's and the background's convolutions."""

    lightmap_height: int
    """Rows of a lightmap; it is twice as wide."""
    light_directions: int
    """Directions on the sphere that a lobe is embedded by."""
    lobe_dim: int
    """Width of the lightmap estimator's tokens."""
    lobe_blocks: int
    """Cross-attention blocks of its decoder."""

    alpha: float = 2.0
    """Fall-off of moving least squares; the paper's 1 is ten times farther from real necks."""
    deformation_nodes: int = 32
    """Nodes of the deformation's table along each axis."""
    deformation: Literal["mls", "surface_field"] = "mls"
    """What moves points to canonical space."""
    expression: Literal["learned", "warped"] = "learned"
    """Whether the bust at rest has the expression to show, which the reenactor puts in, or none:
    then the deformation takes it off, and an expression moves at once what the source shows."""
    rotation: Literal["mls", "surface_field", "none"] = "mls"
    """What turns normals; "none" leaves the canonical ones."""
    decoder: Literal["phong", "plain"] = "phong"
    """Decomposed shading, or the baseline's single colour that ignores light."""
    samples: Literal["surface", "importance"] = "surface"
    """Where rays are sampled: where the bust is, or in two passes, as the paper."""
    residual: Literal["linear", "paper"] = "linear"
    """Residual light as a sum of shadings, which adds up as light does, or the paper's form."""
    occlusion: Literal["none", "lobes"] = "none"
    """Whether points that something shades gather light through lobes of their own as well."""
    colour: Literal["linear", "srgb"] = "linear"
    """What shading is composed and rendered in; linear light then passes the display curve."""

    weights: Literal["ours", "paper"] = "ours"
    """Weights of the losses: balanced, or the paper's plain sum."""
    freeze: Literal["paper", "none"] = "paper"
    """Whether the stage joint keeps E_app and F_de as they are, as the paper does."""


PRESETS = {
    preset.name: preset
    for preset in (
        Preset(
            name="tiny",
            image=128,
            neural=64,
            window=48,
            global_channels=64,
            detail_channels=32,
            aligned_channels=8,
            tokens=16,
            token_dim=128,
            heads=4,
            deenact_blocks=2,
            reenact_blocks=2,
            motion_tokens=8,
            plane_size=64,
            plane_channels=16,
            plane_blocks=1,
            hidden=32,
            features=13,
            coarse_samples=16,
            fine_samples=16,
            skin_samples=10,
            hair_samples=6,
            upsample_channels=32,
            lightmap_height=16,
            light_directions=128,
            lobe_dim=128,
            lobe_blocks=2,
            deformation_nodes=16,
        ),
        Preset(
            name="small",
            image=256,
            neural=64,
            window=64,
            global_channels=256,
            detail_channels=64,
            aligned_channels=16,
            tokens=32,
            token_dim=512,
            heads=8,
            deenact_blocks=3,
            reenact_blocks=3,
            motion_tokens=32,
            plane_size=128,
            plane_channels=32,
            plane_blocks=2,
            hidden=64,
            features=29,
            coarse_samples=36,
            fine_samples=36,
            skin_samples=14,
            hair_samples=10,
            upsample_channels=64,
            lightmap_height=32,
            light_directions=512,
            lobe_dim=256,
            lobe_blocks=3,
        ),
        Preset(
            name="full",
            image=512,
            neural=128,
            window=64,
            global_channels=256,
            detail_channels=96,
            aligned_channels=16,
            tokens=32,
            token_dim=1024,
            heads=16,
            deenact_blocks=4,
            reenact_blocks=4,
            motion_tokens=64,
            plane_size=256,
            plane_channels=32,
            plane_blocks=5,
            hidden=64,
            features=29,
            coarse_samples=48,
            fine_samples=48,
            skin_samples=20,
            hair_samples=12,
            upsample_channels=128,
            lightmap_height=64,
            light_directions=512,
            lobe_dim=256,
            lobe_blocks=4,
        ),
    )
}
"""`tiny` trains in minutes on two cores, `small` on one GPU, `full` has the paper's sizes."""


SWITCHES = {
    "alpha": ("1", "1.5", "2", "3"),
    "deformation": ("mls", "surface_field"),
    "expression": ("learned", "warped"),
    "rotation": ("mls", "surface_field", "none"),
    "decoder": ("phong", "plain"),
    "samples": ("surface", "importance"),
    "residual": ("linear", "paper"),
    "occlusion": ("none", "lobes"),
    "colour": ("linear", "srgb"),
    "weights": ("ours", "paper"),
    "freeze": ("paper", "none"),
}
"""What an ablation may change in a preset, and to what."""


def preset_with(name: str, changes: list[str]) -> Preset:
    """The preset `name` with switches set, each as "decoder=plain".

    Raises:
        InputError: no such preset, switch or value.
    """
    if name not in PRESETS:
        *others, last = PRESETS
        raise InputError(f"--preset: {name}: choose {', '.join(others)} or {last}")
    values: dict[str, str | float] = {}
    for change in changes:
        switch, _, value = change.partition("=")
        if value not in SWITCHES.get(switch, ()):
            known = "; ".join(f"{k}={'|'.join(v)}" for k, v in SWITCHES.items())
            raise InputError(f"--set: {change}: choose one of {known}")
        values[switch] = float(value) if switch == "alpha" else value
    return replace(PRESETS[name], **values)  # pyright: ignore[reportArgumentType]
