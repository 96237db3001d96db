"""Shots of a dataset as tensors: pictures at the model's side S, space with the head at its origin.

Model space has the dataset's world axes (metres, Z up, the head at rest looks along -Y, the
subject's left is +X) and its origin at `head_centre`. Camera space: x right, y up, looks along -z.
Pictures are (C, S, S) float32, rows from the top. Every pixel of the stored picture weighs in by
the area that it shares with the new one (a box filter); display-referred pictures are averaged as
they are shown, albedo in linear light.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from assets_procedural.body.head import HeadModel
from assets_procedural.conventions.colour import display, srgb_decode
from assets_procedural.motion.poses import ARKIT_NAMES, Pose
from assets_procedural.person import Person
from synthgen.dataset import FORMAT, FORMATS, averaged, curve, open_dataset
from totalediting.errors import InputError
from totalediting.geometry.field import Control
from totalediting.geometry.tracking import EXPRESSIONS, FILL, FOCAL_MM, Tracking
from totalediting.geometry.volume import resize_intrinsics
from totalediting.light.environments import environment_lightmaps
from totalediting.pretrained import sface

SPLITS = ("train", "validation", "test")


class Shots:
    """The shots of one split, by position; opens files per access and pickles."""

    def __init__(self, folder: Path | str, split: str, subset: str | None = None) -> None:
        """Raises `InputError`: no dataset, another format, no such split or subset, none in it."""
        self.folder = Path(folder)
        if split not in SPLITS:
            raise InputError(f"split {split!r}: give one of {', '.join(SPLITS)}")
        try:
            self.dataset = open_dataset(self.folder, subset=subset, split=split)
        except RuntimeError as error:  # synthgen's StorageError, which has one line for the user
            raise InputError(str(error)) from None
        description = self.dataset.description
        if description.format not in FORMATS:
            raise InputError(
                f"{self.folder}: a dataset of format {description.format}, this version reads "
                f"{' and '.join(map(str, FORMATS))}; render it again or use the version that "
                "wrote it"
            )
        self.format = int(description.format)
        if not len(self.dataset):
            raise InputError(
                f"{self.folder}: no shot in the split {split}"
                f"{f' of {subset}' if subset else ''}; render more subjects or take another split"
            )
        self.keys = self.dataset.keys()
        self.subjects = [key.split("_")[0] for key in self.keys]  # "<subset>/s000123"
        self._job = description.job

    def environments(self, position: int) -> int:
        """How many environments a shot was rendered under."""
        return int(self._subset(position)["environments"])

    def moves(self, position: int) -> bool:
        """Whether a shot's subject has another pose in its other shots."""
        return self._subset(position)["kind"] == "video"

    def _subset(self, position: int) -> dict[str, Any]:
        return self._job["subsets"][self.keys[position].split("/")[0]]

    def read(self, position: int, *fields: str) -> dict[str, Any]:
        """`synthgen.dataset.Dataset.read`; raises `ValueError`, `KeyError` or `OSError`."""
        return self.dataset.read(position, fields)

    def lightmaps(
        self, meta: dict[str, Any], environment: int, height: int, frame: Tensor | None = None
    ) -> Tensor:
        """Exposed lightmaps (5, 3, height, 2 height) of a shot, see `environment_lightmaps`."""
        use = meta["environments"][environment]
        path = self.dataset.folder.environment(use["id"])
        exposure = float(meta["exposures"][environment])
        return environment_lightmaps(path, height, float(use["rotation"]), exposure, frame)

    def picture(self, stored: np.ndarray, side: int) -> Tensor:
        """`picture` of these shots."""
        return picture(stored, side, self.format)

    def albedo(self, stored: np.ndarray, matte: np.ndarray, side: int) -> Tensor:
        """`albedo` of these shots."""
        return albedo(stored, matte, side, self.format)

    def normals(self, stored: np.ndarray, labels: np.ndarray, side: int) -> Tensor:
        """`normals` of these shots."""
        return normals(stored, labels, side, self.format)


