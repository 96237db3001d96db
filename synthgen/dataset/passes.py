"""The passes of a shot: what is stored per pixel and does not depend on light, one entry each.

This table is the one place to add a pass. From it follow the members of a sample and how they are
written and read (`shards`), shapes and backgrounds that the gate checks, the pictures that `sheet`
and `show` draw, the list and the values on the page of `browse`, the label render of `stage`, and
the table in docs/dataset.md (`table`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

AOV_MEMBER = "aov.exr"
"""The member that holds all passes of floats."""

Style = Literal["colour", "direction", "distance", "texture", "position", "ids", "matte"]


@dataclass(frozen=True)
class Pass:
    """One pass: an array (H, W) or (H, W, C) of a shot.

    uint8 passes are a member <name>.png each; floats share `AOV_MEMBER`, where their channels are
    called <name>.<component>.
    """

    name: str
    """As in `shot.passes[name]` and `shot.name`."""
    dtype: type[np.generic]
    """uint8, float16 or float32."""
    components: str
    """One letter for each of the C channels; a single one makes the pass (H, W)."""
    description: str
    """What it is, for tables."""
    drawn: Style
    """How it is drawn, see `synthgen.pictures.drawing`; colours are sRGB."""
    background: float | None = None
    """Its value wherever nothing is hit (`parts`, or `alpha` if it is `averaged`, is 0), checked by
    the gate; None: not checked."""
    averaged: bool = False
    """Whether it is a mean over the pixel, premultiplied by `alpha`, and not of one point of it."""
    positive: bool = False
    """Whether it is above the background's value wherever something is hit."""
    unit: str = ""
    """Of its values, such as "m"."""
    label: str = ""
    """Its name on the page; default: `name`, capitalised."""
    layer: str = ""
    """The layer of Blender's label render that it is made of; none: of the pictures themselves."""

    @property
    def member(self) -> str:
        """The member of a sample that holds it."""
        return f"{self.name}.png" if self.dtype is np.uint8 else AOV_MEMBER

    @property
    def channels(self) -> tuple[str, ...]:
        """Its channels in `AOV_MEMBER`; none if it has a member of its own."""
        names = tuple(f"{self.name}.{component}" for component in self.components)
        return names if self.member == AOV_MEMBER else ()

    def shape(self, height: int, width: int) -> tuple[int, ...]:
        """(H, W) or (H, W, C)."""
        depth = len(self.components)
        return (height, width) if depth == 1 else (height, width, depth)


PASSES = (
    Pass(
        name="albedo",
        dtype=np.uint8,
        components="RGB",
        description="True base colour, mean times alpha, sRGB",
        drawn="colour",
        background=0.0,
        averaged=True,
        layer="albedo",
    ),
    Pass(
        name="normal",
        dtype=np.float16,
        components="XYZ",
        description="mean times alpha, camera space",
        drawn="direction",
        background=0.0,
        averaged=True,
        layer="normal_world",
    ),
    Pass(
        name="depth",
        dtype=np.float32,
        components="Z",
        description="planar, metres",
        drawn="distance",
        background=0.0,
        positive=True,
        unit="m",
        layer="Depth",
    ),
    Pass(
        name="uv",
        dtype=np.float32,
        components="UV",
        description="",
        drawn="texture",
        background=0.0,
        label="UV",
        layer="texture",
    ),
    Pass(
        name="canonical",
        dtype=np.float32,
        components="XYZ",
        description="metres",
        drawn="position",
        background=0.0,
        unit="m",
        layer="canonical",
    ),
    Pass(
        name="alpha",
        dtype=np.uint8,
        components="A",
        description="Soft matte",
        drawn="matte",
    ),
    Pass(
        name="parts",
        dtype=np.uint8,
        components="I",
        description="FaceSynthetics part ids 0-18, 255 = ignore",
        drawn="ids",
        layer="part",
    ),
)
"""All passes, in the order of their members in a sample."""


def named(name: str) -> Pass | None:
    """The pass of that name, or None."""
    return next((p for p in PASSES if p.name == name), None)


def members() -> dict[str, list[Pass]]:
    """Member of a sample -> the passes that it holds, in order."""
    grouped: dict[str, list[Pass]] = {}
    for each in PASSES:
        grouped.setdefault(each.member, []).append(each)
    return grouped


def contents() -> dict[str, str]:
    """Member of a sample -> what a dataset's card says about it."""
    return {
        member: ", ".join(
            f"{p.name}.{p.components}" + (f" ({p.description})" if p.description else "")
            for p in held
        )
        if member == AOV_MEMBER
        else held[0].description
        for member, held in members().items()
    }


def table() -> list[str]:
    """Rows of the table "Members of a sample" in docs/dataset.md, in Markdown."""
    kinds = {np.uint8: "8 bit", np.float16: "half", np.float32: "float"}
    rows = []
    for member, held in members().items():
        texts = []
        for p in held:
            name = f"`{p.name}.{'/'.join(p.components)}`"
            said = name if member == AOV_MEMBER else p.description
            words = [kinds[p.dtype], p.description if member == AOV_MEMBER else ""]
            texts.append(", ".join(word for word in (said, *words) if word))
        rows.append(f"| `{member}` | {'; '.join(texts)} |")
    return rows
