"""Reading panoramas: what a file's header says its pixels mean is applied, or refused by name.

One function, `read`, turns an .exr or .hdr file into linear Rec.709 radiance on the whole sphere
(see `panorama` for the axes) and says what it did:

    windows      pixels of the data window are placed in the display window, which is to be 2:1;
                 overscan is cut, and a part of the sphere without pixels is refused unless the
                 caller declares it black
    primaries    `chromaticities`, `colorInteropID`, `acesImageContainerFlag`, `PRIMARIES=`: a 3x3
                 matrix with Bradford adaptation to Rec.709 and D65
    orientation  the eight resolution strings of Radiance
    exposure     `EXPOSURE=` and `COLORCORR=`, repeated or not, are divided out; `GAMMA=` is refused
    parts        all parts and layers are searched for one RGB, or for one lone Y;
                 "file.exr#part/layer" chooses
    values       NaN, Inf, negative energy and values whose sums overflow are refused
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from assets_procedural.conventions.errors import UserError
from assets_procedural.conventions.panorama import resize, texel_solid_angles

READER = 1
"""Version of this reader, kept in provenance: to be raised when a file gives other pixels."""
MOST_NEGATIVE = 0.15
"""Largest share of negative energy: ringing of a resampling beside the sun stays below it."""
LARGEST = 1e30
"""Largest radiance: sums over a sphere's texels and their squares stay finite in float32."""
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""CIE xy of red, green, blue and white, as in the attribute `chromaticities`."""
_AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
_AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
_REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
_P3D65 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)
_ADOBE = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290)
# Names of linear colour spaces: ids of the Color Interop Forum, and common names of the same.
_SPACES = {
    "lin_rec709_scene": REC709,
    "lin_rec709": REC709,
    "lin_srgb": REC709,
    "lin_ap1_scene": _AP1,
    "acescg": _AP1,
    "lin_ap0_scene": _AP0,
    "aces2065-1": _AP0,
    "lin_rec2020_scene": _REC2020,
    "lin_p3d65_scene": _P3D65,
    "lin_adobergb_scene": _ADOBE,
}
_SAME = 2e-3  # largest difference between xy of the same primaries, as writers round them
_ORIENTATIONS = {  # first axis, second axis -> (transpose, flip rows, flip columns)
    "-Y +X": (False, False, False),
    "-Y -X": (False, False, True),
    "+Y +X": (False, True, False),
    "+Y -X": (False, True, True),
    "+X -Y": (True, False, False),
    "-X -Y": (True, False, True),
    "+X +Y": (True, True, False),
    "-X +Y": (True, True, True),
}
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_quiet = threading.Lock()

Missing = Literal["refuse", "black"]


class PanoramaError(UserError, ValueError):
    """A panorama file that cannot be used; the message names file, fault and remedy."""


@dataclass
class _Image:
    """Pixels (h, w, 3) as stored, float, and what the header says of them."""

    pixels: np.ndarray
    window: tuple[int, int] = (0, 0)
    """Column and row of the first pixel in the display window."""
    display: tuple[int, int] = (0, 0)
    """Width and height of the display window."""
    primaries: tuple[float, ...] = REC709
    empty: np.ndarray | None = None
    """(h, w) bool: texels whose alpha says that nothing is there."""
    facts: dict[str, Any] = field(default_factory=dict)


def read(
    source: str | Path,
    *,
    max_width: int | None = None,
    missing: Missing = "refuse",
    largest: int | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Read a panorama: (H, 2H, 3) float32, linear Rec.709, all values >= 0, and what was applied.

    `source` is a path, or "path#part/layer" where a file holds several images. A panorama wider
    than `max_width` is area-averaged. With `missing="black"` parts of the sphere that the file does
    not hold are black. `largest` bounds the bytes that all channels take once decoded. The facts
    are plain data: `reader`, and of the header what mattered.

    Raises:
        PanoramaError: one line that names the file, the property and the remedy.
    """
    path, choice = split(source)
    if not path.is_file():
        raise PanoramaError(f"{path}: no such file; give an existing .exr or .hdr panorama")
    with path.open("rb") as file:
        magic = file.read(11)
    if magic[:4] == _EXR_MAGIC:
        image = _read_exr(path, choice, largest)
    elif magic.startswith((b"#?RADIANCE", b"#?RGBE")):
        if choice:
            raise PanoramaError(f"{path}#{choice}: a .hdr file has no parts; leave out #{choice}")
        image = _read_hdr(path, largest)
    else:
        raise _not_a_panorama(path)
    facts: dict[str, Any] = {"reader": READER, **image.facts}
    panorama = _on_the_sphere(path, image, missing, facts)
    _check_values(path, panorama, facts)
    panorama = _to_rec709(path, panorama, image.primaries, facts)
    np.maximum(panorama, 0.0, out=panorama)
    _check_range(path, panorama)
    if max_width is not None and panorama.shape[1] > max_width:
        panorama = resize(panorama, max_width)
    return panorama, facts


