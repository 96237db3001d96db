"""Where things are on the skin: part labels per quad, smooth fields per vertex, loops of the mesh.

Everything is computed once per model from the template's positions, the painted masks and the
topology, so it sticks to the skin under every identity, expression and pose. V vertices, F quads.
"""

from __future__ import annotations

from collections import defaultdict
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.vectors import arctan2, smoothstep

# An edge on the rear border of each eyelid margin, base.obj numbering: the skin turns inwards here
# and everything behind its loop lies in the socket.
_LID_REAR_EDGES = {"left": (7748, 7747), "right": (1056, 1055)}

_MOUTH_LINE = 0.6607  # height where the lips meet in the template, metres

# fmt: off
# Template curves, metres. The nose outlines its front view: (|x|, z) from nasion to columella.
_NOSE = np.array(
    [(0, 0.7305), (0.0055, 0.7295), (0.0070, 0.7220), (0.0095, 0.7125), (0.0125, 0.7040),
     (0.0155, 0.6985), (0.0180, 0.6930), (0.0185, 0.6880), (0.0172, 0.6838), (0.0120, 0.6812),
     (0.0055, 0.6790), (0, 0.6785)]
)
# Lower border of the jaw, then under the ear lobe to the nape: height z over depth y.
_JAW = np.array(
    [(-0.160, 0.610), (-0.140, 0.6135), (-0.130, 0.6175), (-0.118, 0.6220), (-0.105, 0.6285),
     (-0.090, 0.6380), (-0.078, 0.6500), (-0.070, 0.6640), (-0.064, 0.6790), (-0.050, 0.6820),
     (-0.034, 0.6830), (0.000, 0.6700), (0.060, 0.6600)]
)
# Hairline: height z over azimuth (degrees, 0 in front) about a vertical at this depth y.
_CROWN_DEPTH = -0.055
_HAIRLINE = np.array(
    [(0, 0.797), (25, 0.797), (42, 0.789), (52, 0.776), (60, 0.755), (66, 0.735), (70, 0.716),
     (77, 0.707), (80, 0.735), (94, 0.743), (107, 0.736), (112, 0.710), (120, 0.690),
     (140, 0.668), (180, 0.660)]
)
# Upper edge of a full beard on the cheek, up to the sideburn: height z over depth y.
_BEARD_TOP = np.array(
    [(-0.160, 0.680), (-0.140, 0.679), (-0.130, 0.672), (-0.115, 0.664), (-0.100, 0.664),
     (-0.090, 0.676), (-0.083, 0.695), (-0.078, 0.715), (-0.060, 0.715)]
)
# fmt: on


@lru_cache(maxsize=4)
def part_labels(model: HeadModel) -> np.ndarray:
    """(F,) uint8 `Part` ids of `model.faces["skin"]`.

    Neck and shoulders are NECK; lips are the vermilion; nostrils belong to the nose; the skin
    within the eye sockets and the scalp are SKIN.
    """
    quads = model.faces["skin"]
    field = {name: value[quads].mean(axis=1) for name, value in fields(model).items()}
    centre = model.template[quads].mean(axis=1)
    left = centre[:, 0] > 0
    label = np.full(len(quads), Part.SKIN, np.uint8)
    label[field["neck"] > 0.5] = Part.NECK
    label[field["nose"] > 0.5] = Part.NOSE
    label = _without_spikes(label, quads)
    ear = field["ears"] > 0.5
    label[ear & left] = Part.LEFT_EAR
    label[ear & ~left] = Part.RIGHT_EAR
    lip = field["lips"] > 0.5
    above = centre[:, 2] > _MOUTH_LINE
    label[lip & above] = Part.TOP_LIP
    label[lip & ~above] = Part.BOTTOM_LIP
    label[field["mouth_interior"] >= 0.5] = Part.MOUTH_INTERIOR
    label.setflags(write=False)
    return label


