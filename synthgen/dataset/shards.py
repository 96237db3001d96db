"""Shots as members of a tar and back, and subjects joined to shards.

A subject is encoded to bytes of consecutive tar entries; a shard is the concatenation of its
subjects and the end-of-archive blocks. Everything is deterministic byte for byte: member order,
times, owners, and the headers inside PNG, EXR and NPZ.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.files import replacing
from synthgen.dataset import passes
from synthgen.dataset.codecs import (
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


def decode(key: str, members: dict[str, bytes]) -> Shot:
    """The inverse of `encode`; `KeyError` for a missing member, `ValueError` for a broken one."""
    fields = decode_fields(members)
    images = [fields[name] for name in sorted(fields) if name.startswith("rgb_")]
    if not images:
        raise KeyError("rgb_00.png")
    hdr = [fields[name] for name in sorted(fields) if name.startswith("hdr_")]
    for name, member in MEMBER_OF.items():
        if name not in fields:
            raise KeyError(member)
    return Shot(
        key=key,
        rgb=np.stack(images),
        hdr=np.stack(hdr) if hdr else None,
        passes={p.name: fields[p.name] for p in PASSES},
        geometry=fields["geometry"],
        meta=fields["meta"],
    )


def decode_fields(members: dict[str, bytes]) -> dict[str, Any]:
    """Decode the members that are given: `rgb_00`, `hdr_00`, `albedo`, `normal`, `depth`, …"""
    fields: dict[str, Any] = {}
    for name, data in members.items():
        stem, _, extension = name.rpartition(".")
        try:
            if extension == "png":
                fields[stem] = decode_png(data)
            elif name == AOV_MEMBER:
                fields |= _split_aov(decode_exr(data))
            elif extension == "exr":
                planes = decode_exr(data)
                fields[stem] = np.stack([planes[c] for c in "RGBA"], -1)
            elif extension == "npz":
                fields[stem] = decode_npz(data)
            elif extension == "json":
                meta = json.loads(data)
                fields[stem] = meta | {"person": json.loads(meta["person"])}
        except Exception as error:  # decoders raise whatever they like on damaged bytes
            raise ValueError(f"{name} does not decode: {_brief(error)}") from error
    return fields


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
    with path.open("rb") as file:
        while offset < end:
            file.seek(offset)
            try:
                info = tarfile.TarInfo.frombuf(file.read(BLOCK), "utf-8", "surrogateescape")
            except tarfile.HeaderError as error:
                raise ValueError(f"{path.name}: no tar entry at byte {offset}") from error
            content = file.read(info.size)
            if len(content) != info.size or offset + BLOCK + info.size > end:
                raise ValueError(f"{path.name}: {info.name} is cut short")
            yield info.name, offset + BLOCK, content
            offset += BLOCK + info.size + (-info.size % BLOCK)


def read_sample(
    path: Path, offset: int, size: int, key: str, wanted: Iterable[str] | None = None
) -> dict[str, bytes]:
    """The members of the sample `key` (which is stripped from the names), or only those `wanted`.

    Raises `ValueError` if the bytes are not whole tar entries of this sample.
    """
    members = {}
    for name, _, data in read_members(path, offset, size):
        owner, _, field = name.partition(".")
        if owner != key:
            raise ValueError(f"{path.name}: holds {owner[:80]!r} where {key} should be")
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
