"""Eyes and mouth: eyeball, clear films, teeth, gums and tongue. Lenses of glasses are clear too."""

from __future__ import annotations

from typing import Any

from synthgen.stage.nodes import Graph
from synthgen.stage.shading import colour_of, texture

_IRIS_GAIN = 1.7
# What little light gets under the lids has been reflected by skin.
_LID_SHADE = (0.30, 0.19, 0.15)


def eye(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = texture(graph, parameters["texture"])
    # The cornea bends light onto the iris, which no straight ray does; the sclera curves away into
    # the shade of the lids. The label keeps the pigment.
    limbus = parameters["iris_angle"]
    radial = graph.scalar("radial")
    gain = graph.stretch(radial, 0.7 * limbus, 1.05 * limbus, (_IRIS_GAIN, 1.0))
    gain = graph.math("MULTIPLY", gain, graph.stretch(radial, 1.2 * limbus, 1.1, (0.97, 0.66)))
    lit = graph.mix(
        1.0, colour, graph.node("CombineColor", {0: gain, 1: gain, 2: gain}).outputs[0], "MULTIPLY"
    )
    shader = graph.node("BsdfPrincipled", {
        "Base Color": lit, "Roughness": 0.35, "Specular IOR Level": 0.3,
        "Subsurface Weight": 0.15, "Subsurface Scale": 0.001,
    })  # fmt: skip
    return shader.outputs[0], colour


def lid_shade(graph: Graph, _: dict[str, Any]) -> tuple[Any, Any]:
    """What the camera sees through it is darker by the vertex input `shade`; light passes."""
    seen = graph.math(
        "MULTIPLY", graph.scalar("shade"), graph.node("LightPath").outputs["Is Camera Ray"]
    )
    tint = graph.mix(seen, (1.0, 1.0, 1.0), _LID_SHADE)
    return graph.node("BsdfTransparent", {"Color": tint}).outputs[0], None


def clear(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """A thin clear film: what is behind it, a Fresnel highlight, no refraction and no shadow."""
    tint = max(0.0, 1.0 - parameters.get("tint", 0.0))
    through = graph.node("BsdfTransparent", {"Color": (tint, tint, tint)})
    gloss = graph.node("BsdfGlossy", {"Roughness": parameters.get("roughness", 0.02)})
    fresnel = film_fresnel(graph, parameters.get("ior", 1.376))
    lit = graph.node("MixShader", {0: fresnel, 1: through.outputs[0], 2: gloss.outputs[0]})
    # What lies behind gets the same light whether Cycles samples the light or the surface.
    path = graph.node("LightPath")
    gather = graph.math("MAXIMUM", path.outputs["Is Shadow Ray"], path.outputs["Is Diffuse Ray"])
    clear = graph.node("MixShader", {0: gather, 1: lit.outputs[0], 2: through.outputs[0]})
    return clear.outputs[0], None


def film_fresnel(graph: Graph, ior: float) -> Any:
    """The share of light that a thin film reflects."""
    # The Fresnel node inverts the index on back faces: light that leaves the film would be
    # reflected totally. Nothing is refracted here, so both sides reflect alike.
    back = graph.node("NewGeometry").outputs["Backfacing"]
    index = graph.math("ADD", graph.math("MULTIPLY", back, 1 / ior - ior), ior)
    return graph.node("Fresnel", {"IOR": index}).outputs[0]


def enamel(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    tone = graph.attribute("tone").outputs["Color"]
    colour = graph.mix(1.0, colour_of(parameters, (0.72, 0.66, 0.54)), tone, "MULTIPLY")
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
