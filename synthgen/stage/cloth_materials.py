"""Cloth: pattern, weave, seams and small creases, over the folds that the mesh has.

Texture coordinates are metres along the cloth, u across and v upwards; creases are anchored to the
`canonical` position. The vertex attribute `seams` holds signed distances to three seams, in metres.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from synthgen.stage.nodes import Graph, Socket
from synthgen.stage.shading import colour_of

_TURN = 2 * np.pi
# Height of creases (m) and weight of the velvety rim of light, by weave; others as "jersey".
_CREASE = {"jersey": 0.0022, "poplin": 0.0028, "satin": 0.0024, "denim": 0.0024, "leather": 0.0026}
_SHEEN = {"fleece": 0.35, "pile": 0.6, "knit": 0.35, "cable": 0.35, "leather": 0.0, "satin": 0.05}


def cloth(graph: Graph, parameters: dict[str, Any]) -> tuple[Any, Any]:
    rest = graph.attribute("canonical").outputs["Vector"]
    texture = graph.node("SeparateXYZ", {0: graph.attribute("UVMap").outputs["Vector"]})
    u, v = texture.outputs["X"], texture.outputs["Y"]
    weave = parameters.get("weave", "jersey")

    colour: Socket = colour_of(parameters, (0.3, 0.3, 0.3))
    share = _patterned(graph, parameters.get("pattern", "plain"), u, v, rest)
    if share is not None:
        colour = graph.mix(share, colour, colour_of({"colour": parameters["accent"]}, (0.5,) * 3))
    colour = graph.mix(1.0, colour, _tone(graph, rest, weave), "MULTIPLY")

    relief, shade = _RELIEF.get(weave, _plain)(graph, u, v, rest)
    if shade is not None:
        grey = graph.node("CombineColor", {0: shade, 1: shade, 2: shade}).outputs[0]
        colour = graph.mix(1.0, colour, grey, "MULTIPLY")
    height = graph.math("ADD", relief, _creases(graph, rest, _CREASE.get(weave, 0.0018)))
    groove = _seams(graph, weave)
    height = graph.math("ADD", height, graph.math("MULTIPLY", groove, -0.0010))
    colour = graph.mix(graph.math("MULTIPLY", groove, 0.45), colour, (0.0, 0.0, 0.0))

    bump = graph.node("Bump", {"Height": height, "Distance": 1.0})
    shader = graph.node("BsdfPrincipled", {
        "Base Color": colour, "Roughness": parameters.get("roughness", 0.85),
        "Normal": bump.outputs[0], "Sheen Weight": _SHEEN.get(weave, 0.2), "Sheen Roughness": 0.5,
        "Specular IOR Level": 0.5 if weave in ("leather", "satin") else 0.2,
    }).outputs[0]  # fmt: skip
    return shader, colour


def _patterned(graph: Graph, pattern: str, u: Socket, v: Socket, rest: Socket) -> Socket | None:
    """Where the accent shows, in [0, 1]; None: nowhere."""

    def wave(value: Socket, period: float) -> Socket:
        return graph.math("SINE", graph.math("MULTIPLY", value, _TURN / period))

    if pattern == "stripes":
        return graph.stretch(wave(v, 0.034), 0.15, 0.25, (0, 1))
    if pattern == "breton":
        return graph.stretch(wave(v, 0.022), 0.55, 0.65, (0, 1))
    if pattern == "pinstripe":
        return graph.stretch(wave(u, 0.016), 0.97, 0.995, (0, 0.6))
    if pattern == "check":
        across = graph.stretch(wave(u, 0.042), 0.1, 0.25, (0, 0.5))
        along = graph.stretch(wave(v, 0.042), 0.1, 0.25, (0, 0.5))
        return graph.math("ADD", across, along)
    if pattern == "tartan":
        wide = graph.math("ADD", graph.stretch(wave(u, 0.056), 0.2, 0.3, (0, 0.45)),
                          graph.stretch(wave(v, 0.056), 0.2, 0.3, (0, 0.45)))  # fmt: skip
        line = graph.math("MAXIMUM", graph.stretch(wave(u, 0.028), 0.95, 0.98, (0, 0.7)),
                          graph.stretch(wave(v, 0.028), 0.95, 0.98, (0, 0.7)))  # fmt: skip
        return graph.math("MAXIMUM", wide, line)
    if pattern == "dots":
        place = graph.node("CombineXYZ", {0: u, 1: v}).outputs[0]
        cells = graph.node("TexVoronoi", {"Vector": place, "Scale": 62.0, "Randomness": 0.15})
        return graph.stretch(cells.outputs["Distance"], 0.24, 0.21, (0, 1))
    if pattern == "print":
        blot = graph.math("ABSOLUTE", graph.math("SUBTRACT", graph.noise(rest, 42, 3), 0.5))
        leaf = graph.stretch(blot, 0.035, 0.05, (1, 0))
        patch = graph.stretch(graph.noise(rest, 75, 1), 0.54, 0.58, (0, 1))
        return graph.math("MAXIMUM", leaf, patch)
    if pattern == "block":
        return graph.stretch(v, 0.575, 0.577, (0, 1))
    if pattern == "gradient":
        return graph.stretch(v, 0.45, 0.70, (1, 0))
    if pattern == "heather":
        return graph.stretch(graph.noise(rest, 1400, 2), 0.42, 0.62, (0, 0.55))
    if pattern == "zip":
        near = graph.math("ABSOLUTE", graph.math("SUBTRACT", u, 0.5))
        tooth = graph.stretch(wave(v, 0.0034), -0.3, 0.3, (0.35, 1))
        return graph.math("MULTIPLY", graph.stretch(near, 0.0024, 0.0032, (1, 0)), tooth)
    return None


def _tone(graph: Graph, rest: Socket, weave: str) -> Socket:
    """Uneven dye and wear, and the mottle of fibres."""
    worn = 0.72 if weave == "denim" else 0.90
    fade = graph.stretch(graph.noise(rest, 26, detail=4, rough=0.6), 0.3, 0.7, (0, 1))
    fibre = graph.stretch(graph.noise(rest, 900, detail=2), 0.3, 0.7, (0, 1))
    return graph.mix(
        1.0,
        graph.mix(fade, (worn,) * 3, (1.06,) * 3),
        graph.mix(fibre, (0.88,) * 3, (1.08,) * 3),
        "MULTIPLY",
    )


def _creases(graph: Graph, rest: Socket, height: float) -> Socket:
    """Soft dents, and finer folds a centimetre or two apart that come and go in patches."""
    soft = graph.math("MULTIPLY", graph.noise(rest, 17, detail=2, rough=0.45), 3.0 * height)
    noise = graph.noise(rest, 26, detail=1, rough=0.4)
    signed = graph.math("SUBTRACT", graph.math("MULTIPLY", noise, 2.0), 1.0)
    edge = graph.math("SUBTRACT", 1.0, graph.math("ABSOLUTE", signed))
    patch = graph.stretch(graph.noise(rest, 11, detail=1), 0.40, 0.65, (0.0, 1))
    sharp = graph.math("MULTIPLY", graph.math("POWER", edge, 3.0), patch)
    return graph.math("ADD", soft, graph.math("MULTIPLY", sharp, height))


def _seams(graph: Graph, weave: str) -> Socket:
    """1 in the groove of a seam to 0 beside it; woven cloth has a line of stitches along it.

    The third distance of `seams` is not drawn.
    """
    distance = graph.node("SeparateXYZ", {0: graph.attribute("seams").outputs["Vector"]})
    depth: Socket = 0.0
    for axis in ("X", "Y"):
        away = graph.math("ABSOLUTE", distance.outputs[axis])
        line = graph.stretch(away, 0.0008, 0.0028, (1, 0))
        if weave in ("denim", "poplin", "leather"):
            beside = graph.math("ABSOLUTE", graph.math("SUBTRACT", away, 0.007))
            line = graph.math("MAXIMUM", line, graph.stretch(beside, 0.0003, 0.0014, (0.5, 0)))
        depth = graph.math("MAXIMUM", depth, line)
    return depth


def _sine(graph: Graph, value: Socket, period: float) -> Socket:
    """|sine|: rounded ridges `period` metres apart."""
    return graph.math("ABSOLUTE", graph.math("SINE", graph.math("MULTIPLY", value, np.pi / period)))


def _plain(graph: Graph, u: Socket, v: Socket, rest: Socket) -> tuple[Socket, Socket | None]:
    return graph.math("MULTIPLY", graph.noise(rest, 1500, detail=1), 0.00030), None


def _pile(graph: Graph, u: Socket, v: Socket, rest: Socket) -> tuple[Socket, Socket | None]:
    tufts = graph.noise(rest, 420, detail=3, rough=0.7)
    return graph.math("MULTIPLY", tufts, 0.0022), graph.stretch(tufts, 0.3, 0.6, (0.7, 1.05))


def _knitted(wale: float, course: float, deep: float) -> Callable[..., tuple[Socket, Socket]]:
    """Ribs `wale` metres apart along u, rows of stitches `course` apart along v, `deep` high."""

    def relief(graph: Graph, u: Socket, v: Socket, rest: Socket) -> tuple[Socket, Socket]:
        rib, stitch = _sine(graph, u, wale), _sine(graph, v, course)
        height = graph.math("ADD", graph.math("MULTIPLY", rib, deep),
                            graph.math("MULTIPLY", stitch, 0.4 * deep))  # fmt: skip
        return height, graph.stretch(rib, 0.0, 0.6, (0.62, 1.0))

    return relief


def _cabled(graph: Graph, u: Socket, v: Socket, rest: Socket) -> tuple[Socket, Socket]:
    """Columns of twisted strands, 20 mm apart."""
    sway = graph.math("SINE", graph.math("MULTIPLY", v, _TURN / 0.052))
    strand = _sine(graph, graph.math("ADD", u, graph.math("MULTIPLY", sway, 0.0050)), 0.0200)
    return graph.math("MULTIPLY", strand, 0.0040), graph.stretch(strand, 0.0, 0.5, (0.62, 1.0))


def _twilled(period: float, deep: float, dark: float) -> Callable[..., tuple[Socket, Socket]]:
    """Diagonal lines `period` metres apart."""

    def relief(graph: Graph, u: Socket, v: Socket, rest: Socket) -> tuple[Socket, Socket]:
        line = _sine(graph, graph.math("ADD", u, v), period)
        return graph.math("MULTIPLY", line, deep), graph.stretch(line, 0.1, 0.9, (dark, 1.05))

    return relief


def _grained(graph: Graph, u: Socket, v: Socket, rest: Socket) -> tuple[Socket, Socket | None]:
    """The cells of leather."""
    cells = graph.node("TexVoronoi", {"Vector": rest, "Scale": 420.0}, feature="SMOOTH_F1")
    return graph.math("MULTIPLY", cells.outputs["Distance"], 0.0005), None


_RELIEF: dict[str, Callable[..., tuple[Socket, Socket | None]]] = {
    "pile": _pile,
    "knit": _knitted(0.0052, 0.0036, 0.0017),
    "rib": _knitted(0.0040, 0.0035, 0.0016),
    "cable": _cabled,
    "denim": _twilled(0.0021, 0.0003, 0.75),
    "twill": _twilled(0.0014, 0.0002, 0.85),
    "leather": _grained,
}
