"""What `test_stage` and `test_ball` ask of Blender; each function runs in a process of its own."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets_procedural.conventions import panorama, panorama_files
from assets_procedural.conventions.camera import Camera, CameraSample, resolve
from assets_procedural.motion.poses import Pose
from assets_procedural.person import Beard, Glasses, Hair, Person
from synthgen.planning.job import JobSpec, SubsetSpec
from synthgen.planning.plan import EnvironmentUse, ShotPlan, SubjectPlan

if TYPE_CHECKING:
    from synthgen.stage.nodes import Graph

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
    panorama_files.write(folder / f"{name}.exr", (light * tint).astype(np.float32), {})


SUN = np.array([0.5, -0.7, 0.6]) / np.linalg.norm([0.5, -0.7, 0.6])


def write_skies(folder: Path) -> None:
    """A soft sky, and one of other units with a sun at `SUN`: "soft" and "sunny"."""
    direction = panorama.texel_directions(128)
    soft = (2 + direction[..., 2:] + 0.5 * direction[..., :1]) * np.array([1.0, 0.8, 0.5])
    sunny = 100 * soft
    sunny[direction @ SUN > np.cos(0.03)] = 3e5 * np.array([1.0, 0.9, 0.7])
    for name, light in (("soft", soft), ("sunny", sunny)):
        panorama_files.write(folder / f"{name}.exr", light.astype(np.float32), {})


def ball_under_a_spot(folder: Path, direction: np.ndarray, rotation: float) -> np.ndarray:
    """Where (3,), world, the light on a white ball comes from: one texel at `direction`, turned."""
    from synthgen.stage import scene

    sky = np.full((64, 128, 3), 1e-3, np.float32)
    distance = panorama.texel_directions(64) @ direction
    sky[np.unravel_index(distance.argmax(), distance.shape)] = 5000.0
    panorama_files.write(folder / "spot.exr", sky, {})

    camera = _before_a_white_ball(SIZE, 16)
    scene.set_light(folder / "spot.exr", rotation)
    light = scene.shoot_beauty(0, camera).light[0].sum(axis=-1)
    pixels = camera.pixel_centres()
    offset = camera.unproject(pixels, np.full(pixels.shape[:2], -camera.position[1]))
    side = np.clip(0.01 - (offset**2).sum(axis=-1), 0, None)
    normal = (offset - camera.forward * np.sqrt(side)[..., None]) / 0.1
    lit = (light > 0.2 * light.max()) & (side > 0.001)
    towards = np.linalg.lstsq(normal[lit], light[lit], rcond=None)[0]  # Lambert: light ~ n . l
    return towards / np.linalg.norm(towards)


def matte_ball(
    light: Path, rotation: float, colour: tuple[float, float, float], samples: int
) -> np.ndarray:
    """A Lambert ball of that colour as Cycles lights it: (SIZE, SIZE, 3), linear."""
    from synthgen.stage import scene

    scene.open_stage(SIZE, samples, "cpu", 1)
    graph = _add_ball(256)
    graph.output(graph.node("BsdfDiffuse", {"Color": colour}).outputs[0])
    scene.set_light(light, rotation)
    return _shoot_ball(samples)


def phong_ball(light: Path, rotation: float, exponent: int, samples: int) -> np.ndarray:
    """The normalised shading s_s(exponent) of a ball, integrated by Blender's nodes alone.

    (SIZE, SIZE, 3), linear. Cycles has no Phong closure. So the ball emits what the environment
    shows in random directions about the reflected viewing direction, of density (r.l)^exponent,
    and the average over a pixel's samples is the integral.
    """
    import bpy

    from synthgen.stage import scene

    scene.open_stage(SIZE, samples, "cpu", 1)
    graph = _add_ball(256)
    surface = graph.node("NewGeometry").outputs
    # White noise hashes the bits of the position, which differ from one sample to the next.
    noise = graph.node("TexWhiteNoise", {"Vector": surface["Position"]}, noise_dimensions="3D")
    random = graph.node("SeparateColor", {0: noise.outputs["Color"]}).outputs
    view = graph.combine("MULTIPLY", surface["Incoming"], (-1.0, -1.0, -1.0))
    axis = graph.combine("REFLECT", view, surface["Normal"])
    side = graph.node(
        "VectorMath",
        {0: graph.combine("CROSS_PRODUCT", axis, (0.3, 0.5, 0.8))},
        operation="NORMALIZE",
    ).outputs["Vector"]
    other = graph.combine("CROSS_PRODUCT", axis, side)
    image = bpy.data.images.load(str(light))
    image.colorspace_settings.name = "Linear Rec.709"
    # Sixteen points that cover the square evenly, shifted at random, make less noise than one.
    points = 16
    total = (0.0, 0.0, 0.0)
    for i in range(points):
        first = graph.math("FRACT", graph.math("ADD", random[0], i / points))
        second = graph.math("FRACT", graph.math("ADD", random[1], i * 0.618034))
        cosine = graph.math("POWER", first, 1.0 / (exponent + 1))
        square = graph.math("MULTIPLY", cosine, cosine)
        sine = graph.math("SQRT", graph.math("SUBTRACT", 1.0, square))
        angle = graph.math("MULTIPLY", second, 2.0 * np.pi)
        direction = graph.combine("MULTIPLY", axis, cosine)
        for along, turn in ((side, "COSINE"), (other, "SINE")):
            share = graph.math("MULTIPLY", sine, graph.math(turn, angle))
            direction = graph.combine("ADD", direction, graph.combine("MULTIPLY", along, share))
        turned = graph.node("Mapping", {"Vector": direction}, vector_type="TEXTURE")
        turned.inputs["Rotation"].default_value = (0.0, 0.0, rotation)
        inputs = {"Vector": turned.outputs[0]}
        texture = graph.node("TexEnvironment", inputs, image=image, interpolation="Cubic")
        total = graph.combine("ADD", total, texture.outputs["Color"])
    graph.output(graph.node("Emission", {"Color": total, "Strength": 1.0 / points}).outputs[0])
    return _shoot_ball(samples)


def _before_a_white_ball(resolution: int, samples: int) -> Camera:
    """A camera before a ball that fills the picture."""
    from synthgen.stage import scene

    scene.open_stage(resolution, samples, "cpu", 1)
    graph = _add_ball(64)
    graph.output(graph.node("BsdfDiffuse", {"Color": (0.8, 0.8, 0.8)}).outputs[0])
    camera = resolve(CameraSample(fill=0.8, focal_mm=200), np.zeros(3), 0.2, resolution)
    scene.set_camera(camera)
    scene.set_mode("beauty", samples)
    return camera


def _add_ball(segments: int) -> Graph:
    """A smooth ball of radius 0.1 m at the origin; returns its material's graph, empty."""
    import bpy

    from synthgen.stage.nodes import Graph

    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=segments // 2, radius=0.1)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("ball")
    ball.data.materials.append(material)
    return Graph(material)


