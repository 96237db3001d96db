"""`Shot`: arrays and metadata of one (subject, pose, view) under all its environments.

Axes: E environments, H rows from the top, W columns. World: metres, Z up, the head looks along -Y.
Camera space: OpenGL axes (x right, y up, the camera looks along -z), pixel centres at +0.5.

`geometry` holds at least
  landmarks            (70, 3) float32, world: iBUG 68, then the right and the left pupil
  landmarks_canonical  (70, 3) float32, the same points on the canonical bust
  control_points, control_points_canonical, control_normals, control_normals_canonical  (N, 3)
  joints               (J, 4, 4) float32, rest-to-posed transforms; their names in meta["joints"]
`meta` is what `describe` returns, plus two entries that only a renderer knows
  exposures            the linear factor of each environment: rgb = D(exposure x linear)
  joints               names of the joints in `geometry`
and whatever else it adds: the same keys and types in every shot of a subset, no null and no empty
list, but for "person", which is stored as a string.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from assets_procedural.conventions.camera import Camera
from assets_procedural.motion.poses import ARKIT_NAMES, Pose, lid_following

if TYPE_CHECKING:
    from synthgen.planning.plan import ShotPlan, SubjectPlan


@dataclass
class Shot:
    """One sample of a dataset, exactly as it is stored.

    rgb        (E, H, W, 3 | 4) uint8, display-referred
    hdr        (E, H, W, 4) float16, linear Rec.709 premultiplied foreground, or None
    passes     arrays by name, all of `synthgen.dataset.passes`; each is an attribute, too:
      albedo     (H, W, 3) uint8, sRGB base colour
      normal     (H, W, 3) float16, unit, camera space, 0 where nothing is hit
      depth      (H, W) float32, planar z in metres, 0 where nothing is hit
      uv         (H, W, 2) float32
      canonical  (H, W, 3) float32, canonical-pose coordinates in metres
      alpha      (H, W) uint8, soft matte
      parts      (H, W) uint8, FaceSynthetics ids, 0 where nothing is hit
    geometry   arrays, see the module's text
    meta       JSON-serialisable provenance, camera and landmarks
    cost       seconds per stage; goes to the manifest alone, so that shards are reproducible
    """

    key: str
    rgb: np.ndarray
    hdr: np.ndarray | None
    passes: dict[str, np.ndarray]
    geometry: dict[str, np.ndarray]
    meta: dict[str, Any]
    cost: dict[str, float] = field(default_factory=dict)

    def __getattr__(self, name: str) -> np.ndarray:
        # Copying and unpickling ask before there are any fields.
        passes = self.__dict__.get("passes", {})
        if name not in passes:
            raise AttributeError(f"a shot has no {name}")
        return passes[name]

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__.get("passes", {}):
            self.passes[name] = value
        else:
            super().__setattr__(name, value)


@dataclass
class RenderedSubject:
    """What a renderer returns: the shots in plan order, the canonical mesh, identity parameters."""

    shots: list[Shot]
    mesh_glb: bytes
    parameters: dict[str, Any]


def describe(
    subject: SubjectPlan,
    shot: ShotPlan,
    camera_to_world: np.ndarray,
    intrinsics: np.ndarray,
    size: tuple[int, int],
    landmarks: np.ndarray,
    visible: np.ndarray,
) -> dict[str, Any]:
    """The metadata of a shot: where it comes from, its camera, its landmarks.

    `camera_to_world` (4, 4), `intrinsics` (3, 3), `size` (width, height) as in `Camera`.

    `landmarks` is (70, 2) in pixels (x right, y down), `visible` (70,) bool.
    """
    pose, sample = subject.poses[shot.pose], subject.cameras[shot.camera]
    motion = subject.motion
    origin: dict[str, Any] = {}
    if motion is not None:
        seconds = motion.seconds[shot.pose]
        origin["motion"] = {"table": motion.table, "source": motion.source, "seconds": seconds}
    return origin | {
        "key": shot.key,
        "subject": subject.key,
        "subset": subject.subset,
        "kind": subject.kind,
        "split": subject.split,
        "index": subject.index,
        "pose": shot.pose,
        "view": shot.camera,
        "seeds": {"subject": subject.seed, "shot": shot.seed},
        "camera": {
            "camera_to_world": np.asarray(camera_to_world, float).tolist(),
            "intrinsics": np.asarray(intrinsics, float).tolist(),
            "width": int(size[0]),
            "height": int(size[1]),
            "sample": sample.model_dump(mode="json"),
        },
        "environments": [use.model_dump(mode="json") for use in subject.environments],
        "expression": shown_expression(pose),
        "head": dict(zip(("pitch", "roll", "yaw"), pose.head, strict=True)),
        "gaze": dict(zip(("yaw", "pitch"), pose.gaze, strict=True)),
        "landmarks": {
            "scheme": "ibug68+pupils",
            "points": np.asarray(landmarks, float).round(4).tolist(),
            "visible": np.asarray(visible, bool).tolist(),
        },
        "person": subject.person.model_dump(mode="json"),
    }


def shown_expression(pose: Pose) -> dict[str, float]:
    """All 52 ARKit values of a pose as they show: with lids that follow the gaze."""
    shown = lid_following(pose)
    return {name: float(shown.get(name, 0.0)) for name in ARKIT_NAMES}


def camera_of(meta: dict[str, Any]) -> Camera:
    """The camera that a shot's metadata records."""
    stored = meta["camera"]
    return Camera(
        np.asarray(stored["camera_to_world"], float),
        np.asarray(stored["intrinsics"], float),
        stored["width"],
        stored["height"],
    )
