"""Shots as members of a tar and back, and subjects joined to shards.

A subject is encoded to bytes of consecutive tar entries; a shard is the concatenation of its
subjects and the end-of-archive blocks. Everything is deterministic byte for byte: member order,
times, owners, and the headers inside PNG, EXR and NPZ.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.files import open_regular, replacing
from synthgen.dataset import metadata, passes
from synthgen.dataset.codecs import (
    LARGEST,
    decode_exr,
    decode_npz,
    decode_png,
    encode_exr,
    encode_json,
    encode_npz,
    encode_png,
)
from synthgen.dataset.passes import AOV_MEMBER, PASSES, Pass
from synthgen.dataset.shot import Shot

MEMBER_OF = {p.name: p.member for p in PASSES} | {
    "geometry": "geometry.npz",
    "meta": "meta.json",
}
"""Field of a sample -> the member that holds it; pictures have one each."""
BLOCK = tarfile.BLOCKSIZE
LARGEST_MEMBER = 1 << 30
"""Bytes of a member that is read."""


# ---------------------------------------------------------------- shot <-> members


def encode(shot: Shot) -> dict[str, bytes]:
    """The members of a shot in their fixed order: field name (without the key) -> content."""
    members = {f"rgb_{i:02d}.png": encode_png(image) for i, image in enumerate(shot.rgb)}
    if shot.hdr is not None:
        for i, image in enumerate(shot.hdr):
            planes = {c: image[..., k].astype(np.float16) for k, c in enumerate("RGBA")}
            members[f"hdr_{i:02d}.exr"] = encode_exr(planes)
    for member, held in passes.members().items():
        if member == AOV_MEMBER:
            members[member] = encode_exr(_planes(shot, held))
        else:
            members[member] = encode_png(shot.passes[held[0].name])
    members["geometry.npz"] = encode_npz(shot.geometry)
    # As a string, because its keys vary from person to person: readers that infer one type for all
    # samples, as Hugging Face's does, could not hold it as an object.
    person = encode_json(shot.meta["person"]).decode()
    members["meta.json"] = encode_json(shot.meta | {"person": person})
    return members


def _planes(shot: Shot, held: list[Pass]) -> dict[str, np.ndarray]:
    planes = {}
    for each in held:
        array = np.atleast_3d(shot.passes[each.name])
        for k, channel in enumerate(each.channels):
            planes[channel] = array[..., k].astype(each.dtype)
    return planes


def decode(key: str, members: dict[str, bytes], most: int = LARGEST) -> Shot:
    """The inverse of `encode`; `KeyError` for a missing member, `ValueError` for a broken one.

    Arrays of one shot take at most `most` bytes.
    """
    fields = decode_fields(members, most)
    images = [fields[name] for name in sorted(fields) if name.startswith("rgb_")]
    if not images:
        raise KeyError("rgb_00.png")
    hdr = [fields[name] for name in sorted(fields) if name.startswith("hdr_")]
    for name, member in MEMBER_OF.items():
        if name not in fields:
            raise KeyError(member)
    _check_sizes(fields, images, hdr)
    return Shot(
        key=key,
        rgb=np.stack(images),
        hdr=np.stack(hdr) if hdr else None,
        passes={p.name: fields[p.name] for p in PASSES},
        geometry=fields["geometry"],
        meta=fields["meta"],
    )


def decode_fields(members: dict[str, bytes], most: int = LARGEST) -> dict[str, Any]:
    """Decode the members that are given: `rgb_00`, `hdr_00`, `albedo`, `normal`, `depth`, …

    Raises `ValueError` for a broken member, and beyond `most` bytes of arrays.
    """
    fields: dict[str, Any] = {}
    left = most
    for name, data in members.items():
        stem, _, extension = name.rpartition(".")
        try:
            if extension == "png":
                found: dict[str, Any] = {stem: decode_png(data, left)}
            elif name == AOV_MEMBER:
                found = _split_aov(decode_exr(data, left))
            elif extension == "exr":
                planes = decode_exr(data, left)
                found = {stem: np.stack([planes[c] for c in "RGBA"], -1)}
            elif extension == "npz":
                found = {stem: decode_npz(data, left)}
            elif name == "meta.json":
                found = {stem: metadata.parse(data)}
            else:
                continue
        except Exception as error:  # decoders raise whatever they like on damaged bytes
            raise ValueError(f"{name} does not decode: {_brief(error)}") from error
        fields |= found
        left -= sum(map(_room, found.values()))
    return fields


def _room(value: Any) -> int:
    """Bytes of an array, or of all arrays of a member."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    arrays = value.values() if isinstance(value, dict) else ()
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