def _shoot_ball(samples: int) -> np.ndarray:
    """The ball fills the picture: seen along +Y, without perspective, through pixel centres."""
    import bpy

    from synthgen.stage import scene

    viewer = bpy.context.scene.camera
    viewer.matrix_world = np.array([[1, 0, 0, 0], [0, 0, -1, -1], [0, 1, 0, 0], [0, 0, 0, 1]]).T
    viewer.data.type = "ORTHO"
    viewer.data.ortho_scale = 0.2
    scene.set_mode("beauty", samples)
    settings = bpy.context.scene
    settings.cycles.filter_width = 0.01
    return scene.render_layers()["Combined"][..., :3]


def bare_head(folder: Path) -> dict[str, np.ndarray]:
    """Labels of a bald, bare skin in a turned, open-mouthed pose, and the mesh that was shown.

    Relief, which bends the stored normals away from the mesh's, is taken off the skin.
    """
    import bpy

    from assets_procedural.body.head import HeadModel
    from synthgen.stage import scene
    from synthgen.stage.build import build_figure, pose_figure
    from synthgen.stage.geometry import frame_of_head

    person = Person(hair=Hair(style="bald"))
    identity = HeadModel.load().identity(person)
    scene.open_stage(SIZE, 4, "cpu", 1)
    figure = build_figure(person, identity, [])
    for material in bpy.data.materials:
        for node in material.node_tree.nodes:
            if node.type == "BUMP":
                node.inputs["Strength"].default_value = 0.0
    bust = identity.pose(Pose(expression={"jawOpen": 0.4}, head=(0.1, 0.05, 0.4)))
    pose_figure(figure, bust)
    camera = resolve(CameraSample(yaw=0.3, fill=0.7), *frame_of_head(bust), SIZE)
    scene.set_light(folder / "gradient.exr", 0.0)
    scene.set_camera(camera)
    scene.set_mode("beauty", 4)
    mean = scene.shoot_beauty(0, camera)
    scene.set_mode("labels", 4)
    labels = scene.shoot_labels(camera)
    return {
        "vertices": figure.subdivision.matrix @ bust.vertices,
        "faces": figure.subdivision.faces,
        "camera_to_world": camera.camera_to_world,
        "intrinsics": camera.intrinsics,
        "depth": labels["depth"],
        "normal": labels["normal"],
        "mean_normal": mean.surface[..., 3:6],
        "coverage": mean.surface[..., 6],
    }


