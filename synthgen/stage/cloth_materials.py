"""Cloth and knit."""

from __future__ import annotations

from typing import Any

from synthgen.stage.nodes import Graph, Socket
from synthgen.stage.shading import colour_of


def cloth(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    rest = graph.attribute("canonical").outputs["Vector"]
    colour: Socket = colour_of(parameters, (0.3, 0.3, 0.3))
    if parameters.get("pattern") == "stripes":
        height = graph.node("SeparateXYZ", {0: rest}).outputs["Z"]
        wave = graph.math("SINE", graph.math("MULTIPLY", height, 210.0))
        colour = graph.mix(
            graph.stretch(wave, -0.1, 0.1, (0, 1)), colour, tuple(parameters["accent"])
        )
    fade = graph.stretch(graph.noise(rest, 30, detail=3), 0.3, 0.7, (0, 1))
    tone = graph.mix(fade, (0.9, 0.9, 0.9), (1.06, 1.06, 1.06))
    fibre = graph.stretch(graph.noise(rest, 900, detail=2), 0.3, 0.7, (0, 1))
    tone = graph.mix(
        1.0, tone, graph.mix(fibre, (0.88, 0.88, 0.88), (1.08, 1.08, 1.08)), "MULTIPLY"
    )
    colour = graph.mix(1.0, colour, tone, "MULTIPLY")
    folds = graph.math("MULTIPLY", graph.noise(rest, 16, detail=2, rough=0.45), 0.012)
    weave = graph.math("MULTIPLY", graph.noise(rest, 1500, detail=1), 0.00030)
    bump = graph.node("Bump", {"Height": graph.math("ADD", folds, weave), "Distance": 1.0})
    return _fabric(graph, colour, bump, parameters), colour


def knit(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """Ribs along u, stitches along v of the piece's metre-like texture coordinates."""
    uv = graph.node("SeparateXYZ", {0: graph.attribute("UVMap").outputs["Vector"]})
    rib = graph.math("ABSOLUTE", graph.math("SINE", graph.math("MULTIPLY", uv.outputs["X"], 780.0)))
    stitch = graph.math(
        "ABSOLUTE", graph.math("SINE", graph.math("MULTIPLY", uv.outputs["Y"], 900.0))
    )
    height = graph.math(
        "ADD", graph.math("MULTIPLY", rib, 0.0016), graph.math("MULTIPLY", stitch, 0.0006)
    )
    rest = graph.attribute("canonical").outputs["Vector"]
    fuzz = graph.stretch(graph.noise(rest, 1200, detail=2), 0.3, 0.7, (0.8, 1.12))
    shade = graph.math("MULTIPLY", graph.stretch(rib, 0.0, 0.6, (0.6, 1.0)), fuzz)
    colour = graph.mix(
        1.0,
        colour_of(parameters, (0.2, 0.2, 0.25)),
        graph.node("CombineColor", {0: shade, 1: shade, 2: shade}).outputs[0],
        "MULTIPLY",
    )
    bump = graph.node("Bump", {"Height": height, "Distance": 1.0})
    return _fabric(graph, colour, bump, parameters), colour


def _fabric(graph: Graph, colour: Socket, bump: Any, parameters: dict[str, Any]) -> Any:
    return graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": parameters.get("roughness", 0.85),
        "Normal": bump.outputs[0], "Sheen Weight": 0.25, "Sheen Roughness": 0.5,
        "Specular IOR Level": 0.2,
    }).outputs[0]  # fmt: skip
