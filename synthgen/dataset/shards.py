"""Shot <-> members of a tar; subjects to a shard.

A subject is encoded to bytes of consecutive tar entries; a shard is the concatenation of its
subjects and the end-of-archive blocks. Everything is deterministic byte for byte: member order,
times, owners, and the headers inside PNG, EXR and NPZ.
"""

from __future__ import annotations

import hashlib
import json
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from assets_procedural.conventions.files import replacing
from synthgen.dataset.codecs import (
    decode_exr,
    decode_npz,
    decode_png,
    encode_exr,
    encode_json,
    encode_npz,
    encode_png,
)
from synthgen.dataset.shot import Shot

# aov.exr: channel name -> (field, component, pixel type)
AOV_CHANNELS: dict[str, tuple[str, int | None, type]] = {
    "normal.X": ("normal", 0, np.float16),
    "normal.Y": ("normal", 1, np.float16),
    "normal.Z": ("normal", 2, np.float16),
    "depth.Z": ("depth", None, np.float32),
    "uv.U": ("uv", 0, np.float32),
    "uv.V": ("uv", 1, np.float32),
    "canonical.X": ("canonical", 0, np.float32),
    "canonical.Y": ("canonical", 1, np.float32),
    "canonical.Z": ("canonical", 2, np.float32),
}
# field of a Shot -> member that holds it
MEMBER_OF = {
    "albedo": "albedo.png",
    "normal": "aov.exr",
    "depth": "aov.exr",
    "uv": "aov.exr",
    "canonical": "aov.exr",
    "alpha": "alpha.png",
    "parts": "parts.png",
    "geometry": "geometry.npz",
    "meta": "meta.json",
}
BLOCK = tarfile.BLOCKSIZE


# ---------------------------------------------------------------- shot <-> members


def encode(shot: Shot) -> dict[str, bytes]:
    """The members of a shot in their fixed order: field name (without the key) -> content."""
    members = {f"rgb_{i:02d}.png": encode_png(image) for i, image in enumerate(shot.rgb)}
    if shot.hdr is not None:
        for i, image in enumerate(shot.hdr):
            planes = {c: image[..., k].astype(np.float16) for k, c in enumerate("RGBA")}
            members[f"hdr_{i:02d}.exr"] = encode_exr(planes)
    members["albedo.png"] = encode_png(shot.albedo)
    planes = {}
    for name, (source, component, dtype) in AOV_CHANNELS.items():
        array = getattr(shot, source)
        planes[name] = (array if component is None else array[..., component]).astype(dtype)
    members["aov.exr"] = encode_exr(planes)
    members["alpha.png"] = encode_png(shot.alpha)
    members["parts.png"] = encode_png(shot.parts)
    members["geometry.npz"] = encode_npz(shot.geometry)
    # As a string, because its keys vary from person to person: readers that infer one type for all
    # samples, as Hugging Face's does, could not hold it as an object.
    person = encode_json(shot.meta["person"]).decode()
    members["meta.json"] = encode_json(shot.meta | {"person": person})
    return members


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
        **{name: fields[name] for name in MEMBER_OF},
    )


def decode_fields(members: dict[str, bytes]) -> dict[str, Any]:
    """Decode whatever members are there: `rgb_00`, `hdr_00`, `albedo`, `normal`, `depth`, …"""
    fields: dict[str, Any] = {}
    for name, data in members.items():
        stem, _, extension = name.rpartition(".")
        try:
            if extension == "png":
                fields[stem] = decode_png(data)
            elif name == "aov.exr":
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
    missing = set(AOV_CHANNELS) - set(planes)
    if missing:
        raise ValueError(f"channels {sorted(missing)} are missing")
    return {
        "normal": np.stack([planes[f"normal.{c}"] for c in "XYZ"], -1),
        "depth": planes["depth.Z"],
        "uv": np.stack([planes[f"uv.{c}"] for c in "UV"], -1),
        "canonical": np.stack([planes[f"canonical.{c}"] for c in "XYZ"], -1),
    }


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

    Raises `ValueError` if the bytes are no whole tar entries.
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
    path: Path, offset: int, size: int, wanted: Iterable[str] | None = None
) -> dict[str, bytes]:
    """The members of one sample (key stripped from the names), or only those `wanted`."""
    members = {name.split(".", 1)[1]: data for name, _, data in read_members(path, offset, size)}
    return members if wanted is None else {name: members[name] for name in wanted}


def concatenate(parts: Iterable[Path], target: Path) -> tuple[list[int], int, str]:
    """Commit a shard made of subject files: (start of every part, size, sha256)."""
    digest, starts = hashlib.sha256(), []
    with replacing(target) as file:

        def put(block: bytes) -> None:
            file.write(block)
            digest.update(block)

        position = 0
        for part in parts:
            starts.append(position)
            with part.open("rb") as source:
                while block := source.read(1 << 22):
                    put(block)
                    position += len(block)
        tail = 2 * BLOCK
        tail += -(position + tail) % tarfile.RECORDSIZE
        put(bytes(tail))
    return starts, position + tail, digest.hexdigest()