def load(source: str | Path, max_width: int | None = None) -> np.ndarray:
    """The pixels alone of `read`."""
    return read(source, max_width=max_width)[0]


def check_size(path: Path, largest: int) -> None:
    """Raise `PanoramaError` if all channels of a panorama decode to more than `largest` bytes."""
    with path.open("rb") as file:
        magic = file.read(4)
    if magic == _EXR_MAGIC:
        _exr_header(path, largest)
    else:
        _, _, (height, width), _ = _hdr_header(path)
        _check_fits(path, 12 * height * width, largest)


def split(source: str | Path) -> tuple[Path, str]:
    """The file and what stands behind its last #, if a file of the whole name does not exist."""
    text = os.fspath(source)
    head, mark, choice = text.rpartition("#")
    if mark and not Path(text).is_file():
        return Path(head), choice.strip("/")
    return Path(text), ""


def _not_a_panorama(path: Path) -> PanoramaError:
    """What is wrong with a file that is neither .exr nor .hdr, whatever its name."""
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    reason = "is neither an .exr nor an .hdr file, or damaged"
    if image is not None:
        kind, depth = image.format_name(), image.spec().format
        image.close()
        if depth.basetype not in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE):
            return PanoramaError(
                f"{path}: stores {depth} integers, low dynamic range; "
                "use an .exr or .hdr with linear float radiance"
            )
        reason = f"is a {kind} file, whose orientation and colours are not defined well enough"
    else:
        oiio.geterror()
    return PanoramaError(f"{path}: {reason}; export it as .exr or .hdr")


# ---------------------------------------------------------------- OpenEXR


def _read_exr(path: Path, choice: str, largest: int | None) -> _Image:
    import OpenEXR

    with _without_chatter(), _damaged(path):
        header = OpenEXR.File(str(path), header_only=True)
    layers = _layers(header)
    part, names = _choose(path, choice, layers)
    attributes = header.parts[part].header
    windows = [part.header["dataWindow"] for part in header.parts]
    texels = [int(np.prod(high.astype(np.int64) - low + 1)) for low, high in windows]
    channels = [len(part.header["channels"]) for part in header.parts]
    _check_fits(path, 4 * sum(n * c for n, c in zip(texels, channels, strict=True)), largest)
    with _without_chatter(), _damaged(path):
        file = OpenEXR.File(str(path), separate_channels=True)
        if len(file.parts) != len(header.parts):  # it leaves out what it cannot read
            raise ValueError("its pixels cannot be read")
        stored = file.parts[part].channels
    planes = [stored[name] for name in names]
    if any(plane.xSampling != 1 or plane.ySampling != 1 for plane in planes):
        raise PanoramaError(f"{path}: has subsampled channels; export R, G and B at full size")
    if any(plane.pixels.dtype.kind != "f" for plane in planes):
        raise PanoramaError(
            f"{path}: stores {planes[0].pixels.dtype} integers, low dynamic range; "
            "use an .exr or .hdr with linear float radiance"
        )
    pixels = np.empty((*planes[0].pixels.shape, 3), np.float32)
    for index in range(3):
        pixels[..., index] = planes[index % len(planes)].pixels
    (low, high), (first, last) = attributes["dataWindow"], attributes["displayWindow"]
    if tuple(high - low + 1) != pixels.shape[1::-1]:
        raise PanoramaError(f"{path}: is damaged (its data window does not fit its pixels)")
    image = _Image(
        pixels,
        window=(int(low[0] - first[0]), int(low[1] - first[1])),
        display=(int(last[0] - first[0] + 1), int(last[1] - first[1] + 1)),
        primaries=_exr_primaries(path, attributes),
    )
    aspect = float(attributes.get("pixelAspectRatio", 1.0))
    if abs(aspect - 1.0) > 1e-3:
        raise PanoramaError(f"{path}: pixelAspectRatio = {aspect:g}; resample it to square pixels")
    if int(attributes.get("envmap", 0)) != 0:
        raise PanoramaError(f"{path}: envmap says that it is a cube map; convert it to 2:1")
    layer = names[0].rpartition(".")[0]
    if label := _label(header, part, layer):
        image.facts["layer"] = label
    if len(names) == 1:
        image.facts["channels"] = list(names)
    if alpha := stored.get(f"{layer}.A" if layer else "A"):
        empty = alpha.pixels < 0.5
        if alpha.pixels.shape == pixels.shape[:2] and empty.any():
            image.empty = empty
    return image


