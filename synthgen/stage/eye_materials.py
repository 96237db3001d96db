"""Eyes and mouth: eyeball, clear films, teeth, gums and tongue. Lenses of glasses are clear too."""

from __future__ import annotations

from typing import Any

from synthgen.stage.nodes import Graph
from synthgen.stage.shading import colour_of, texture


def eye(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = texture(graph, parameters["texture"])
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": 0.35, "Specular IOR Level": 0.3,
        "Subsurface Weight": 0.25, "Subsurface Scale": 0.0015,
    })  # fmt: skip
    return shader.outputs[0], colour


def clear(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """A thin clear film: what is behind it, a Fresnel highlight, no refraction and no shadow."""
    tint = max(0.0, 1.0 - parameters.get("tint", 0.0))
    through = graph.node("BsdfTransparent", {"Color": (tint, tint, tint)})
    gloss = graph.node("BsdfGlossy", {"Roughness": parameters.get("roughness", 0.02)})
    # The Fresnel node inverts the index on back faces: light that leaves the film would be
    # reflected totally. Nothing is refracted here, so both sides reflect alike.
    ior = parameters.get("ior", 1.376)
    back = graph.node("NewGeometry").outputs["Backfacing"]
    index = graph.math("ADD", graph.math("MULTIPLY", back, 1 / ior - ior), ior)
    fresnel = graph.node("Fresnel", {"IOR": index}).outputs[0]
    lit = graph.node("MixShader", {0: fresnel, 1: through.outputs[0], 2: gloss.outputs[0]})
    # What lies behind gets the same light whether Cycles samples the light or the surface.
    path = graph.node("LightPath")
    gather = graph.math("MAXIMUM", path.outputs["Is Shadow Ray"], path.outputs["Is Diffuse Ray"])
    clear = graph.node("MixShader", {0: gather, 1: lit.outputs[0], 2: through.outputs[0]})
    return clear.outputs[0], (tint, tint, tint)


def enamel(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = colour_of(parameters, (0.72, 0.66, 0.54))
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": 0.22, "Subsurface Weight": 0.5,
        "Subsurface Scale": 0.002, "Coat Weight": 0.3, "Coat Roughness": 0.1,
    })  # fmt: skip
    return shader.outputs[0], colour


def mucosa(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = colour_of(parameters, (0.38, 0.10, 0.09))
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": 0.3, "Subsurface Weight": 0.8,
        "Subsurface Scale": 0.003, "Coat Weight": 0.25, "Coat Roughness": 0.15,
    })  # fmt: skip
    return shader.outputs[0], colour
