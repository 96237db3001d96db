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

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from assets_procedural.conventions import panorama_exr, panorama_hdr
from assets_procedural.conventions.panorama import resize, texel_solid_angles
from assets_procedural.conventions.primaries import REC709, SAME, to_rec709
from assets_procedural.conventions.stored_panorama import (
    PanoramaError,
    StoredPanorama,
    check_fits,
)

READER = 1
"""Version of this reader, kept in provenance: to be raised when a file gives other pixels."""
MOST_NEGATIVE = 0.15
"""Largest share of negative energy: ringing of a resampling beside the sun stays below it."""
LARGEST = 1e30
"""Largest radiance: sums over a sphere's texels and their squares stay finite in float32."""

Missing = Literal["refuse", "black"]


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
    if magic.startswith(panorama_exr.MAGIC):
        image = panorama_exr.read_exr(path, choice, largest)
    elif magic.startswith(panorama_hdr.MAGIC):
        if choice:
            raise PanoramaError(f"{path}#{choice}: a .hdr file has no parts; leave out #{choice}")
        image = panorama_hdr.read_hdr(path, largest)
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
    if magic == panorama_exr.MAGIC:
        panorama_exr.check_exr_size(path, largest)
    else:
        _, _, (height, width), _ = panorama_hdr.hdr_header(path)
        check_fits(path, 12 * height * width, largest)


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


# ---------------------------------------------------------------- to radiance on the sphere


def _on_the_sphere(
    path: Path, image: StoredPanorama, missing: Missing, facts: dict[str, Any]
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
    if np.abs(np.subtract(primaries, REC709)).max() <= SAME:
        return panorama
    facts["primaries"] = [round(value, 5) for value in primaries]
    matrix = to_rec709(primaries)
    if matrix is None:
        raise PanoramaError(f"{path}: chromaticities {list(primaries)} span no colours; mend them")
    if np.abs(matrix - np.eye(3)).max() <= SAME:  # Rec.709 as adapted to another white
        return panorama
    for row in panorama:  # row by row: a second panorama need not fit into memory
        row[:] = row @ matrix.T.astype(np.float32)
    return panorama


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