def _exr_header(path: Path, largest: int | None) -> Any:
    """A file opened without its pixels, which fit into memory."""
    import OpenEXR

    with _without_chatter(), _damaged(path):
        file = OpenEXR.File(str(path), header_only=True)
        windows = [part.header["dataWindow"] for part in file.parts]
        texels = [int(np.prod(high.astype(np.int64) - low + 1)) for low, high in windows]
        channels = [len(part.header["channels"]) for part in file.parts]
    _check_fits(path, 4 * sum(n * c for n, c in zip(texels, channels, strict=True)), largest)
    return file


@dataclass(frozen=True)
class _Layer:
    part: int
    label: str
    channels: tuple[str, ...]
    """R, G, B; or Y alone."""
    base: bool
    """Whether the channels stand in no layer of a file of one part: what every viewer shows."""


def _layers(file: Any) -> list[_Layer]:
    """Every image of a file: RGB of a layer, or a Y that stands alone."""
    found: list[_Layer] = []
    for index, part in enumerate(file.parts):
        if "deep" in str(part.header.get("type", "")):
            continue
        groups: dict[str, dict[str, str]] = {}  # layer -> R, G, B or another -> channel
        for channel in part.header["channels"]:
            layer, _, last = str(channel.name).rpartition(".")
            name = _CHANNELS.get(last.lower(), last)
            groups.setdefault(layer, {})[name] = str(channel.name)
        for layer, names in groups.items():
            kept = tuple(names[c] for c in "RGB" if c in names)
            if len(kept) < 3:
                kept = (names["Y"],) if "Y" in names and not {"RY", "BY"} & set(names) else ()
            if kept:
                base = not layer and len(file.parts) == 1
                found.append(_Layer(index, _label(file, index, layer), kept, base))
    colours = [layer for layer in found if len(layer.channels) == 3]
    return colours or found


_CHANNELS = {"red": "R", "green": "G", "blue": "B", "r": "R", "g": "G", "b": "B", "y": "Y"}


def _label(file: Any, part: int, layer: str) -> str:
    name = file.parts[part].name() or (str(part) if len(file.parts) > 1 else "")
    return "/".join(word for word in (name, layer) if word)


def _choose(path: Path, choice: str, layers: list[_Layer]) -> tuple[int, tuple[str, ...]]:
    if not layers:
        raise PanoramaError(f"{path}: has no R, G and B channels in any part; export them")
    if choice:
        found = [layer for layer in layers if layer.label == choice]
        found = found or [layer for layer in layers if choice in layer.label.split("/")]
    else:
        found = layers if len(layers) == 1 else [layer for layer in layers if layer.base]
    if len(found) != 1:
        names = ", ".join(layer.label or "(the unnamed one)" for layer in layers)
        wrong = f'"{choice}" is not one of its images' if choice else "holds several images"
        example = next((layer.label for layer in layers if layer.label), "")
        raise PanoramaError(f"{path}: {wrong} ({names}); choose one as {path.name}#{example}")
    return found[0].part, found[0].channels


def _exr_primaries(path: Path, attributes: dict[str, Any]) -> tuple[float, ...]:
    """xy of the primaries and white that a header declares, in whatever way."""
    said: dict[str, tuple[float, ...]] = {}
    for name in ("colorInteropID", "oiio:ColorSpace"):
        value = attributes.get(name)
        if isinstance(value, bytes):
            value = value.decode(errors="replace")
        if not isinstance(value, str) or value.lower() in ("", "unknown", "scene_linear"):
            continue
        if value.lower() not in _SPACES:
            raise PanoramaError(
                f"{path}: {name} = {value}: not a linear colour space that is known here; "
                "convert it to linear Rec.709"
            )
        said[f"{name} = {value}"] = _SPACES[value.lower()]
    if attributes.get("acesImageContainerFlag") == 1:
        said["acesImageContainerFlag = 1"] = _AP0
    if (xy := attributes.get("chromaticities")) is not None:
        said["chromaticities"] = tuple(float(x) for x in np.ravel(xy))
    for name, primaries in said.items():
        other = next(iter(said.values()))
        if np.abs(np.subtract(primaries, other)).max() > _SAME:
            raise PanoramaError(
                f"{path}: {name} contradicts {next(iter(said))}; remove the wrong attribute"
            )
    return next(reversed(said.values()), REC709)


