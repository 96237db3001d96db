"""What Cycles rendered, read from its memory: no file is written."""

from __future__ import annotations

from typing import Any

import bpy
import cycles
import numpy as np

_layers: dict[str, np.ndarray] = {}
_cycles_render = cycles.CyclesRender.render


def _render(engine: Any, depsgraph: Any) -> None:
    """Cycles' own call, after which its result can still be read."""
    _cycles_render(engine, depsgraph)
    result = engine.get_result()
    height, width = result.resolution_y, result.resolution_x
    for each in result.layers[0].passes:
        flat = np.empty(height * width * each.channels, np.float32)
        each.rect.foreach_get(flat)
        image = flat.reshape(height, width, each.channels)[::-1]
        _layers[each.name] = image[..., 0] if each.channels == 1 else image


cycles.CyclesRender.render = _render


def render_layers() -> dict[str, np.ndarray]:
    """Render once and return every layer by name: (H, W) or (H, W, C) float32, row 0 at the top."""
    # Settings of Cycles are an add-on's: a scene that is held between renders misses a change.
    bpy.context.scene.update_tag()
    _layers.clear()
    bpy.ops.render.render()
    layers = dict(_layers)
    _layers.clear()
    return layers
