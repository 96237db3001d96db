"""The gate: checks each shot must pass before it is stored, and again when it is verified."""

from __future__ import annotations

import numpy as np

from assets_procedural.conventions.camera import LANDMARK_MARGIN
from assets_procedural.conventions.colour import to_bytes
from assets_procedural.conventions.parts import Part
from synthgen.dataset.passes import PASSES
from synthgen.dataset.records import FORMAT, averaged, curve
from synthgen.dataset.shot import Shot, camera_of
from synthgen.planning.job import LensSettings

PART_IDS = tuple(Part)
_SKIN = (Part.SKIN, Part.NOSE)
_STRANDS = (Part.HAIR, Part.BEARD, Part.LEFT_BROW, Part.RIGHT_BROW)
_SMOOTH = 0.9  # of |n|: below, a pixel's normal is that of several surfaces

# Tolerances of the gate. They are part of the dataset contract: loosening one is a format change.
LANDMARK_PIXELS = 0.5  # 2D landmarks against the projected 3D ones
LANDMARK_DEPTH = 0.01  # metres, median over the visible landmarks
NORMAL_LENGTH = 0.05  # | |n| - 1 |, of the smoothest tenth of skin; in format 1 the median of all
NORMAL_EXCESS = 0.02  # of |n| above alpha, which a mean of unit vectors never exceeds
NORMAL_ANGLE = 20.0  # degrees, median between the normal pass and the slope of the depth
MASK_OVERLAP = 0.7  # intersection over union of alpha > 127 and parts > 0
ROTATION_ERROR = 1e-4
MIN_MASK = 0.01  # share of the frame
LIGHT_LEVELS = 1  # 8-bit levels between a picture and D(exposure · linear) where alpha is 255
DARK, BRIGHT = 2.0, 253.0  # mean 8-bit level inside the mask


def quality(shot: Shot, format: int = FORMAT) -> dict[str, float]:
    """Figures of one shot for the manifest."""
    mask = shot.parts > 0
    height, width = shot.depth.shape
    points, z = camera_of(shot.meta).project(np.asarray(shot.geometry["landmarks"], float))
    declared = np.asarray(shot.meta["landmarks"]["points"], float)
    visible = np.asarray(shot.meta["landmarks"]["visible"], bool)
    size = np.array([width, height])
    inside = np.isfinite(declared).all(1) & (declared >= 0).all(1) & (declared < size).all(1)
    seen = visible & inside
    column, row = np.floor(declared[seen]).astype(int).T
    gap = np.abs(shot.depth[row, column] - z[seen])[shot.depth[row, column] > 0]
    matte = shot.alpha > 127
    union = (mask | matte).sum()
    length = np.linalg.norm(shot.normal.astype(np.float32), axis=-1)
    whole, bare, share = mask, mask, 0.5
    if averaged(format):
        # Strands in front of skin, and its relief, make means of normals short.
        whole, share = np.isin(shot.parts, _SKIN) & (shot.alpha == 255), 0.9
        bare = mask & ~np.isin(shot.parts, _STRANDS) & (length > _SMOOTH)
    typical = np.quantile(length[whole], share) if whole.any() else 1.0
    level = [float(image[matte][:, :3].mean()) if matte.any() else 0.0 for image in shot.rgb]
    deviation = [float(image[..., :3].std()) for image in shot.rgb]
    return {
        "mask_fraction": float(mask.mean()),
        "mask_overlap": float((mask & matte).sum() / union) if union else 0.0,
        "normal_length": float(typical),
        "normal_angle": _normal_angle(shot, bare),
        "depth_min": float(shot.depth[mask].min()) if mask.any() else 0.0,
        "depth_max": float(shot.depth[mask].max()) if mask.any() else 0.0,
        "landmarks_visible": float(visible.sum()),
        "landmarks_inside": float(inside.sum()),
        "landmark_pixels": float(np.abs(points - declared).max()),
        "landmark_depth": float(np.median(gap)) if gap.size else 0.0,
        "level_min": min(level),
        "level_max": max(level),
        "contrast_min": min(deviation),
    }


def _light_levels(shot: Shot, format: int) -> int:
    """Largest difference between rgb and D(exposure · hdr) on opaque pixels; 0 without hdr.

    A lens that blurs, and grain, are no function of a pixel's light: with them it is not asked.
    """
    if shot.hdr is None or _lens(shot).changes_pictures:
        return 0
    opaque = shot.alpha == 255
    display = curve(format).display
    worst = 0
    for picture, linear, exposure in zip(shot.rgb, shot.hdr, shot.meta["exposures"], strict=True):
        shown = to_bytes(display(exposure * linear[opaque][:, :3].astype(np.float32)))
        difference = np.abs(picture[opaque][:, :3].astype(int) - shown)
        worst = max(worst, int(difference.max(initial=0)))
    return worst