def _check_fits(path: Path, decoded: int, largest: int | None) -> None:
    """One clear line, instead of a killed process, where a file does not fit into memory."""
    if largest is not None and decoded > largest:
        raise PanoramaError(
            f"{path}: is more than {largest / 1e9:.2g} GB once decoded; scale it down"
        )
    free = available_memory()
    if free is not None and 2 * decoded > free:
        raise PanoramaError(
            f"{path}: takes {2 * decoded / 1e9:.1f} GB of memory, {free / 1e9:.1f} GB are free; "
            "scale it down"
        )


def available_memory() -> int | None:
    """Bytes that a process can still have; None where the system does not say."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return None


# ---------------------------------------------------------------- Radiance


def _read_hdr(path: Path, largest: int | None) -> _Image:
    import OpenImageIO as oiio

    lines, orientation, (height, width), start = _hdr_header(path)
    if "32-bit_rle_xyze" in lines.get("FORMAT", ["32-bit_rle_rgbe"]):
        raise PanoramaError(f"{path}: FORMAT=32-bit_rle_xyze is not supported; save it as RGBE")
    if unknown := set(lines.get("FORMAT", [])) - {"32-bit_rle_rgbe"}:
        raise PanoramaError(f"{path}: FORMAT={unknown.pop()} is not supported; save it as RGBE")
    gamma = [value for text in lines.get("GAMMA", []) for value in _floats(path, "GAMMA", text, 1)]
    if any(abs(value - 1.0) > 1e-3 for value in gamma):
        raise PanoramaError(f"{path}: GAMMA={gamma[0]:g}; save it with linear radiance, GAMMA=1")
    aspects = [
        value
        for text in lines.get("PIXASPECT", [])
        for value in _floats(path, "PIXASPECT", text, 1)
    ]
    if any(abs(value - 1.0) > 1e-3 for value in aspects):
        raise PanoramaError(f"{path}: PIXASPECT={aspects[0]:g}; resample it to square pixels")
    scale = np.ones(3)
    for text in lines.get("EXPOSURE", []):
        scale *= _floats(path, "EXPOSURE", text, 1)
    for text in lines.get("COLORCORR", []):
        scale *= _floats(path, "COLORCORR", text, 3)
    if not (np.isfinite(scale) & (scale > 0)).all():
        raise PanoramaError(f"{path}: EXPOSURE or COLORCORR is not above 0; mend its header")
    primaries = REC709
    if texts := lines.get("PRIMARIES"):
        primaries = tuple(_floats(path, "PRIMARIES", texts[-1], 8))
    _check_fits(path, 12 * height * width, largest)
    _check_scanlines(path, start, height, width)
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise PanoramaError(f"{path}: is damaged ({_reason(oiio.geterror())}); copy it again")
    try:
        pixels = image.read_image(0, 0, 0, 3, oiio.FLOAT)
        if pixels is None:
            raise PanoramaError(f"{path}: is damaged ({_reason(image.geterror())}); copy it again")
    finally:
        image.close()
    pixels = np.asarray(pixels, np.float32).reshape(height, width, 3)
    transpose, rows, columns = _ORIENTATIONS[orientation]
    if transpose:
        pixels = pixels.transpose(1, 0, 2)
    pixels = pixels[:: -1 if rows else 1, :: -1 if columns else 1]
    pixels = np.ascontiguousarray(pixels)
    facts: dict[str, Any] = {}
    if orientation != "-Y +X":
        facts["orientation"] = orientation
    if (scale != 1.0).any():
        pixels /= scale.astype(np.float32)
        facts["exposure"] = scale.tolist()
    return _Image(
        pixels, display=(pixels.shape[1], pixels.shape[0]), primaries=primaries, facts=facts
    )


def _hdr_header(path: Path) -> tuple[dict[str, list[str]], str, tuple[int, int], int]:
    """Variables, axes, (scanlines, their length) and where pixels start."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    found = re.search(rb"\n\r?\n([+-])([XY]) +(\d{1,7}) +([+-])([XY]) +(\d{1,7})[ \r]*\n", head)
    if found is None or found[2] == found[5]:
        raise PanoramaError(f"{path}: is damaged (no resolution line in its header); copy it again")
    variables: dict[str, list[str]] = {}
    for line in head[: found.start()].decode("latin-1").splitlines()[1:]:
        name, mark, value = line.partition("=")
        if mark and not line.startswith("#"):
            variables.setdefault(name.strip().upper(), []).append(value.strip())
    axes = f"{found[1].decode()}{found[2].decode()} {found[4].decode()}{found[5].decode()}"
    return variables, axes, (int(found[3]), int(found[6])), found.end()


