"""Scarves around the neck, and headscarves that cover hair, ears and neck."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter1d, maximum_filter
from scipy.spatial import KDTree

from assets_procedural.body.head import Identity, vertex_normals
from assets_procedural.body.piece import MeshPiece, skinned
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.sweep import joined, shell, tube_faces
from assets_procedural.mesh.vectors import arctan2, smoothstep
from assets_procedural.outfit.cloth import Sheet, border_loops, ring_strip
from assets_procedural.outfit.fabrics import FABRICS, cloth_look
from assets_procedural.outfit.garment import bone_weights, no_seams
from assets_procedural.person import Hat, Scarf

_AROUND = 96


def _neck_reach(
    identity: Identity, heights: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far the skin reaches from the neck's axis: (rows, around), and that axis (rows, 3)."""
    skin = identity.model.groups["skin"]
    skin = skin[identity.model.masks["inside-mouth"][skin] < 0.3]
    points = identity.rest[skin]
    low, high = identity.joints[0], identity.joints[3]
    slope = (high[1] - low[1]) / (high[2] - low[2])
    axis = np.stack(
        [0 * heights, low[1] + slope * np.clip(heights - low[2], -0.02, 0.14), heights], axis=1
    )
    depth = low[1] + slope * np.clip(points[:, 2] - low[2], -0.02, 0.14)
    turn = arctan2(points[:, 0], -(points[:, 1] - depth))
    reach = np.hypot(points[:, 0], points[:, 1] - depth)
    row = np.searchsorted(-(heights[1:] + heights[:-1]) / 2, -points[:, 2])
    inside = (points[:, 2] < heights[0] + 0.01) & (points[:, 2] > heights[-1] - 0.01)
    step = angles[1] - angles[0]
    column = np.round((turn - angles[0]) / step).astype(int) % len(angles)
    table = np.zeros((len(heights), len(angles)))
    np.maximum.at(table, (row[inside], column[inside]), reach[inside])
    return _filled(table), axis


def _filled(table: np.ndarray) -> np.ndarray:
    """Empty cells take their neighbours' largest value; the columns go around."""
    for _ in range(12):
        if (table > 0).all():
            break
        grown = maximum_filter(np.pad(table, ((1, 1), (0, 0)), "edge"), 3, mode="wrap")[1:-1]
        table = np.where(table > 0, table, grown)
    return table


def _smoothed(table: np.ndarray, rows: float, columns: float) -> np.ndarray:
    """Gaussian of so many cells; the columns go around."""
    down = gaussian_filter1d(table, rows, axis=0, mode="nearest")
    return gaussian_filter1d(down, columns, axis=1, mode="wrap")


def scarf(wearing: Scarf, identity: Identity) -> list[MeshPiece]:
    """Two turns around the neck and an end that hangs down in front; "cloth", Part.CLOTHING."""
    rng = np.random.default_rng(wearing.seed)
    angles = (np.arange(_AROUND) + 0.5) * 2 * np.pi / _AROUND - np.pi
    thick = wearing.thickness_mm * 1e-3
    base = identity.joints[0, 2]  # the root of the neck
    parts, textures = [], []
    for turn, (lift, gap, tilt) in enumerate(((-0.006, 0.008, 0.010), (0.016, 0.004, -0.009))):
        phase = rng.uniform(0, 2 * np.pi)
        # Lower in front, where the neck's pit is, and a little askew.
        middle = base + lift - 0.020 * np.cos(angles) + tilt * np.sin(angles + phase)
        heights = np.linspace(middle.max() + 0.5 * thick, middle.min() - 0.5 * thick, 24)
        table, axis = _neck_reach(identity, heights, angles)
        rows = np.abs(heights[:, None] - middle[None]) < 0.42 * thick
        inner = np.where(rows, table, 0).max(axis=0)
        inner = gaussian_filter1d(np.minimum(inner, 0.135), 2.5, mode="wrap")
        section = np.arange(28) * 2 * np.pi / 28
        size = thick * (
            1 + 0.12 * np.sin(2 * angles + phase) + 0.08 * np.sin(5 * angles + 2 * phase)
        )
        # Pleats run along the roll and twist around it.
        twist = (3 if turn else -2) * angles[:, None] + 5 * section + phase
        pleats = (
            1 + 0.10 * np.sin(twist) + 0.07 * np.sin(1.7 * twist + 2 * np.sin(3 * angles)[:, None])
        )
        wide = 0.36 * size[:, None] * pleats * np.cos(section)
        tall = 0.62 * size[:, None] * pleats * np.sin(section)
        radius = inner[:, None] + gap + 0.36 * size[:, None] + wide
        depth = np.interp(middle, heights[::-1], axis[::-1, 1])
        points = np.stack(
            [radius * np.sin(angles)[:, None], depth[:, None] - radius * np.cos(angles)[:, None],
             middle[:, None] + tall - 0.25 * wide], axis=-1,
        )  # fmt: skip
        index = np.arange(points[..., 0].size).reshape(_AROUND, 28)
        parts.append((points.reshape(-1, 3), tube_faces(np.concatenate([index, index[:1]]), True)))
        uv = np.stack(np.broadcast_arrays(0.045 * section[None], 0.10 * angles[:, None]), axis=-1)
        textures.append(uv.reshape(-1, 2))
    parts.append(_tail(parts[0][0].reshape(_AROUND, 28, 3), identity, rng))
    textures.append(parts[-1][0][:, [0, 2]])
    points, faces = joined(parts)
    uv = np.concatenate(textures)[faces]
    look = cloth_look(wearing, FABRICS[wearing.fabric].weave, 0.9)
    place = skinned(points, bone_weights(identity, points))
    vertex = {"seams": no_seams(points)}
    return [MeshPiece("scarf", Part.CLOTHING, faces, "cloth", place, look, uv, vertex)]