@lru_cache(maxsize=4)
def fields(model: HeadModel) -> dict[str, np.ndarray]:
    """Smooth fields on the skin, (V,) in [0, 1] each; 0 on eyes, teeth and other groups.

    lips, ears, mouth_interior, eye_socket (behind the lids), eyelids, under_eye, nose, cheeks,
    forehead, chin, t_zone (oily), beard (hair-bearing lower face), scalp (hair-bearing head), neck
    (with the shoulders).
    """
    socket = _behind(model, (lid_loop(model, "left"), lid_loop(model, "right")))
    inside = model.masks["inside-mouth"].astype(float)
    ears = model.masks["ears"].astype(float)
    # The rim of the mouth is in both masks; it counts as lip until it is mostly inside.
    lips = model.masks["lips"] * (1 - np.clip(2 * inside - 1, 0, 1))
    zones = _zones(model, ears, lips)
    outside = (1 - inside) * (1 - socket)
    field = {"lips": lips, "ears": ears, "mouth_interior": inside, "eye_socket": socket}
    field |= {name: outside * value for name, value in zones.items()}

    opposite = mirror(model)  # the painted masks are not quite symmetric
    skin = np.isin(np.arange(len(model.template)), model.groups["skin"])
    result = {
        name: (skin * (value + value[opposite]) / 2).clip(0, 1).astype(np.float32)
        for name, value in field.items()
    }
    for value in result.values():
        value.setflags(write=False)
    return result


def _zones(model: HeadModel, ears: np.ndarray, lips: np.ndarray) -> dict[str, np.ndarray]:
    """Fields from positions in the template alone."""
    x, y, z = np.abs(model.template[:, 0]), model.template[:, 1], model.template[:, 2]
    below_jaw = np.interp(y, *_JAW.T) - z
    shoulders = smoothstep(0.600, 0.590, z)
    neck = np.maximum(smoothstep(-0.003, 0.003, below_jaw), shoulders) * (1 - ears)
    nose = smoothstep(-0.0015, 0.0015, _inside_distance(_NOSE, x, z))
    nose *= smoothstep(-0.118, -0.126, y)

    azimuth = np.degrees(arctan2(x, _CROWN_DEPTH - y))
    above_hairline = z - np.interp(azimuth, *_HAIRLINE.T)
    scalp = smoothstep(-0.004, 0.006, above_hairline) * (1 - ears)
    forehead = smoothstep(0.750, 0.760, z) * (1 - scalp) * smoothstep(-0.095, -0.115, y)

    below_beard = np.interp(y, *_BEARD_TOP.T) - z
    beard = (
        smoothstep(-0.004, 0.006, below_beard)
        * smoothstep(-0.066, -0.074, y)
        * smoothstep(0.590, 0.606, z)
    )
    beard *= (1 - np.clip(1.6 * lips, 0, 1)) * (1 - ears) * (1 - nose)

    chin = _blob(model, (0.0, -0.148, 0.630), (0.021, 0.022, 0.017))
    ridge = nose * smoothstep(0.017, 0.008, x)
    return {
        "nose": nose,
        "neck": neck,
        "scalp": scalp,
        "forehead": forehead,
        "beard": beard,
        "chin": chin,
        "cheeks": _blob(model, (0.0430, -0.130, 0.6960), (0.028, 0.035, 0.025)),
        "eyelids": _blob(model, (0.0325, -0.139, 0.7305), (0.027, 0.030, 0.0150)),
        "under_eye": _blob(model, (0.0310, -0.141, 0.7165), (0.018, 0.025, 0.0075)),
        "t_zone": np.maximum.reduce([forehead * smoothstep(0.045, 0.020, x), ridge, 0.7 * chin]),
    }


def lid_loop(model: HeadModel, side: str) -> np.ndarray:
    """(28,) vertices of the rear border of the eyelid margin, where it touches the eyeball."""
    return edge_loop(model, *model.from_base(_LID_REAR_EDGES[side]))