def furnace() -> dict[str, np.ndarray]:
    """A pair of eyes in light of 1 from everywhere, linear (SIZE, SIZE, 3) each.

    "bare" without clear surfaces, "eyes" with corneas and tears, "glasses" with lenses.
    """
    import bpy

    from assets_procedural.assembly import pieces
    from assets_procedural.body.head import HeadModel
    from assets_procedural.body.landmarks import landmarks
    from synthgen.stage import scene
    from synthgen.stage.build import build_figure
    from synthgen.stage.nodes import Graph

    person = Person(hair=Hair(style="bald"), glasses=Glasses())
    identity = HeadModel.load().identity(person)
    scene.open_stage(SIZE, 64, "cpu", 1)
    figure = build_figure(person, identity, pieces(person, identity))
    graph = Graph(bpy.context.scene.world)
    light = graph.node("Background", {"Color": (1.0, 1.0, 1.0)})
    graph.node("OutputWorld", {"Surface": light.outputs[0]})
    eyes = landmarks(identity.neutral)[36:48].mean(axis=0)
    scene.set_camera(resolve(CameraSample(fill=2.0), eyes, 0.2, SIZE))
    scene.set_mode("beauty", 64)
    images = {}
    for name, shown in {"bare": (), "eyes": ("cornea", "tear"), "glasses": ("lens",)}.items():
        for piece, object_ in figure.pieces:
            if getattr(piece, "hidden_from_labels", False):
                object_.hide_render = piece.material not in shown
        images[name] = scene.render_layers()["Combined"][..., :3]
    return images


def dressed(folder: Path, light: str) -> list:
    """The shots of a dressed, bearded person in two poses and two views under one light.

    What Cycles says of it is in `folder`, in `<light>.log`.
    """
    from synthgen.farm.process import redirect
    from synthgen.stage.render import render_subject

    redirect(folder / f"{light}.log")

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


def denoisings() -> dict[str, np.ndarray]:
    """What the denoiser makes of noise: "light" with one thread and with "two", "coverage"."""
    from synthgen.stage.light.denoising import Denoiser

    rng = np.random.default_rng(0)
    noisy = rng.exponential(size=(SIZE, SIZE, 3)).astype(np.float32)
    noisy[3, 5] = np.nan
    flat = np.full_like(noisy, 0.5)
    covered = (rng.random((SIZE, SIZE)) < 0.7).astype(np.float32)
    one, two = Denoiser("cpu", 1), Denoiser("cpu", 2)
    return {
        "light": one.light(noisy, flat, flat),
        "two": two.light(noisy, flat, flat),
        "coverage": one.coverage(covered),
        "whole": one.coverage(np.ones_like(covered)),
    }


def denoised_with_shared_guides(lights: int) -> list[str]:
    """What the denoiser is asked for in a shot under so many lights."""
    from synthgen.stage.light import shooting
    from synthgen.stage.light.denoising import Denoiser

    asked: list[str] = []

    class Counting(Denoiser):
        def __init__(self) -> None:
            pass

        def _run(self, images: dict[str, np.ndarray], *flags: str) -> np.ndarray:
            asked.append("+".join(images))
            return np.zeros((SIZE, SIZE, 3), np.float32)

    planes = np.zeros((SIZE, SIZE, 7), np.float32)
    shooting.denoised([planes[..., :3]] * lights, planes, planes[..., :6], Counting())
    return asked


def held_scene(folder: Path) -> dict[str, np.ndarray]:
    """A ball, the scene held between renders: pictures by "seed_samples"."""
    from synthgen.stage import scene

    camera = _before_a_white_ball(SIZE, 2)
    scene.hold_scene()
    scene.set_light(folder / "gradient.exr", 0.0)
    images = {}
    for seed, samples in ((1, 2), (2, 2), (1, 2), (2, 32)):
        scene.set_mode("beauty", samples)
        images.setdefault(f"{seed}_{samples}", []).append(scene.shoot_beauty(seed, camera).light)
    return {name: np.stack(taken) for name, taken in images.items()}


def ball_in_a_basis(folder: Path, resolution: int) -> dict[str, np.ndarray]:
    """A ball under "soft" and "sunny", turned: (2, N, N, 3) each, linear, with noise.

    "worlds" one by one, "basis" at once, "parts" likewise but in three parts.
    """
    from synthgen.stage import scene
    from synthgen.stage.light.dome import set_dome
    from synthgen.stage.light.patches import basis

    uses = [
        EnvironmentUse(id=name, rotation=rotation, exposure=0.0, seed=0)
        for name, rotation in (("soft", 0.7), ("sunny", -1.9))
    ]
    camera = _before_a_white_ball(resolution, 64)
    worlds = []
    for use in uses:
        scene.set_light(folder / f"{use.id}.exr", use.rotation)
        worlds.append(scene.shoot_beauty(0, camera).light[0])
    lights = basis(uses, folder)
    weights = dict(zip(set_dome(lights), lights.weights.swapaxes(0, 1), strict=True))
    whole = scene.shoot_beauty(0, camera, weights).light
    parts = []
    edges = [0, resolution // 3, resolution // 2 + 1, resolution]
    for rows in itertools.pairwise(edges):
        scene.set_part(rows)
        parts.append(scene.shoot_beauty(0, camera, weights).light)
    return {"worlds": np.stack(worlds), "basis": whole, "parts": np.concatenate(parts, axis=1)}
