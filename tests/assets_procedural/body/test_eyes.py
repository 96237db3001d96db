"""Eyes: fitted to the head, opened and closed by its lids, turned by the gaze."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from assets_procedural.body.eyes import IRIS_RATIO, eyeball, eyes
from assets_procedural.body.head import HeadModel, Identity
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.subdivision import catmull_clark
from assets_procedural.motion.poses import Pose
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.person import Eyes, Person

PERSON = Person(eyes=Eyes(iris=(0.1, 0.2, 0.35), redness=0.5, seed=3))


@pytest.fixture(scope="module")
def identity() -> Identity:
    return HeadModel.load().identity(PERSON)


@pytest.fixture(scope="module")
def pieces(identity):
    return {piece.name: piece for piece in eyes(PERSON, identity)}


def test_eyeballs_sit_at_their_joints(identity):
    for name, joint in (("eye_left", identity.joints[4]), ("eye_right", identity.joints[5])):
        centre, radius = eyeball(identity, name)
        assert np.linalg.norm(centre - joint) < 0.0006
        own = identity.rest[identity.model.groups[name]]
        np.testing.assert_allclose(np.linalg.norm(own - centre, axis=1), radius, rtol=0.04)


def test_labels_and_transparent_films(pieces):
    for name, piece in pieces.items():
        assert piece.part == (Part.LEFT_EYE if "left" in name else Part.RIGHT_EYE)
        assert piece.hidden_from_labels == (piece.material in ("cornea", "tear", "lid_shade"))


def test_topology_is_constant_and_faces_are_whole(identity, pieces):
    blink = identity.pose(Pose(expression={"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}))
    for piece in pieces.values():
        still, shut = piece.place(identity.neutral), piece.place(blink)
        assert still.shape == shut.shape and np.isfinite(still).all() and np.isfinite(shut).all()
        assert piece.faces.min() == 0 and piece.faces.max() == len(still) - 1
        assert (np.diff(np.sort(piece.faces, axis=1), axis=1) > 0).all()


def test_gaze_turns_the_optic_axis(identity, pieces):
    gaze = (0.3, 0.2)
    bust = identity.pose(Pose(gaze=gaze, head=(0.0, 0.0, 0.4)))
    points = pieces["eye_left"].place(bust)
    pupil = points[pieces["eye_left"].vertex["radial"] < 0.05].mean(axis=0)
    axis = pupil - bust.eyes["eye_left"]
    axis /= np.linalg.norm(axis)
    assert np.arctan2(axis[0], -axis[1]) == pytest.approx(0.7, abs=0.02)
    assert np.arcsin(axis[2]) == pytest.approx(0.2, abs=0.02)


def test_the_cornea_covers_the_iris(identity, pieces):
    centre, radius = eyeball(identity, "eye_left")
    distance = np.linalg.norm(pieces["cornea_left"].place(identity.neutral) - centre, axis=1)
    assert distance.min() > radius
    assert 1.05 * radius < distance.max() < 1.1 * radius
    ball = pieces["eye_left"]
    iris = ball.vertex["radial"] < np.arcsin(IRIS_RATIO) * 0.9
    inner = np.linalg.norm(ball.place(identity.neutral)[iris] - centre, axis=1)
    assert inner.max() < 0.99 * radius  # the iris is recessed


def test_texture_has_a_pupil_an_iris_and_a_white(pieces):
    texture = pieces["eye_left"].parameters["texture"]
    assert texture.shape == (512, 512, 3) and texture.dtype == np.float32
    assert texture.min() >= 0 and texture.max() <= 1
    assert texture[250:262, 250:262].max() < 0.02
    ring = texture[256, 256 + 60]
    assert ring[2] > ring[0]  # a blue iris
    white = texture[256, 256 + 170]
    assert white.min() > 0.15 and white[0] >= white[2]
    mirrored = pieces["eye_right"].parameters["texture"]
    np.testing.assert_array_equal(mirrored, texture[:, ::-1])


def test_same_person_same_eyes(identity, pieces):
    again = {piece.name: piece for piece in eyes(PERSON, identity)}
    first, second = (p["eye_left"].parameters["texture"] for p in (pieces, again))
    np.testing.assert_array_equal(first, second)


def test_tear_line_and_caruncle_stay_on_the_eye(identity, pieces):
    centre, radius = eyeball(identity, "eye_left")
    for expression in ({}, {"eyeBlinkLeft": 0.5}, {"eyeWideLeft": 1.0}, {"eyeSquintLeft": 1.0}):
        bust = identity.pose(Pose(expression=expression))
        for name in ("tear_left", "caruncle_left"):
            points = pieces[name].place(bust)
            distance = np.linalg.norm(points - centre, axis=1)
            assert distance.max() < radius + 0.0035
            assert distance.min() > radius - 0.003
        assert pieces["caruncle_left"].place(bust)[:, 0].mean() < centre[0] - 0.006
        tear = pieces["tear_left"].place(bust)
        assert np.median(tear[:, 2]) < centre[2]


def test_the_shade_of_the_lids_follows_them_over_the_eye(identity, pieces):
    centre, radius = eyeball(identity, "eye_left")
    shade = pieces["lid_shade_left"]
    dark = shade.vertex["shade"] > 0.5
    for expression in ({}, {"eyeBlinkLeft": 0.5}, {"eyeWideLeft": 1.0}):
        bust = identity.pose(Pose(expression=expression))
        points = shade.place(bust) - centre
        ball = np.linalg.norm(pieces["eye_left"].place(bust) - centre, axis=1).max()
        distance = np.linalg.norm(points, axis=1) / ball
        assert distance.min() > 1.005 and distance.max() < 1.1
        upper = points[:, 2] > 0.3 * radius * np.abs(points[:, 0])
        # Darkest where the lid is, that is farthest from the pupil.
        height = points[upper & dark][:, 2].mean() - points[upper & ~dark][:, 2].mean()
        assert height > 0.001


@pytest.mark.parametrize("squeeze", [{}, {"eyeSquintLeft": 0.6, "mouthSmileLeft": 1.0}])
def test_shut_lids_cover_the_eye(squeeze):
    """Nearly every ray that leaves the front of cornea and ball meets skin."""
    model = HeadModel.load()
    quads = model.faces["skin"]
    middle = model.template[quads].mean(axis=1)
    ball = model.template[model.groups["eye_left"]].mean(axis=0)
    lids = catmull_clark(quads[np.linalg.norm(middle - ball, axis=1) < 0.03], len(model.template))
    triangles = lids.faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    for seed in (0, 1, 8):
        person = sample_person(np.random.default_rng(seed), PeopleSettings())
        identity = model.identity(person)
        bust = identity.pose(Pose(expression={"eyeBlinkLeft": 1.0} | squeeze))
        skin = trimesh.Trimesh(lids.matrix @ bust.vertices, triangles, process=False)
        for piece in eyes(person, identity):
            if piece.name in ("eye_left", "cornea_left"):
                points = piece.place(bust)
                points = points[np.argsort(points[:, 1])[:1200:8]]
                covered = skin.ray.intersects_any(points, np.tile([0.0, -1.0, 0.0], (150, 1)))
                assert covered.mean() > 0.97, (seed, piece.name)
