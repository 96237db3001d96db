"""A renderer without Blender: the head is a sphere, with true depth, normals and landmarks.

Named to workers as `RENDERER`. `TROUBLE`, an environment variable with
JSON {subject key: kind}, makes subjects crash, hang, raise, break the gate, fill the disk, raise
words that no file can hold, call their number "one", or leave temporary files behind; with a
"<kind> once" only the first attempt does.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.camera import resolve
from assets_procedural.conventions.colour import display, to_bytes
from synthgen.dataset.passes import PASSES, Pass
from synthgen.dataset.shot import RenderedSubject, Shot, describe
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import ShotPlan, SubjectPlan
from synthgen.planning.turning import turned

RENDERER = "fake_renderer:render_subject"
CENTRE, RADIUS = np.array([0.0, 0.0, 0.65]), 0.11


def small_job(**changes: Any) -> JobSpec:
    """A job of 5 + 3 subjects and 2 subsets that takes a second to render."""
    data: dict[str, Any] = {
        "name": "small",
        "seed": 3,
        "resolution": 48,
        "shard_subjects": 2,
        "subsets": {
            "multiview": {"kind": "multiview", "subjects": 5, "environments": 2, "views": 2},
            "video": {"kind": "video", "subjects": 3, "environments": 3, "frames": 2},
        },
        "environments": {"bundled": ["city", "night", "studio"]},
        "splits": {"validation": 0.2, "test": 0.2},
    }
    return JobSpec.model_validate(data | changes)


def render_subject(
    subject: SubjectPlan, job: JobSpec, environments: Path, device: str, threads: int
) -> RenderedSubject:
    subject = turned(subject, environments)
    spoil = _trouble(subject, environments.parent)
    time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
    shots = [_shot(subject, shot, job) for shot in subject.shots]
    if spoil == "gate":
        shots[-1].depth[:] = np.nan
    elif spoil == "index":
        shots[-1].meta["index"] = "one"
    elif spoil == "pose":
        shots[-1].meta["pose"] = 2**40
    return RenderedSubject(shots, b"glTF" + subject.key.encode(), {"seed": subject.seed})


def _trouble(subject: SubjectPlan, out: Path) -> str:
    kind = json.loads(os.environ.get("TROUBLE", "{}")).get(subject.key, "")
    if kind.endswith(" once"):
        marker = out / "work" / f"{subject.subset}-{subject.key}.tripped"
        if marker.exists():
            return ""
        marker.touch()
        kind = kind.removesuffix(" once")
    if kind == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    elif kind == "hang":
        time.sleep(3600)
    elif kind == "raise":
        raise RuntimeError("no hair left\nand a second line")
    elif kind == "surrogate":
        raise RuntimeError("no \ud800 left")
    elif kind == "litter":
        tempfile.mkdtemp(prefix="blender_")
    elif kind == "full":
        raise OSError(errno.ENOSPC, "No space left on device")
    return kind


def _shot(subject: SubjectPlan, plan: ShotPlan, job: JobSpec) -> Shot:
    size = job.resolution
    camera = resolve(subject.cameras[plan.camera], CENTRE, 2 * RADIUS, size)
    # Rays with planar depth 1, in world axes; the nearer of the two intersections.
    ray = camera.unproject(camera.pixel_centres(), np.ones((size, size))) - camera.position
    offset = camera.position - CENTRE
    a, b = (ray**2).sum(-1), (ray @ offset)
    discriminant = b**2 - a * (offset @ offset - RADIUS**2)
    mask = discriminant > 0
    depth = np.where(mask, (-b - np.sqrt(np.maximum(discriminant, 0))) / a, 0)
    point = camera.position + ray * depth[..., None]
    outward = np.where(mask[..., None], (point - CENTRE) / RADIUS, 0)
    rotation = camera.camera_to_world[:3, :3]
    rng = np.random.default_rng(plan.seed)
    landmarks = _landmarks(camera.position)
    pixels, _ = camera.project(landmarks)
    visible = ((landmarks - CENTRE) * (camera.position - landmarks)).sum(-1) > 0
    alpha = np.where(mask, 255, 0).astype(np.uint8)
    tone = np.array(subject.person.eyes.iris) + 0.2
    images, linear, exposures = [], [], []
    for use in subject.environments:
        light = np.array([np.cos(use.rotation), np.sin(use.rotation), 0.5])
        shade = np.clip(outward @ light, 0, None)[..., None] * tone + 0.05
        shade += 0.02 * rng.random(shade.shape)
        linear.append(np.concatenate([shade, np.ones((size, size, 1))], -1) * mask[..., None])
        exposures.append(0.5 * 2.0**use.exposure)
        shown = to_bytes(display(np.where(mask[..., None], exposures[-1] * shade, 0.2)))
        if job.image.background == "transparent":
            shown = np.concatenate([shown, alpha[..., None]], -1)
        images.append(shown)
    meta = describe(
        subject,
        plan,
        camera.camera_to_world,
        camera.intrinsics,
        (camera.width, camera.height),
        pixels,
        visible,
    )
    meta["exposures"] = exposures
    meta["joints"] = ["head"]
    points = landmarks.astype(np.float32)
    normals = ((landmarks - CENTRE) / RADIUS).astype(np.float32)
    geometry = {
        "landmarks": points,
        "landmarks_canonical": points,
        "control_points": points,
        "control_points_canonical": points,
        "control_normals": normals,
        "control_normals_canonical": normals,
        "joints": np.eye(4, dtype=np.float32)[None],
    }
    known = {
        "albedo": np.where(mask[..., None], tone, 0).clip(0, 1) * 255,
        "normal": outward @ rotation,
        "depth": depth,
        "uv": outward[..., :2] * 0.5 + 0.5 * mask[..., None],
        "canonical": np.where(mask[..., None], point, 0),
        "alpha": alpha,
        "parts": np.where(mask, 1 + (outward[..., 2] > 0.5) * 12, 0),
    }
    return Shot(
        key=plan.key,
        rgb=np.stack(images),
        hdr=np.stack(linear).astype(np.float16) if job.image.linear else None,
        passes={p.name: (known.get(p.name, _plain(p, mask))).astype(p.dtype) for p in PASSES},
        geometry=geometry,
        meta=meta,
        cost={"beauty": 0.01, "labels": 0.002},
    )


def _plain(each: Pass, mask: np.ndarray) -> np.ndarray:
    """A pass that this renderer does not know: 1 on the sphere."""
    shape = each.shape(*mask.shape)
    background = each.background or 0.0
    on = mask if len(shape) == 2 else np.repeat(mask[..., None], shape[2], -1)
    return np.where(on, 1.0, background)


def _landmarks(eye: np.ndarray) -> np.ndarray:
    """(70, 3) points on the front of the sphere (the head looks along -Y)."""
    golden = np.pi * (3 - np.sqrt(5))
    k = np.arange(70)
    out = 1 - 0.9 * (k + 0.5) / 70
    ring = np.sqrt(1 - out**2)
    offsets = np.stack([ring * np.cos(golden * k), -out, ring * np.sin(golden * k)], -1)
    return CENTRE + RADIUS * offsets
