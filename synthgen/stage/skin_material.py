"""Skin: colour, relief, gloss and scattering."""

from __future__ import annotations

import bpy
import numpy as np

from assets_procedural.body.skin import HAEMOGLOBIN, MELANIN
from assets_procedural.person import Skin
from synthgen.stage.nodes import Socket
from synthgen.stage.shading import new_material, write_labels

_DETAIL = "skin detail"  # the image over the face, see `assets_procedural.skin_detail`

# Jensen-style mean free paths of skin, relative to the red channel; the red one's length in
# metres in the palest skin, and the share of it that the darkest loses to its melanin.
_SSS_RADIUS = (1.0, 0.36, 0.20)
_SSS_SCALE = 0.0019
_SSS_VEILED = 0.4


def skin(parameters: Skin) -> bpy.types.Material:
    """Random-walk skin; reads the vertex attributes of `assets_procedural.body.skin.SkinFields`.

    Structure is strongest at 2 to 10 mm, which a portrait's pixels resolve; all noise is in the
    template's space, so that it sticks to the skin.
    """
    material, graph = new_material("skin")
    rng = np.random.default_rng(parameters.seed)
    offset = tuple(float(v) for v in rng.uniform(-5, 5, 3))
    place = graph.combine("ADD", graph.attribute("rest").outputs["Vector"], offset)
    detail = graph.node(
        "TexImage", {"Vector": graph.attribute("chart").outputs["Vector"]},
        image=bpy.data.images[_DETAIL], interpolation="Cubic", extension="CLIP",
    )  # fmt: skip
    pores = graph.scalar("pores")

    def tinted(colour: Socket, amount: Socket, value: Socket, *tones: Socket) -> Socket:
        """Multiply by a tone that goes from the first to the second as noise rises."""
        tone = graph.mix(graph.stretch(value, 0.35, 0.66, (0, 1)), *tones)
        return graph.mix(amount, colour, tone, "MULTIPLY")

    # Blood in patches of centimetres, pigment at 5 to 15 mm, dark mouths of pores. Dark skin hides
    # its blood and is the more uneven in pigment.
    colour = graph.attribute("colour").outputs["Color"]
    flush = graph.noise(place, 48, detail=3, rough=0.5)
    blood = (1 - 0.5 * parameters.melanin) * HAEMOGLOBIN
    mottling = graph.scalar("mottling")
    colour = tinted(colour, mottling, flush, _tone(0.26 * blood), _tone(-0.38 * blood))
    tan = graph.noise(graph.combine("ADD", place, (3.1, 1.7, 0.4)), 190, detail=3, rough=0.65)
    pigment = (0.04 + 0.03 * parameters.melanin) * MELANIN
    colour = tinted(colour, 1.0, tan, _tone(-pigment), _tone(0.6 * pigment))
    specks = graph.noise(place, 620, detail=1)
    amount = graph.math("MULTIPLY", graph.stretch(specks, 0.58, 0.72, (0, 0.6)), pores)
    colour = graph.mix(amount, colour, graph.mix(1.0, colour, (0.82, 0.74, 0.70), "MULTIPLY"))

    dots = graph.stretch(graph.noise(place, 1100, detail=1), 0.50, 0.66, (0, 0.5))
    amount = graph.math("MULTIPLY", dots, graph.scalar("stubble"))
    colour = graph.mix(amount, colour, graph.mix(1.0, colour, (0.35, 0.36, 0.39), "MULTIPLY"))
    kept = graph.combine("SUBTRACT", (1.0, 1.0, 1.0), detail.outputs["Color"])
    colour = graph.mix(1.0, colour, kept, "MULTIPLY")

    # One bump node with summed heights: chained ones are slow.
    relief = graph.noise(place, 330, detail=4, rough=0.72)
    relief = graph.math("MULTIPLY", relief, graph.math("MULTIPLY", pores, 0.00095))
    # The net of furrows between pores, finer across the face than along it.
    net = graph.noise(graph.combine("MULTIPLY", place, (0.6, 0.6, 1.0)), 640, detail=2)
    net = graph.math("MULTIPLY", graph.math("ABSOLUTE", graph.math("SUBTRACT", net, 0.5)), 0.00065)
    along = graph.combine("MULTIPLY", place, (1.0, 0.3, 0.12))
    furrows = graph.math("MULTIPLY", graph.noise(along, 620, detail=2), graph.scalar("lips"))
    furrows = graph.math("MULTIPLY", furrows, 0.00055)
    height = graph.math("ADD", graph.math("ADD", relief, net), furrows)
    height = graph.math("ADD", height, detail.outputs["Alpha"])
    bump = graph.node("Bump", {"Height": height, "Strength": 1.0, "Distance": 1.0})

    # Highlights break: gloss follows the relief, and sebum lies over it in a tight second lobe.
    patchy = graph.stretch(graph.noise(place, 260, detail=3, rough=0.7), 0.3, 0.7, (-0.12, 0.12))
    roughness = graph.math("ADD", graph.scalar("roughness"), patchy, clamp=True)
    sebum = graph.math("MULTIPLY", graph.scalar("sebum"), graph.stretch(tan, 0.3, 0.7, (1.25, 0.6)))
    surface = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": roughness, "IOR": 1.42, "Normal": bump.outputs[0],
        "Subsurface Weight": 1.0, "Subsurface Anisotropy": 0.0, "Specular IOR Level": 0.5,
        "Subsurface Scale": _SSS_SCALE * (1 - _SSS_VEILED * parameters.melanin),
        "Coat Weight": sebum, "Coat Roughness": 0.27, "Coat Normal": bump.outputs[0],
    }, subsurface_method="RANDOM_WALK")  # fmt: skip
    surface.inputs["Subsurface Radius"].default_value = _SSS_RADIUS
    graph.output(surface.outputs[0])
    write_labels(graph, surface.outputs[0], colour, graph.scalar("part"))
    return material


def _tone(log_gain: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = (float(c) for c in np.exp(log_gain))
    return red, green, blue


def show_detail(picture: np.ndarray) -> None:
    """Make `picture` (H, W, 4), see `assets_procedural.skin_detail`, what the skin shows."""
    height, width = picture.shape[:2]
    image = bpy.data.images.get(_DETAIL)
    if image is None:
        image = bpy.data.images.new(_DETAIL, width, height, alpha=True, float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(np.ascontiguousarray(picture[::-1], np.float32).ravel())
    image.update()
