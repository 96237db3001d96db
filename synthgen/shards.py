"""Shot <-> tar members; the atomic commit of a finished file.

A subject is encoded to bytes of consecutive tar entries; a shard is the concatenation of its
subjects and the end-of-archive blocks. Everything is deterministic byte for byte: member order,
times, owners, and the headers inside PNG, EXR and NPZ.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import tarfile
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from synthgen.shot import Shot

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


@dataclass(frozen=True)
class Member:
    """Where a member's content lies: bytes [offset, offset + size) of the file."""

    name: str
    offset: int
    size: int


# ---------------------------------------------------------------- shot <-> members


def encode(shot: Shot) -> dict[str, bytes]:
    """The members of a shot in their fixed order: field name (without the key) -> content."""
    members = {f"rgb_{i:02d}.png": _png(image) for i, image in enumerate(shot.rgb)}
    if shot.hdr is not None:
        for i, image in enumerate(shot.hdr):
            planes = {c: image[..., k].astype(np.float16) for k, c in enumerate("RGBA")}
            members[f"hdr_{i:02d}.exr"] = encode_exr(planes)
    members["albedo.png"] = _png(shot.albedo)
    planes = {}
    for name, (source, component, dtype) in AOV_CHANNELS.items():
        array = getattr(shot, source)
        planes[name] = (array if component is None else array[..., component]).astype(dtype)
    members["aov.exr"] = encode_exr(planes)
    members["alpha.png"] = _png(shot.alpha)
    members["parts.png"] = _png(shot.parts)
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
                fields[stem] = _unpng(data)
            elif name == "aov.exr":
                fields |= _split_aov(decode_exr(data))
            elif extension == "exr":
                planes = decode_exr(data)
                fields[stem] = np.stack([planes[c] for c in "RGBA"], -1)
            elif extension == "npz":
                with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                    fields[stem] = {k: archive[k] for k in archive.files}
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


def _png(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()


def _unpng(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image)


def encode_exr(planes: dict[str, np.ndarray]) -> bytes:
    """One scan-line EXR, ZIP-compressed, from (H, W) planes of float16 or float32."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    buffer = io.BytesIO()
    contiguous = {name: np.ascontiguousarray(plane) for name, plane in planes.items()}
    OpenEXR.File(header, contiguous, num_threads=0).write(buffer)
    return buffer.getvalue()


def decode_exr(data: bytes) -> dict[str, np.ndarray]:
    """Channel name -> (H, W) plane, in the type it is stored in."""
    import OpenEXR

    file = OpenEXR.File(io.BytesIO(data), separate_channels=True, num_threads=0)
    return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def encode_npz(arrays: dict[str, np.ndarray]) -> bytes:
    """A compressed NPZ with sorted names and fixed dates."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(arrays):
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(arrays[name]), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content.getvalue())
    return buffer.getvalue()


def encode_json(value: Any) -> bytes:
    """Compact UTF-8 JSON with sorted keys; `ValueError` for NaN and Inf."""
    text = json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"), default=_plain)
    return text.encode()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} does not go to JSON")


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


# ---------------------------------------------------------------- atomic commit


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[io.BufferedWriter]:
    """A file that appears under `target` whole, or not at all: temporary name, fsync, rename."""
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    _sync_folder(target.parent)


def write_atomically(target: Path, content: bytes) -> None:
    """Commit `content` under `target`."""
    with replacing(target) as file:
        file.write(content)


def sha256(path: Path) -> str:
    """Hex digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync_folder(folder: Path) -> None:
    if os.name == "nt":  # directories cannot be opened there
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _brief(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:160] if lines else type(error).__name__