def motion_code(meta: dict[str, Any]) -> Tensor:
    """e (54,): ARKit's 52 coefficients in [0, 1] as shown, then gaze (yaw, pitch) in radians."""
    gaze = meta["gaze"]
    values = [meta["expression"][name] for name in ARKIT_NAMES]
    return _floats([*values, gaze["yaw"], gaze["pitch"]])


def tracking(meta: dict[str, Any], identity: Tensor) -> Tracking:
    """What a tracker should find, fields without a batch axis; `identity` (32,) is passed on."""
    drawn, code = meta["camera"]["sample"], motion_code(meta)
    return Tracking(
        expression=code[:EXPRESSIONS],
        gaze=code[EXPRESSIONS:],
        head=_floats([meta["head"][name] for name in ("pitch", "roll", "yaw")]),
        identity=identity,
        camera_yaw_pitch_roll=_floats([drawn[name] for name in ("yaw", "pitch", "roll")]),
        log_focal=_floats([math.log(drawn["focal_mm"] / FOCAL_MM)]),
        log_fill=_floats([math.log(drawn["fill"] / FILL)]),
        shift=_floats(drawn["shift"]),
        face=((five_points(meta, 1) - 0.5) * torch.tensor([1, -1])).flatten(),
    )


def camera(meta: dict[str, Any], origin: np.ndarray, side: int) -> tuple[Tensor, Tensor]:
    """`camera_to_world` (4, 4) in model space and `intrinsics` (3, 3) of pictures of `side`."""
    stored = meta["camera"]
    camera_to_world = np.array(stored["camera_to_world"])
    camera_to_world[:3, 3] -= origin
    intrinsics = resize_intrinsics(
        torch.tensor(stored["intrinsics"], dtype=torch.float64),
        (stored["height"], stored["width"]),
        (side, side),
    )
    return torch.from_numpy(camera_to_world).float(), intrinsics.float()


def rgb_name(environment: int) -> str:
    """The name under which `read` gives a shot's picture in one of its environments."""
    return f"rgb_{environment:02d}"


def five_points(meta: dict[str, Any], side: int) -> Tensor:
    """(5, 2) where a face's five points lie in a picture of `side`, see `sface`."""
    scale = side / torch.tensor([meta["camera"]["width"], meta["camera"]["height"]])
    return sface.five_points(torch.tensor(meta["landmarks"]["points"])) * scale


def control(geometry: dict[str, np.ndarray], origin: np.ndarray) -> Control:
    """The bust's corresponding points and normals (V, 3) in model space."""
    posed, canonical = (
        torch.from_numpy(geometry[name] - origin).float()
        for name in ("control_points", "control_points_canonical")
    )
    return Control(
        posed,
        canonical,
        torch.from_numpy(geometry["control_normals"]),
        torch.from_numpy(geometry["control_normals_canonical"]),
    )


def neutral(control: Control, meta: dict[str, Any], origin: np.ndarray) -> Control:
    """A control whose bust at rest has no expression.

    Raises:
        ValueError: the control points are not those of the head model's skin.
    """
    person = Person.model_validate(meta["person"])
    rest = _head().identity(person).pose(Pose()).canonical
    skin = _head().groups["skin"]
    if control.posed.shape != (len(skin), 3):
        raise ValueError(f"{len(control.posed)} control points, the bust's skin has {len(skin)}")
    points, normals = rest.vertices[skin] - origin, rest.normals[skin]
    return control._replace(
        canonical=torch.from_numpy(points).float(),
        canonical_normals=torch.from_numpy(np.asarray(normals)).float(),
    )


