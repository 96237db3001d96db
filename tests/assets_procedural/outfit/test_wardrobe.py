"""Tops, glasses, earrings and hats: whole meshes, outside the skin, that follow the bust."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel
from assets_procedural.body.piece import MeshPiece
from assets_procedural.conventions.parts import Part
from assets_procedural.motion.poses import Pose
from assets_procedural.outfit.accessories import accessories
from assets_procedural.outfit.cloth import Sheet, border_loops, sheet_from_quads
from assets_procedural.outfit.glasses import SHAPES
from assets_procedural.outfit.headwear import above_rim
from assets_procedural.outfit.tops import STYLES, covered_skin, wardrobe
from assets_procedural.person import Earrings, Glasses, Hat, Person, Top

WOMAN = {"gender": 1.0, "age": 0.66, "asian": 1.0, "african": 0.0, "caucasian": 0.0}
MAN = {"gender": 0.0, "age": 0.95, "weight": 0.8}


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


def _check_mesh(piece: MeshPiece, points: np.ndarray) -> None:
    assert np.isfinite(points).all()
    assert piece.faces.min() == 0 and piece.faces.max() == len(points) - 1
    ordered = np.sort(piece.faces, axis=1)
    assert (np.diff(ordered, axis=1) > 0).all(), f"{piece.name}: a face uses a vertex twice"
    assert len(np.unique(ordered, axis=0)) == len(ordered), f"{piece.name}: duplicate faces"
    if piece.uv is not None:
        assert piece.uv.shape == (*piece.faces.shape, 2)


@pytest.mark.parametrize("style", STYLES)
def test_tops_are_whole_and_follow_the_bust(model, style):
    person = Person(top=Top(style=style), phenotypes=WOMAN)
    identity = model.identity(person)
    turned = identity.pose(Pose(head=(0.2, 0.1, 0.7)))
    for piece in wardrobe(person, identity):
        assert piece.part == Part.CLOTHING and piece.material in ("cloth", "knit")
        still = piece.place(identity.neutral)
        _check_mesh(piece, still)
        np.testing.assert_allclose(piece.place(turned.canonical), still, atol=1e-9)
        # A turn of the head leaves the trunk's cloth alone and pulls a little at the collar.
        moved = np.linalg.norm(piece.place(turned) - still, axis=1)
        assert np.median(moved) < 0.012 and moved.max() < 0.06


@pytest.mark.parametrize("phenotypes", [WOMAN, MAN], ids=["woman", "man"])
def test_cloth_lies_above_the_skin(model, phenotypes):
    person = Person(top=Top(style="tee"), phenotypes=phenotypes)
    identity = model.identity(person)
    cloth = wardrobe(person, identity)[0].place(identity.neutral)
    bust = identity.neutral
    skin = model.groups["skin"]
    near = cloth[(cloth[:, 2] > identity.joints[0, 2] - 0.1)]
    distance, index = KDTree(bust.vertices[skin]).query(near)
    index = skin[index]
    height = np.einsum("ni,ni->n", near - bust.vertices[index], bust.normals[index])
    assert (height > 0).mean() > 0.985
    assert np.quantile(distance, 0.9) < 0.03


def test_only_skin_well_inside_is_left_out(model):
    identity = _average(model)
    covered = {style: covered_skin(Person(top=Top(style=style)), identity) for style in STYLES}
    centre = identity.rest[model.faces["skin"]].mean(axis=1)
    for mask in covered.values():
        assert mask.shape == (len(model.faces["skin"]),)
        assert not mask[centre[:, 2] > 0.56].any()
    assert covered["vneck"].sum() < covered["tee"].sum()
    assert covered["tank"].sum() < covered["tee"].sum()


def _average(model):
    return model.identity(Person())


def test_unknown_style_is_an_error(model):
    with pytest.raises(KeyError):
        wardrobe(Person(top=Top(style="toga")), _average(model))


def test_a_cut_follows_the_level_set_without_holes():
    n = 8
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    index = np.arange(n * n).reshape(n, n)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1)
    field = (x + 0.37 * y - 5.1).ravel().astype(float)
    sheet: Sheet = sheet_from_quads(
        sparse.csr_matrix(sparse.identity(n * n)), quads.reshape(-1, 4), field
    )
    cut = sheet.cut(0.0)
    values = cut.field[cut.faces]
    assert not ((values.min(axis=1) < -1e-9) & (values.max(axis=1) > 1e-9)).any()
    points = cut.matrix @ np.stack([x.ravel(), y.ravel()], 1).astype(float)
    on_cut = np.isclose(cut.field, 0)
    np.testing.assert_allclose((points[on_cut] @ [1, 0.37]), 5.1, atol=1e-9)
    assert len(border_loops(cut.faces)) == 1
    corner = points[cut.faces]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0).all()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("phenotypes", [WOMAN, MAN], ids=["woman", "man"])
def test_glasses_clear_the_face_and_reach_the_ears(model, shape, phenotypes):
    person = Person(glasses=Glasses(shape=shape, tint=0.5), phenotypes=phenotypes)
    identity = model.identity(person)
    bust = identity.neutral
    frame, *lenses = accessories(person, identity)
    for piece in (frame, *lenses):
        assert piece.part == Part.GLASSES
        _check_mesh(piece, piece.place(bust))
    skin = model.groups["skin"]
    skin = skin[(model.masks["ears"][skin] < 0.2)]
    tree = KDTree(bust.vertices[skin])
    for lens in lenses:
        assert lens.hidden_from_labels and lens.parameters["tint"] == 0.5
        points = lens.place(bust)
        index = skin[tree.query(points)[1]]
        height = np.einsum("ni,ni->n", points - bust.vertices[index], bust.normals[index])
        assert height.min() > -0.001
        eye = bust.eyes["eye_left" if "left" in lens.name else "eye_right"]
        assert 0.015 < eye[1] - points[:, 1].mean() < 0.045
        assert np.abs(points[:, 2].mean() - eye[2]) < 0.012
    points = frame.place(bust)
    assert points[:, 1].max() > identity.joints[4, 1] + 0.075  # behind the ears
    turned = identity.pose(Pose(head=(0.0, 0.0, 0.5)))
    motion = turned.bones["head"]
    np.testing.assert_allclose(
        frame.place(turned), points @ motion[:3, :3].T + motion[:3, 3], atol=1e-9
    )


def test_earrings_hang_down_from_the_lobes(model):
    person = Person(earrings=Earrings(shape="hoop", size_mm=20))
    identity = model.identity(person)
    bust = identity.pose(Pose(head=(0.0, 0.3, 0.0)))
    left, right = accessories(person, identity)
    for piece, side in ((left, 1), (right, -1)):
        assert piece.part == Part.FACEWEAR and piece.material == "metal"
        points = piece.place(bust)
        _check_mesh(piece, points)
        assert np.ptp(points[:, 2]) == pytest.approx(0.02, abs=0.003)  # upright though tilted
        assert points[:, 0].mean() * side > 0.05


@pytest.mark.parametrize("style", ["beanie", "cap"])
def test_hats_cover_the_scalp_and_nothing_else(model, style):
    hat = Hat(style=style)
    person = Person(hat=hat, phenotypes=MAN)
    identity = model.identity(person)
    pieces = accessories(person, identity)
    bust = identity.neutral
    for piece in pieces:
        assert piece.part == Part.HEADWEAR
        _check_mesh(piece, piece.place(bust))
    skin = model.groups["skin"]
    under = above_rim(identity.rest[skin], hat, identity) > 0
    top = skin[np.argmax(identity.rest[skin, 2])]
    assert under[skin == top].all()
    assert not under[identity.rest[skin, 2] < identity.joints[4, 2]].any()
    hat = pieces[0].place(bust)
    assert hat[:, 2].max() > identity.rest[top, 2] + 0.004
