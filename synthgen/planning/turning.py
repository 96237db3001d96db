"""Turning a subject's panoramas to where the plan wants their key; this needs their pixels."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from assets_procedural.conventions import panorama_reading
from assets_procedural.light.key_light import Survey, rotation, survey
from synthgen.planning.plan import SubjectPlan


def turned(subject: SubjectPlan, environments: Path) -> SubjectPlan:
    """The subject with every `rotation` as it is rendered, and no `keys` left.

    `environments` is the folder that holds `<id>.exr`. Every renderer begins with this.

    Raises:
        PanoramaError: a panorama cannot be read.
    """
    if not any(key is not None for key in subject.keys):
        return subject.model_copy(update={"keys": ()})
    views = [(camera.yaw, camera.pitch) for camera in subject.cameras]
    facing = sum(pose.head[2] for pose in subject.poses) / len(subject.poses)
    uses = []
    for use, key in zip(subject.environments, subject.keys, strict=True):
        if key is not None:
            angle = rotation(_survey(environments / f"{use.id}.exr"), key, views, facing)
            use = use.model_copy(update={"rotation": round(angle, 6)})
        uses.append(use)
    return subject.model_copy(update={"environments": tuple(uses), "keys": ()})


@lru_cache(maxsize=256)
def _survey(path: Path) -> Survey:
    return survey(panorama_reading.load(path))