def picture(stored: np.ndarray, side: int, format: int = FORMAT) -> Tensor:
    """(H, W, 3 | 4) uint8 to (3, side, side) in [0, 1]; a transparent picture is put on black.

    Pictures of a format that had another curve are shown with the present one.
    """
    if stored.ndim != 3 or stored.shape[2] not in (3, 4):
        raise ValueError(f"a picture must be (H, W, 3 or 4), got {stored.shape}")
    shown = stored.astype(np.float32) / 255.0
    made, transparent = curve(format), stored.shape[2] == 4
    if transparent or made is not curve(FORMAT):
        linear = made.undisplay(shown[..., :3])
        shown = display(linear * (shown[..., 3:] if transparent else 1))
    return _to_tensor(area(shown, side)).clamp_(0.0, 1.0)


def albedo(stored: np.ndarray, matte: np.ndarray, side: int, format: int = FORMAT) -> Tensor:
    """(H, W, 3) sRGB bytes to (3, side, side) linear, in [0, 1]: the mean of what is covered.

    `matte` (H, W) bytes is `alpha`, which albedo is premultiplied by where it is a mean.
    """
    mean = _to_tensor(area(_LINEAR[stored], side))
    if averaged(format):
        mean = mean / alpha(matte, side).clamp_min(1e-3)
    return mean.clamp_(0.0, 1.0)


def alpha(stored: np.ndarray, side: int) -> Tensor:
    """(H, W) bytes to (1, side, side) coverage in [0, 1]."""
    return _to_tensor(area(stored[..., None].astype(np.float32) / 255.0, side)).clamp_(0.0, 1.0)


def parts(stored: np.ndarray, side: int) -> Tensor:
    """(H, W) part ids to (1, side, side) uint8: that of the pixel at the new one's centre."""
    rows, columns = (((np.arange(side) + 0.5) * n / side).astype(int) for n in stored.shape)
    return torch.from_numpy(np.ascontiguousarray(stored[rows[:, None], columns]))[None]


def over_surface(stored: np.ndarray, labels: np.ndarray, side: int) -> Tensor:
    """(H, W, C), 0 off the surface, to (C, side, side): the mean over what is surface.

    That is where `labels` (H, W) is above 0. The result is 0 where `parts` of the new size is.
    """
    hit = (labels > 0)[..., None]
    total = area(np.concatenate([stored, hit], -1, dtype=np.float32), side)
    seen = parts(labels, side)[0].numpy() > 0
    share = np.where(seen, total[..., -1], np.inf)[..., None]
    return _to_tensor(total[..., :-1] / share)


def normals(stored: np.ndarray, labels: np.ndarray, side: int, format: int = FORMAT) -> Tensor:
    """(H, W, 3) to (3, side, side) unit normals in the frame they are stored in, the camera's.

    0 where nothing is; where normals are no means, that is where `labels` (H, W) are 0.
    """
    if averaged(format):
        mean = _to_tensor(area(stored.astype(np.float32), side))
    else:
        mean = over_surface(stored, labels, side)
    return mean / mean.square().sum(0).sqrt().clamp_min(1e-6)


def area(values: np.ndarray, side: int) -> np.ndarray:
    """(H, W, C) float32 to (side, side, C) by box filters; enlarging repeats pixels."""
    height, width, channels = values.shape
    if (height, width) == (side, side):
        return values
    tall = (_overlap(height, side) @ values.reshape(height, -1)).reshape(side, width, channels)
    wide = _overlap(width, side) @ tall.swapaxes(0, 1).reshape(width, -1)
    return wide.reshape(side, side, channels).swapaxes(0, 1)


@lru_cache(maxsize=1)
def _head() -> HeadModel:
    return HeadModel.load()


@lru_cache(maxsize=16)
def _overlap(size: int, to: int) -> sparse.csr_matrix:
    """(to, size): the share that each old pixel has in each new one."""
    edges, new = np.arange(size + 1) / size, np.arange(to + 1) / to
    low = np.maximum(edges[:-1], new[:-1, None])
    high = np.minimum(edges[1:], new[1:, None])
    return sparse.csr_matrix((np.maximum(high - low, 0.0) * to).astype(np.float32))


def _floats(values: list[float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)


def _to_tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))


_LINEAR = srgb_decode(np.arange(256) / 255.0).astype(np.float32)  # of an sRGB byte
