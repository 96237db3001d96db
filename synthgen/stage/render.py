"""`render_subject`: a plan becomes shots. The one function that a render worker calls."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import numpy as np

from assets_procedural.assembly import pieces
from assets_procedural.body.head import Bust, HeadModel
from assets_procedural.body.landmarks import PUPILS, landmarks
from assets_procedural.conventions import panorama_reading
from assets_procedural.conventions.camera import Camera, resolve
from assets_procedural.conventions.colour import srgb_encode, to_bytes
from synthgen.dataset.passes import PASSES
from synthgen.dataset.shot import RenderedSubject, Shot, describe
from synthgen.planning.job import JobSpec, LensSettings
from synthgen.planning.light_basis import basis_samples
from synthgen.planning.plan import ShotPlan, SubjectPlan
from synthgen.planning.turning import turned
from synthgen.stage import photograph, scene
from synthgen.stage.build import build_figure, pose_figure, strands_for_pixel
from synthgen.stage.geometry import canonical_mesh, control_geometry, frame_of_head, visible
from synthgen.stage.light import shooting
from synthgen.stage.light.denoising import denoiser


def render_subject(
    subject: SubjectPlan, job: JobSpec, environments: Path, device: str, threads: int
) -> RenderedSubject:
    """Render every shot of a subject.

    `environments` is the folder that holds `<id>.exr`; `device` is cpu, cuda, optix, hip or metal;
    `threads` 0 takes every core.

    Raises:
        RuntimeError: the device is not there.
    """
    clock = _Clock()
    subject = turned(subject, environments)
    with clock("build"):
        identity = _head_model().identity(subject.person)
        scene.open_stage(job.resolution, job.samples, device, threads)
        closest = max(camera.fill for camera in subject.cameras)
        pixel = frame_of_head(identity.neutral)[1] / (closest * job.resolution)
        parts = strands_for_pixel(pieces(subject.person, identity), pixel)
        figure = build_figure(subject.person, identity, parts)
    by_pose: dict[int, list[ShotPlan]] = defaultdict(list)
    for shot in subject.shots:
        by_pose[shot.pose].append(shot)

    shots = {}
    for pose, taken in by_pose.items():
        with clock("pose"):
            scene.hold_scene()
            bust = identity.pose(subject.poses[pose])
            pose_figure(figure, bust)
            centre, height = frame_of_head(
                bust if subject.kind == "multiview" else identity.neutral
            )
            cameras = {
                s.key: resolve(subject.cameras[s.camera], centre, height, job.resolution)
                for s in taken
            }
        with clock("beauty"):
            pupils = landmarks(bust)[list(PUPILS.values())]
            views = [
                shooting.View(s, c := cameras[s.key], float(c.project(pupils)[1].mean()))
                for s in taken
            ]
            lit = shooting.shoot(
                views, subject.environments, environments, job, denoiser(device, threads)
            )
        scene.set_mode("labels", job.samples)
        for shot in taken:
            camera = cameras[shot.key]
            with clock("labels"):
                scene.set_camera(camera)
                labels = scene.shoot_labels(camera)
            with clock("develop"):
                shots[shot.key] = compose_shot(
                    subject, shot, job, environments, camera, bust, lit[shot.key], labels
                )
        scene.release_scene()
    share = {name: seconds / len(subject.shots) for name, seconds in clock.seconds.items()}
    for shot in shots.values():
        shot.cost = dict(share)
    return RenderedSubject(
        shots=[shots[s.key] for s in subject.shots],
        mesh_glb=canonical_mesh(subject.person, identity, figure),
        parameters={"person": subject.person.model_dump(mode="json"), "seed": subject.seed},
    )


def compose_shot(
    subject: SubjectPlan,
    plan: ShotPlan,
    job: JobSpec,
    environments: Path,
    camera: Camera,
    bust: Bust,
    seen: shooting.Lit,
    labels: scene.Labels,
) -> Shot:
    """Develop the pictures of one shot and gather its labels, geometry and metadata."""
    alpha = to_bytes(photograph.matte(seen.coverage)).astype(np.float32) / 255
    linear = [np.concatenate([light, alpha[..., None]], axis=-1) for light in seen.light]
    surface = photograph.mean_surface(seen.surface[..., :6], seen.surface[..., 6:])
    surface = surface * alpha[..., None]
    labels = labels | {"albedo": surface[..., :3], "normal": surface[..., 3:]}
    colour = job.image.background_colour
    distance = float(np.linalg.norm(frame_of_head(bust)[0] - camera.position))
    pictures, factors = [], []
    for image, use in zip(linear, subject.environments, strict=True):
        factor = photograph.face_exposure(image, labels["albedo"], labels["parts"])
        background: np.ndarray | tuple[float, float, float] | None = colour
        if job.image.background == "environment":
            around = _panorama(environments / f"{use.id}.exr")
            background = photograph.behind(around, camera, use.rotation, distance)
            factor *= photograph.spared(factor * background, alpha)
        factor *= 2.0**use.exposure
        rng = np.random.default_rng([use.seed, plan.seed])
        factors.append(factor)
        pictures.append(
            photograph.develop(image[..., :3], alpha, factor, background, job.lens, rng)
        )

    points = landmarks(bust)
    pixels, depth = camera.project(points)
    meta = describe(
        subject,
        plan,
        camera.camera_to_world,
        camera.intrinsics,
        (camera.width, camera.height),
        pixels,
        visible(pixels, depth, labels["depth"]),
    )
    meta["exposures"] = factors
    if job.lens != LensSettings():
        meta["lens"] = job.lens.model_dump(mode="json", exclude_none=True)
    if samples := basis_samples(job, len(subject.environments)):
        meta["light_basis"] = {"samples": samples}
    geometry = control_geometry(bust)
    meta["joints"] = list(bust.bones)
    geometry["landmarks"] = points.astype(np.float32)
    geometry["landmarks_canonical"] = landmarks(bust.canonical).astype(np.float32)
    passes = {p.name: labels[p.name].astype(p.dtype) for p in PASSES if p.layer}
    passes["albedo"] = to_bytes(srgb_encode(labels["albedo"]))
    passes["alpha"] = to_bytes(alpha)
    return Shot(
        key=plan.key,
        rgb=np.stack(pictures),
        hdr=np.stack(linear).astype(np.float16) if job.image.linear else None,
        passes=passes,
        geometry=geometry,
        meta=meta,
    )


@lru_cache(maxsize=1)
def _head_model() -> HeadModel:
    return HeadModel.load()


@lru_cache(maxsize=10)
def _panorama(path: Path) -> np.ndarray:
    return panorama_reading.load(path)


class _Clock:
    """Seconds spent under each name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - start
