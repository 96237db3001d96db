"""A person as Blender objects: built once, moved from pose to pose.

The skin is the head model's bust, subdivided once in numpy, so the evaluated mesh is known outside
Blender. Everything else is pieces that know their own place on a bust.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from assets_procedural.body import regions
from assets_procedural.body.head import Bust, Identity
from assets_procedural.body.piece import Piece, StrandPiece
from assets_procedural.body.skin import skin_fields
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.subdivision import Subdivision, catmull_clark
from assets_procedural.outfit import tops
from assets_procedural.person import Person
from assets_procedural.skin_detail import chart
from assets_procedural.skin_detail.detail import SkinDetail
from synthgen.stage import materials, skin_material
from synthgen.stage.hair_colour import strand_colours


@dataclass(frozen=True)
class Figure:
    """A person on the stage: skin, its subdivision and detail, the pieces with their objects."""

    subdivision: Subdivision
    skin: bpy.types.Object
    detail: SkinDetail
    pieces: list[tuple[Piece, bpy.types.Object]]


# Strands that are thinner than a third of a pixel only cost. On pixels of this size and smaller,
# metres, a head has all its hair; on larger ones fewer and thicker strands, to a limit.
_FINEST_PIXEL, _WIDEST = 6e-4, 1.9
_THINNED = (Part.HAIR, Part.BEARD)


def strands_for_pixel(pieces: list[Piece], pixel: float) -> list[Piece]:
    """The pieces with as many strands of hair as pixels of `pixel` metres on the head can show."""
    wider = float(np.clip((pixel / _FINEST_PIXEL) ** 0.6, 1, _WIDEST))
    if wider == 1:
        return pieces
    return [
        piece.thinned(wider**-2, wider)
        if isinstance(piece, StrandPiece) and piece.part in _THINNED
        else piece
        for piece in pieces
    ]


def build_figure(person: Person, identity: Identity, pieces: list[Piece]) -> Figure:
    """Create all objects, in the neutral pose; `pose_figure` moves them."""
    neutral = identity.neutral
    detail = SkinDetail(person, identity.model)
    # The skin's material takes the image as it is made; `pose_figure` then changes its pixels.
    skin_material.show_detail(detail.picture(neutral.pose.expression))
    subdivision, skin = _build_skin(person, identity)
    objects = [(piece, _build_piece(piece, neutral)) for piece in pieces]
    figure = Figure(subdivision, skin, detail, objects)
    pose_figure(figure, neutral)
    return figure


def pose_figure(figure: Figure, bust: Bust) -> None:
    """Move every object to the bust's pose, write its canonical coordinates, crease the skin."""
    skin_material.show_detail(figure.detail.picture(bust.pose.expression))
    surface = figure.subdivision.matrix
    _move(figure.skin.data, surface @ bust.vertices, surface @ bust.canonical.vertices)
    for piece, object_ in figure.pieces:
        _move(object_.data, piece.place(bust), piece.place(bust.canonical))


def _build_skin(person: Person, identity: Identity) -> tuple[Subdivision, bpy.types.Object]:
    model = identity.model
    shown = ~tops.covered_skin(person, identity)
    quads = model.faces["skin"][shown]
    subdivision = catmull_clark(quads, len(model.template))
    surface = vars(skin_fields(person, model))
    vertex = {name: subdivision.matrix @ value for name, value in surface.items()}
    vertex["rest"] = subdivision.matrix @ model.template
    around = chart.project(vertex["rest"])
    vertex["chart"] = np.concatenate([around, np.zeros((len(around), 1))], axis=1)
    part = np.repeat(regions.part_labels(model)[shown], 4)
    uv = subdivision.corner_values(model.uv["skin"][shown])
    mesh = _mesh("skin", subdivision.matrix @ identity.rest, subdivision.faces, uv, vertex, part)
    mesh.materials.append(skin_material.skin(person.skin))
    return subdivision, _link(mesh)


def _build_piece(piece: Piece, bust: Bust) -> bpy.types.Object:
    if isinstance(piece, StrandPiece):
        return _build_strands(piece)
    vertices = piece.place(bust)
    mesh = _mesh(piece.name, vertices, piece.faces, piece.uv, piece.vertex, piece.part)
    mesh.shade_smooth() if piece.smooth else mesh.shade_flat()
    mesh.materials.append(materials.surface(piece.material, piece.parameters))
    object_ = _link(mesh)
    object_["hidden_from_labels"] = piece.hidden_from_labels
    return object_


def _build_strands(piece: StrandPiece) -> bpy.types.Object:
    strands, points = piece.radius.shape
    curves = bpy.data.hair_curves.new(piece.name)
    curves.add_curves([points] * strands)
    _attribute(curves, "radius", "FLOAT", "POINT", piece.radius)
    _attribute(curves, "colour", "FLOAT_COLOR", "POINT", strand_colours(piece))
    curves.materials.append(materials.hair(piece.parameters.get("roughness", 0.3), piece.part))
    object_ = _link(curves)
    # Cycles puts strands of uniform scale into the scene's BVH, which it builds anew for every
    # light and view; others keep a BVH of their own. This is half a micrometre on a head.
    object_.scale = (1.0, 1.0, 1 + 2e-6)
    return object_


def _mesh(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray | None,
    vertex: dict[str, np.ndarray],
    part: int | np.ndarray,
) -> bpy.types.Mesh:
    count, corners = faces.shape
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.loops.add(faces.size)
    mesh.polygons.add(count)
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, corners, dtype=np.int32))
    mesh.update(calc_edges=True)
    if mesh.validate():
        raise ValueError(f"piece {name!r} has degenerate or duplicate faces")
    mesh.shade_smooth()
    if uv is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", np.ascontiguousarray(uv, np.float32).ravel())
    for attribute, values in vertex.items():
        kind = "FLOAT" if values.ndim == 1 else "FLOAT_VECTOR"
        _attribute(mesh, attribute, kind, "POINT", values)
    labels = np.broadcast_to(np.asarray(part, np.float32), (count,))
    _attribute(mesh, "part", "FLOAT", "FACE", labels)
    return mesh


def _attribute(data: bpy.types.ID, name: str, kind: str, domain: str, values: np.ndarray) -> None:
    attribute = data.attributes.get(name) or data.attributes.new(name, kind, domain)
    field = {"FLOAT": "value", "FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}[kind]
    attribute.data.foreach_set(field, np.ascontiguousarray(values, np.float32).ravel())


def _move(data: bpy.types.ID, positions: np.ndarray, canonical: np.ndarray) -> None:
    _attribute(data, "position", "FLOAT_VECTOR", "POINT", positions)
    _attribute(data, "canonical", "FLOAT_VECTOR", "POINT", canonical)
    data.update_tag()
    if isinstance(data, bpy.types.Mesh):
        data.update()


def _link(data: bpy.types.ID) -> bpy.types.Object:
    object_ = bpy.data.objects.new(data.name, data)
    bpy.context.scene.collection.objects.link(object_)
    return object_
