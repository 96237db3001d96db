"""Strands: counts, determinism, hairlines, draping, and hair that follows the face."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.body.hairline import bare_crown, hairline_distance
from assets_procedural.body.head import HeadModel, Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.body.roots import sample_roots
from assets_procedural.conventions.parts import Part
from assets_procedural.hair import beards, brows_and_lashes, scalp_hair
from assets_procedural.hair.draping import Surface, chin_height
from assets_procedural.hair.styles import STYLES
from assets_procedural.mesh.vectors import smoothstep
from assets_procedural.motion.poses import Pose
from assets_procedural.person import Beard, Hair, Person


@pytest.fixture(scope="module")
def identity() -> Identity:
    return HeadModel.load().identity(Person())


def grow(identity: Identity, style: str, **changes: object) -> StrandPiece:
    person = Person(hair=Hair(style=style, **changes))  # type: ignore[arg-type]
    (piece,) = scalp_hair.scalp_hair(person, identity, np.random.default_rng(4))
    return piece


@pytest.mark.parametrize("style", [name for name, style in STYLES.items() if style.count])
def test_every_style_grows_strands_on_the_scalp(identity, style):
    piece = grow(identity, style)
    points = piece.place(identity.neutral)
    count, steps = piece.radius.shape
    assert points.shape == (count, steps, 3)
    assert np.isfinite(points).all()
    assert 10_000 < count < 62_000
    assert piece.part == Part.HAIR
    assert piece.radius.min() > 3e-6 and piece.radius.max() < 1.2e-4
    assert (piece.radius[:, -1] < piece.radius[:, 0]).all()
    assert piece.parameters["strand_random"].shape == (count,)
    # Nobody's hair comes near the tip of the nose.
    skin = identity.model.groups["skin"]
    nose = identity.rest[skin[np.argmin(identity.rest[skin, 1])]]
    assert np.linalg.norm(points - nose, axis=-1).min() > 0.01


def test_a_bald_head_has_no_piece(identity):
    assert (
        scalp_hair.scalp_hair(Person(hair=Hair(style="bald")), identity, np.random.default_rng(0))
        == []
    )


def test_an_unknown_style_is_named(identity):
    with pytest.raises(KeyError, match="mullet"):
        scalp_hair.scalp_hair(Person(hair=Hair(style="mullet")), identity, np.random.default_rng(0))
    with pytest.raises(KeyError, match="goat"):
        beards.beard(Person(beard=Beard(style="goat")), identity, np.random.default_rng(0))


def test_the_same_seed_gives_the_same_hair(identity):
    first, second = (grow(identity, "short").place(identity.neutral) for _ in range(2))
    assert np.array_equal(first, second)


def test_density_sets_the_number_of_strands(identity):
    assert len(grow(identity, "short", density=0.2).radius) < len(
        grow(identity, "short", density=0.9).radius
    )


def test_hair_follows_the_head_rigidly_above_the_chin(identity):
    piece = grow(identity, "short")
    bust = identity.pose(Pose(head=(0.2, 0.1, 0.6)))
    head = bust.bones["head"]
    rest = piece.place(identity.neutral)
    high = rest[..., 2].min(axis=1) > chin_height(identity)
    assert high.mean() > 0.99
    posed = piece.place(bust)[high]
    assert np.allclose(posed, rest[high] @ head[:3, :3].T + head[:3, 3], atol=1e-5)


@pytest.mark.parametrize("yaw", [-35, 35])
def test_long_hair_drapes_on_a_turned_bust(identity, yaw):
    piece = grow(identity, "long_straight")
    bust = identity.pose(Pose(head=(0.0, 0.0, np.radians(yaw))))
    rest, posed = piece.place(identity.neutral), piece.place(bust)
    # Tips on the chest stay with the trunk instead of swinging with the head.
    low = rest[:, -1, 2] < rest[:, -1, 2].min() + 0.03
    assert np.median(np.linalg.norm(posed[low, -1] - rest[low, -1], axis=1)) < 0.02
    # No strand is torn apart, and hardly a point is inside the body.
    stretch = np.linalg.norm(np.diff(posed, axis=1), axis=2).sum(axis=1)
    before = np.linalg.norm(np.diff(rest, axis=1), axis=2).sum(axis=1)
    assert np.quantile(stretch / before, 0.99) < 1.5
    signed, _ = Surface.of(bust).distance(posed[::10, 1:])
    assert (signed < -0.002).mean() < 0.01


def test_hair_on_the_shoulders_hangs_before_or_behind_them_not_over_them(identity):
    tips = grow(identity, "long_straight").place(identity.neutral)[:, -1]
    assert np.quantile(np.abs(tips[:, 0]), 0.95) < 0.115
    # Between chest and back nearly nothing hangs.
    assert ((tips[:, 1] > -0.04) & (tips[:, 1] < 0.03)).mean() < 0.08


def test_a_receding_hairline_and_a_bare_crown_take_hair_where_they_should(identity):
    model = identity.model
    skin = model.template[model.groups["skin"]]
    crown = skin[[np.argmax(skin[:, 2])]]
    temple = np.array([[0.055, -0.115, 0.80]])
    full, bald = Person(hair=Hair()), Person(hair=Hair(receding=0.8, thinning=1.0))
    assert hairline_distance(temple, bald)[0] < hairline_distance(temple, full)[0] - 10
    assert bare_crown(crown, full)[0] == 0 and bare_crown(crown, bald)[0] > 0.9
    roots = grow(identity, "horseshoe").place(identity.neutral)[:, 0]
    on_top = roots[:, 2] > identity.rest[model.groups["skin"], 2].max() - 0.02
    assert on_top.mean() < 0.02


def test_the_face_lies_outside_the_hairline(identity):
    model = identity.model
    skin = model.groups["skin"]
    nose = skin[np.argmin(model.template[skin, 1])]
    crown = skin[np.argmax(model.template[skin, 2])]
    inside = hairline_distance(model.template[[nose, crown]], Person())
    assert inside[0] < 0 < inside[1]


def test_grey_is_a_share_of_white_strands(identity):
    parameters = grow(identity, "short", grey=0.4).parameters
    white = parameters["strand_random"] < parameters["grey"]
    assert 0.3 < white.mean() < 0.5


def test_brows_ride_on_the_raised_skin(identity):
    left, right = brows_and_lashes.brows(Person(), identity, np.random.default_rng(1))
    assert (left.part, right.part) == (Part.LEFT_BROW, Part.RIGHT_BROW)
    rest = left.place(identity.neutral)
    assert rest[..., 0].mean() > 0 > right.place(identity.neutral)[..., 0].mean()
    raised = left.place(identity.pose(Pose(expression={"browInnerUp": 1, "browOuterUpLeft": 1})))
    assert (raised - rest)[..., 2].mean() > 0.002
    signed, _ = Surface.of(identity.neutral).distance(rest)
    assert signed.max() < 0.006


def test_lashes_close_with_the_lids(identity):
    (piece,) = brows_and_lashes.lashes(Person(), identity, np.random.default_rng(1))
    open_, closed = (
        piece.place(bust)
        for bust in (
            identity.neutral,
            identity.pose(Pose(expression={"eyeBlinkLeft": 1, "eyeBlinkRight": 1})),
        )
    )
    upper = open_[:, 0, 2] > np.median(open_[:, 0, 2])
    assert (closed - open_)[upper, 0, 2].mean() < -0.003
    assert (open_[..., 1].min(axis=1) < open_[:, 0, 1]).all()


@pytest.mark.parametrize("style", list(beards.BEARDS))
def test_beards_cover_their_region_and_spare_the_lips(identity, style):
    person = Person(beard=Beard(style=style, length_mm=6))
    (piece,) = beards.beard(person, identity, np.random.default_rng(2))
    points = piece.place(identity.neutral)
    roots = points[:, 0]
    assert piece.part == Part.BEARD and np.isfinite(points).all()
    lips = identity.model.masks["lips"] > 0.9
    near = np.linalg.norm(roots[:, None] - identity.rest[lips][None, ::8], axis=-1).min(axis=1)
    assert np.quantile(near, 0.01) > 0.001
    assert (roots[:, 2] < identity.neutral.eyes["eye_left"][2] + 0.01).all()
    dropped = piece.place(identity.pose(Pose(expression={"jawOpen": 1})))
    chin = roots[:, 2] < np.quantile(roots[:, 2], 0.2)
    if style not in ("moustache", "sideburns"):
        assert (dropped - points)[chin, :, 2].mean() < -0.001


def test_roots_follow_the_asked_density(identity):
    def left_half(points, roots):
        return smoothstep(0, 0.001, points[:, 0])

    roots = sample_roots(identity, left_half, 500, np.random.default_rng(0))
    assert len(roots) == 500
    assert (roots.of(identity.model.template)[:, 0] > 0).all()
    assert np.allclose(roots.barycentric.sum(axis=1), 1)


@pytest.mark.parametrize("style", ["boxed", "full", "long"])
def test_a_beard_fades_out_on_the_cheek(identity, style):
    person = Person(beard=Beard(style=style, length_mm=8))
    (piece,) = beards.beard(person, identity, np.random.default_rng(2))
    points = piece.place(identity.neutral)
    roots = points[:, 0]
    x = np.abs(roots[:, 0])
    cheek = (x > 0.035) & (x < 0.05) & (roots[:, 1] < -0.06)
    z = roots[cheek, 2]
    dense, _ = np.histogram(z, np.arange(0.55, 0.70, 0.002))
    peak = dense[np.argmax(dense) :] / dense.max()
    # From dense to single hairs over more than a centimetre, and the outer hairs are shorter.
    assert 0.002 * np.count_nonzero((peak < 0.8) & (peak > 0.03)) > 0.010
    length = np.linalg.norm(np.diff(points[cheek], axis=1), axis=-1).sum(axis=1)
    outer = z > np.quantile(z, 0.97)
    middle = (z > np.quantile(z, 0.5)) & (z < np.quantile(z, 0.8))
    assert np.median(length[outer]) < 0.87 * np.median(length[middle])
