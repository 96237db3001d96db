"""Moving least squares and the surface field: exact where theory says so, near truth on necks."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import normalize

from assets_procedural.body.head import Bust, HeadModel
from assets_procedural.motion.poses import Pose
from assets_procedural.person import Person
from totalediting.geometry.field import (
    Control,
    Field,
    Table,
    kabsch,
    nodes,
    quaternion_of,
    tabulate,
)
from totalediting.geometry.moving_least_squares import mls, mls_reference
from totalediting.geometry.space import BOX_HIGH, box
from totalediting.geometry.surface_field import nearest_triangle, surface_field

LOW, HIGH = torch.tensor([-0.26, -0.2, 0.28]), torch.tensor([0.26, 0.12, 0.83])


def bust(**pose) -> Bust:
    model = HeadModel.load()
    return model.identity(Person()).pose(Pose(**pose))


def control_of(bust: Bust) -> Control:
    skin, canonical = bust.model.groups["skin"], bust.canonical
    arrays = (bust.vertices, canonical.vertices, bust.normals, canonical.normals)
    return Control(*(torch.from_numpy(a[skin]) for a in arrays))


@pytest.fixture(scope="module")
def faces() -> Tensor:
    """The skin's triangles, as places among its vertices."""
    model = HeadModel.load()
    quads = np.searchsorted(model.groups["skin"], model.faces["skin"])
    return torch.from_numpy(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


@pytest.fixture(scope="module")
def turned() -> Control:
    """A bust that looks 35 degrees to its left."""
    return control_of(bust(head=(0.0, 0.0, math.radians(35))))


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.fixture(params=["by neighbourhoods", "at once"])
def way(request, monkeypatch) -> None:
    """Both ways of one computation; "at once" is that of a GPU."""
    for module in ("moving_least_squares", "field"):
        name = f"totalediting.geometry.{module}.favours_few_operations"
        monkeypatch.setattr(name, lambda _: request.param == "at once")


def around(generator: torch.Generator, count: int) -> Tensor:
    """Points (count, 3) in the bust's box, float64."""
    return LOW + (HIGH - LOW) * torch.rand(count, 3, generator=generator, dtype=torch.float64)


def anywhere(generator: torch.Generator, count: int) -> Tensor:
    """Points (count, 3) of model space in the box that is rendered, float64."""
    low, high = box(torch.zeros(0).double())
    return low + (high - low) * torch.rand(count, 3, generator=generator, dtype=torch.float64)


def in_model_space(control: Control) -> Control:
    """The bust about the middle of its head, within a centimetre or two."""
    middle = torch.tensor([0.0, 0.0, 0.68]).to(control.posed)
    return control._replace(posed=control.posed - middle, canonical=control.canonical - middle)


def on_surface(control: Control, faces: Tensor, generator: torch.Generator, count: int):
    """Posed and canonical points of the mesh and their normals, (count, 3) each."""
    corners = faces[torch.randint(len(faces), (count,), generator=generator)]
    share = -torch.rand(count, 3, 1, generator=generator, dtype=torch.float64).log()
    share = share / share.sum(1, keepdim=True)
    points = [(share * array[corners]).sum(1) for array in control]
    return points[0], points[1], normalize(points[2], dim=-1), normalize(points[3], dim=-1)


def angles(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between rotations (..., 3, 3); by the chord, which is exact for small ones."""
    chord = (a - b).flatten(-2).norm(dim=-1) / math.sqrt(8)
    return torch.rad2deg(2 * torch.arcsin(chord.clamp(max=1)))


def between(a: Tensor, b: Tensor) -> Tensor:
    return torch.rad2deg(2 * torch.arcsin(((a - b).norm(dim=-1) / 2).clamp(max=1)))


@pytest.mark.parametrize("alpha", [1.0, 1.5, 2.0, 3.0])
def test_no_motion_is_the_identity(generator, alpha):
    posed = 0.2 * torch.randn(100, 3, generator=generator, dtype=torch.float64)
    normals = normalize(posed, dim=-1)
    points = torch.cat([posed[:5], 0.3 * torch.randn(50, 3, generator=generator).double()])
    field = mls(points, Control(posed, posed, normals, normals), alpha=alpha)
    torch.testing.assert_close(field.position, points, atol=1e-9, rtol=0)
    # At a lone control point its one normal leaves the spin about it open.
    assert angles(field.rotation, torch.eye(3).double())[5:].max() < 1e-4
    torch.testing.assert_close(field.to_posed(normals[:5].repeat(11, 1))[:5], normals[:5])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("alpha", [1.0, 1.5, 2.0])
def test_a_rigid_motion_of_everything_is_reproduced(turned, faces, generator, alpha, dtype):
    turn = torch.from_numpy(Rotation.from_euler("xyz", [0.4, -1.1, 2.3]).as_matrix())
    shift = torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)
    posed, normals = turned.posed, turned.posed_normals
    control = Control(posed, posed @ turn.T + shift, normals, normals @ turn.T)
    points = torch.cat([around(generator, 200), posed[::200] + 1e-3])
    wanted = points @ turn.T + shift
    control, points = Control(*(a.to(dtype) for a in control)), points.to(dtype)
    for field in (mls(points, control, alpha), mls(points, control, alpha, clusters=256)):
        assert (field.position - wanted).abs().max() < 1e-6
        assert (field.rotation - turn).abs().max() < 1e-6
    field = surface_field(points, control, faces)
    assert (field.position - wanted).abs().max() < 1e-5
    # The frame of one small triangle shows the rounding of its corners.
    assert (field.rotation - turn).abs().max() < 1e-4


def test_control_points_are_interpolated_as_the_softening_vanishes(turned):
    index = torch.arange(0, 5465, 50)
    errors = []
    for epsilon in (1e-6, 1e-8, 1e-12):
        field = mls(turned.posed[index], turned, alpha=1.0, epsilon=epsilon)
        errors.append((field.position - turned.canonical[index]).norm(dim=-1).max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-7


@pytest.mark.parametrize("alpha", [1.0, 1.5, 2.0, 3.0])
def test_the_fast_way_equals_the_equations(turned, generator, alpha, way):
    beside = turned.posed[::100] + 0.002 * torch.randn(55, 3, generator=generator).double()
    points = torch.cat([around(generator, 100), beside, turned.posed[:5]])
    position, rotation = mls_reference(points, turned, alpha)
    field = mls(points, turned, alpha)
    assert (field.position - position).norm(dim=-1).max() < 1e-7
    assert angles(field.rotation, rotation).max() < 1e-3


def test_single_precision_stays_close(turned, generator):
    points = torch.cat([around(generator, 300), turned.posed[::20] + 0.001])
    wanted = mls(points, turned)
    found = mls(points.float(), Control(*(a.float() for a in turned)))
    assert found.position.dtype == found.quaternion.dtype == torch.float32
    assert (found.position - wanted.position).norm(dim=-1).max() < 1e-6
    angle = angles(found.rotation.double(), wanted.rotation)
    assert angle.max() < 0.05


def test_far_clusters_stay_close(turned, generator):
    points = around(generator, 2000)
    wanted, found = mls(points, turned), mls(points, turned, clusters=256)
    error = (found.position - wanted.position).norm(dim=-1)
    assert 0 < error.mean() < 2e-4
    assert error.quantile(0.99) < 1e-3
    angle = angles(found.rotation, wanted.rotation)
    assert angle.mean() < 0.15
    assert angle.quantile(0.99) < 1.0


def test_a_table_stays_close(turned, generator):
    control = in_model_space(turned)
    single = Control(*(a.float() for a in control))
    table = tabulate(lambda p: mls(p, single, clusters=256), 32, single.posed)
    points = anywhere(generator, 3000)
    wanted, found = mls(points, control), table(points.float())
    error = (found.position - wanted.position).norm(dim=-1)
    assert error.mean() < 5e-4
    assert error.quantile(0.99) < 2e-3
    angle = angles(found.rotation.double(), wanted.rotation)
    assert angle.mean() < 0.5
    assert angle.quantile(0.99) < 3.0
    assert torch.allclose(found.quaternion.norm(dim=-1), torch.ones(3000), atol=1e-6)


def test_tables_of_a_batch_come_apart_and_together(generator):
    def bent(points: Tensor) -> Field:
        quaternion = torch.tensor([1.0, 0, 0, 0]).expand(*points.shape[:-1], 4)
        factor = torch.tensor([1.0, 2.0, 3.0])[:, None, None]
        return Field(points * factor, quaternion)

    table = tabulate(bent, 8, torch.zeros(0), lead=(3,))
    again = Table.stack([table.unstack()[k] for k in (2, 0)])
    points = torch.rand(3, 20, 3, generator=generator)
    wanted = table(points).position[[2, 0]]
    assert torch.equal(again(points[[2, 0]]).position, wanted)


def test_a_mirrored_table_is_that_of_the_mirrored_bust(turned):
    """On average to a tenth of a millimetre: clusters are not mirrored."""
    across = torch.tensor([-1.0, 1, 1])
    control = Control(*(a.float() for a in in_model_space(turned)))
    other = Control(*(across * a for a in control))
    one, mirror = (
        tabulate(lambda p, c=c: mls(p, c, clusters=256), 16, across) for c in (control, other)
    )
    points = anywhere(torch.Generator().manual_seed(0), 500).float()
    wanted, found = mirror(points), one.mirrored()(points)
    assert (found.position - wanted.position).norm(dim=-1).mean() < 1e-4
    assert angles(found.rotation.double(), wanted.rotation.double()).mean() < 0.1
    assert (mirror(points).position - one(points).position).norm(dim=-1).mean() > 1e-3


def test_a_table_is_exact_at_its_nodes_and_extends_beyond_its_box():
    def field(points: Tensor) -> Field:
        angle = 3 * points[..., 0]
        turn = torch.stack([torch.cos(angle), *[0 * angle] * 2, torch.sin(angle)], -1)
        # q and -q mean one rotation; a table must not care.
        flipped = torch.where(points[..., 1:2] > 0.1, -turn, turn)
        return Field(points * torch.tensor([2.0, 3.0, 4.0]) + 1, flipped)

    table = tabulate(field, 9, torch.zeros(0))
    points = nodes(9, torch.zeros(0))[::7]
    torch.testing.assert_close(table(points).position, field(points).position)
    assert angles(table(points).rotation, field(points).rotation).max() < 0.2
    # Beyond the border its offset is kept.
    high = torch.tensor(BOX_HIGH)
    inside, outside = table(torch.stack([high, high + torch.tensor([0.5, 0.0, 0.0])])).position
    torch.testing.assert_close(outside - inside, torch.tensor([0.5, 0.0, 0.0]))


def test_nodes_are_finest_at_the_face():
    steps = nodes(16, torch.zeros(0)).view(16, 16, 16, 3)[7, 7, :, 0].diff()
    assert steps.min() < 0.018 and steps.max() > 0.08
    assert steps.argmin() == 7


def test_a_mouth_that_is_open_shuts():
    """Of a jaw's 3 cm, a table keeps four fifths: as many nodes, evenly spread, three quarters."""
    model = HeadModel.load()
    identity = model.identity(Person())
    shut, open_ = (
        in_model_space(control_of(identity.pose(Pose(expression={"jawOpen": x}))))
        for x in (0.0, 0.9)
    )
    straight = shut._replace(canonical=open_.posed, canonical_normals=open_.posed_normals)
    apart = (straight.posed - straight.canonical).norm(dim=-1)
    lips = straight.posed[apart > 0.6 * apart.max()]
    wanted = mls(lips, straight).position
    errors = []
    for count in (8, 16, 32):
        table = tabulate(lambda p: mls(p, straight, clusters=256), count, lips)
        errors.append((table(lips).position - wanted).norm(dim=-1).mean() / apart.max())
    assert errors[2] < errors[1] < errors[0]
    assert errors[1] < 0.22


def test_quaternions_agree_with_the_svd(generator, way):
    moments = torch.randn(500, 3, 3, generator=generator, dtype=torch.float64)
    mirrored = moments.det() < 0
    assert 100 < mirrored.sum() < 400
    rotation = Field(moments[:, 0], quaternion_of(moments)).rotation
    assert angles(rotation, kabsch(moments)).max() < 1e-5
    torch.testing.assert_close(rotation.det(), torch.ones(500).double())


@pytest.mark.parametrize("case", ["mirrored", "plane", "line", "point", "one"])
def test_rotations_are_proper_whatever_the_control_points(generator, case, way):
    posed = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    canonical = posed.clone()
    if case == "mirrored":
        canonical[:, 0] *= -1
    elif case == "plane":
        posed[:, 2] = 0
    elif case == "line":
        posed[:, 1:] = 0
    elif case == "point":
        posed[:] = canonical[:] = 0.1
    else:
        posed, canonical = posed[:1], canonical[:1]
    normals = normalize(canonical + 1e-6, dim=-1)
    mirrored = normals * torch.tensor([-1.0, 1.0, 1.0])
    field = mls(
        torch.randn(200, 3, generator=generator).double(),
        Control(posed, canonical, normals, mirrored),
    )
    assert field.position.isfinite().all()
    torch.testing.assert_close(field.rotation.det(), torch.ones(200).double())
    product = field.rotation @ field.rotation.mT
    torch.testing.assert_close(product, torch.eye(3).double().expand(200, 3, 3))


def test_nothing_to_align_is_the_identity(way):
    assert torch.equal(quaternion_of(torch.zeros(3, 3)), torch.tensor([1.0, 0, 0, 0]).double())


def test_far_away_points_are_finite(turned, way):
    points = torch.tensor([[1e4, 0.0, 0.0], [0.0, -1e6, 3.0], [0.0, 0.0, 0.5]])
    single = Control(*(a.float() for a in turned))
    for field in (mls(points, single, alpha=4.0), mls(points, single, clusters=64)):
        assert field.position.isfinite().all()
        assert field.quaternion.isfinite().all()


POSES = {
    "yaw": {"head": (0.0, 0.0, math.radians(35))},
    "pitch": {"head": (math.radians(25), 0.0, 0.0)},
    "all": {
        "head": (math.radians(15), math.radians(10), math.radians(35)),
        "expression": {"jawOpen": 0.7},
    },
}


@pytest.mark.parametrize("pose", POSES)
def test_turned_normals_are_the_true_normals_of_a_bent_bust(faces, generator, pose):
    """On the skin, with the default fall-off: half a millimetre, a third of a degree."""
    control = control_of(bust(**POSES[pose]))
    posed, canonical, normal, canonical_normal = on_surface(control, faces, generator, 2000)
    field = mls(posed, control)
    error = (field.position - canonical).norm(dim=-1)
    assert error.mean() < 5e-4
    assert error.quantile(0.99) < 3e-3
    turned_back = field.to_posed(canonical_normal)
    assert between(turned_back, normal).mean() < 0.3
    assert between(turned_back, normal).quantile(0.99) < 2.5
    torch.testing.assert_close(
        turned_back, (field.rotation.mT @ canonical_normal[..., None])[..., 0]
    )


def test_the_paper_s_fall_off_is_coarser_on_a_real_neck(turned, faces, generator):
    posed, canonical, *_ = on_surface(turned, faces, generator, 1000)
    error = [
        (mls(posed, turned, alpha).position - canonical).norm(dim=-1).mean() for alpha in (1.0, 2.0)
    ]
    assert error[0] > 10 * error[1]


def test_the_surface_field_is_exact_on_the_mesh(turned, faces, generator):
    posed, canonical, *_ = on_surface(turned, faces, generator, 1000)
    field = surface_field(posed, turned, faces)
    assert (field.position - canonical).norm(dim=-1).max() < 1e-9
    torch.testing.assert_close(field.rotation.det(), torch.ones(1000).double())


def test_the_surface_field_keeps_the_distance_along_the_normal(turned, faces, generator):
    posed, canonical, _, _ = on_surface(turned, faces, generator, 300)
    triangle, _, _ = nearest_triangle(posed, turned.posed[faces])

    def normal(vertices: Tensor) -> Tensor:
        a, b, c = vertices[faces[triangle]].unbind(1)
        return normalize(torch.linalg.cross(b - a, c - a), dim=-1)

    found = surface_field(posed + 2e-4 * normal(turned.posed), turned, faces)
    wanted = canonical + 2e-4 * normal(turned.canonical)
    # Where another triangle is nearer to the lifted point, its own answer is as good.
    assert (found.position - wanted).norm(dim=-1).quantile(0.9) < 1e-6


def test_nearest_triangles_are_trimesh_s(turned, faces, generator):
    mesh = trimesh.Trimesh(turned.posed.numpy(), faces.numpy(), process=False)
    points = torch.cat(
        [around(generator, 200), turned.posed[::50] + 1e-3, 4 * around(generator, 9)]
    )
    _, distance, _ = trimesh.proximity.closest_point(mesh, points.numpy())
    _, foot, share = nearest_triangle(points, turned.posed[faces])
    excess = (points - foot).norm(dim=-1).numpy() - distance
    assert excess.max() < 1e-9  # trimesh's own are up to 10 micrometres too long on slivers
    assert excess.min() > -2e-5
    assert share.min() >= 0
    torch.testing.assert_close(share.sum(-1), torch.ones(len(points)).double())


def test_batches_are_their_parts(turned, faces, generator):
    other = control_of(bust(head=(0.3, 0.0, 0.0)))
    both = Control(*(torch.stack(pair) for pair in zip(turned, other, strict=True)))
    points = torch.stack([around(generator, 40), around(generator, 40)])
    for field in (mls, lambda p, c: surface_field(p, c, faces)):
        whole, parts = field(points, both), (field(points[0], turned), field(points[1], other))
        for k in range(2):
            assert torch.equal(whole.position[k], parts[k].position)
            assert torch.equal(whole.quaternion[k], parts[k].quaternion)
    table = tabulate(lambda p: mls(p, both), 4, points, lead=(2,))
    alone = tabulate(lambda p: mls(p, other), 4, points)
    torch.testing.assert_close(table(points).position[1], alone(points[1]).position)


def test_gradients_stop_at_the_field_and_reach_the_normals(turned):
    points = turned.posed[:10].clone().requires_grad_()
    field = mls(points, turned)
    assert not field.position.requires_grad
    normals = turned.canonical_normals[:10].clone().requires_grad_()
    assert torch.autograd.gradcheck(field.to_posed, (normals,))


def bad(control: Control, **changes: Tensor) -> Control:
    return control._replace(**changes)


def test_bad_input_is_named(turned, faces):
    points = torch.zeros(4, 3, dtype=torch.float64)
    cases = [
        (lambda: mls(points[:, :2], turned), r"points must be .* got \(4, 2\)"),
        (lambda: mls(points * torch.nan, turned), r"points \(4, 3\) hold NaN"),
        (lambda: mls(points.long(), turned), r"points must be .* floats"),
        (
            lambda: mls(points[None], turned),
            r"control.posed must be \(1, 'V', 3\), got \(5465, 3\)",
        ),
        (lambda: mls(points, bad(turned, canonical=points)), r"control.canonical must be \(5465"),
        (lambda: mls(points, bad(turned, posed=turned.posed / 0)), "control.posed .* NaN or Inf"),
        (
            lambda: mls(points, bad(turned, posed_normals=2 * turned.posed_normals)),
            r"control.posed_normals \(5465, 3\) must hold unit",
        ),
        (lambda: mls(points, turned, alpha=0.0), "alpha must be in"),
        (lambda: mls(points, turned, epsilon=0.0), "epsilon must be positive"),
        (lambda: mls(points, turned, clusters=0), "clusters must be at least 1"),
        (lambda: surface_field(points, turned, faces.T), r"faces must be \(F, 3\), got"),
        (lambda: tabulate(lambda p: mls(p, turned), 1, points), "resolution must be at least 2"),
    ]
    for call, message in cases:
        with pytest.raises(ValueError, match=message):
            call()
