"""Skin: colour, relief, gloss and scattering."""

from __future__ import annotations

import bpy
import numpy as np

from assets_procedural.person import Skin
from synthgen.stage.shading import new_material, write_labels

# Jensen-style mean free paths of skin, relative to the red channel, and the red one's length.
_SSS_RADIUS = (1.0, 0.36, 0.20)
_SSS_SCALE = 0.0030


def skin(parameters: Skin) -> bpy.types.Material:
    """Random-walk skin; reads the vertex attributes of `assets_procedural.body.skin.SkinFields`."""
    material, graph = new_material("skin")
    rest = graph.attribute("rest").outputs["Vector"]
    rng = np.random.default_rng(parameters.seed)
    offset = tuple(float(v) for v in rng.uniform(-5, 5, 3))
    place = graph.combine("ADD", rest, offset)

    colour = graph.attribute("colour").outputs["Color"]
    blotches = graph.noise(place, 55, detail=3, rough=0.6)
    redder = graph.mix(
        graph.stretch(blotches, 0.35, 0.7, (0, 1)), (0.99, 1.02, 1.02), (1.03, 0.95, 0.945)
    )
    colour = graph.mix(1.0, colour, redder, "MULTIPLY")
    mottling = graph.noise(place, 420, detail=2, rough=0.7)
    paler = graph.mix(
        graph.stretch(mottling, 0.3, 0.7, (0, 1)), (0.95, 0.94, 0.93), (1.05, 1.05, 1.05)
    )
    colour = graph.mix(1.0, colour, paler, "MULTIPLY")

    if parameters.freckles > 0.05:
        cells = graph.node("TexVoronoi", {"Vector": place, "Scale": 380.0, "Randomness": 1.0})
        size = graph.math(
            "MULTIPLY",
            graph.node("SeparateColor", {"Color": cells.outputs["Color"]}).outputs["Red"],
            0.42,
        )
        spot = graph.math("LESS_THAN", cells.outputs["Distance"], size)
        cluster = graph.stretch(graph.noise(place, 90, detail=2), 0.42, 0.62, (0.1, 1))
        strength = graph.math("MULTIPLY", graph.scalar("freckles"), cluster)
        amount = graph.math("MULTIPLY", graph.math("MULTIPLY", spot, strength), 0.55, clamp=True)
        colour = graph.mix(amount, colour, graph.mix(1.0, colour, (0.62, 0.42, 0.30), "MULTIPLY"))
    if parameters.blemishes > 0.1:
        patches = graph.stretch(graph.noise(place, 160, detail=1), 0.70, 0.78, (0, 1))
        amount = graph.math("MULTIPLY", patches, 0.6 * parameters.blemishes)
        colour = graph.mix(amount, colour, graph.mix(1.0, colour, (1.0, 0.66, 0.62), "MULTIPLY"))
    for centre, radius in moles(parameters):
        away = graph.node("VectorMath", {0: rest, 1: centre}, operation="DISTANCE").outputs["Value"]
        amount = graph.stretch(away, 0.6 * radius, 1.1 * radius, (0.8, 0))
        colour = graph.mix(amount, colour, graph.mix(1.0, colour, (0.28, 0.18, 0.14), "MULTIPLY"))
    dots = graph.stretch(graph.noise(place, 1400, detail=0), 0.58, 0.68, (0, 0.55))
    amount = graph.math("MULTIPLY", dots, graph.scalar("stubble"))
    colour = graph.mix(amount, colour, graph.mix(1.0, colour, (0.35, 0.35, 0.37), "MULTIPLY"))

    # One bump node with summed heights: chained ones are slow.
    pores = graph.math(
        "MULTIPLY", graph.noise(place, 1300, detail=2, rough=0.6), graph.scalar("pores")
    )
    pores = graph.math("MULTIPLY", pores, 0.00013)
    soft = graph.math("MULTIPLY", graph.noise(place, 240, detail=2), 0.00022)
    across = graph.combine("MULTIPLY", place, (0.16, 0.16, 1.0))
    lines = graph.noise(across, 185, detail=2, rough=0.55)
    lines = graph.math(
        "MULTIPLY", graph.stretch(lines, 0.36, 0.60, (0, 1)), graph.scalar("wrinkles")
    )
    lines = graph.math("MULTIPLY", lines, 0.0008)
    along = graph.combine("MULTIPLY", place, (1.0, 0.3, 0.12))
    furrows = graph.math("MULTIPLY", graph.noise(along, 620, detail=1), graph.scalar("lips"))
    furrows = graph.math("MULTIPLY", furrows, 0.00045)
    height = graph.math("ADD", graph.math("ADD", pores, soft), graph.math("ADD", lines, furrows))
    bump = graph.node("Bump", {"Height": height, "Strength": 1.0, "Distance": 1.0})

    oil = graph.stretch(graph.noise(place, 70, detail=2), 0.3, 0.7, (-0.06, 0.06))
    roughness = graph.math("ADD", graph.scalar("roughness"), oil, clamp=True)
    surface = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": roughness, "IOR": 1.42, "Normal": bump.outputs[0],
        "Subsurface Weight": 1.0, "Subsurface Scale": _SSS_SCALE,
        "Subsurface Anisotropy": 0.0, "Specular IOR Level": 0.5,
        "Coat Weight": 0.04 + 0.1 * parameters.oiliness, "Coat Roughness": 0.28,
    }, subsurface_method="RANDOM_WALK")  # fmt: skip
    surface.inputs["Subsurface Radius"].default_value = _SSS_RADIUS
    graph.output(surface.outputs[0])
    write_labels(graph, surface.outputs[0], colour, graph.scalar("part"))
    return material


def moles(parameters: Skin) -> list[tuple[tuple[float, float, float], float]]:
    """Centres (template space) and radii in metres of the moles on the face and neck."""
    rng = np.random.default_rng([parameters.seed, 1])
    spots = []
    for _ in range(parameters.moles):
        x, z = rng.uniform(-0.06, 0.06), rng.uniform(0.63, 0.79)
        y = -0.165 + 0.9 * x**2 / 0.12 + rng.uniform(0, 0.01)
        spots.append(((float(x), float(y), float(z)), float(rng.uniform(0.0015, 0.0045))))
    return spots
