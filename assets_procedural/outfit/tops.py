"""What a person wears on the trunk: a top, and perhaps an open jacket over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import MeshPiece
from assets_procedural.mesh.sweep import ellipsoid, joined
from assets_procedural.mesh.vectors import smoothstep, unit
from assets_procedural.outfit.cloth import average_person
from assets_procedural.outfit.collars import collar
from assets_procedural.outfit.fabrics import FABRICS, cloth_look
from assets_procedural.outfit.garment import Garment, Patchwork
from assets_procedural.outfit.necklines import JACKETS, NECKLINES, Outline
from assets_procedural.person import Jacket, Person, Top

# Skin farther than this inside the garment (metres) can never be seen.
_HIDDEN_MARGIN = 0.022
# How high a jacket lies over the skin beyond the slack and thickness of the top, whose folds it
# presses flat (metres).
_UNDER_JACKET = 0.008


def wardrobe(person: Person, identity: Identity) -> list[MeshPiece]:
    """The top and the jacket that a person wears: bodies, bands, collars, plackets and buttons.

    Material "cloth" ("plastic" for buttons); `parameters` hold colour and accent (linear
    Rec.709), pattern, weave and roughness. `uv` are metres along the cloth: u across and v upwards,
    or along and across the band.

    Raises:
        KeyError: an unknown neckline, fabric, collar or jacket.
    """
    top, jacket = person.top, person.jacket
    fabric = FABRICS[top.fabric]
    rng = np.random.default_rng(top.seed)
    calm = None if jacket is None else _pressed_by(JACKETS[jacket.style])
    garment = Garment(identity, NECKLINES[top.neckline], fabric, rng, calm=calm)
    pieces = _dressed(garment, identity, top)
    if jacket is not None:
        pieces += _jacket(jacket, identity, fabric.slack + fabric.thickness)
    return pieces


def _pressed_by(jacket: Outline) -> Callable[[np.ndarray], np.ndarray]:
    """The share of a top's folds that an open jacket leaves, as `Garment` wants it."""

    def calm(average: np.ndarray) -> np.ndarray:
        return 0.15 + 0.85 * smoothstep(0.02, -0.03, jacket.field(average))

    return calm


def covered_skin(person: Person, identity: Identity) -> np.ndarray:
    """(F,) mask over `model.faces["skin"]`: quads wholly under the top, safe to leave out."""
    model = identity.model
    field = NECKLINES[person.top.neckline].field(average_person(model))
    return (field[model.faces["skin"]] > _HIDDEN_MARGIN).all(axis=1)


def _look(worn: Top | Jacket, **changes: object) -> dict:
    fabric = FABRICS[worn.fabric]
    return {**cloth_look(worn, fabric.weave, fabric.roughness), **changes}


def _dressed(garment: Garment, identity: Identity, top: Top) -> list[MeshPiece]:
    knitted = FABRICS[top.fabric].weave in ("fleece", "pile", "knit", "cable", "rib", "jersey")
    trim = _look(top, pattern="plain", weave="rib" if knitted else FABRICS[top.fabric].weave)
    if top.pattern == "ringer":
        trim["colour"] = top.accent
    whole = _look(top, pattern="plain" if top.pattern == "ringer" else top.pattern)
    pieces = garment.body(whole, trim)
    if garment.outline.collar:
        folded = garment.outline.collar in ("shirt", "hood")
        soft = trim if not folded else _look(top, pattern=_quiet(top.pattern))
        pieces += collar(garment, identity, soft, top.seed + 1)
    if top.closure != "none":
        pieces += _placket(garment, top)
    return pieces


def _quiet(pattern: str) -> str:
    """Collars repeat woven patterns but no prints."""
    return pattern if pattern in ("stripes", "pinstripe", "check") else "plain"


def _placket(garment: Garment, top: Top) -> list[MeshPiece]:
    """A strip down the front's middle with buttons, or a zip's tape."""
    average = garment.average
    zipped = top.closure == "zip"
    half = 0.009 if zipped else 0.0155
    shift = 0.0 if zipped else 0.004
    vee = garment.outline.vee or garment.outline.front
    strip = np.minimum(half - np.abs(average[:, 0] - shift), vee + 0.012 - average[:, 2])
    strip = np.where(average[:, 1] < -0.03, strip, -0.05)
    points, weights, places, faces = garment.panel(strip, garment.fabric.thickness + 0.0004)
    patches = Patchwork()
    patches.add(points, weights, places[:, [0, 2]] + 0.5)
    look = _look(top, pattern=_quiet(top.pattern))
    if zipped:
        look = {**look, "pattern": "zip", "accent": (0.35, 0.35, 0.36)}
    pieces = [patches.piece("placket", faces, look)]
    if not zipped:
        heights = np.arange(
            vee - 0.004, 0.33, -0.075 if garment.outline.collar == "shirt" else -0.028
        )
        heights = heights[: 8 if garment.outline.collar == "shirt" else 3]
        pieces.append(_buttons(garment, shift, heights, top.accent))
    return pieces


