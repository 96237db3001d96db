"""What a frame costs and what samples buy, on this project's own heads.

    python benchmarks/rendering.py [--subjects 3] [--resolutions 128 256 512] [--reference 512]

Prints two tables. First: CPU seconds of each step on one thread, and the frames per
core-hour that follow for the paper's two kinds of subset. Second: PSNR of the display-referred
picture (foreground over black) against a converged render, by samples per pixel.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import report

from synthgen.farm.process import redirect

if TYPE_CHECKING:  # processes of their own load Blender
    from assets_procedural.body.head import Identity
    from synthgen.planning.plan import SubjectPlan
    from synthgen.stage.build import Figure

STEPS = ("build", "pose", "sync", "sample", "denoise", "guides", "labels", "develop", "write")
SAMPLES = (4, 8, 16, 32, 64)


def measure(index: int, resolution: int) -> dict[str, float]:
    """CPU seconds of each step for subject `index`; `sample` is for one sample of one frame.

    `denoise` is for the colour of a frame, `guides` for what all lights of a shot share.
    """
    from assets_procedural.body.head import HeadModel
    from assets_procedural.conventions.camera import resolve
    from synthgen.dataset.shards import encode
    from synthgen.stage import render, scene
    from synthgen.stage.build import pose_figure
    from synthgen.stage.geometry import frame_of_head
    from synthgen.stage.light import shooting
    from synthgen.stage.light.denoising import denoiser

    job, subject, folder = _subject(index, resolution)
    model = HeadModel.load()
    seconds = {}

    @contextmanager
    def timed(step: str) -> Iterator[None]:
        with report.clock() as took:
            yield
        seconds[step] = took.cpu_seconds

    with timed("build"):
        identity = model.identity(subject.person)
        scene.open_stage(resolution, 2, "cpu", 1)
        scene.hold_scene()
        figure = _figure(subject, identity, resolution)
    with timed("pose"):
        bust = identity.pose(subject.poses[0])
        pose_figure(figure, bust)

    camera = resolve(subject.cameras[0], *frame_of_head(bust), resolution)
    scene.set_camera(camera)
    lights = subject.environments
    scene.set_mode("beauty", 2)
    scene.set_light(folder / f"{lights[0].id}.exr", lights[0].rotation)
    scene.shoot_beauty(0, camera)  # compiles kernels and uploads the scene

    def frame(samples: int, light: int) -> float:
        scene.set_mode("beauty", samples)
        scene.set_light(folder / f"{lights[light].id}.exr", lights[light].rotation)
        with report.clock() as took:
            scene.shoot_beauty(0, camera)
        return took.cpu_seconds

    scene.release_scene()
    scene.hold_scene()  # so that the first frame builds the BVH, as that of every pose does
    first, few, many = frame(2, 0), frame(2, 1), frame(10, 0)
    seconds["pose"] += max(0.0, first - few)
    seconds["sample"] = (many - few) / 8
    seconds["sync"] = max(0.0, few - 2 * seconds["sample"])

    scene.set_mode("beauty", 8)
    noisy = scene.shoot_beauty(1, camera)
    oidn = denoiser("cpu", 1)

    def denoised(lights: int) -> shooting.Lit:
        return shooting.denoised(list(noisy.light) * lights, noisy.surface, noisy.guides, oidn)

    denoised(1)  # reads the networks
    with timed("guides"):
        denoised(0)
    with timed("denoise"):
        seen = denoised(2)
    seconds["denoise"] = max(0.0, seconds["denoise"] - seconds["guides"]) / 2
    scene.set_mode("labels", 8)
    with timed("labels"):
        labels = scene.shoot_labels(camera)
    with timed("develop"):
        args = (subject, subject.shots[0], job, folder, camera, bust, seen, labels)
        shot = render.compose_shot(*args)
    with timed("write"):
        encode(shot)
    return seconds


def fidelity(index: int, resolution: int, reference: int) -> list[float]:
    """PSNR in dB of each entry of SAMPLES against `reference` samples, both denoised."""
    from assets_procedural.body.head import HeadModel
    from assets_procedural.conventions.camera import resolve
    from assets_procedural.conventions.colour import display
    from synthgen.stage import photograph, scene
    from synthgen.stage.build import pose_figure
    from synthgen.stage.geometry import frame_of_head
    from synthgen.stage.light import shooting
    from synthgen.stage.light.denoising import denoiser

    _, subject, folder = _subject(index, resolution)
    identity = HeadModel.load().identity(subject.person)
    scene.open_stage(resolution, 4, "cpu", 1)
    scene.hold_scene()
    figure = _figure(subject, identity, resolution)
    bust = identity.pose(subject.poses[0])
    pose_figure(figure, bust)
    camera = resolve(subject.cameras[0], *frame_of_head(bust), resolution)
    scene.set_camera(camera)
    light = subject.environments[0]
    scene.set_light(folder / f"{light.id}.exr", light.rotation)

    def shoot(samples: int, seed: int) -> np.ndarray:
        scene.set_mode("beauty", samples)
        noisy = scene.shoot_beauty(seed, camera)
        oidn = denoiser("cpu", 1)
        return shooting.denoised(list(noisy.light), noisy.surface, noisy.guides, oidn).light[0]

    truth = shoot(reference, 99)
    scene.set_mode("labels", 4)
    labels = scene.shoot_labels(camera)
    exposure = photograph.face_exposure(truth, labels["albedo"], labels["parts"])
    shown = display(exposure * truth)
    result = []
    for samples in SAMPLES:
        error = display(exposure * shoot(samples, 7)) - shown
        result.append(float(-10 * np.log10(np.mean(error**2))))
    return result


def _figure(subject: SubjectPlan, identity: Identity, resolution: int) -> Figure:
    """The subject on the stage, with as many strands as `render_subject` gives such pixels."""
    from assets_procedural.assembly import pieces
    from synthgen.stage.build import build_figure, strands_for_pixel
    from synthgen.stage.geometry import frame_of_head

    pixel = frame_of_head(identity.neutral)[1] / (subject.cameras[0].fill * resolution)
    parts = strands_for_pixel(pieces(subject.person, identity), pixel)
    return build_figure(subject.person, identity, parts)


def _subject(index: int, resolution: int):
    """The `index`-th subject of a fixed job, and a folder with its environments."""
    from assets_procedural.light.pool import pool, write_pool
    from synthgen.planning.job import JobSpec, SubsetSpec
    from synthgen.planning.plan import plan

    subset = SubsetSpec(kind="multiview", subjects=100, environments=2, views=1)
    job = JobSpec(name="benchmark", resolution=resolution, subsets={"multiview": subset})
    folder = Path(tempfile.gettempdir()) / "synthgen-benchmark-environments"
    folder.mkdir(exist_ok=True)
    write_pool(pool(job.environments, job.seed), folder)
    return job, plan(job).subject("multiview", index), folder


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--subjects", type=int, default=3)
    parser.add_argument("--resolutions", type=int, nargs="+", default=[128, 256, 512])
    parser.add_argument(
        "--reference",
        type=int,
        default=512,
        help="samples of the converged render; 0: no such table",
    )
    options = parser.parse_args()
    with ProcessPoolExecutor(
        1,
        mp_context=get_context("spawn"),
        max_tasks_per_child=1,
        initializer=redirect,  # Cycles writes to the standard output
        initargs=(Path(os.devnull),),
    ) as pool:
        means = {}
        for resolution in options.resolutions:
            runs = list(pool.map(measure, range(options.subjects), [resolution] * options.subjects))
            means[resolution] = {step: np.mean([run[step] for run in runs]) for step in STEPS}
        report.table(["CPU seconds", *(f"{r}²" for r in options.resolutions)], costs(means))

        if not options.reference:
            return

        def quality(resolution: int) -> list[str]:
            count = options.subjects
            tasks = ([resolution] * count, [options.reference] * count)
            found = np.array(list(pool.map(fidelity, range(count), *tasks)))
            return [f"PSNR at {resolution}², dB", *(f"{v:.1f}" for v in found.mean(0))]

        report.table(["samples", *map(str, SAMPLES)], map(quality, options.resolutions[:2]))


def costs(means: dict[int, dict[str, float]]) -> Iterator[list[str]]:
    """Rows: the seconds of every step, then frames per core-hour, by resolution."""
    for step in STEPS:
        yield [step, *(f"{mean[step]:.2f}" for mean in means.values())]
    for name, lights, shots, poses in (("multiview 2×10", 2, 10, 1), ("video 10×10", 10, 10, 10)):
        for samples in (8, 64):
            rates = []
            for m in means.values():
                frame = m["sync"] + samples * m["sample"] + m["denoise"]
                shot = m["guides"] + m["labels"] + m["develop"] + m["write"]
                total = m["build"] + poses * m["pose"] + shots * (shot + lights * frame)
                rates.append(f"{3600 * lights * shots / total:.0f}")
            yield [f"frames per core-hour, {name}, {samples} samples", *rates]


if __name__ == "__main__":
    main()
