"""Eyes and mouth: eyeball, the shade of the lids, teeth, gums and tongue."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from synthgen.stage.nodes import Graph
from synthgen.stage.shading import colour_of

_IRIS_GAIN = 1.7
# What little light gets under the lids has been reflected by skin.
_LID_SHADE = (0.30, 0.19, 0.15)


def eye(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = _texture(graph, parameters["texture"])
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


def _texture(graph: Graph, pixels: np.ndarray) -> Any:
    """A linear (H, W, 3) array, row 0 at the top, sampled by the mesh's texture coordinates."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("texture", width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels[::-1]
    image.pixels.foreach_set(rgba.ravel())
    uv = graph.attribute("UVMap").outputs["Vector"]
    node = graph.node("TexImage", {"Vector": uv}, image=image, interpolation="Cubic")
    return node.outputs["Color"]
