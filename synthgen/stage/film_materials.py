"""Thin clear films, which write no labels: corneas, tears, lenses of glasses and of sunglasses."""

from __future__ import annotations

from typing import Any

import numpy as np

from synthgen.stage.nodes import Graph


def clear(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """A thin clear film: what is behind it, a Fresnel highlight, no refraction and no shadow."""
    tint = max(0.0, 1.0 - parameters.get("tint", 0.0))
    through = graph.node("BsdfTransparent", {"Color": (tint, tint, tint)})
    gloss = graph.node("BsdfGlossy", {"Roughness": parameters.get("roughness", 0.02)})
    fresnel = _film_fresnel(graph, parameters.get("ior", 1.376))
    lit = graph.node("MixShader", {0: fresnel, 1: through.outputs[0], 2: gloss.outputs[0]})
    # What lies behind gets the same light whether Cycles samples the light or the surface.
    path = graph.node("LightPath")
    gather = graph.math("MAXIMUM", path.outputs["Is Shadow Ray"], path.outputs["Is Diffuse Ray"])
    film = graph.node("MixShader", {0: gather, 1: lit.outputs[0], 2: through.outputs[0]})
    return film.outputs[0], None


def shade(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """A sunglass lens: absorbs less towards its lower edge, and may be coated with a mirror."""
    height = graph.node("SeparateXYZ", {0: graph.attribute("UVMap").outputs["Vector"]}).outputs["Y"]
    dark, light = 1.0 - parameters["tint"], 1.0 - parameters["tint"] * (1 - parameters["gradient"])
    hue = np.array(parameters["lens"], float) / max(max(parameters["lens"]), 1e-6)
    amount = graph.stretch(height, 0.15, 0.85, (0.0, 1.0))
    upper, lower = (tuple(float(c) for c in share * hue) for share in (dark, light))
    through = graph.mix(amount, lower, upper)
    passed = graph.node("BsdfTransparent", {"Color": through}).outputs[0]
    coat = tuple(float(c) for c in 0.4 + 0.6 * hue) if parameters["mirror"] else (1.0, 1.0, 1.0)
    gloss = graph.node("BsdfGlossy", {"Color": coat, "Roughness": 0.03}).outputs[0]
    fresnel = _film_fresnel(graph, parameters.get("ior", 1.5))
    thrown = graph.math("MAXIMUM", fresnel, parameters["mirror"])
    shader = graph.node("MixShader", {0: thrown, 1: passed, 2: gloss}).outputs[0]
    return shader, None


def _film_fresnel(graph: Graph, ior: float) -> Any:
    """The share of light that a thin film reflects."""
    # The Fresnel node inverts the index on back faces: light that leaves the film would be
    # reflected totally. Nothing is refracted here, so both sides reflect alike.
    back = graph.node("NewGeometry").outputs["Backfacing"]
    index = graph.math("ADD", graph.math("MULTIPLY", back, 1 / ior - ior), ior)
    return graph.node("Fresnel", {"IOR": index}).outputs[0]
