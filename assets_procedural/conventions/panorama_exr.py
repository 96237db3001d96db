"""Panoramas in OpenEXR files: parts and layers, windows, primaries, alpha."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions import console
from assets_procedural.conventions.primaries import REC709, SAME, SPACES
from assets_procedural.conventions.stored_panorama import (
    PanoramaError,
    StoredPanorama,
    check_fits,
    reason,
)

MAGIC = b"\x76\x2f\x31\x01"
"""The first bytes of every OpenEXR file."""


def read_exr(path: Path, choice: str, largest: int | None) -> StoredPanorama:
    import OpenEXR

    with console.without_chatter(), _damaged(path):
        header = OpenEXR.File(str(path), header_only=True)
    layers = _layers(header)
    part, names = _choose(path, choice, layers)
    attributes = header.parts[part].header
    check_fits(path, _decoded(header), largest)
    with console.without_chatter(), _damaged(path):
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
    image = StoredPanorama(
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


def check_exr_size(path: Path, largest: int | None) -> None:
    """Raise `PanoramaError` if the pixels of a file do not fit into `largest` bytes of memory."""
    import OpenEXR

    with console.without_chatter(), _damaged(path):
        size = _decoded(OpenEXR.File(str(path), header_only=True))
    check_fits(path, size, largest)


def _decoded(file: Any) -> int:
    """Bytes that all channels of a file take in memory."""
    windows = [part.header["dataWindow"] for part in file.parts]
    texels = [int(np.prod(high.astype(np.int64) - low + 1)) for low, high in windows]
    channels = [len(part.header["channels"]) for part in file.parts]
    return 4 * sum(n * c for n, c in zip(texels, channels, strict=True))


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
        if value.lower() not in SPACES:
            raise PanoramaError(
                f"{path}: {name} = {value}: not a linear colour space that is known here; "
                "convert it to linear Rec.709"
            )
        said[f"{name} = {value}"] = SPACES[value.lower()]
    if attributes.get("acesImageContainerFlag") == 1:
        said["acesImageContainerFlag = 1"] = SPACES["lin_ap0_scene"]
    if (xy := attributes.get("chromaticities")) is not None:
        said["chromaticities"] = tuple(float(x) for x in np.ravel(xy))
    for name, primaries in said.items():
        other = next(iter(said.values()))
        if np.abs(np.subtract(primaries, other)).max() > SAME:
            raise PanoramaError(
                f"{path}: {name} contradicts {next(iter(said))}; remove the wrong attribute"
            )
    return next(reversed(said.values()), REC709)


@contextlib.contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Whatever the library raises, as one line for the user."""
    try:
        yield
    except MemoryError:
        raise PanoramaError(f"{path}: does not fit into memory; scale it down") from None
    except Exception as error:  # it raises whatever it likes
        raise PanoramaError(f"{path}: is damaged ({reason(error)}); copy it again") from None
