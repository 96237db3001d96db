"""What a tracking becomes, against the head model in numpy and the generator's camera."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from assets_procedural.body.head import Bust, HeadModel, Identity
from assets_procedural.body.landmarks import landmarks
from assets_procedural.conventions import camera
from assets_procedural.conventions.camera import CameraSample
from assets_procedural.motion.poses import ARKIT_NAMES, Pose, PoseSettings, sample_pose
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from synthgen.stage.geometry import control_geometry, frame_of_head
from totalediting.geometry.field import check_control
from totalediting.geometry.identity import identity_basis
from totalediting.geometry.rig import camera_of, control_of, reframed
from totalediting.geometry.space import head_centre
from totalediting.geometry.tracking import FILL, FOCAL_MM, Tracking

SIDE = 96
POSES = {
    "neutral": Pose(),
    "turned": Pose(head=(0.2, -0.15, 0.6)),
    "far turned": Pose(head=(-0.7, 0.6, -1.3)),
    "shouting": Pose(
        expression={"jawOpen": 1.0, "eyeWideLeft": 0.9, "browInnerUp": 0.8, "mouthStretchLeft": 0.7}
    ),
    "winking": Pose(expression={"eyeBlinkLeft": 1.0, "cheekSquintLeft": 0.8, "eyeSquintLeft": 1.0}),
    "shut, looking down": Pose(
        expression={"eyeBlinkLeft": 0.7, "eyeBlinkRight": 1.0, "eyeWideRight": 0.6},
        gaze=(0.3, -0.4),
    ),
    "beyond full lids": Pose(expression={"eyeLookUpLeft": 0.4}, gaze=(-0.55, 0.5)),
    "lids against the gaze": Pose(
        expression={"eyeLookOutLeft": 0.7, "eyeLookInLeft": 0.9, "eyeLookDownLeft": 0.6},
        gaze=(-0.2, 0.1),
        head=(0.1, 0.1, -0.4),
    ),
    "sampled": sample_pose(np.random.default_rng(3), PoseSettings(neutral=0, talking=1)),
}
CAMERAS = (
    CameraSample(),
    CameraSample(yaw=0.7, pitch=-0.3, roll=0.2, focal_mm=35, fill=0.4, shift=(0.05, -0.1)),
    CameraSample(yaw=-1.4, pitch=0.5, roll=-0.4, focal_mm=120, fill=0.7, shift=(-0.02, 0.03)),
)


def tracking(coefficients: torch.Tensor, pose: Pose, shot: CameraSample = CAMERAS[0]) -> Tracking:
    """(1, …) what a perfect tracker says."""
    fields = Tracking(
        expression=torch.tensor([pose.expression.get(name, 0.0) for name in ARKIT_NAMES]),
        gaze=torch.tensor(pose.gaze),
        head=torch.tensor(pose.head),
        identity=coefficients,
        camera_yaw_pitch_roll=torch.tensor([shot.yaw, shot.pitch, shot.roll]),
        log_focal=torch.tensor([math.log(shot.focal_mm / FOCAL_MM)]),
        log_fill=torch.tensor([math.log(shot.fill / FILL)]),
        shift=torch.tensor(shot.shift),
        face=torch.zeros(10),
    )
    return Tracking(*(field.float()[None] for field in fields))


def joined(trackings: list[Tracking]) -> Tracking:
    return Tracking(*map(torch.cat, zip(*trackings, strict=True)))


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def coefficients(model: HeadModel) -> torch.Tensor:
    """Of a random person, 2.5 times as far from the mean."""
    person = sample_person(np.random.default_rng(11), PeopleSettings())
    return 2.5 * identity_basis().coefficients(person)


@pytest.fixture(scope="module")
def identity(model: HeadModel, coefficients: torch.Tensor) -> Identity:
    """The subject of those coefficients, standing elsewhere in the world."""
    basis, place = identity_basis(), np.array([0.3, -0.2, 1.5])
    rest, joints = (
        points(coefficients).double().numpy() + place for points in (basis.vertices, basis.joints)
    )
    return Identity(model, rest, joints)


def origin(bust: Bust) -> np.ndarray:
    return head_centre(landmarks(bust.canonical))


def degrees(a: torch.Tensor, b: torch.Tensor) -> float:
    """The largest angle between unit vectors."""
    return math.degrees(2 * math.asin(float((a - b).norm(dim=-1).max()) / 2))


@pytest.mark.parametrize("name", POSES)
def test_the_bust_is_the_head_model_posed(
    name: str, identity: Identity, coefficients: torch.Tensor
) -> None:
    bust = identity.pose(POSES[name])
    found = control_of(tracking(coefficients, POSES[name]))
    skin = bust.model.groups["skin"]
    pairs = ((found.posed, found.posed_normals, bust),)
    pairs += ((found.canonical, found.canonical_normals, bust.canonical),)
    for points, normals, true in pairs:
        assert points.shape == normals.shape == (1, len(skin), 3)
        expected = torch.from_numpy(true.vertices[skin] - origin(bust)).float()
        assert (points[0] - expected).norm(dim=-1).max() < 1e-5
        assert degrees(normals[0].double(), torch.from_numpy(true.normals[skin])) < 0.1


def test_vertices_are_in_the_order_of_the_dataset(
    identity: Identity, coefficients: torch.Tensor
) -> None:
    bust = identity.pose(POSES["sampled"])
    stored = control_geometry(bust)
    found = control_of(tracking(coefficients, POSES["sampled"]))
    expected = torch.from_numpy(stored["control_points"] - origin(bust)).float()
    torch.testing.assert_close(found.posed[0], expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("shot", CAMERAS)
@pytest.mark.parametrize("name", ["neutral", "far turned", "shouting"])
def test_the_camera_is_the_generators(
    name: str, shot: CameraSample, identity: Identity, coefficients: torch.Tensor
) -> None:
    bust = identity.pose(POSES[name])
    true = camera.resolve(shot, *frame_of_head(bust), SIDE)
    camera_to_world, intrinsics = camera_of(tracking(coefficients, POSES[name], shot), SIDE)
    expected = true.camera_to_world.copy()
    expected[:3, 3] -= origin(bust)
    expected, lens = (torch.from_numpy(a).float() for a in (expected, true.intrinsics))
    torch.testing.assert_close(camera_to_world[0], expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(intrinsics[0], lens, rtol=1e-6, atol=1e-6)


def all_of(seen: Tracking) -> tuple[torch.Tensor, ...]:
    return (*control_of(seen), *camera_of(seen, SIDE))


def test_a_batch_is_its_singles(coefficients: torch.Tensor) -> None:
    singles = [
        tracking(k * coefficients / 3, pose, CAMERAS[k % 3])
        for k, pose in enumerate(list(POSES.values())[1:5])
    ]
    alone = [torch.cat(parts) for parts in zip(*map(all_of, singles), strict=True)]
    for together, by_itself in zip(all_of(joined(singles)), alone, strict=True):
        torch.testing.assert_close(together, by_itself, rtol=0, atol=1e-6)


def test_no_gradients(coefficients: torch.Tensor) -> None:
    seen = Tracking(*(f.requires_grad_() for f in tracking(coefficients, POSES["sampled"])))
    assert not any(result.requires_grad for result in all_of(seen))


def test_autocast_and_halves_leave_the_points_exact(coefficients: torch.Tensor) -> None:
    seen = Tracking(*(f.bfloat16() for f in tracking(coefficients, POSES["sampled"])))
    plain = all_of(Tracking(*(f.float() for f in seen)))
    with torch.autocast("cpu", torch.bfloat16):
        cast = all_of(seen)
    for a, b in zip(cast, plain, strict=True):
        assert a.dtype == torch.float32 and torch.equal(a, b)


def test_the_model_takes_it(coefficients: torch.Tensor) -> None:
    check_control(control_of(tracking(coefficients, POSES["far turned"])), (1,))


def test_what_does_not_fit_is_an_error(coefficients: torch.Tensor) -> None:
    seen = tracking(coefficients, Pose())
    with pytest.raises(ValueError, match=r"gaze must be \(B, 2\), got \(1, 3\)"):
        control_of(seen._replace(gaze=torch.zeros(1, 3)))
    with pytest.raises(ValueError, match=r"log_fill must be \(B, 1\), got \(2, 1\)"):
        camera_of(seen._replace(log_fill=torch.zeros(2, 1)), SIDE)
    with pytest.raises(ValueError, match="side must be at least 1, got 0"):
        camera_of(seen, 0)


def test_a_video_reframed_about_the_posed_head_is_seen_by_the_same_camera() -> None:
    """Drawn about the head at rest, as the generator frames videos; told about the posed one."""
    generator = torch.Generator().manual_seed(4)
    drawn = Tracking(
        expression=0.5 * torch.rand(3, 52, generator=generator),
        gaze=torch.tensor([[0.2, -0.1]] * 3),
        head=torch.tensor([[0.2, 0.1, 0.4], [-0.2, 0.0, -0.5], [0.0, 0.0, 0.0]]),
        identity=torch.randn(3, 32, generator=generator),
        camera_yaw_pitch_roll=torch.tensor([[0.3, 0.1, 0.05]] * 3),
        log_focal=torch.zeros(3, 1),
        log_fill=torch.full((3, 1), 0.1),
        shift=torch.tensor([[0.02, -0.03]] * 3),
        face=torch.zeros(3, 10),
    )
    still = drawn._replace(
        expression=torch.zeros(3, 52), gaze=torch.zeros(3, 2), head=torch.zeros(3, 3)
    )
    found = reframed(drawn)
    assert (found.shift - drawn.shift).abs().max() > 0.005
    wanted, seen = camera_of(still, 128)[0], camera_of(found, 128)[0]
    # The origins differ by what the landmarks of an expression move.
    torch.testing.assert_close(wanted[:, :3, :3], seen[:, :3, :3])
    assert (wanted[:, :3, 3] - seen[:, :3, 3]).norm(dim=-1).max() < 1e-3
    again = reframed(still)
    torch.testing.assert_close(again.shift, still.shift, atol=1e-6, rtol=0)
    torch.testing.assert_close(again.log_fill, still.log_fill, atol=1e-6, rtol=0)