def _floats(path: Path, name: str, text: str, count: int) -> list[float]:
    words = text.split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise PanoramaError(
            f"{path}: {name}={text[:40]}: {count} numbers are wanted; mend its header"
        )
    return values


def _check_scanlines(path: Path, start: int, height: int, width: int) -> None:
    """Refuse the run-length code of before 1991, which the library reads as pixels."""
    size = path.stat().st_size - start
    with path.open("rb") as file:
        file.seek(start)
        first = file.read(4)
        if first[:2] == b"\x02\x02" and len(first) == 4 and first[2] < 128:
            return
        file.seek(start)
        pixels = np.frombuffer(file.read(min(size, 4 * height * width)), np.uint8)
    pixels = pixels[: len(pixels) // 4 * 4].reshape(-1, 4)
    if (pixels[:, :3] == 1).all(axis=1).any():
        raise PanoramaError(
            f"{path}: has Radiance's old run-length code, which is not supported; save it again"
        )


# ---------------------------------------------------------------- to radiance on the sphere


def _on_the_sphere(
    path: Path, image: _Image, missing: Missing, facts: dict[str, Any]
) -> np.ndarray:
    """The pixels in their display window, (H, 2H, 3)."""
    width, height = image.display
    if width != 2 * height or height < 2:
        raise PanoramaError(
            f"{path}: is {width} x {height}, an equirectangular panorama is twice as wide as high; "
            "crop or convert it to 2:1"
        )
    pixels, (left, top) = image.pixels, image.window
    if image.empty is not None:
        pixels[image.empty] = 0.0
    rows, columns = pixels.shape[:2]
    whole = (left, top, columns, rows) == (0, 0, width, height)
    if not whole:
        facts["data_window"] = [left, top, columns, rows]
        facts["display_window"] = [width, height]
    covered = np.zeros(height)  # share of each row that has pixels
    y0, y1 = max(top, 0), min(top + rows, height)
    x0, x1 = max(left, 0), min(left + columns, width)
    inside = (slice(y0 - top, y1 - top), slice(x0 - left, x1 - left))
    if y0 < y1 and x0 < x1:
        covered[y0:y1] = (x1 - x0) / width
        if image.empty is not None:
            covered[y0:y1] -= image.empty[inside].sum(axis=1) / width
    gone = 1.0 - float(covered @ texel_solid_angles(height)) * width / (4.0 * np.pi)
    if (covered < 1.0 - 1e-9).any():
        if missing == "refuse":
            why = "its data window" if not whole else "its alpha"
            raise PanoramaError(
                f"{path}: {why} leaves {gone:.1%} of the sphere without pixels; fill it in, or "
                'declare it black (missing = "black")'
            )
        facts["missing_black"] = round(gone, 6)
    if whole:
        return pixels
    panorama = np.zeros((height, width, 3), np.float32)
    if y0 < y1 and x0 < x1:
        panorama[y0:y1, x0:x1] = pixels[inside]
    return panorama


def _to_rec709(
    path: Path, panorama: np.ndarray, primaries: tuple[float, ...], facts: dict[str, Any]
) -> np.ndarray:
    if np.abs(np.subtract(primaries, REC709)).max() <= _SAME:
        return panorama
    facts["primaries"] = [round(value, 5) for value in primaries]
    matrix = to_rec709(primaries)
    if matrix is None:
        raise PanoramaError(f"{path}: chromaticities {list(primaries)} span no colours; mend them")
    if np.abs(matrix - np.eye(3)).max() <= _SAME:  # Rec.709 as adapted to another white
        return panorama
    for row in panorama:  # row by row: a second panorama need not fit into memory
        row[:] = row @ matrix.T.astype(np.float32)
    return panorama


def to_rec709(primaries: tuple[float, ...]) -> np.ndarray | None:
    """(3, 3) from linear RGB of primaries and white (xy) to Rec.709, by Bradford's adaptation.

    None if they span no colours. Equals `colour.matrix_RGB_to_RGB`, whose import takes a second.
    """
    xy = np.reshape(primaries, (4, 2)).astype(float)
    if not np.isfinite(xy).all() or (np.abs(xy[:, 1]) < 1e-6).any() or xy[3, 1] <= 0:
        return None
    if abs(np.linalg.det(np.c_[xy[:3], np.ones(3)])) < 1e-3:
        return None
    target = np.reshape(REC709, (4, 2))
    cones = [_BRADFORD @ _xyz(white) for white in (xy[3], target[3])]
    if min(cones[0]) <= 0:
        return None
    adapt = np.linalg.solve(_BRADFORD, np.diag(cones[1] / cones[0]) @ _BRADFORD)
    return np.linalg.solve(_rgb_to_xyz(target), adapt @ _rgb_to_xyz(xy))


_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def _rgb_to_xyz(xy: np.ndarray) -> np.ndarray:
    columns = np.stack([_xyz(colour) for colour in xy[:3]], axis=1)
    return columns * np.linalg.solve(columns, _xyz(xy[3]))


def _xyz(xy: np.ndarray) -> np.ndarray:
    """XYZ of a chromaticity at Y = 1."""
    return np.array([xy[0], xy[1], 1 - xy.sum()]) / xy[1]


def _check_values(path: Path, panorama: np.ndarray, facts: dict[str, Any]) -> None:
    height = len(panorama)
    weights = texel_solid_angles(height)
    negative = positive = 0.0
    counts = {"NaN or Inf": 0, "negative": 0, "huge": 0}
    place: dict[str, tuple[int, int]] = {}
    for number, row in enumerate(panorama):
        wrong = {
            "NaN or Inf": ~np.isfinite(row),
            "negative": row < 0,
            "huge": np.abs(row) > LARGEST,
        }
        for name, mask in wrong.items():
            if mask.any():
                counts[name] += int(mask.sum())
                place.setdefault(name, (number, int(np.argwhere(mask)[0][0])))
        if not counts["NaN or Inf"]:
            values = row.astype(np.float64)
            positive += weights[number] * float(values[values > 0].sum())
            negative -= weights[number] * float(values[values < 0].sum())

    def at(name: str) -> str:
        row, column = place[name]
        return f"{counts[name]} {name} values, the first at row {row}, column {column}"

    if counts["NaN or Inf"]:
        raise PanoramaError(f"{path}: holds {at('NaN or Inf')}; repair or replace the file")
    if counts["huge"]:
        raise PanoramaError(
            f"{path}: holds {at('huge')}: above {LARGEST:g} no sum is finite; repair the file"
        )
    if negative > MOST_NEGATIVE * positive and negative > 0:
        share = negative / (positive + negative)
        raise PanoramaError(
            f"{path}: holds {at('negative')}, {share:.1%} of its energy; repair the file"
        )
    if negative:
        facts["negative_share"] = float(f"{negative / (positive + negative):.3g}")
    if positive <= 0.0:
        raise PanoramaError(f"{path}: is black; an environment must emit light")


def _check_range(path: Path, panorama: np.ndarray) -> None:
    high, low = float(panorama.max()), float(panorama.min())
    if high > 1.0 or low == high:
        return
    # At most 1 everywhere: a photograph saved as float betrays itself by its 256 levels or by
    # highlights clipped to one value.
    levels = max(len(np.unique(panorama[..., channel])) for channel in range(3))
    clipped = float(np.mean(panorama == high))
    if levels <= 256 or clipped > 5e-4:
        sign = f"only {levels} levels" if levels <= 256 else f"{clipped:.1%} clipped at {high:g}"
        raise PanoramaError(
            f"{path}: is a low dynamic range image in a float file ({sign}, nothing above 1); "
            "use a true HDR panorama"
        )


# ---------------------------------------------------------------- libraries


@contextlib.contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Whatever the library raises, as one line for the user."""
    try:
        yield
    except MemoryError:
        raise PanoramaError(f"{path}: does not fit into memory; scale it down") from None
    except Exception as error:  # it raises whatever it likes
        raise PanoramaError(f"{path}: is damaged ({_reason(error)}); copy it again") from None


def _reason(error: object) -> str:
    lines = str(error).strip().splitlines() or ["unknown format"]
    return " ".join(lines[0].split())[:120]


@contextlib.contextmanager
def _without_chatter() -> Iterator[None]:
    """Keep what the library prints, by Python and from C++, off the terminal."""
    with _quiet, tempfile.TemporaryFile() as sink, contextlib.redirect_stdout(io.StringIO()):
        sys.stderr.flush()
        kept = os.dup(2)
        try:
            os.dup2(sink.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
