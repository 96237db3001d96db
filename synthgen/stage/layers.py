"""What Cycles rendered, read from its memory: no file is written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy
import cycles
import numpy as np

Layers = dict[str, np.ndarray]
"""Layers by name: (H, W) or (H, W, C) float32, row 0 at the top."""
Weights = Mapping[str, np.ndarray]
"""Layers to be added up to E pictures, by name: (E, 3)."""

_cycles_render = cycles.CyclesRender.render
_weights: dict[str, np.ndarray] = {}
_layers: Layers = {}
_sums: list[np.ndarray] = []


def _render(engine: Any, depsgraph: Any) -> None:
    """Cycles' own call, after which its result can still be read."""
    _cycles_render(engine, depsgraph)
    result = engine.get_result()
    height, width = result.resolution_y, result.resolution_x
    if _weights:
        count = len(next(iter(_weights.values())))
        _sums.append(np.zeros((count, 3, height * width), np.float32))
    for each in result.layers[0].passes:
        flat = np.empty(height * width * each.channels, np.float32)
        each.rect.foreach_get(flat)
        if each.name in _weights:
            _add(_sums[0], flat.reshape(-1, 3), _weights[each.name])
        else:
            image = flat.reshape(height, width, each.channels)[::-1]
            _layers[each.name] = image[..., 0] if each.channels == 1 else image
    if _weights:
        planes = _sums.pop().reshape(count, 3, height, width)
        _sums.append(planes.transpose(0, 2, 3, 1)[:, ::-1])


def _add(sums: np.ndarray, layer: np.ndarray, weights: np.ndarray) -> None:
    """Add a layer (N, 3) to pictures (E, 3, N); always in the same order, to the last bit."""
    for c, plane in enumerate(np.ascontiguousarray(layer.T)):
        for e in np.flatnonzero(weights[:, c]):
            sums[e, c] += plane * weights[e, c]


cycles.CyclesRender.render = _render


def render_layers() -> Layers:
    """Render once and return every layer."""
    return render_sums({})[0]


def render_sums(weights: Weights) -> tuple[Layers, np.ndarray]:
    """Render once and return the layers that are not in `weights`, and the sums of those that are.

    The sums are (E, H, W, 3), or nothing without weights. Layers are added up as they are read, so
    that of several hundred there is never more than one copy.
    """
    # Settings of Cycles are an add-on's: a scene that is held between renders misses a change.
    bpy.context.scene.update_tag()
    _weights.update(weights)
    try:
        bpy.ops.render.render()
        return dict(_layers), _sums[0] if _sums else np.empty(0)
    finally:
        for kept in (_weights, _layers, _sums):
            kept.clear()
