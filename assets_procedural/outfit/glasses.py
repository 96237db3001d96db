"""Glasses fitted to a face: they rest on the bridge of the nose and on the ears."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from assets_procedural.body.head import Identity
from assets_procedural.body.piece import MeshPiece, rigid
from assets_procedural.body.regions import mirror
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import ellipsoid, joined, rounded, sweep, tube_faces
from assets_procedural.mesh.vectors import way_along
from assets_procedural.person import Glasses

_OUTLINE = 96
# Vertices of MakeHuman's base mesh: the narrowest point of the bridge, and the left ear's root.
_BRIDGE = (132, 133, 134)
_EAR_ROOT = (12322, 12321, 12339)
_AVERAGE_HALF_WIDTH = 0.0655


@dataclass(frozen=True)
class _Shape:
    """Lens outline in millimetres: half width and height, squareness, `drop` of the outer half;
    `centre` from the midline; heights of the bridge and of the hinge over the lens's centre;
    `lift` of the outer upper corner, `taper` of the lower half. `rim` is what holds the lens: full,
    brow (acetate above, wire below) or none; `heavy` scales an acetate rim."""

    half_width: float
    half_height: float
    power: float
    drop: float
    centre: float
    bridge: float
    hinge: float
    bars: int = 1
    lift: float = 0.0
    taper: float = 0.0
    rim: str = "full"
    heavy: float = 1.0


SHAPES = {
    "round": _Shape(22.5, 22.0, 2.1, 0.0, 33.0, 6.0, 7.0),
    "oval": _Shape(25.0, 17.5, 2.2, 0.0, 34.0, 5.0, 6.0),
    "rectangle": _Shape(26.0, 17.0, 4.5, 1.0, 34.5, 7.0, 10.0),
    "aviator": _Shape(27.5, 23.5, 2.5, 6.0, 35.5, 5.0, 13.0, bars=2),
    "wayfarer": _Shape(25.5, 20.0, 3.4, 0.0, 34.5, 9.0, 13.0, lift=2.5, taper=0.14, heavy=1.35),
    "cat_eye": _Shape(26.0, 19.0, 2.7, 0.0, 34.5, 7.0, 14.0, lift=7.0, taper=0.12, heavy=1.1),
    "browline": _Shape(25.5, 19.5, 2.9, 0.0, 34.5, 8.0, 13.0, lift=1.5, taper=0.1, rim="brow"),
    "rimless": _Shape(25.5, 17.0, 3.2, 0.5, 34.5, 5.0, 7.0, rim="none"),
    "oversized": _Shape(29.0, 25.5, 2.7, 1.5, 37.0, 10.0, 14.0, lift=1.0, taper=0.05, heavy=1.2),
    "hexagon": _Shape(24.0, 21.5, 2.9, 0.0, 33.5, 7.0, 9.0, taper=0.16),
}
# From this tint on a lens is a sunglass lens.
_SHADED = 0.25


def glasses(wearing: Glasses, identity: Identity) -> list[MeshPiece]:
    """The frame (material "metal" or "plastic", one piece of each that it has) and two lenses.

    A lens is "lens" or, if strongly tinted, "shade"; lenses are hidden from the labels and come
    last. `parameters["tint"]` of a lens is the share of light that it absorbs; its `uv` run from
    0 to 1 across and up the lens.

    Raises:
        KeyError: an unknown shape.
    """
    shape = SHAPES[wearing.shape]
    fit = _Fit(identity, shape)
    metal = wearing.metal or shape.rim != "full"
    sides = (1.0, -1.0)
    wire = [part for side in sides for part in _nose_pad(fit, shape, side, metal)]
    wire += _bridges(fit, shape, metal)
    temples = [_temple(fit, shape, identity, side, wearing.metal) for side in sides]
    bold = []
    if shape.rim == "brow":
        wire += [_rim(fit, shape, side, True) for side in sides]
        bold = [_brow_bar(fit, shape, side) for side in sides] + temples
    elif metal:
        thin = 0.35 if shape.rim == "none" else 1.0
        wire += [_rim(fit, shape, side, True, thin) for side in sides] + temples
    else:
        bold = [_rim(fit, shape, side, False, shape.heavy) for side in sides] + temples + wire
        wire = []
    silver = wearing.colour if wearing.metal else (0.75, 0.75, 0.77)
    pieces = []
    for name, parts, kind, look in (
        ("glasses_frame", bold, "plastic", {
            "colour": wearing.colour, "roughness": 0.25, "tortoise": wearing.tortoise}),
        ("glasses_wire", wire, "metal", {"colour": silver, "roughness": 0.18}),
    ):  # fmt: skip
        if parts:
            points, faces = joined(parts)
            pieces.append(MeshPiece(name, Part.GLASSES, faces, kind, rigid("head", points), look))
    shaded = wearing.tint >= _SHADED
    lens = {"tint": wearing.tint, "ior": 1.5}
    if shaded:
        lens |= {"lens": wearing.lens, "gradient": wearing.gradient, "mirror": wearing.mirror}
    for name, side in (("left", 1.0), ("right", -1.0)):
        points, faces, uv = _lens(fit, shape, side)
        pieces.append(
            MeshPiece(
                f"lens_{name}",
                Part.GLASSES,
                faces,
                "shade" if shaded else "lens",
                rigid("head", points),
                lens,
                uv[faces],
                hidden_from_labels=True,
            )
        )
    return pieces


class _Fit:
    """Maps the flat front of the frame, in millimetres, onto a face."""

    def __init__(self, identity: Identity, shape: _Shape):
        model, rest = identity.model, identity.rest
        left, right = identity.joints[4], identity.joints[5]
        self.middle = (left + right) / 2
        skin = rest[model.groups["skin"]]
        level = np.abs(skin[:, 2] - self.middle[2]) < 0.015
        temple = level & (skin[:, 1] > self.middle[1] + 0.012)
        temple &= skin[:, 1] < self.middle[1] + 0.035
        self.half_width = float(np.abs(skin[temple, 0]).max())
        self.scale = 1e-3 * float(np.clip(self.half_width / _AVERAGE_HALF_WIDTH, 0.88, 1.2))
        bridge = rest[model.from_base(_BRIDGE)].mean(axis=0)
        eyes = rest[np.concatenate([model.groups["eye_left"], model.groups["eye_right"]])]
        # Clear of the lashes, and of the bridge.
        self.front = min(eyes[:, 1].min() - 0.0115, bridge[1] - 0.0045)
        # Step forward until no brow, nose or cheek pokes through.
        near = np.abs(skin[:, 0]) < self.scale * (shape.centre + shape.half_width)
        near &= skin[:, 1] < self.middle[1]
        inside = _within(skin[near], self, shape)
        if len(inside):
            self.front -= max(0.0, float(inside.max()))

    def place(self, x: np.ndarray, z: np.ndarray, forward: np.ndarray | float = 0.0) -> np.ndarray:
        """Millimetres on the front (x from the midline, z from the pupils) → rest (N, 3)."""
        x, z = np.broadcast_arrays(np.asarray(x, float), np.asarray(z, float))
        # Wrapped around the face, and tilted so that the lower rims come closer to the cheeks.
        back = x**2 / 620.0 - 0.11 * z - forward
        return np.stack(
            [
                self.middle[0] + self.scale * x,
                self.front + self.scale * back,
                self.middle[2] + self.scale * (z - 2.0),
            ],
            axis=-1,
        )


def _within(skin: np.ndarray, fit: _Fit, shape: _Shape) -> np.ndarray:
    """How far (m) skin points inside either rim stand out in front of the lens."""
    x = np.abs(skin[:, 0] - fit.middle[0]) / fit.scale
    z = (skin[:, 2] - fit.middle[2]) / fit.scale + 2.0
    inside = (np.abs(x - shape.centre) / (shape.half_width + 2)) ** 2 + (
        np.abs(z) / (shape.half_height + 2)
    ) ** 2 < 1
    surface = fit.place(x, z)[:, 1]
    return (surface - skin[:, 1] + 0.002)[inside]


def _outline(shape: _Shape, side: float) -> tuple[np.ndarray, np.ndarray]:
    """The lens's outline: x from the midline and z, millimetres."""
    angle = np.arange(_OUTLINE) * 2 * np.pi / _OUTLINE
    cos, sin = np.cos(angle), np.sin(angle)
    x = shape.half_width * np.sign(cos) * np.abs(cos) ** (2 / shape.power)
    z = shape.half_height * np.sign(sin) * np.abs(sin) ** (2 / shape.power)
    # Narrower below on the nose's side; aviators sag outwards.
    share = x / shape.half_width
    low = np.clip(-z / shape.half_height, 0, 1)
    x = x + low * shape.half_width * 0.10 * np.clip(-share, 0, 1) * 1.2
    z = z - shape.drop * 0.5 * (share + 0.4) * low
    x = x * (1 - shape.taper * low)
    z = z + shape.lift * np.clip(share, 0, 1) ** 2 * np.clip(z / shape.half_height, 0, 1)
    return side * (shape.centre + x), z


