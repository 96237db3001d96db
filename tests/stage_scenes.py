"""What `test_stage` asks of Blender; each function runs in a process of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets_procedural import panorama
from assets_procedural.motion import Pose
from assets_procedural.person import Beard, Hair, Person
from synthgen.camera import CameraSample, resolve
from synthgen.job import JobSpec, SubsetSpec
from synthgen.plan import EnvironmentUse, ShotPlan, SubjectPlan

SIZE = 64


def job() -> JobSpec:
    subset = SubsetSpec(kind="multiview", subjects=1, environments=1, views=1)
    return JobSpec(name="test", resolution=SIZE, samples=4, subsets={"test": subset})


def subject(person: Person, poses: list[Pose], cameras: list[CameraSample]) -> SubjectPlan:
    """A multi-view subject under one light, "gradient", with every pose seen by every camera."""
    shots = [
        ShotPlan(key=f"s000000_p{i:02d}", pose=i // len(cameras), camera=i % len(cameras), seed=i)
        for i in range(len(poses) * len(cameras))
    ]
    light = EnvironmentUse(id="gradient", rotation=0.4, exposure=0.0, seed=0)
    return SubjectPlan(
        subset="test", kind="multiview", index=0, key="s000000", seed=0, split="train",
        person=person, environments=(light,), poses=tuple(poses), cameras=tuple(cameras),
        shots=tuple(shots),
    )  # fmt: skip


def write_gradient(folder: Path, name: str, tint: tuple[float, float, float]) -> None:
    """A soft sky of one tint as `<name>.exr`."""
    direction = panorama.texel_directions(32)
    light = 2 + direction[..., 2:] + 0.3 * direction[..., :1]
    panorama.write(folder / f"{name}.exr", (light * tint).astype(np.float32), {})


def ball_under_a_spot(folder: Path, direction: np.ndarray, rotation: float) -> np.ndarray:
    """Where (3,), world, the light on a white ball comes from: one texel at `direction`, turned."""
    import bpy

    from synthgen.stage import scene
    from synthgen.stage.nodes import Graph

    sky = np.full((64, 128, 3), 1e-3, np.float32)
    distance = panorama.texel_directions(64) @ direction
    sky[np.unravel_index(distance.argmax(), distance.shape)] = 5000.0
    panorama.write(folder / "spot.exr", sky, {})

    scene.open_stage(SIZE, 16, "cpu", 1)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.1)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("white")
    graph = Graph(material)
    graph.output(graph.node("BsdfDiffuse", {"Color": (0.8, 0.8, 0.8)}).outputs[0])
    ball.data.materials.append(material)
    camera = resolve(CameraSample(fill=0.8, focal_mm=200), np.zeros(3), 0.2, SIZE)
    scene.set_camera(camera)
    scene.set_mode("beauty", 16)
    scene.set_light(folder / "spot.exr", rotation)
    light = scene.shoot_beauty(0)[..., :3].sum(axis=-1)
    pixels = camera.pixel_centres()
    offset = camera.unproject(pixels, np.full(pixels.shape[:2], -camera.position[1]))
    side = np.clip(0.01 - (offset**2).sum(axis=-1), 0, None)
    normal = (offset - camera.forward * np.sqrt(side)[..., None]) / 0.1
    lit = (light > 0.2 * light.max()) & (side > 0.001)
    towards = np.linalg.lstsq(normal[lit], light[lit], rcond=None)[0]  # Lambert: light ~ n . l
    return towards / np.linalg.norm(towards)


def bare_head(folder: Path) -> dict[str, np.ndarray]:
    """Labels of a bald, bare skin in a turned, open-mouthed pose, and the mesh that was shown."""
    from assets_procedural.head import HeadModel
    from synthgen.stage import scene
    from synthgen.stage.build import build_figure, pose_figure
    from synthgen.stage.geometry import frame_of_head

    person = Person(hair=Hair(style="bald"))
    identity = HeadModel.load().identity(person)
    scene.open_stage(SIZE, 4, "cpu", 1)
    figure = build_figure(person, identity, [])
    bust = identity.pose(Pose(expression={"jawOpen": 0.4}, head=(0.1, 0.05, 0.4)))
    pose_figure(figure, bust)
    camera = resolve(CameraSample(yaw=0.3, fill=0.7), *frame_of_head(bust), SIZE)
    scene.set_light(folder / "gradient.exr", 0.0)
    scene.set_camera(camera)
    scene.set_mode("beauty", 4)
    scene.shoot_beauty(0)
    scene.set_mode("labels", 4)
    labels = scene.shoot_labels(camera)
    return {
        "vertices": figure.subdivision.matrix @ bust.vertices,
        "faces": figure.subdivision.faces,
        "camera_to_world": camera.camera_to_world,
        "intrinsics": camera.intrinsics,
        "depth": labels.depth,
        "normal": labels.normal,
    }


def dressed(folder: Path, light: str) -> list:
    """The shots of a dressed, bearded person in two poses and two views under one light."""
    from synthgen.stage.render import render_subject

    person = Person(
        phenotypes={"gender": 0.1},
        hair=Hair(style="short", density=0.3),
        beard=Beard(style="stubble", density=0.3),
    )
    poses = [Pose(), Pose(expression={"mouthSmileLeft": 0.6}, gaze=(0.2, 0), head=(0.1, 0, -0.4))]
    cameras = [CameraSample(fill=0.6), CameraSample(yaw=0.7, pitch=0.2, fill=0.6)]
    plan = subject(person, poses, cameras)
    use = plan.environments[0].model_copy(update={"id": light})
    plan = plan.model_copy(update={"environments": (use,)})
    return render_subject(plan, job(), folder, "cpu", 1).shots