def _buttons(
    garment: Garment, across: float, heights: np.ndarray, colour: tuple[float, float, float]
) -> MeshPiece:
    """Buttons (half width 5.5 mm) on the placket at places of the average person."""
    parts, weights = [], []
    front = np.flatnonzero(garment.average[:, 1] < -0.03)
    for height in heights:
        gap = garment.average[front][:, [0, 2]] - [across, height]
        at = front[np.argmin((gap**2).sum(axis=1))]
        normal = garment.normals[at]
        centre = garment.cloth[at] + (garment.fabric.thickness + 0.0012) * normal
        side = unit(np.cross([0.0, 0.0, 1.0], normal))
        axes = np.stack([side * 0.0055, np.cross(normal, side) * 0.0055, normal * 0.0014])
        points, faces = ellipsoid(centre, axes)
        parts.append((points, faces))
        weights.append(np.repeat(garment.weights[at][None], len(points), axis=0))
    points, faces = joined(parts)
    patches = Patchwork()
    patches.add(points, np.concatenate(weights), points[:, [0, 2]])
    piece = patches.piece("buttons", faces, {"colour": colour, "roughness": 0.3})
    return replace(piece, material="plastic", uv=None, vertex={})


def _jacket(jacket: Jacket, identity: Identity, beneath: float) -> list[MeshPiece]:
    outline, fabric = JACKETS[jacket.style], FABRICS[jacket.fabric]
    rng = np.random.default_rng(jacket.seed)
    garment = Garment(identity, outline, fabric, rng, under=_UNDER_JACKET + beneath)
    look = _look(jacket)
    rib = _look(jacket, weave="rib", pattern="plain")
    pieces = garment.body(look, rib)
    plain = _look(jacket, pattern=_quiet(jacket.pattern))
    if outline.collar == "lapels":
        pieces.append(_lapels(garment, plain))
    elif outline.collar:
        ribbed = jacket.style == "bomber"
        pieces += collar(garment, identity, rib if ribbed else plain, jacket.seed + 1)
    if jacket.style in ("trucker", "biker", "bomber"):
        pieces.append(_edging(garment, plain, jacket.style))
    return [replace(piece, name=f"jacket_{piece.name}") for piece in pieces]


def _lapels(garment: Garment, look: dict) -> MeshPiece:
    """Collar and lapels of a blazer, turned back on the cloth along the opening."""
    p = garment.average
    height, field = p[:, 2], garment.outline.field(p)
    front = p[:, 1] < -0.02
    # Wide at the notch and tapering to the button; above the notch the collar.
    lapel = np.interp(height, [0.352, 0.40, 0.448, 0.462], [0.0, 0.030, 0.060, 0.066])
    notch = smoothstep(0.462, 0.472, height)
    folded = np.interp(height, [0.47, 0.50, 0.56], [0.043, 0.046, 0.036])
    width = np.where(front, lapel * (1 - notch) + folded * notch, 0.036)
    # The notch itself, a bite into the outer edge.
    bite = np.exp(-(((height - 0.469) / 0.005) ** 2)) * front
    width = width - 0.016 * bite
    roll = 0.0035 * np.exp(-field / 0.006) + 0.0010
    points, weights, places, faces = garment.panel(width - field, 0.0022, roll)
    patches = Patchwork()
    patches.add(points, weights, places[:, [0, 2]] + 0.5)
    return patches.piece("lapels", faces, look)


def _edging(garment: Garment, look: dict, style: str) -> MeshPiece:
    """The stitched front edges of a jacket, or the tape of its zip."""
    p = garment.average
    field = garment.outline.field(p)
    width = 0.014 if style != "trucker" else 0.034
    strip = np.where((p[:, 1] < -0.03) & (garment.outline.around(p) > 0.004), width - field, -0.05)
    points, weights, places, faces = garment.panel(strip, garment.fabric.thickness)
    patches = Patchwork()
    patches.add(points, weights, places[:, [0, 2]] + 0.5)
    return patches.piece("edging", faces, look)
