"""Materials: how each kind of surface answers light, and what it writes into the label passes.

Every opaque material writes the same label AOVs at its first hit, so that albedo, normal, canonical
position, texture coordinate and part label exist on skin, hair, eyes and metal alike. Lengths are
metres, colours linear Rec.709; noise on skin is anchored to the vertex attribute `rest` (neutral
template position), on cloth to `canonical`, so that it sticks under expression and pose.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from assets_procedural.people.person import Skin
from synthgen.stage.nodes import Graph, Socket

# Jensen-style mean free paths of skin, relative to the red channel, and the red one's length.
_SSS_RADIUS = (1.0, 0.36, 0.20)
_SSS_SCALE = 0.0030


def write_labels(graph: Graph, albedo: Socket, part: Socket) -> None:
    """Write the label AOVs of a surface: `albedo` a colour, `part` a FaceSynthetics id."""
    geometry = graph.node("NewGeometry")
    for name, value in (
        ("albedo", albedo),
        ("normal_world", geometry.outputs["Normal"]),
        ("canonical", graph.attribute("canonical").outputs["Vector"]),
        ("texture", graph.attribute("UVMap").outputs["Vector"]),
    ):
        graph.node("OutputAOV", {"Color": value}, aov_name=name)
    graph.node("OutputAOV", {"Value": part}, aov_name="part")


def skin(parameters: Skin) -> bpy.types.Material:
    """Random-walk skin; reads the vertex attributes of `assets_procedural.body.skin.SkinFields`."""
    material, graph = _new("skin")
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
    write_labels(graph, colour, graph.scalar("part"))
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


def hair(roughness: float, part: int) -> bpy.types.Material:
    """Principled hair; each strand's colour comes from the attribute `colour`."""
    material, graph = _new("hair")
    colour = graph.attribute("colour").outputs["Color"]
    surface = graph.node("BsdfHairPrincipled", {
        "Color": colour, "Roughness": roughness, "Radial Roughness": min(1.0, roughness + 0.15),
        "IOR": 1.55, "Random Roughness": 0.1,
    }, parametrization="COLOR", model="CHIANG")  # fmt: skip
    graph.output(surface.outputs[0])
    write_labels(graph, colour, float(part))
    return material


def surface(kind: str, parameters: dict[str, Any], part: Socket) -> bpy.types.Material:
    """The material of a mesh piece by its `material` key.

    Raises:
        KeyError: no material of that kind.
    """
    material, graph = _new(kind)
    part = graph.scalar("part") if part is None else part
    build = _SURFACES[kind]
    shader, albedo = build(graph, parameters)
    graph.output(shader)
    write_labels(graph, albedo, part)
    return material


def _eye(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = _texture(graph, parameters["texture"])
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": 0.35, "Specular IOR Level": 0.3,
        "Subsurface Weight": 0.25, "Subsurface Scale": 0.0015,
    })  # fmt: skip
    return shader.outputs[0], colour


def _clear(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """A thin clear film: what is behind it, a Fresnel highlight, no refraction and no shadow."""
    tint = max(0.0, 1.0 - parameters.get("tint", 0.0))
    through = graph.node("BsdfTransparent", {"Color": (tint, tint, tint)})
    gloss = graph.node("BsdfGlossy", {"Roughness": parameters.get("roughness", 0.02)})
    fresnel = graph.node("Fresnel", {"IOR": parameters.get("ior", 1.376)}).outputs[0]
    lit = graph.node("MixShader", {0: fresnel, 1: through.outputs[0], 2: gloss.outputs[0]})
    shadow = graph.node("LightPath").outputs["Is Shadow Ray"]
    clear = graph.node("MixShader", {0: shadow, 1: lit.outputs[0], 2: through.outputs[0]})
    return clear.outputs[0], (tint, tint, tint)


def _enamel(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = _colour(parameters, (0.72, 0.66, 0.54))
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": 0.22, "Subsurface Weight": 0.5,
        "Subsurface Scale": 0.002, "Coat Weight": 0.3, "Coat Roughness": 0.1,
    })  # fmt: skip
    return shader.outputs[0], colour


def _mucosa(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = _colour(parameters, (0.38, 0.10, 0.09))
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": 0.3, "Subsurface Weight": 0.8,
        "Subsurface Scale": 0.003, "Coat Weight": 0.25, "Coat Roughness": 0.15,
    })  # fmt: skip
    return shader.outputs[0], colour


def _cloth(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    rest = graph.attribute("canonical").outputs["Vector"]
    colour: Socket = _colour(parameters, (0.3, 0.3, 0.3))
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


def _knit(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
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
        _colour(parameters, (0.2, 0.2, 0.25)),
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


def _plastic(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = _colour(parameters, (0.03, 0.03, 0.03))
    shader = graph.node("BsdfPrincipled", {"Base Color": colour, "Roughness": 0.25, "IOR": 1.5})
    return shader.outputs[0], colour


def _metal(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    colour = _colour(parameters, (0.8, 0.6, 0.25))
    inputs = {"Base Color": colour, "Metallic": 1.0, "Roughness": 0.22}
    return graph.node("BsdfPrincipled", inputs).outputs[0], colour


_SURFACES = {
    "eye": _eye,
    "cornea": _clear,
    "tear": _clear,
    "lens": _clear,
    "teeth": _enamel,
    "gums": _mucosa,
    "tongue": _mucosa,
    "cloth": _cloth,
    "knit": _knit,
    "plastic": _plastic,
    "metal": _metal,
}


def _new(name: str) -> tuple[bpy.types.Material, Graph]:
    material = bpy.data.materials.new(name)
    return material, Graph(material)


def _colour(parameters: dict[str, Any], default: tuple[float, float, float]) -> Any:
    return tuple(float(c) for c in parameters.get("colour", default))


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