def _check_sizes(fields: dict[str, Any], images: list[np.ndarray], hdr: list[np.ndarray]) -> None:
    """Raise `ValueError` unless the arrays of a shot fit each other, as `Shot` says."""
    first, lights = images[0].shape, len(fields["meta"]["environments"])
    if len(first) != 3 or any(image.shape != first for image in images):
        raise ValueError("pictures are grey, or of several sizes")
    if any(image.shape != (*first[:2], 4) for image in hdr):
        raise ValueError("linear pictures are of another size than the others")
    if lights != len(images) or len(hdr) not in (0, lights):
        raise ValueError(f"{len(images)} pictures of {lights} environments")
    for each in PASSES:
        found, wanted = fields[each.name].shape, each.shape(*first[:2])
        if found != wanted:
            raise ValueError(f"{each.name} has the shape {found}, not {wanted}")


def _split_aov(planes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    held = passes.members()[AOV_MEMBER]
    missing = {channel for p in held for channel in p.channels} - set(planes)
    if missing:
        raise ValueError(f"channels {sorted(missing)} are missing")
    split = {}
    for each in held:
        stack = [planes[channel] for channel in each.channels]
        split[each.name] = stack[0] if len(stack) == 1 else np.stack(stack, -1)
    return split


def _brief(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:160] if lines else type(error).__name__


# ---------------------------------------------------------------- tar


def tar_entry(name: str, content: bytes) -> bytes:
    """Header, content and padding of one tar entry."""
    info = tarfile.TarInfo(name)
    info.size, info.mode = len(content), 0o644
    return info.tobuf(tarfile.USTAR_FORMAT) + content + bytes(-len(content) % BLOCK)


def read_members(path: Path, offset: int, size: int) -> Iterator[tuple[str, int, bytes]]:
    """Entries that lie in bytes [offset, offset + size) of a tar: (name, content offset, content).

    Raises `ValueError` if the bytes are not whole tar entries.
    """
    end = offset + size
    with open_regular(path) as file:
        if offset < 0 or size < 0 or end > os.fstat(file.fileno()).st_size:
            raise ValueError(f"{path.name} is cut short: it ends before byte {end}")
        while offset < end:
            file.seek(offset)
            try:
                info = tarfile.TarInfo.frombuf(file.read(BLOCK), "utf-8", "surrogateescape")
            except tarfile.HeaderError as error:
                raise ValueError(f"{path.name}: no tar entry at byte {offset}") from error
            if not 0 <= info.size <= min(end - offset - BLOCK, LARGEST_MEMBER):
                raise ValueError(f"{path.name}: {info.name} is cut short, or too large")
            content = file.read(info.size)
            if len(content) != info.size:
                raise ValueError(f"{path.name}: {info.name} is cut short")
            yield info.name, offset + BLOCK, content
            offset += BLOCK + info.size + (-info.size % BLOCK)


def read_sample(
    path: Path, offset: int, size: int, key: str, wanted: Iterable[str] | None = None
) -> dict[str, bytes]:
    """The members of the sample `key` (which is stripped from the names), or only those `wanted`.

    Raises `ValueError` if the bytes are not whole tar entries of this sample, or too many.
    """
    members: dict[str, bytes] = {}
    left = LARGEST
    for name, _, data in read_members(path, offset, size):
        owner, _, field = name.partition(".")
        if owner != key:
            raise ValueError(f"{path.name}: holds {owner[:80]!r} where {key} should be")
        left -= len(data)
        if left < 0:
            raise ValueError(f"{path.name}: a sample of more than {LARGEST >> 30} GB")
        members[field] = data
    return members if wanted is None else {name: members[name] for name in wanted}


class Changed(ValueError):
    """A part of a shard is not what its checksum says; `place` is its number."""

    def __init__(self, path: Path, place: int) -> None:
        super().__init__(f"{path}: changed since it was written")
        self.place = place


def concatenate(
    parts: Iterable[Path], target: Path, checksums: Iterable[str | None] = itertools.repeat(None)
) -> tuple[list[int], int, str, list[str]]:
    """Commit a shard made of subject files: (start of every part, size, sha256, that of each part).

    Raises `Changed` where a part has another sha256 than `checksums` gives for it.
    """
    digest, starts, digests = hashlib.sha256(), [], []
    with replacing(target) as file:

        def put(block: bytes) -> None:
            file.write(block)
            digest.update(block)

        position = 0
        for place, (part, expected) in enumerate(zip(parts, checksums, strict=False)):
            starts.append(position)
            own = hashlib.sha256()
            with part.open("rb") as source:
                while block := source.read(1 << 22):
                    put(block)
                    own.update(block)
                    position += len(block)
            digests.append(own.hexdigest())
            if expected not in (None, digests[-1]):
                raise Changed(part, place)
        tail = 2 * BLOCK
        tail += -(position + tail) % tarfile.RECORDSIZE
        put(bytes(tail))
    return starts, position + tail, digest.hexdigest(), digests