def _lens(shot: Shot) -> LensSettings:
    """What a shot says of its lens; unchecked, since a stranger may have written anything."""
    said = shot.meta.get("lens", {})
    known = {name: value for name, value in said.items() if name in LensSettings.model_fields}
    return LensSettings.model_construct(**known)


def _normal_excess(shot: Shot, format: int) -> float:
    """By how much a normal is at most longer than coverage; 0 where normals are no means."""
    if not averaged(format):
        return 0.0
    length = np.linalg.norm(shot.normal.astype(np.float32), axis=-1)
    return float((length - shot.alpha / np.float32(255)).max())


def _normal_angle(shot: Shot, mask: np.ndarray) -> float:
    """Median angle in degrees between the normals and the slope of the unprojected depth."""
    camera = camera_of(shot.meta)
    points = camera.unproject(camera.pixel_centres(), shot.depth) - camera.position
    points = points @ camera.camera_to_world[:3, :3]
    right, down = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
    slope = np.cross(down, right)
    usable = mask[:-1, :-1] & mask[1:, :-1] & mask[:-1, 1:]
    # Depth jumps (silhouettes, strands) have no slope: keep steps of the size of a pixel.
    jump = np.maximum(np.abs(right[..., 2]), np.abs(down[..., 2]))
    if not usable.any():
        return 0.0
    usable &= jump < 4 * max(float(np.median(np.abs(right[..., 0][usable]))), 1e-9)
    a, b = slope[usable], shot.normal[:-1, :-1][usable].astype(float)
    norm = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    if not (norm > 0).any():
        return 0.0
    cosine = (a * b).sum(-1)[norm > 0] / norm[norm > 0]
    return float(np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))))


def inspect(shot: Shot, format: int = FORMAT) -> tuple[list[str], dict[str, float]]:
    """Check a shot of a dataset of `format` against the contract: problems, and quality figures.

    Problems are one line each; a shot without any may be stored. There are no figures if shapes or
    values are too wrong to compute any.
    """
    if problems := _shapes(shot) or _values(shot, format):
        return problems, {}
    figures = quality(shot, format)
    f = figures.__getitem__
    margin = LANDMARK_MARGIN * np.array([shot.depth.shape[1], shot.depth.shape[0]])
    points = np.asarray(shot.meta["landmarks"]["points"], float)
    outside = (points < -margin) | (points > margin / LANDMARK_MARGIN + margin)
    checks = [
        (f("mask_fraction") >= MIN_MASK, f"mask covers {f('mask_fraction'):.2%} of the frame"),
        (f("mask_overlap") >= MASK_OVERLAP, f"alpha and parts overlap {f('mask_overlap'):.2f}"),
        (
            (excess := _normal_excess(shot, format)) <= NORMAL_EXCESS,
            f"a normal is {excess:.3f} longer than alpha",
        ),
        (
            abs(f("normal_length") - 1) <= NORMAL_LENGTH,
            f"normals of skin are {f('normal_length'):.3f} long",
        ),
        (
            f("normal_angle") <= NORMAL_ANGLE,
            f"normals are {f('normal_angle'):.0f} degrees off the depth",
        ),
        (not outside.any(), f"{int(outside.any(1).sum())} landmarks outside the declared bounds"),
        (
            f("landmark_pixels") <= LANDMARK_PIXELS,
            f"landmarks are {f('landmark_pixels'):.2f} px off their projection",
        ),
        (
            f("landmark_depth") <= LANDMARK_DEPTH,
            f"depth is {f('landmark_depth') * 1e3:.1f} mm off the visible landmarks",
        ),
        (
            (levels := _light_levels(shot, format)) <= LIGHT_LEVELS,
            f"a picture is {levels} levels off its linear light",
        ),
        (f("level_min") >= DARK, f"black image: mean level {f('level_min'):.1f}"),
        (f("level_max") <= BRIGHT, f"white image: mean level {f('level_max'):.1f}"),
        (f("contrast_min") > 0, "an image of one colour"),
    ]
    return [message for passed, message in checks if not passed], figures


