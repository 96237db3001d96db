"""What every material shares: its label passes, its colour from parameters."""

from __future__ import annotations

from typing import Any

import bpy

from synthgen.stage.nodes import Graph, Socket


def new_material(name: str) -> tuple[bpy.types.Material, Graph]:
    material = bpy.data.materials.new(name)
    return material, Graph(material)


def write_labels(graph: Graph, shader: Socket, albedo: Socket, part: Socket) -> None:
    """Write the label AOVs of a surface: `albedo` a colour, `part` a FaceSynthetics id.

    The normal is what `shader` is lit by, with its relief.
    """
    geometry = graph.node("NewGeometry")
    lit = shader.node.inputs.get("Normal")
    relief = lit.links[0].from_socket if lit is not None and lit.is_linked else None
    for name, value in (
        ("albedo", albedo),
        ("normal_world", relief or geometry.outputs["Normal"]),
        ("canonical", graph.attribute("canonical").outputs["Vector"]),
        ("texture", graph.attribute("UVMap").outputs["Vector"]),
    ):
        graph.node("OutputAOV", {"Color": value}, aov_name=name)
    graph.node("OutputAOV", {"Value": part}, aov_name="part")


def colour_of(parameters: dict[str, Any], default: tuple[float, float, float]) -> Any:
    return tuple(float(c) for c in parameters.get("colour", default))
