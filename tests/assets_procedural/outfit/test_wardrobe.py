"""Tops, glasses, earrings and hats: whole meshes, outside the skin, that follow the bust."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel
from assets_procedural.body.piece import MeshPiece
from assets_procedural.conventions.camera import resolve
from assets_procedural.conventions.parts import Part
from assets_procedural.hair.scalp_hair import scalp_hair
from assets_procedural.motion.poses import Pose
from assets_procedural.outfit.accessories import accessories
from assets_procedural.outfit.cloth import Sheet, border_loops, sheet_from_quads
from assets_procedural.outfit.glasses import SHAPES
from assets_procedural.outfit.headwear import EDGES, above_rim
from assets_procedural.outfit.necklines import JACKETS, NECKLINES
from assets_procedural.outfit.tops import covered_skin, wardrobe
from assets_procedural.person import (
    Earrings,
    Glasses,
    Hair,
    Hat,
    Headphones,
    Jacket,
    Necklace,
    Person,
    Scarf,
    Top,
)
from synthgen.planning.camera_sampling import sample_camera
from synthgen.planning.job import CameraSettings
from synthgen.stage.geometry import frame_of_head

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


def _dressed(kind: str, phenotypes: dict[str, float], seed: int = 0) -> Person:
    """Someone in the top or, over a shirt, the jacket of that name."""
    buttons = "buttons" if kind in ("shirt", "polo", "henley") else "none"
    if kind in JACKETS:
        jacket = Jacket(style=kind, seed=seed)
        return Person(top=Top(neckline="shirt", fabric="poplin"), jacket=jacket,
                      phenotypes=phenotypes)  # fmt: skip
    zipped = kind == "quarter_zip"
    top = Top(neckline=kind, closure="zip" if zipped else buttons, seed=seed)
    return Person(top=top, phenotypes=phenotypes)


@pytest.mark.parametrize("kind", [*NECKLINES, *JACKETS])
def test_tops_are_whole_and_follow_the_bust(model, kind):
    person = _dressed(kind, WOMAN)
    identity = model.identity(person)
    turned = identity.pose(Pose(head=(0.2, 0.1, 0.7)))
    for piece in wardrobe(person, identity):
        assert piece.part == Part.CLOTHING and piece.material in ("cloth", "plastic")
        still = piece.place(identity.neutral)
        _check_mesh(piece, still)
        np.testing.assert_allclose(piece.place(turned.canonical), still, atol=1e-9)
        # A turn of the head leaves the trunk's cloth alone and pulls a little at the collar.
        moved = np.linalg.norm(piece.place(turned) - still, axis=1)
        assert moved.max() < 0.06
        if piece.name.endswith("top"):
            assert np.median(moved) < 0.012


@pytest.mark.parametrize("kind", ["crew", "shirt", "hood", "blazer"])
@pytest.mark.parametrize("body", [WOMAN, MAN, {"weight": 0.95, "gender": 0.0, "muscle": 0.9}])
def test_no_default_camera_sees_where_sleeves_and_waist_end(model, kind, body):
    person = _dressed(kind, body)
    identity = model.identity(person)
    bust = identity.neutral
    assert covered_skin(person, identity)[_at_the_stumps(model)].all()
    ends = []
    for piece in wardrobe(person, identity):
        if piece.name.endswith("top"):
            points = piece.place(bust)
            for wanted in (points[:, 0] > 0.15, points[:, 0] < -0.15, np.abs(points[:, 0]) < 0.15):
                low = points[wanted]
                ends.append(low[low[:, 2] < low[:, 2].min() + 0.02])
    centre, height = frame_of_head(bust)
    rng = np.random.default_rng(1)
    for _ in range(200):
        camera = resolve(sample_camera(rng, CameraSettings()), centre, height, 256)
        pixels, depth = camera.project(np.concatenate(ends))
        inside = ((pixels > 0) & (pixels < 256)).all(axis=1) & (depth > 0)
        assert not inside.any()


def _at_the_stumps(model):
    """Quads (F,) at the borders of the bust."""
    quads = model.faces["skin"]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    border = np.concatenate([loop for loop in border_loops(triangles) if len(loop) > 30])
    return np.isin(quads, border).any(axis=1)


@pytest.mark.parametrize("kind", ["crew", "buttoned", "mock", "hood"])
@pytest.mark.parametrize("head", [(0, 0, 1.05), (0.5, 0, 0), (-0.5, 0, 0)])
def test_no_skin_pierces_the_collar_of_a_turned_head(model, kind, head):
    person = _dressed(kind, WOMAN)
    identity = model.identity(person)
    bust = identity.pose(Pose(head=head))
    skin = model.groups["skin"]
    neck = skin[model.template[skin, 2] < 0.60]
    tree = KDTree(bust.vertices[neck])
    points = np.concatenate([piece.place(bust) for piece in wardrobe(person, identity)])
    points = points[points[:, 2] > identity.joints[0, 2] - 0.03]
    index = neck[tree.query(points)[1]]
    height = np.einsum("ni,ni->n", points - bust.vertices[index], bust.normals[index])
    assert (height > -0.003).mean() > 0.97


def test_folds_differ_between_seeds_and_cloth_is_not_a_balloon(model):
    people = [_dressed("crew", WOMAN, seed) for seed in (1, 2)]
    identity = model.identity(people[0])
    first, second = (wardrobe(person, identity)[0].place(identity.neutral) for person in people)
    apart = np.linalg.norm(first - second, axis=1)
    assert 0.001 < np.quantile(apart, 0.9) < 0.010


@pytest.mark.parametrize("phenotypes", [WOMAN, MAN], ids=["woman", "man"])
def test_cloth_lies_above_the_skin(model, phenotypes):
    person = Person(top=Top(neckline="crew"), phenotypes=phenotypes)
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
    covered = {name: covered_skin(Person(top=Top(neckline=name)), identity) for name in NECKLINES}
    centre = identity.rest[model.faces["skin"]].mean(axis=1)
    for mask in covered.values():
        assert mask.shape == (len(model.faces["skin"]),)
        assert not mask[centre[:, 2] > 0.60].any()
    assert covered["vee"].sum() < covered["crew"].sum()
    assert covered["scoop"].sum() < covered["loose"].sum()


def _average(model):
    return model.identity(Person())


def test_unknown_style_is_an_error(model):
    with pytest.raises(KeyError):
        wardrobe(Person(top=Top(neckline="toga")), _average(model))


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
    *frames, _, _ = pieces = accessories(person, identity)
    lenses = pieces[-2:]
    for piece in pieces:
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
    frame = max(frames, key=lambda piece: piece.place(bust)[:, 1].max())
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


@pytest.mark.parametrize("style", [*EDGES])
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


def test_a_bucket_hat_is_no_bucket(model):
    """It tapers, stands no higher than hair and lining need, and is smooth on top."""
    person = Person(hat=Hat(style="bucket"), phenotypes=MAN)
    identity = model.identity(person)
    crown = accessories(person, identity)[0].place(identity.neutral)
    head = identity.rest[model.groups["skin"]]
    assert crown[:, 2].max() < head[:, 2].max() + 0.012
    assert np.ptp(crown[-96:, 2]) < 0.001
    low, high = np.quantile(crown[:, 2], [0.05, 0.55])
    width = [np.ptp(crown[np.abs(crown[:, 2] - z) < 0.006, 0]) for z in (low, high)]
    assert width[1] < 0.86 * width[0]


def test_a_headscarf_covers_hair_ears_and_neck_but_not_the_face(model):
    hat = Hat(style="headscarf")
    person = Person(hat=hat, phenotypes=WOMAN, hair=Hair(style="long_wavy"))
    identity = model.identity(person)
    (piece,) = accessories(person, identity)
    _check_mesh(piece, piece.place(identity.neutral))
    assert not scalp_hair(person, identity, np.random.default_rng(0))
    cloth = piece.place(identity.neutral)
    eyes = identity.joints[4:6].mean(axis=0)
    face = (np.abs(cloth[:, 0]) < 0.04) & (np.abs(cloth[:, 2] - eyes[2]) < 0.03)
    assert not (face & (cloth[:, 1] < eyes[1])).any()
    ears = identity.rest[model.masks["ears"] > 0.8]
    beside = cloth[np.abs(cloth[:, 2] - ears[:, 2].mean()) < 0.02]
    assert np.abs(beside[:, 0]).max() > np.abs(ears[:, 0]).max()


@pytest.mark.parametrize(
    ("name", "worn"),
    [
        ("scarf", Scarf()),
        ("headphones", Headphones()),
        *(("necklace", Necklace(style=style)) for style in ("chain", "pendant", "beads")),
        ("earrings", Earrings(shape="drop")),
    ],
)
def test_what_is_worn_is_whole_and_follows_every_pose(model, name, worn):
    person = Person(**{name: worn}, phenotypes=WOMAN)
    identity = model.identity(person)
    for piece in accessories(person, identity):
        for head in ((0, 0, 0), (0.5, 0.1, 1.0), (-0.5, 0, -1.0)):
            _check_mesh(piece, piece.place(identity.pose(Pose(head=head))))


def test_a_necklace_lies_on_the_skin(model):
    person = Person(necklace=Necklace(style="chain", drop=0.5))
    identity = model.identity(person)
    bust = identity.pose(Pose(head=(0.3, 0.0, 0.6)))
    (piece,) = accessories(person, identity)
    skin = model.groups["skin"]
    distance, _ = KDTree(bust.vertices[skin]).query(piece.place(bust))
    assert distance.max() < 0.012
