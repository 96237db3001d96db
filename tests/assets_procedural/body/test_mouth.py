"""The mouth: hidden behind closed lips, shown by open ones, and moved by the jaw."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from assets_procedural.body.head import Bust, HeadModel
from assets_procedural.body.mouth import jaw_motion, mouth
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.subdivision import catmull_clark
from assets_procedural.motion.poses import Pose
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.person import Person

PEOPLE = {
    "average": Person(),
    "old": Person(
        phenotypes={"gender": 0.0, "age": 0.98, "weight": 0.7},
        shape={"mouth-scale-horiz-incr": -0.6},
    ),
    "small jaw": sample_person(np.random.default_rng(16), PeopleSettings()),
}
SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0}
UP = {"mouthUpperUpLeft": 0.8, "mouthUpperUpRight": 0.8}
DOWN = {"mouthLowerDownLeft": 0.8, "mouthLowerDownRight": 0.8}
CLOSED = {
    "neutral": {},
    "press": {"mouthPressLeft": 1.0, "mouthPressRight": 1.0},
    "pucker": {"mouthPucker": 1.0},
}
OPEN = {
    "grin": {**SMILE, **UP, **DOWN, "jawOpen": 0.12},
    "wide": {"jawOpen": 1.0},
    "aah": {"jawOpen": 0.4},
}
MOVED = {
    "aside": {"jawLeft": 0.7, "jawOpen": 0.2},
    "forward": {"jawForward": 0.7, "jawOpen": 0.2},
}


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def lips_surface(model: HeadModel):
    """The skin around the mouth as it is rendered: (matrix, triangles)."""
    faces = model.faces["skin"]
    teeth = model.template[model.groups["teeth_upper"]]
    low, high = teeth.min(axis=0) - 0.045, teeth.max(axis=0) + 0.03
    centre = model.template[faces].mean(axis=1)
    near = ((centre > low) & (centre < high)).all(axis=1)
    refined = catmull_clark(faces[near], len(model.template))
    quads = refined.faces
    return refined.matrix, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _seen(points: np.ndarray, triangles: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(N,) mask: no triangle lies between a point and a far viewer in `direction`."""
    right = np.cross(direction, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    basis = np.stack([right, np.cross(right, direction), direction])
    p, t = points @ basis.T, triangles @ basis.T
    low, high = t[..., :2].min(axis=1), t[..., :2].max(axis=1)
    free = np.ones(len(p), bool)
    for part in np.array_split(np.argsort(p[:, 0]), max(len(p) // 50, 1)):
        q = p[part][None]
        # Only triangles over these neighbours can hide one of them.
        over = (high >= q[0, :, :2].min(axis=0)) & (low <= q[0, :, :2].max(axis=0))
        a, b, c = (t[over.all(axis=1)][:, None, k] for k in range(3))
        sides = [
            (v[..., 0] - u[..., 0]) * (q[..., 1] - u[..., 1])
            - (v[..., 1] - u[..., 1]) * (q[..., 0] - u[..., 0])
            for u, v in ((a, b), (b, c), (c, a))
        ]
        total = sides[0] + sides[1] + sides[2]
        inside = (np.sign(sides[0]) == np.sign(sides[1])) & (np.sign(sides[1]) == np.sign(sides[2]))
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (sides[1] * a[..., 2] + sides[2] * b[..., 2] + sides[0] * c[..., 2]) / total
        free[part] = ~(inside & (depth > q[..., 2])).any(axis=0)
    return free


def _solid_points(person: Person, bust: Bust) -> dict[str, np.ndarray]:
    return {p.name: p.place(bust) for p in mouth(person, bust.identity) if p.name != "tongue"}


FRONT = np.array([0.0, -1.0, 0.0])


@pytest.mark.parametrize("who", PEOPLE)
@pytest.mark.parametrize("expression", CLOSED | MOVED | OPEN)
def test_nothing_breaks_through_the_skin(model, lips_surface, who, expression):
    """What is seen is seen between the lips: its nearest skin is lip or mouth."""
    bust = model.identity(PEOPLE[who]).pose(Pose(expression=(CLOSED | MOVED | OPEN)[expression]))
    matrix, triangles = lips_surface
    vertices = matrix @ bust.vertices
    wet = matrix @ (model.masks["lips"] + model.masks["inside-mouth"])
    used = np.unique(triangles)
    tree = KDTree(vertices[used])
    for name, points in _solid_points(PEOPLE[who], bust).items():
        sample = points[::6]
        visible = _seen(sample, vertices[triangles], FRONT)
        if visible.any():
            outside = wet[used][tree.query(sample[visible])[1]] < 0.02
            assert not outside.any(), name
        if expression in CLOSED:
            # The head model's lips leave a slit of a millimetre; gums never show in it.
            assert visible.mean() < (0.12 if name.startswith("teeth") else 1e-9), name


@pytest.mark.parametrize("who", PEOPLE)
def test_open_mouths_show_teeth(model, lips_surface, who):
    matrix, triangles = lips_surface
    for expression in ("grin", "aah"):
        bust = model.identity(PEOPLE[who]).pose(Pose(expression=OPEN[expression]))
        skin = (matrix @ bust.vertices)[triangles]
        shown = _solid_points(PEOPLE[who], bust)
        upper = _seen(shown["teeth_upper"][::6], skin, FRONT).sum()
        assert upper > 8, expression


def test_lower_teeth_follow_the_jaw(model):
    identity = model.identity(Person())
    person = Person()
    lower = next(p for p in mouth(person, identity) if p.name == "teeth_lower")
    upper = next(p for p in mouth(person, identity) if p.name == "teeth_upper")
    shut, ajar = identity.neutral, identity.pose(Pose(expression={"jawOpen": 0.5}))
    drop = lower.place(shut)[:, 2] - lower.place(ajar)[:, 2]
    assert drop.mean() == pytest.approx(0.012, abs=0.005)
    np.testing.assert_allclose(upper.place(shut), upper.place(ajar), atol=1e-12)
    motion = jaw_motion(identity.pose(Pose(expression={"jawLeft": 1.0})))
    assert motion[0, 3] > 0.002
    np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-12)


def test_pieces_are_well_formed_and_turn_with_the_head(model):
    identity = model.identity(PEOPLE["old"])
    turned = identity.pose(Pose(head=(0.1, 0.05, 0.6)))
    for piece in mouth(PEOPLE["old"], identity):
        assert piece.part == Part.MOUTH_INTERIOR
        points = piece.place(identity.neutral)
        assert piece.faces.min() == 0 and piece.faces.max() == len(points) - 1
        assert np.isfinite(points).all()
        ordered = np.sort(piece.faces, axis=1)
        assert (np.diff(ordered, axis=1) > 0).all()
        motion = turned.bones["head"]
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        if piece.name != "tongue":
            np.testing.assert_allclose(piece.place(turned), moved, atol=1e-9)
        np.testing.assert_allclose(
            piece.place(turned.canonical), points, atol=1e-9, err_msg=piece.name
        )


def test_faces_of_teeth_and_gums_point_outwards(model):
    identity = model.identity(Person())
    for piece in mouth(Person(), identity):
        points = piece.place(identity.neutral)
        corner = points[piece.faces]
        normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
        middle = corner.mean(axis=1)
        front = np.flatnonzero(np.abs(middle[:, 0]) < 0.01)
        front = front[np.argsort(middle[front, 1])[:20]]
        assert (normal[front, 1] < 0).mean() > 0.8, piece.name