def _rim(
    fit: _Fit, shape: _Shape, side: float, metal: bool, size: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    x, z = _outline(shape, side)
    path = fit.place(x, z)
    outward = path - path.mean(axis=0)
    profile = rounded(1.3e-3, 1.7e-3, 2.6) if metal else rounded(3.0e-3, 3.6e-3, 4.0)
    # Acetate is stronger above, where the hinges are.
    upper = np.clip(z / shape.half_height, -1, 1)[:, None, None]
    profile = profile * size * (1 + (0.0 if metal else 0.18) * upper)
    return sweep(path, outward, profile, closed=True)


def _brow_bar(fit: _Fit, shape: _Shape, side: float) -> tuple[np.ndarray, np.ndarray]:
    """The acetate upper half of a browline frame."""
    x, z = _outline(shape, side)
    above = np.flatnonzero(z > 0.12 * shape.half_height)
    above = above[np.argsort(side * x[above])]
    path = fit.place(x[above], z[above], 0.3)
    along = np.linspace(0, 1, len(above))[:, None, None]
    profile = rounded(5.2e-3, 3.6e-3, 3.6) * (0.55 + 0.6 * np.sin(np.pi * (0.12 + 0.76 * along)))
    return sweep(path, path - path.mean(axis=0) + [0, 0, 2e-3], profile, closed=False)


def _bridges(fit: _Fit, shape: _Shape, metal: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    bars = []
    for bar in range(shape.bars):
        height = shape.bridge + (9.5 if bar else 0.0)
        x, z = _outline(shape, 1.0)
        inner = np.flatnonzero(x < shape.centre)
        start = inner[np.argmin(np.abs(z[inner] - height))]
        reach = float(x[start]) + 0.4
        across = np.linspace(-reach, reach, 21)
        arch = (1 - (across / reach) ** 2) * (2.6 if bar == 0 else 0.6)
        path = fit.place(across, z[start] + arch, (1 - (across / reach) ** 2) * 1.2)
        profile = rounded(1.3e-3, 1.5e-3, 2.2) if metal else rounded(3.6e-3, 3.2e-3, 3.0)
        bars.append(sweep(path, np.array([0.0, 0.0, 1.0]), profile, closed=False))
    return bars


def _nose_pad(
    fit: _Fit, shape: _Shape, side: float, metal: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    x, z = _outline(shape, side)
    inner = np.flatnonzero(side * x < shape.centre)
    start = inner[np.argmin(np.abs(z[inner] + 1.0))]
    rim = fit.place(x[start], z[start])
    seat = rim + np.array([-side * 0.8e-3, 4.2e-3, -2.0e-3])
    lean = np.array([side * 0.32, -0.1, 1.0])
    lean /= np.linalg.norm(lean)
    flat = np.cross(lean, [0.0, 1.0, 0.0])
    flat /= np.linalg.norm(flat)
    flat = flat + np.array([0.0, 0.55, 0.0]) * side * np.sign(flat[0])
    flat /= np.linalg.norm(flat)
    third = np.cross(lean, flat)
    axes = np.stack([lean * 5.2e-3, third * 2.6e-3, flat * 0.9e-3])
    parts = [ellipsoid(seat, axes)]
    if metal:
        bend = rim + np.array([-side * 1.0e-3, 3.2e-3, 2.5e-3])
        curve = CubicSpline([0, 0.55, 1], np.stack([rim, bend, seat]))
        wire = curve(np.linspace(0, 1, 9))
        parts.append(sweep(wire, np.array([0.0, 0.0, 1.0]), rounded(0.8e-3, 0.8e-3, 2, 8), False))
    return parts


def _temple(
    fit: _Fit, shape: _Shape, identity: Identity, side: float, metal: bool
) -> tuple[np.ndarray, np.ndarray]:
    model, rest = identity.model, identity.rest
    ear = _mirrored(identity, _EAR_ROOT, side)
    x, z = _outline(shape, side)
    outer = np.flatnonzero(side * x > shape.centre)
    start = outer[np.argmin(np.abs(z[outer] - shape.hinge))]
    rim = fit.place(x[start], z[start])
    end_piece = np.array(
        [side * max(abs(rim[0]) + 1.5e-3, fit.half_width + 2.5e-3), rim[1] + 4.0e-3, rim[2]]
    )
    over = ear + np.array([side * 0.5e-3, 0.002, 2.2e-3])
    behind = over + np.array([-side * 3.5e-3, 0.016, -0.011])
    tip = over + np.array([-side * 5.5e-3, 0.021, -0.028])
    corner = end_piece + np.array([0, 0.008, 0])
    stops = np.stack([rim, end_piece, corner, over, behind, tip])
    length = way_along(stops)
    path = PchipInterpolator(length, stops)(np.linspace(0, length[-1], 60))

    # Keep clear of the skin on the way to the ear.
    skin = model.groups["skin"]
    skin = skin[model.masks["ears"][skin] < 0.3]
    points = rest[skin]
    points = points[points[:, 0] * side > 0]
    along = (path[:, 1] > rim[1]) & (path[:, 1] < over[1] + 0.004)
    for k in np.flatnonzero(along):
        near = (np.abs(points[:, 1:] - path[k, 1:]) < [0.007, 0.007]).all(axis=1)
        if near.any():
            least = np.abs(points[near, 0]).max() + 1.2e-3
            path[k, 0] = side * max(abs(path[k, 0]), least)
    for _ in range(6):
        path[2:-2, 0] = 0.5 * path[2:-2, 0] + 0.25 * (path[1:-3, 0] + path[3:-1, 0])
    thin = rounded(1.4e-3, 1.2e-3, 2.4) if metal else rounded(1.9e-3, 4.6e-3, 3.5)
    thick = rounded(2.2e-3, 3.4e-3, 2.6) if metal else rounded(2.2e-3, 3.8e-3, 3.0)
    share = np.clip((np.linspace(0, 1, 60) - 0.6) / 0.1, 0, 1)[:, None, None]
    profile = thin * (1 - share) + thick * share
    return sweep(path, np.array([side, 0.0, 0.0]) + 0 * path, profile, closed=False)


def _lens(fit: _Fit, shape: _Shape, side: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, z = _outline(shape, side)
    share = np.linspace(0.02, 0.99, 10)[:, None]
    middle = side * shape.centre
    x, z = middle + share * (x - middle), share * z
    # A slight bulge of its own on top of the frame's wrap.
    points = fit.place(x, z, 1.4 * (1 - share**2) + 0 * x)
    index = np.arange(10 * _OUTLINE).reshape(10, _OUTLINE)
    faces = tube_faces(index, flipped=True)
    uv = np.stack([(x - middle) / shape.half_width, z / shape.half_height], axis=-1) * 0.45 + 0.5
    return points.reshape(-1, 3), faces if side > 0 else faces[:, ::-1], uv.reshape(-1, 2)


def _mirrored(identity: Identity, ids: tuple[int, ...], side: float) -> np.ndarray:
    """Mean rest position (3,) of base-mesh vertices of the left half, or of their mirror images."""
    index = identity.model.from_base(ids)
    if side < 0:
        index = mirror(identity.model)[index]
    return identity.rest[index].mean(axis=0)