def _shapes(shot: Shot) -> list[str]:
    names = {p.name for p in PASSES}
    if differing := names ^ shot.passes.keys():
        lacking = ", ".join(sorted(names & differing)) or "none"
        unknown = ", ".join(sorted(differing - names)) or "none"
        return [f"other passes than a dataset's (missing: {lacking}; unknown: {unknown})"]
    height, width = shot.depth.shape[:2]
    count = len(shot.meta.get("environments", ()))
    expected: dict[str, tuple[np.ndarray, tuple[int, ...], type[np.generic]]] = {
        "rgb": (shot.rgb, (count, height, width, shot.rgb.shape[-1]), np.uint8)
    }
    expected |= {p.name: (shot.passes[p.name], p.shape(height, width), p.dtype) for p in PASSES}
    if shot.hdr is not None:
        expected["hdr"] = (shot.hdr, (count, height, width, 4), np.float16)
    problems = []
    for name, (array, shape, dtype) in expected.items():
        if array.shape != shape or array.dtype != dtype:
            problems.append(f"{name} is {array.dtype} {array.shape}, not {np.dtype(dtype)} {shape}")
    if shot.rgb.shape[-1] not in (3, 4):
        problems.append(f"rgb has {shot.rgb.shape[-1]} channels")
    controls = {
        shot.geometry.get(f"control_{what}{suffix}", np.empty(0)).shape
        for what in ("points", "normals")
        for suffix in ("", "_canonical")
    }
    if len(controls) > 1 or (shape := controls.pop())[1:] != (3,) or not shape[0]:
        problems.append("geometry has no control points and normals of one shape (N, 3)")
    camera = shot.meta.get("camera", {})
    if (camera.get("width"), camera.get("height")) != (width, height):
        problems.append("the camera's size is not the image's")
    for name in ("landmarks", "landmarks_canonical"):
        if name not in shot.geometry or shot.geometry[name].shape != (70, 3):
            problems.append(f"geometry has no {name} of shape (70, 3)")
    exposures = shot.meta.get("exposures", ())
    if len(exposures) != count:
        problems.append(f"meta has {len(exposures)} exposures for {count} environments")
    names, joints = shot.meta.get("joints", ()), shot.geometry.get("joints", np.empty(0))
    if not names or joints.shape != (len(names), 4, 4):
        problems.append(f"geometry has joints {joints.shape} for {len(names)} names in meta")
    landmarks = shot.meta.get("landmarks", {})
    if len(landmarks.get("points", ())) != 70 or len(landmarks.get("visible", ())) != 70:
        problems.append("meta has no 70 landmarks with visibility")
    return problems


def _values(shot: Shot, format: int) -> list[str]:
    problems = []
    arrays = dict(shot.passes)
    if shot.hdr is not None:
        arrays["hdr"] = shot.hdr
    arrays |= {f"geometry {name}": array for name, array in shot.geometry.items()}
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            problems.append(f"{name} has {int((~np.isfinite(array)).sum())} NaN or Inf values")
    mask = shot.parts > 0
    if not mask.any():
        problems.append("empty mask")
    illegal = set(np.unique(shot.parts).tolist()) - set(PART_IDS)
    if illegal:
        problems.append(f"unknown part ids {sorted(illegal)}")
    for each in PASSES:
        if each.background is None:
            continue
        array = shot.passes[each.name]
        if each.name == "albedo" and not averaged(format):
            continue
        there = shot.alpha > 0 if each.averaged and averaged(format) else mask
        if each.positive:
            above = array > each.background
            if (above != mask).any() or (array < each.background).any():
                problems.append(f"{each.name} is not positive exactly where parts are labelled")
        elif (array[~there] != each.background).any():
            problems.append(f"{each.name} is not {each.background:g} in the background")
    exposures = np.asarray(shot.meta["exposures"], float)
    if not (np.isfinite(exposures) & (exposures > 0)).all():
        problems.append(f"exposures {exposures.tolist()} are not all finite and positive")
    matrix = np.asarray(shot.meta["camera"]["camera_to_world"], float)
    intrinsics = np.asarray(shot.meta["camera"]["intrinsics"], float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        problems.append("camera_to_world is not a finite 4x4 matrix")
    else:
        rotation = matrix[:3, :3]
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if error > ROTATION_ERROR or np.linalg.det(rotation) < 0:
            problems.append(f"the camera's rotation is not in SO(3) (error {error:.1e})")
    if intrinsics.shape != (3, 3) or not np.isfinite(intrinsics).all() or intrinsics[0, 0] <= 0:
        problems.append("intrinsics are not a finite 3x3 matrix with a positive focal length")
    return problems
