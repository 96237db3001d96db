"""Materials: how each kind of surface answers light, and what it writes into the label passes.

Every opaque material writes the same label AOVs at its first hit, so that albedo, normal, canonical
position, texture coordinate and part label exist on skin, hair, eyes and metal alike. Lengths are
metres, colours linear Rec.709; noise on skin is anchored to the vertex attribute `rest` (neutral
template position), on cloth to `canonical`, so that it sticks under expression and pose.
"""

from __future__ import annotations

from typing import Any

import bpy

from synthgen.stage import cloth_materials, eye_and_mouth_materials, film_materials
from synthgen.stage.nodes import Graph, Socket
from synthgen.stage.shading import colour_of, new_material, write_labels


def hair(roughness: float, part: int) -> bpy.types.Material:
    """Principled hair; each strand's colour comes from the attribute `colour`."""
    material, graph = new_material("hair")
    colour = graph.attribute("colour").outputs["Color"]
    surface = graph.node("BsdfHairPrincipled", {
        "Color": colour, "Roughness": roughness, "Radial Roughness": min(1.0, roughness + 0.15),
        "IOR": 1.55, "Random Roughness": 0.4,
    }, parametrization="COLOR", model="CHIANG")  # fmt: skip
    graph.output(surface.outputs[0])
    write_labels(graph, surface.outputs[0], colour, float(part))
    return material


def surface(kind: str, parameters: dict[str, Any]) -> bpy.types.Material:
    """The material of a mesh piece by its `material` key; parts are labelled face by face.

    Raises:
        KeyError: no material of that kind.
    """
    material, graph = new_material(kind)
    part = graph.scalar("part")
    shader, albedo = _SURFACES[kind](graph, parameters)
    graph.output(shader)
    if albedo is not None:  # else labels are of what is behind
        write_labels(graph, shader, albedo, part)
    return material


def _plastic(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour: Socket = colour_of(parameters, (0.03, 0.03, 0.03))
    if parameters.get("tortoise"):
        # Acetate with dark clouds in amber.
        place = graph.attribute("canonical").outputs["Vector"]
        clouds = graph.stretch(graph.noise(place, 130, detail=2), 0.42, 0.60, (0, 1))
        colour = graph.mix(clouds, (0.30, 0.11, 0.025), (0.018, 0.008, 0.004))
    inputs = {"Base Color": colour, "Roughness": parameters.get("roughness", 0.25), "IOR": 1.5}
    return graph.node("BsdfPrincipled", inputs).outputs[0], colour


def _metal(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = colour_of(parameters, (0.8, 0.6, 0.25))
    inputs = {"Base Color": colour, "Metallic": 1.0, "Roughness": 0.22}
    return graph.node("BsdfPrincipled", inputs).outputs[0], colour


_SURFACES = {
    "eye": eye_and_mouth_materials.eye,
    "cornea": film_materials.clear,
    "tear": film_materials.clear,
    "lens": film_materials.clear,
    "lid_shade": eye_and_mouth_materials.lid_shade,
    "teeth": eye_and_mouth_materials.enamel,
    "gums": eye_and_mouth_materials.mucosa,
    "tongue": eye_and_mouth_materials.mucosa,
    "cloth": cloth_materials.cloth,
    "plastic": _plastic,
    "shade": film_materials.shade,
    "metal": _metal,
}