@lru_cache(maxsize=4)
def mirror(model: HeadModel) -> np.ndarray:
    """(V,) each skin vertex's counterpart on the other side of the template; others map to self."""
    skin = model.groups["skin"]
    _, nearest = KDTree(model.template[skin]).query(model.template[skin] * [-1, 1, 1])
    opposite = np.arange(len(model.template))
    opposite[skin] = skin[nearest]
    return opposite


def edge_loop(model: HeadModel, first: int, second: int) -> np.ndarray:
    """The closed loop of vertices that continues straight from the edge `first`, `second`.

    Raises:
        ValueError: the loop ends at a pole or a border of the skin.
    """
    neighbours, beside = _adjacency(model)
    loop = [int(first), int(second)]
    while True:
        previous, current = loop[-2:]
        corners = beside[frozenset((previous, current))]
        ahead = neighbours[current] - corners
        if len(neighbours[current]) != 4 or len(ahead) != 1:
            raise ValueError(f"no closed edge loop runs through vertices {first} and {second}")
        (following,) = ahead
        if following == loop[0]:
            return np.array(loop)
        loop.append(following)


@lru_cache(maxsize=4)
def _adjacency(model: HeadModel) -> tuple[dict[int, set[int]], dict[frozenset[int], set[int]]]:
    """Neighbours of each skin vertex, and the corners of the quads beside each edge."""
    neighbours: dict[int, set[int]] = defaultdict(set)
    beside: dict[frozenset[int], set[int]] = defaultdict(set)
    for quad in model.faces["skin"].tolist():
        for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
            neighbours[a].add(b)
            neighbours[b].add(a)
            beside[frozenset((a, b))].update(quad)
    return neighbours, beside


def _behind(model: HeadModel, loops: tuple[np.ndarray, ...]) -> np.ndarray:
    """1 at vertices cut off by the loops on the side that holds fewer vertices, else 0: (V,)."""
    neighbours, _ = _adjacency(model)
    walls = {int(v) for loop in loops for v in loop}
    result = np.zeros(len(model.template))
    for loop in loops:
        for start in {n for v in loop for n in neighbours[int(v)]} - walls:
            reached, frontier = {start}, [start]
            while frontier:
                fresh = neighbours[frontier.pop()] - walls - reached
                reached |= fresh
                frontier.extend(fresh)
            if len(reached) < len(neighbours) // 2:
                result[list(reached)] = 1
    return result


def _without_spikes(label: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Quads that differ from three of their four neighbours take the neighbours' label."""
    edges = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1), axis=-1)
    _, edge = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    total = np.bincount(edge, weights=np.repeat(label.astype(float), 4))
    count = np.bincount(edge)
    edge = edge.reshape(quads.shape)
    across = np.where(count[edge] == 2, total[edge] - label[:, None], label[:, None])
    across.sort(axis=1)
    agreed = across[:, 1] == across[:, 2]
    three = agreed & ((across[:, 0] == across[:, 1]) | (across[:, 3] == across[:, 1]))
    return np.where(three, across[:, 1], label).astype(np.uint8)


def _blob(model: HeadModel, centre: tuple, radii: tuple) -> np.ndarray:
    """A soft ellipsoid on both sides of the face: 1 inside, 0 from the radii outwards."""
    mirrored = np.abs(model.template[:, 0])
    position = np.stack([mirrored, model.template[:, 1], model.template[:, 2]], axis=1)
    return smoothstep(1.0, 0.35, np.linalg.norm((position - centre) / radii, axis=1))


def _inside_distance(outline: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Signed distance to a polyline closed along u = 0: positive within."""
    points = np.stack([u, v], axis=1)[:, None]
    start, step = outline[:-1], np.diff(outline, axis=0)
    along = ((points - start) * step).sum(-1) / (step**2).sum(-1)
    nearest = start + np.clip(along, 0, 1)[..., None] * step
    distance = np.linalg.norm(points - nearest, axis=-1).min(axis=1)
    width = np.interp(v, *outline[::-1, ::-1].T)
    within = (u < width) & (v > outline[-1, 1]) & (v < outline[0, 1])
    return np.where(within, distance, -distance)
