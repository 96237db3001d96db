"""Shots decoded to arrays, for the page of one shot; the last few stay in memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numpy as np

from assets_procedural.conventions.colour import srgb_decode
from synthgen.browse.folder import Refused
from synthgen.browse.shot.samples import Broken, Sample
from synthgen.dataset.passes import PASSES, named
from synthgen.dataset.shards import decode, decode_fields
from synthgen.dataset.shot import Shot
from synthgen.pictures.drawing import PICTURES

VALUES = ("image", "linear", *(p.name for p in PASSES))
"""What `values` gives the numbers of."""
_KEPT = 4
_MOST = 1 << 30  # bytes of a shot, once it is decoded; a request decodes one


class Decoder:
    """Decodes whole samples, one at a time, and remembers the last ones with their pictures."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._shots: OrderedDict[tuple[Any, ...], tuple[Shot, dict[str, np.ndarray]]] = (
            OrderedDict()
        )

    def shot(self, sample: Sample) -> Shot:
        """The sample's shot, without its linear pictures. Raises `Broken` if it does not decode."""
        return self._get(sample)[0]

    def picture(self, sample: Sample, name: str, environment: int) -> np.ndarray:
        """A pass as (H, W, 3 | 4) uint8: `image`, or one of `PICTURES` as `synthgen show` draws it.

        Raises `Refused` for an unknown pass or environment, `Broken` if the sample is damaged.
        """
        shot, drawn = self._get(sample)
        if name == "image":
            return shot.rgb[_environment(shot, environment)]
        if name not in PICTURES:
            raise Refused(f"no pass {name[:40]}; there are image, {', '.join(PICTURES)}")
        with self._lock:
            if name not in drawn:
                drawn[name] = PICTURES[name](shot)
        return drawn[name]

    def values(self, sample: Sample, name: str, environment: int) -> np.ndarray:
        """The numbers of a pass, float32 or uint8, (H, W) or (H, W, C).

        `image` as stored, `linear` RGBA light before exposure (where the dataset has it), and
        passes as stored, but for colours, which are made linear. Raises as `picture`.
        """
        shot = self.shot(sample)
        if name not in VALUES:
            raise Refused(f"no values {name[:40]}; there are {', '.join(VALUES)}")
        if name == "image":
            return shot.rgb[_environment(shot, environment)]
        if name == "linear":
            member = f"hdr_{_environment(shot, environment):02d}.exr"
            try:
                return decode_fields({member: sample.read(member)}, _MOST)[member[:-4]].astype(
                    np.float32
                )
            except ValueError as error:
                raise Broken(_first_line(error)) from None
        array, wanted = shot.passes[name], named(name)
        if wanted is not None and wanted.drawn == "colour":
            return srgb_decode(array.astype(np.float32) / np.float32(255))
        return array if array.dtype == np.uint8 else array.astype(np.float32)

    def _get(self, sample: Sample) -> tuple[Shot, dict[str, np.ndarray]]:
        place = sample.place()
        with self._lock:
            if place not in self._shots:
                self._shots[place] = (_decode(sample), {})
            self._shots.move_to_end(place)
            while len(self._shots) > _KEPT:
                self._shots.popitem(last=False)
            return self._shots[place]


def metadata(sample: Sample) -> dict[str, Any]:
    """A sample's meta.json alone, `person` parsed. Raises `Broken` if it does not decode."""
    try:
        return decode_fields({"meta.json": sample.read("meta.json")})["meta"]
    except (ValueError, Refused) as error:
        raise Broken(_first_line(error)) from None


def _decode(sample: Sample) -> Shot:
    wanted = [m for m in sample.members.values() if not m.name.startswith("hdr_")]
    if sum(member.size for member in wanted) > _MOST:
        raise Broken(f"it has more than {_MOST >> 30} GB")
    try:
        return decode(sample.key, {m.name: sample.read(m.name) for m in wanted}, _MOST)
    except KeyError as error:
        raise Broken(f"{error.args[0]} is missing") from None
    except (ValueError, MemoryError) as error:
        raise Broken(_first_line(error)) from None


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def _environment(shot: Shot, environment: int) -> int:
    if not 0 <= environment < len(shot.rgb):
        raise Refused(f"no environment {environment}: this shot has {len(shot.rgb)}, from 0 on")
    return environment