def _tail(
    ring: np.ndarray, identity: Identity, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The end that hangs over the chest, pleated, from under the lower turn."""
    side = float(rng.choice([-1.0, 1.0]))
    start = ring[int(_AROUND * (0.5 + 0.06 * side)), :].mean(axis=0)
    across = np.linspace(-1, 1, 33)
    along = np.linspace(0, 1, 26)
    half = np.interp(along, [0, 0.3, 1], [0.026, 0.045, 0.052])
    x = start[0] + half[:, None] * across + 0.02 * side * along[:, None]
    z = start[2] - 0.26 * along[:, None] + 0 * across
    pleat = 0.5 + 0.5 * np.sin(across * rng.uniform(9, 12) + 1.5 * np.sin(4 * along)[:, None])
    chest = identity.rest[identity.model.groups["skin"]]
    chest = chest[(chest[:, 1] < -0.03) & (np.abs(chest[:, 0]) < 0.12)]
    levels = np.linspace(start[2], start[2] - 0.26, 26)
    front = [
        chest[np.abs(chest[:, 2] - level) < 0.02][:, 1].min(initial=start[1]) for level in levels
    ]
    front = np.minimum(gaussian_filter1d(np.array(front), 2), start[1] + 0.05)
    y = front[:, None] - 0.022 - 0.008 * pleat * smoothstep(0, 0.2, along)[:, None]
    grid = np.stack([x, y, z], axis=-1)
    return shell(np.swapaxes(grid, 0, 1)[::-1], 0.004)


def headscarf(wearing: Hat, identity: Identity) -> list[MeshPiece]:
    """A wrap that leaves the face alone: "cloth", Part.HEADWEAR; it follows head and neck."""
    rng = np.random.default_rng(wearing.seed)
    rest, model = identity.rest, identity.model
    angles = (np.arange(_AROUND) + 0.5) * 2 * np.pi / _AROUND - np.pi
    skin = model.groups["skin"]
    middle = (identity.joints[4] + identity.joints[5]) / 2
    # The skull, seen from its centre.
    centre = np.array([0.0, identity.joints[3, 1] - 0.012, middle[2] + 0.005])
    head = rest[skin[rest[skin, 2] > centre[2] - 0.02]]
    offset = head - centre
    turn = arctan2(offset[:, 0], -offset[:, 1])
    tilt = arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
    tilts = np.linspace(np.pi / 2 - 0.03, 0.0, 26)
    table = np.zeros((26, _AROUND))
    row = np.round((np.pi / 2 - 0.03 - tilt) / (tilts[0] - tilts[1])).astype(int)
    column = np.round((turn - angles[0]) / (angles[1] - angles[0])).astype(int) % _AROUND
    good = (row >= 0) & (row < 26)
    np.maximum.at(table, (row[good], column[good]), np.linalg.norm(offset[good], axis=1))
    skull = _filled(table)
    direction = np.stack(
        [np.cos(tilts)[:, None] * np.sin(angles), -np.cos(tilts)[:, None] * np.cos(angles),
         np.sin(tilts)[:, None] + 0 * angles], axis=-1,
    )  # fmt: skip
    # Below it, from the axis of the neck outwards.
    hem = identity.joints[0, 2] - 0.075
    heights = np.linspace(centre[2], hem, 40)[1:]
    reach, axis = _neck_reach(identity, heights, angles)
    share = np.linspace(0, 1, len(heights))[:, None]
    blend = smoothstep(0, 0.25, share)
    axis[:, 1] = (1 - blend[:, 0]) * centre[1] + blend[:, 0] * axis[:, 1]
    # Cloth hangs straight from jaw and nape to the shoulders.
    reach = np.minimum(reach, np.interp(share, [0, 0.5, 0.8, 1], [1, 0.105, 0.118, 0.128]))
    reach = _hanging(heights, reach)
    skull = _smoothed(skull, 1.2, 2.0)
    reach = _smoothed(reach, 1.5, 1.6)
    pleats = _pleats(np.concatenate([np.zeros(26), share[:, 0]]), angles, rng)
    upper = centre + (skull + 0.009 + 0.3 * pleats[:26])[..., None] * direction
    radius = reach + 0.009 + 0.006 * share + pleats[26:]
    lower = axis[:, None] + np.stack(
        [radius * np.sin(angles), -radius * np.cos(angles), 0 * radius], axis=-1
    )
    grid = np.concatenate([upper, lower])
    # The first lower row joins the skull's last.
    blend = smoothstep(0, 6, np.arange(6) + 1.0)[:, None, None]
    offset = grid[25] - grid[26]
    grid[26:32] += (1 - blend) * (offset * [1, 1, 0])
    rows = len(grid)
    points = grid.reshape(-1, 3)
    index = np.arange(rows * _AROUND).reshape(rows, _AROUND)
    quads = tube_faces(index, flipped=True)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    points = np.concatenate([points, grid[0].mean(axis=0, keepdims=True)])
    ring = index[0]
    fan = np.stack([np.roll(ring, -1), np.full(_AROUND, rows * _AROUND), ring], axis=1)
    faces = np.concatenate([faces, fan]).astype(np.int32)

    # The opening around the face.
    face = rest[skin]
    chin = face[(np.abs(face[:, 0]) < 0.012) & (face[:, 1] < middle[1] - 0.005)][:, 2]
    low = chin[chin > identity.joints[2, 2] - 0.05].min() - 0.001
    high = middle[2] + 0.052
    width = np.abs(face[(np.abs(face[:, 2] - middle[2]) < 0.01)
                        & (face[:, 1] < middle[1] + 0.04)][:, 0]).max() - 0.002  # fmt: skip
    level, half = (low + high) / 2, (high - low) / 2
    oval = np.hypot(points[:, 0] / width, (points[:, 2] - level) / half) - 1
    field = np.where(points[:, 1] < centre[1] - 0.01, oval * 0.07, 0.07)
    unity = sparse.csr_matrix(sparse.identity(len(points)))
    sheet = Sheet(unity, faces, field).cut(0.0)
    sheet = sheet.keep(sheet.field[sheet.faces].max(axis=1) > 1e-9)
    cloth = sheet.matrix @ points
    for _ in range(3):
        cloth = sheet.smoothing @ cloth
    # The edge clings to temples, cheeks and the underside of the chin.
    outer = skin[(model.masks["inside-mouth"][skin] < 0.3) & (model.masks["ears"][skin] < 0.3)]
    _, near = KDTree(rest[outer]).query(cloth)
    cling = rest[outer][near] + 0.004 * identity.neutral.normals[outer][near]
    hug = smoothstep(0.032, 0.004, sheet.field)[:, None]
    cloth = cloth + hug * (cling - cloth)
    for _ in range(4):
        cloth = sheet.smoothing @ cloth
    normals = vertex_normals(cloth, sheet.faces)
    weights = bone_weights(identity, cloth)
    for _ in range(10):
        weights = sheet.smoothing @ weights
    inner = cloth - 0.0022 * normals
    points = np.concatenate([cloth, inner])
    strips = [ring_strip(loop, loop + len(cloth)) for loop in border_loops(sheet.faces)]
    faces = np.concatenate([sheet.faces, sheet.faces[:, ::-1] + len(cloth), *strips])
    uv = np.stack([arctan2(points[:, 0], -(points[:, 1] - centre[1])) * 0.09, points[:, 2]], axis=1)
    look = cloth_look(wearing, "poplin", 0.8)
    faces = faces.astype(np.int32)
    place = skinned(points, np.tile(weights, (2, 1)))
    vertex = {"seams": no_seams(points)}
    return [MeshPiece("headscarf", Part.HEADWEAR, faces, "cloth", place, look, uv[faces], vertex)]


def _hanging(heights: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Raise a profile (rows, around) about half the way to straight lines over its hollows."""
    hull = reach.copy()
    for column in hull.T:
        stack: list[int] = []
        for k in range(len(heights)):
            while len(stack) > 1:
                a, b = stack[-2], stack[-1]
                rise = (column[k] - column[a]) * (heights[a] - heights[b])
                if rise < (column[b] - column[a]) * (heights[a] - heights[k]):
                    break
                stack.pop()
            stack.append(k)
        column[:] = np.interp(-heights, -heights[stack], column[stack])
    return reach + 0.45 * (hull - reach)


def _pleats(share: np.ndarray, angles: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Heights (rows, around) of folds that sweep around the neck, metres."""
    height = np.zeros((len(share), len(angles)))
    rows = np.linspace(0, 1, len(share))[:, None]
    for _ in range(4):
        around = int(rng.integers(1, 4)) * float(rng.choice([-1, 1]))
        phase = around * angles + rng.uniform(16, 30) * rows * (
            1 + 0.3 * np.sin(angles + rng.uniform(0, 6))
        )
        height += (0.5 + 0.5 * np.sin(phase + rng.uniform(0, 6))) ** 2.5 * rng.uniform(0.4, 1)
    return 0.0062 * height * (0.2 + smoothstep(0.05, 0.35, share))[:, None]
