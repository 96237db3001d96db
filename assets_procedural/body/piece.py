"""Everything that sits on a bust, as arrays that follow it: surfaces and strands.

A piece knows its topology once and its place on any `Bust`: `place(bust)` is a pure function that
is called with the posed bust for the picture and with the canonical bust for the canonical label.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from assets_procedural.mesh.vectors import moved

if TYPE_CHECKING:
    from assets_procedural.body.head import Bust


@dataclass(frozen=True)
class MeshPiece:
    """A surface: V vertices, F faces of k = 3 or 4 corners.

    `part` is one label for all faces or an (F,) array. `uv` is (F, k, 2), in [0, 1] or, on cloth,
    in metres. `vertex` holds per-vertex material inputs, (V,) or (V, 3). `hidden_from_labels` marks
    thin transparent surfaces (cornea, lenses) that the labels look through.
    """

    name: str
    part: int | np.ndarray
    faces: np.ndarray
    material: str
    place: Callable[[Bust], np.ndarray]
    parameters: dict[str, Any] = field(default_factory=dict)
    uv: np.ndarray | None = None
    vertex: dict[str, np.ndarray] = field(default_factory=dict)
    smooth: bool = True
    hidden_from_labels: bool = False


class StrandPlace(Protocol):
    """Where strands are: `place(bust)` are (N, K, 3), `place[index]` is the place of some."""

    def __call__(self, bust: Bust) -> np.ndarray: ...

    def __getitem__(self, index: np.ndarray) -> StrandPlace: ...


@dataclass(frozen=True)
class StrandPiece:
    """N strands of K points each, root first and in random order; `radius` (N, K) in metres.

    Arrays among `parameters` are per strand, (N, ...).
    """

    name: str
    part: int
    radius: np.ndarray
    place: StrandPlace
    parameters: dict[str, Any] = field(default_factory=dict)

    def thinned(self, share: float, wider: float) -> StrandPiece:
        """A `share` in (0, 1] of the strands, evenly chosen, `wider` times as thick."""
        kept = np.flatnonzero(np.diff(np.floor(np.arange(len(self.radius) + 1) * share)))
        parameters = {
            name: value[kept] if isinstance(value, np.ndarray) else value
            for name, value in self.parameters.items()
        }
        radius = self.radius[kept] * np.float32(wider)
        return replace(self, radius=radius, place=self.place[kept], parameters=parameters)


Piece = MeshPiece | StrandPiece


def rigid(bone: str, rest: np.ndarray) -> Callable[[Bust], np.ndarray]:
    """A `place` that moves rest positions (V, 3) with one bone of the bust."""

    def place(bust: Bust) -> np.ndarray:
        return moved(rest, bust.bones[bone])

    return place


def skinned(rest: np.ndarray, weights: np.ndarray) -> Callable[[Bust], np.ndarray]:
    """A `place` that moves rest positions (V, 3) with the bones by `weights` (V, J)."""

    def place(bust: Bust) -> np.ndarray:
        motion = bust.blend_bones(weights)
        return np.einsum("nij,nj->ni", motion[..., :3], rest) + motion[..., 3]

    return place
