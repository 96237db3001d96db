"""The lights of a basis in Blender: a dome of triangles and suns, a light group each."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector

from synthgen.stage.light.patches import PATCHES, Basis, triangles
from synthgen.stage.nodes import Graph

GROUPS = 256
"""The most that Cycles tells apart: beyond it, light lands in others' groups without a word."""
_RADIUS = 60.0
_MARK = "dome"


def set_dome(basis: Basis) -> Sequence[str]:
    """Light the stage by a basis instead of the world; the layers of its lights, in order.

    Raises ValueError for more lights than `GROUPS`.
    """
    if PATCHES + len(basis.suns) > GROUPS:
        raise ValueError(f"{PATCHES + len(basis.suns)} lights, more than {GROUPS}")
    clear_dome()
    scene = bpy.context.scene
    graph = Graph(scene.world)
    dark = graph.node("Background", {"Strength": 0.0})
    graph.node("OutputWorld", {"Surface": dark.outputs[0]})
    # Sums of lights need each as it is, however bright it is or however little it matters.
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.light_sampling_threshold = 0.0
    lights = [
        _patch(corners, strength)
        for corners, strength in zip(triangles(), basis.strengths, strict=True)
    ]
    for sun in basis.suns:
        lamp = bpy.data.lights.new(_MARK, "SUN")
        lamp.energy, lamp.angle = float(sun.irradiance[0]), sun.angle
        light = bpy.data.objects.new(_MARK, lamp)
        light.rotation_euler = Vector(sun.direction).to_track_quat("Z", "Y").to_euler()
        lights.append(light)
    names = []
    for number, light in enumerate(lights):
        light[_MARK] = True
        light.lightgroup = f"light_{number:03d}"
        bpy.context.view_layer.lightgroups.add(name=light.lightgroup)
        scene.collection.objects.link(light)
        names.append(f"Combined_{light.lightgroup}")
    return names


def clear_dome() -> None:
    """Take the lights of a basis away, if there are any."""
    for light in [each for each in bpy.data.objects if each.get(_MARK)]:
        data = light.data
        materials = list(data.materials) if isinstance(data, bpy.types.Mesh) else []
        bpy.data.objects.remove(light)
        for unused in (data, *materials):
            bpy.data.batch_remove([unused])
    bpy.ops.scene.view_layer_remove_unused_lightgroups()


def _patch(corners: np.ndarray, strength: float) -> bpy.types.Object:
    """A triangle (3, 3) of the sky, which shines and is neither seen nor in the way."""
    mesh = bpy.data.meshes.new(_MARK)
    mesh.from_pydata((corners * _RADIUS).tolist(), [], [(0, 1, 2)])
    material = bpy.data.materials.new(_MARK)
    graph = Graph(material)
    graph.output(graph.node("Emission", {"Strength": float(strength)}).outputs[0])
    material.cycles.emission_sampling = "FRONT_BACK"
    mesh.materials.append(material)
    light = bpy.data.objects.new(_MARK, mesh)
    light.visible_camera = light.visible_shadow = False
    return light
