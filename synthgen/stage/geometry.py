"""What a shot records of the surface itself: control points, framing, visibility, the mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import trimesh

from assets_procedural.body.head import Bust, Identity
from assets_procedural.body.landmarks import COUNT, PUPILS
from assets_procedural.body.piece import MeshPiece
from assets_procedural.body.regions import fields
from assets_procedural.body.skin import skin_fields
from assets_procedural.conventions.colour import srgb_encode, to_bytes
from assets_procedural.person import Person

if TYPE_CHECKING:  # it starts Blender, and this room needs none
    from synthgen.stage.build import Figure

# How far behind the first surface in its pixel a landmark may lie and still count as seen, metres;
# a closed lid is only 4 mm in front of the pupil.
_VISIBLE_WITHIN = np.full(COUNT, 0.008)
_VISIBLE_WITHIN[list(PUPILS.values())] = 0.003


def control_geometry(bust: Bust) -> dict[str, np.ndarray]:
    """Skin vertices and normals, posed and canonical, and the bones' motions; float32, metres."""
    skin = bust.model.groups["skin"]
    canonical = bust.canonical
    arrays = {
        "control_points": bust.vertices[skin],
        "control_normals": bust.normals[skin],
        "control_points_canonical": canonical.vertices[skin],
        "control_normals_canonical": canonical.normals[skin],
        "joints": np.stack(list(bust.bones.values())),
    }
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def frame_of_head(bust: Bust) -> tuple[np.ndarray, float]:
    """Centre (3,) and height in metres of the head without hair, chin to crown."""
    head = bust.model.groups["skin"]
    head = head[fields(bust.model)["neck"][head] < 0.5]
    low, high = bust.vertices[head].min(axis=0), bust.vertices[head].max(axis=0)
    return (low + high) / 2, float(high[2] - low[2])


def visible(pixels: np.ndarray, depth: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Which landmarks (70, 2), (70,) are seen: in the frame and on the first surface (H, W)."""
    height, width = surface.shape
    column, row = np.floor(pixels).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    first = surface[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return inside & (first > 0) & (depth < first + _VISIBLE_WITHIN)


def canonical_mesh(person: Person, identity: Identity, figure: Figure) -> bytes:
    """The neutral bust with its opaque surfaces (no strands) as binary glTF, metres, Y up."""
    colour = to_bytes(srgb_encode(skin_fields(person, identity.model).colour))
    whole = trimesh.Scene()
    skin = _triangles(identity.rest, identity.model.faces["skin"])
    skin.visual = trimesh.visual.ColorVisuals(skin, vertex_colors=colour)
    skin.remove_unreferenced_vertices()
    whole.add_geometry(skin, geom_name="skin")
    for piece, _ in figure.pieces:
        if isinstance(piece, MeshPiece) and not piece.hidden_from_labels:
            mesh = _triangles(piece.place(identity.neutral), piece.faces)
            base = np.clip(piece.parameters.get("colour", (0.5, 0.5, 0.5)), 0, 1)
            mesh.visual = trimesh.visual.ColorVisuals(
                mesh, face_colors=to_bytes(srgb_encode(np.asarray(base, float)))
            )
            whole.add_geometry(mesh, geom_name=piece.name)
    # Z up to Y up, the head then looks along +Z as glTF wants.
    whole.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return whole.export(file_type="glb")


def _triangles(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    if faces.shape[1] == 4:
        faces = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    return trimesh.Trimesh(vertices, faces, process=False)
