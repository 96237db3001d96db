"""Datasets and conditions made to do harm: does anything get out, in, on, or stuck?

    python benchmarks/torture_foreign.py [--kind NAME ...] [--seconds 20] [--no-sql]

Every kind of hostile dataset goes through every command that reads one, through `open_dataset`,
training's `Shots` and the page's application, each in a process of its own with a limit of time and
memory, beside a folder that holds a secret. Counted are: files outside that were changed, made or
read; files of the dataset that were changed; tracebacks; runs that did not end; characters that a
terminal obeys. Then hostile conditions go through the page, `open_dataset` and `query`: escapes,
seconds beyond the limit, memory. Prints a line per finding, the counts, and ends with 1 if any.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import pickle
import re
import resource
import shutil
import signal
import socket
import struct
import sys
import tempfile
import time
import traceback
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import report

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

import fake_renderer  # noqa: E402
from starlette.testclient import TestClient  # noqa: E402

from synthgen.browse import sandbox  # noqa: E402
from synthgen.browse.app import create  # noqa: E402
from synthgen.browse.folder import Folder  # noqa: E402
from synthgen.browse.snapshot import Library  # noqa: E402
from synthgen.browse.thumbnails import Thumbnails  # noqa: E402
from synthgen.cli import main as synthgen  # noqa: E402
from synthgen.dataset import manifest, open_dataset  # noqa: E402
from synthgen.dataset.codecs import encode_json, encode_npz, encode_png  # noqa: E402
from synthgen.dataset.folder import StorageError  # noqa: E402
from synthgen.dataset.shards import read_sample, tar_entry  # noqa: E402
from synthgen.farm.local import render_job  # noqa: E402

SECRET = b"nobody shall read this: 5f3a9c"
SHOT = "multiview/s000002_p01"
MEMORY = 12 << 30
"""Bytes of addresses that a run may take; what is held is counted beside it."""
HELD = 3000.0
"""Megabytes that a run may hold."""
OWNED = "\x1b]0;owned\x07\x1b[2J[/x][bold]\u202e\x9b31m"


# ---------------------------------------------------------------- hostile datasets


@dataclass
class Place:
    """Where a kind is tried: a dataset to spoil, what lies outside it, where answers go."""

    root: Path
    out: Path = field(init=False)
    outside: Path = field(init=False)
    target: Path = field(init=False)

    def __post_init__(self) -> None:
        self.out, self.outside = self.root / "dataset", self.root / "outside"
        self.target = self.root / "target"


KINDS: dict[str, Callable[[Place], None]] = {}
LINKS = ("a folder is a link", "a shard is a link")
"""Kinds whose links commands follow, as docs/threat-model.md says; the page must not."""


def kind(name: str) -> Callable[[Callable[[Place], None]], Callable[[Place], None]]:
    def register(spoil: Callable[[Place], None]) -> Callable[[Place], None]:
        KINDS[name] = spoil
        return spoil

    return register


def description(place: Place, change: Callable[[dict[str, Any]], None]) -> None:
    path = place.out / "dataset.json"
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))


def rename_subset(name: str, incomplete: bool = True) -> Callable[[Place], None]:
    def spoil(place: Place) -> None:
        def change(info: dict[str, Any]) -> None:
            text = name.format(outside=place.outside)
            info["plan"][text] = info["plan"].pop("multiview")
            info["job"]["subsets"][text] = info["job"]["subsets"].pop("multiview")
            info["complete"] = not incomplete

        description(place, change)
        old = place.out / "manifest" / "multiview.parquet"
        with contextlib.suppress(OSError, ValueError):
            shutil.copy(old, old.with_name(name + ".parquet"))

    return spoil


def set_in_description(**values: Any) -> Callable[[Place], None]:
    return lambda place: description(place, lambda info: info.update(values))


def manifest_with(changes: str, added: str = "") -> Callable[[Place], None]:
    """The multiview manifest with an SQL list of replacements, and columns added."""

    def spoil(place: Place) -> None:
        path = place.out / "manifest" / "multiview.parquet"
        replaced = f"* REPLACE ({changes.format(outside=place.outside)})" if changes else "*"
        more = f", {added.format(outside=place.outside)}" if added else ""
        with duckdb.connect() as connection:
            text = f"COPY (SELECT {replaced}{more} FROM '{path}') TO '{path}.new'"
            connection.execute(f"{text} (FORMAT parquet)")
        Path(f"{path}.new").rename(path)

    return spoil


def sample_with(**changes: Any) -> Callable[[Place], None]:
    """A shot of which members are replaced or (None) left out."""

    def spoil(place: Place) -> None:
        members = members_of(place.out)
        for name, content in changes.items():
            name = name.replace("__", ".")
            if content is None:
                members.pop(name, None)
            else:
                made = content(members.get(name, b"")) if callable(content) else content
                assert isinstance(made, bytes)
                members[name] = made
        key = SHOT.split("/")[1]
        store(place, b"".join(tar_entry(f"{key}.{n}", c) for n, c in members.items()))

    return spoil


def store(place: Place, content: bytes, size: int | None = None) -> None:
    (place.out / "data" / "multiview" / "hostile.tar").write_bytes(content)
    shard = "'data/multiview/hostile.tar'"
    only(place, {"shard": shard, '"offset"': "0", "size": str(size or len(content))})


def only(place: Place, values: dict[str, str]) -> None:
    """Change the row of `SHOT` alone."""
    changes = (
        f"CASE WHEN key = '{SHOT.split('/')[1]}' THEN {value} ELSE {name} END AS {name}"
        for name, value in values.items()
    )
    manifest_with(", ".join(changes))(place)


def members_of(out: Path) -> dict[str, bytes]:
    dataset = open_dataset(out)
    position = dataset.position(SHOT)
    shard = out / dataset.index.shards[dataset.index.shard[position]]
    place = int(dataset.index.offset[position]), int(dataset.index.size[position])
    return read_sample(shard, *place, SHOT.split("/")[1])


def meta(change: Callable[[dict[str, Any]], Any]) -> Callable[[bytes], bytes]:
    def replace(content: bytes) -> bytes:
        value = json.loads(content)
        return json.dumps(change(value) or value).encode()

    return replace


def put(*keys: str | int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(meta: Any) -> None:
        for key in keys[:-1]:
            meta = meta[key]
        meta[keys[-1]] = value

    return change


def pipe(name: str) -> Callable[[Place], None]:
    def spoil(place: Place) -> None:
        path = place.out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        os.mkfifo(path)

    return spoil


def incomplete(*spoils: Callable[[Place], None]) -> Callable[[Place], None]:
    """A dataset that is being rendered, so that ledger and waiting subjects are read."""

    def spoil(place: Place) -> None:
        description(place, lambda info: info.update(complete=False))
        for each in spoils:
            each(place)

    return spoil


def file(name: str, content: bytes | str) -> Callable[[Place], None]:
    def spoil(place: Place) -> None:
        path = place.out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = content if isinstance(content, bytes) else content.encode()
        path.write_bytes(text.replace(b"{outside}", str(place.outside).encode()))

    return spoil


def link(name: str, target: str) -> Callable[[Place], None]:
    def spoil(place: Place) -> None:
        path = place.out / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.symlink_to(target.format(outside=place.outside))

    return spoil


def waiting(change: Callable[[dict[str, Any], Place], Any]) -> Callable[[Place], None]:
    """A row of a finished subject waits for its shard."""

    def spoil(place: Place) -> None:
        description(place, lambda info: info.update(complete=False))
        rows = manifest.read_rows(place.out / "manifest" / "multiview.parquet")
        row = rows[0] | {"key": "s000009_p00", "subject": "s000009"}
        row = json.loads(encode_json({k: v for k, v in row.items() if v is not None}))
        row["members"] = [dict(m) for m in row["members"]]
        changed = change(row, place)
        lines = json.dumps(row if changed is None else changed)
        file("work/multiview/s000009.json", lines + "\n")(place)

    return spoil


def postscript(place: Place) -> bytes:
    """What Ghostscript would write a file for."""
    return (
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 48 48\n("
        + str(place.outside).encode()
        + b"/written) (w) file (x) writestring\nshowpage\n%%EOF\n"
    )


def png_header(width: int, height: int) -> bytes:
    import zlib

    def chunk(name: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(name + content))
        return struct.pack(">I", len(content)) + name + content + check

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes(1 << 20), 9)
    start = b"\x89PNG\r\n\x1a\n"
    return start + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def other_picture(format_: str) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.new("RGB", (48, 48)).save(buffer, format_)
    return buffer.getvalue()


def exr(height: int, width: int, claim: tuple[int, int] | None = None) -> bytes:
    """An EXR, of which the data window may claim another size."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {c: np.zeros((height, width), np.float32) for c in "RGB"}
    buffer = io.BytesIO()
    OpenEXR.File(header, planes).write(buffer)
    content = buffer.getvalue()
    if claim:
        for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
            at = content.index(name) + len(name) + 4
            box = struct.pack("<4i", 0, 0, claim[0] - 1, claim[1] - 1)
            content = content[:at] + box + content[at + 16 :]
    return content


def zip_of(name: str, content: bytes, times: int = 1, compression: int = 8) -> bytes:
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", compression) as archive,
        archive.open(name, "w", force_zip64=True) as entry,
    ):
        for _ in range(times):
            entry.write(content)
    return buffer.getvalue()


def npy(shape: tuple[int, ...], content: bytes) -> bytes:
    buffer = io.BytesIO()
    header = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue() + content


class _Writes:
    """A pickle that writes a file as it is read."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return (exec, (f"open({self.path!r}, 'w').write('x')",))


def pickled(place: Place) -> bytes:
    buffer = io.BytesIO()
    header = {"descr": "|O", "fortran_order": False, "shape": (1,)}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue() + pickle.dumps([_Writes(str(place.outside / "written"))])


SQL_NAME = "x\" AS SELECT 1; COPY (SELECT 'x') TO '{outside}/written'; --"
for _name, _subset in {
    "a subset is SQL": SQL_NAME,
    "a subset leads out": "../../outside/x",
    "a subset is a path": "/etc/passwd",
    "a subset is called manifest": "manifest",
    "a subset is a table of DuckDB": "duckdb_settings",
    "a subset commands the terminal": OWNED,
    "a subset is empty": "",
    "a subset is long": "x" * 5000,
    "a subset holds a null byte": "x\0y",
}.items():
    KINDS[_name] = rename_subset(_subset)
KINDS["two subsets differ in case"] = rename_subset("VIDEO", incomplete=False)
KINDS["the name commands the terminal"] = set_in_description(name=OWNED)
KINDS["the name has half a character"] = set_in_description(name="\ud800 x")
KINDS["the name is a megabyte"] = set_in_description(name="x" * (1 << 20))
KINDS["the renderer runs a program"] = set_in_description(renderer="os:system")


@kind("the renderer is a module beside the dataset")
def _(place: Place) -> None:
    code = f"open({str(place.outside / 'written')!r}, 'w').write('x')\ndef f(*a): raise SystemExit"
    for folder in (place.out, place.root / "cwd"):
        (folder / "evil.py").write_text(code)
    description(place, lambda info: info.update(renderer="evil:f"))


for _name, _value in {
    "an environment leads out": "../../outside/panorama",
    "an environment is a path": "/etc/passwd",
    "an environment is a number": 3,
    "an environment commands the terminal": OWNED,
}.items():
    KINDS[f"{_name}, dataset.json"] = lambda place, value=_value: description(
        place, lambda info: info["environments"][0].update(id=value)
    )
    KINDS[f"{_name}, meta.json"] = sample_with(
        meta__json=meta(put("environments", 0, "id", value=_value))
    )
KINDS["dataset.json is nested deeply"] = file("dataset.json", "[" * 200_000)
KINDS["dataset.json has a long number"] = file(
    "dataset.json", '{"plan": {}, "x": ' + "9" * 6000 + "}"
)
KINDS["dataset.json is a list"] = file("dataset.json", "[]")
KINDS["dataset.json is no text"] = file("dataset.json", b"\xff\xfe\0")
KINDS["dataset.json counts without end"] = lambda place: description(
    place, lambda info: info["plan"]["multiview"].update(subjects=10**30)
)
KINDS["dataset.json has no shots per subject"] = lambda place: description(
    place, lambda info: info["plan"]["multiview"].update(shots_per_subject=0)
)
KINDS["the job is huge"] = lambda place: description(
    place, lambda info: info["job"]["subsets"]["multiview"].update(subjects=10**15)
)
KINDS["the job is nonsense"] = set_in_description(job={"subsets": OWNED})
KINDS["files lead out"] = set_in_description(files={"../outside/secret.txt": "0" * 64})
KINDS["shards lead out"] = set_in_description(
    shards=[{"tar": "../outside/secret.tar", "bytes": 1, "sha256": "0" * 64}]
)

for _name, _changes in {
    "a shard leads out": "'../outside/secret.tar' AS shard",
    "a shard is a path": "'{outside}/secret.tar' AS shard",
    "a shard leads out from inside": "'data/../../outside/secret.tar' AS shard",
    "a shard is NULL": "NULL AS shard",
    "a shard is a number": "3 AS shard",
    "a shard commands the terminal": "'data/' || chr(27) || '[2J/x.tar' AS shard",
    "a key leads out": "'../../outside/x' AS key",
    "a key is NULL": "NULL AS key",
    "a key commands the terminal": "chr(27) || '[2J[/x]' AS key",
    "a key is long": "repeat('x', 1000000) AS key",
    "an offset is negative": '-512 AS "offset"',
    "an offset is a text": "'x' AS \"offset\"",
    "a size is huge": "9000000000000000000 AS size",
    "a mesh leads out": "'../outside/secret.txt' AS mesh",
    "a number is infinite": "'inf'::DOUBLE AS camera_yaw",
    "a text is no name": "chr(27) || ']0;x' || chr(7) || '[/x]' AS split",
}.items():
    KINDS[f"manifest: {_name}"] = manifest_with(_changes)
_column = "x\"\"; COPY (SELECT 'x') TO '{outside}/written'; --"
KINDS["manifest: a column is SQL"] = manifest_with("", f'1 AS "{_column}"')
KINDS["manifest: a cost is SQL"] = manifest_with("", f'1 AS "cost_{_column}"')
KINDS["manifest: a cost reads files"] = manifest_with(
    "", "1 AS \"cost_x + (SELECT count(*) FROM read_text('{outside}/secret.txt'))\""
)
KINDS["manifest: a column commands the terminal"] = manifest_with("", f'1 AS "{OWNED}"')
KINDS["manifest: columns are missing"] = lambda place: _query(place, "SELECT 1 AS one")
KINDS["manifest: no rows"] = lambda place: _query(place, "SELECT * FROM old LIMIT 0")
KINDS["manifest: a billion rows"] = lambda place: _query(
    place, "SELECT old.* FROM (FROM old LIMIT 1) old, range(200000000)"
)
KINDS["manifest: nonsense"] = file("manifest/multiview.parquet", b"PAR1" + SECRET + b"PAR1")


def _query(place: Place, sql: str) -> None:
    path = place.out / "manifest" / "multiview.parquet"
    columns = '"key", shard, "offset", "size", subset, split, subject'
    with duckdb.connect() as connection:
        table = f"CREATE VIEW old AS SELECT {columns} FROM '{path}'"
        connection.execute(table)
        connection.execute(f"COPY ({sql}) TO '{path}.new' (FORMAT parquet, COMPRESSION zstd)")
    Path(f"{path}.new").rename(path)


_waiting_sql = "quality_x\": 'INT'}}); COPY (SELECT 'x') TO '{outside}/written'; --"
KINDS["waiting: a column is SQL"] = waiting(
    lambda row, place: row | {_waiting_sql.format(outside=place.outside): 1}
)
KINDS["waiting: columns differ in case"] = waiting(
    lambda row, place: row | {"quality_A": 1, "quality_a": 2}
)
KINDS["waiting: a shard leads out"] = waiting(
    lambda row, place: row | {"shard": "../outside/secret.tar"}
)
KINDS["waiting: no object"] = waiting(lambda row, place: [row])
KINDS["waiting: other types"] = waiting(lambda row, place: row | {"index": "one", "key": ["x"]})
KINDS["waiting: half a character"] = waiting(lambda row, place: row | {"kind": "\ud800"})
KINDS["waiting: nonsense"] = incomplete(file("work/multiview/s000009.json", b"\xff{"))

for _name, _path in {
    "dataset.json": "dataset.json",
    "a manifest": "manifest/multiview.parquet",
    "a panorama": "environments/city.exr",
    "the card": "README.md",
    "Croissant": "croissant.json",
}.items():
    KINDS[f"{_name} is a pipe"] = pipe(_path)
KINDS["a record is a pipe"] = incomplete(pipe("ledger/multiview/train-000000.json"))
KINDS["a part is a pipe"] = incomplete(pipe("ledger/multiview/train-000000.parquet"))
KINDS["a failure is a pipe"] = incomplete(pipe("ledger/failed/multiview/s000009.json"))
KINDS["a waiting subject is a pipe"] = incomplete(pipe("work/multiview/s000009.json"))
KINDS["a lock is a pipe"] = incomplete(
    pipe("work/locks/slice-1-of-1"), pipe("work/runs/1-of-1.json")
)
KINDS["dataset.json is endless"] = link("dataset.json", "/dev/zero")
KINDS["a shard is endless"] = lambda place: (
    link("data/multiview/hostile.tar", "/dev/zero")(place),
    manifest_with("'data/multiview/hostile.tar' AS shard, 0 AS \"offset\", 1000000000000 AS size")(
        place
    ),
)[0]
KINDS["a record is endless"] = incomplete(link("ledger/multiview/train-000000.json", "/dev/zero"))
KINDS["a link leads in a circle"] = link("dataset.json", "dataset.json")


@kind("shards are pipes and sockets")
def _(place: Place) -> None:
    for number, path in enumerate(sorted((place.out / "data").rglob("*.tar"))):
        path.unlink()
        if number % 2:
            os.mkfifo(path)
        else:
            here = os.getcwd()
            os.chdir(path.parent)  # paths of sockets are short
            with socket.socket(socket.AF_UNIX) as bound:
                bound.bind(path.name)
            os.chdir(here)


@kind(LINKS[0])
def _(place: Place) -> None:
    shutil.copytree(place.out / "data", place.outside / "data")
    link("data", "{outside}/data")(place)


@kind(LINKS[1])
def _(place: Place) -> None:
    link("data/multiview/hostile.tar", "{outside}/secret.tar")(place)
    size = (place.outside / "secret.tar").stat().st_size
    manifest_with(f"'data/multiview/hostile.tar' AS shard, 0 AS \"offset\", {size} AS size")(place)


KINDS["a picture is PostScript"] = lambda place: sample_with(
    rgb_00__png=postscript(place), albedo__png=postscript(place)
)(place)
KINDS["a panorama is PostScript"] = lambda place: file("environments/city.exr", postscript(place))(
    place
)
for _format in ("GIF", "TIFF", "JPEG", "ICO", "PCX"):
    KINDS[f"a picture is {_format}"] = sample_with(rgb_00__png=other_picture(_format))
KINDS["a picture is a bomb"] = sample_with(rgb_00__png=png_header(60_000, 60_000))
KINDS["a picture is a large bomb"] = sample_with(parts__png=png_header(2_000_000_000, 1))
KINDS["a thousand pictures"] = sample_with(
    **{f"rgb_{i:04d}__png": png_header(8000, 8000) for i in range(100, 1100)}
)
KINDS["pictures are of several sizes"] = sample_with(
    rgb_01__png=encode_png(np.zeros((7, 9, 3), np.uint8))
)
KINDS["a picture is grey"] = sample_with(rgb_00__png=encode_png(np.zeros((48, 48), np.uint8)))
KINDS["passes are of another size"] = sample_with(parts__png=encode_png(np.zeros((1, 1), np.uint8)))
KINDS["passes are missing"] = sample_with(aov__exr=None)
KINDS["passes claim a huge picture"] = sample_with(aov__exr=exr(8, 8, (1 << 28, 1 << 28)))
KINDS["passes have other channels"] = sample_with(aov__exr=exr(48, 48))
KINDS["a panorama claims a huge picture"] = file(
    "environments/city.exr", exr(8, 16, (1 << 30, 1 << 29))
)
KINDS["geometry is a bomb"] = sample_with(
    geometry__npz=lambda _: zip_of("x.npy", bytes(1 << 24), 400)
)
KINDS["geometry claims a huge array"] = sample_with(
    geometry__npz=zip_of("landmarks.npy", npy((10**6, 10**6), b""))
)
KINDS["geometry is pickled"] = lambda place: sample_with(
    geometry__npz=zip_of("landmarks.npy", pickled(place))
)(place)
KINDS["geometry is text"] = sample_with(
    geometry__npz=encode_npz({"landmarks": np.array(["x" * 100])})
)
KINDS["geometry is packed otherwise"] = sample_with(
    geometry__npz=zip_of("landmarks.npy", bytes(1 << 20), compression=zipfile.ZIP_LZMA)
)
KINDS["geometry leads out"] = sample_with(
    geometry__npz=zip_of("../../outside/written.npy", npy((1,), bytes(4)))
)
for _name, _change in {
    "nested deeply": lambda _: b"[" * 200_000,
    "not a number": meta(put("camera", "intrinsics", value=[[float("nan")] * 3] * 3)),
    "landmarks far away": meta(put("landmarks", "points", value=[[1e308, -1e308]] * 70)),
    "no camera": meta(lambda m: {k: v for k, v in m.items() if k != "camera"}),
    "another subset": meta(put("subset", value="../../outside")),
    "an unknown subset": meta(put("subset", value="nowhere")),
    "a negative index": meta(put("index", value=-1)),
    "a huge index": meta(put("index", value=10**30)),
    "a person of nonsense": meta(put("person", value=json.dumps({"hair": OWNED}))),
    "a person nested deeply": meta(put("person", value="[" * 200_000)),
    "words for the terminal": meta(put(OWNED, value=OWNED)),
    "a kind for the terminal": meta(put("kind", value=OWNED)),
    "no environments": meta(put("environments", value=[])),
    "many environments": meta(
        put("environments", value=[{"id": "city", "rotation": 0.0, "exposure": 0.0}] * 900)
    ),
    "a huge picture": meta(put("camera", "width", value=10**12)),
}.items():
    KINDS[f"meta.json: {_name}"] = sample_with(meta__json=_change)


@kind("a tar claims a huge member")
def _(place: Place) -> None:
    import tarfile

    info = tarfile.TarInfo("s000002_p01.meta.json")
    info.size = 1 << 60
    store(place, info.tobuf(tarfile.GNU_FORMAT) + bytes(512), 1 << 61)


@kind("a tar claims a negative member")
def _(place: Place) -> None:
    head = bytearray(tar_entry("s000002_p01.meta.json", b""))
    head[124:136] = b"\xff" * 12  # -1 in base 256
    head[148:156] = b" " * 8
    head[148:156] = b"%06o\0 " % sum(head[:512])
    store(place, bytes(head) + bytes(1024))


@kind("a tar is a hole of a terabyte")
def _(place: Place) -> None:
    import tarfile

    info = tarfile.TarInfo("s000002_p01.rgb_00.png")
    info.size = 1 << 39
    store(place, info.tobuf(tarfile.GNU_FORMAT), 512 + (1 << 39))
    with (place.out / "data" / "multiview" / "hostile.tar").open("r+b") as tar:
        tar.truncate(1 << 40)


KINDS["members have no names"] = lambda place: store(place, tar_entry("x", b"y"))
_failure = {"subset": "multiview", "key": OWNED, "attempts": 3, "reason": OWNED, "log": OWNED}
KINDS["failures command the terminal"] = incomplete(
    file("ledger/failed/multiview/s000009.json", json.dumps(_failure))
)
KINDS["failures are for the terminal's records"] = incomplete(
    file("ledger/failed/multiview/s000009.json", json.dumps(_failure | {"subset": OWNED}))
)


# ---------------------------------------------------------------- what reads


def command(*arguments: str) -> Callable[[Place], None]:
    def run(place: Place) -> None:
        given = [a.format(out=place.out, target=place.target) for a in arguments]
        sys.argv = ["synthgen", *given]
        with contextlib.suppress(SystemExit):
            synthgen()

    return run


def reading(place: Place) -> None:
    """What `open_dataset` promises to raise is no fault."""
    fine = (StorageError, ValueError, KeyError, IndexError, OSError)
    with contextlib.suppress(*fine):
        dataset = open_dataset(place.out)
        for name in [e.get("id") for e in dataset.description.environments]:
            with contextlib.suppress(*fine):
                dataset.environment(str(name))
        for position in range(min(len(dataset), 6)):
            with contextlib.suppress(*fine):
                for use in dataset[position].meta["environments"][:3]:
                    dataset.environment(use["id"])
            with contextlib.suppress(*fine):
                dataset.read(position, ("rgb_00", "meta", "geometry"))
        for key in dataset.keys()[:3]:
            with contextlib.suppress(*fine):
                dataset[key]


def training(place: Place) -> None:
    from totalediting.data.shots import Shots
    from totalediting.errors import InputError

    fine = (InputError, StorageError, ValueError, KeyError, OSError)
    with contextlib.suppress(*fine):
        shots = Shots(place.out, "train")
        for position in range(min(len(shots.keys), 2)):
            with contextlib.suppress(*fine):
                read = shots.read(position, "rgb_00", "normal", "parts", "geometry", "meta")
                shots.lightmaps(read["meta"], 0, 8)


def browsing(place: Place) -> None:
    try:
        library = Library(Folder(place.out))
    except StorageError as error:
        print(str(error).encode("unicode_escape").decode())
        return
    app = create(library, Thumbnails(place.target / "cache"), token=None, port=7)
    ask = TestClient(app, base_url="http://localhost")
    shot = f"{SHOT.split('/')[0]}/{SHOT.split('/')[1]}"
    paths = ["/api/dataset", "/api/shots?limit=500", "/api/counts", f"/api/shot/{shot}"]
    paths += [f"/thumbnail/{shot}", f"/member/{shot}/meta.json", "/lightmaps/city"]
    paths += [
        f"/{what}/{shot}/{name}" for what in ("pass", "values") for name in ("image", "parts")
    ]
    paths += ["/api/subject/multiview/s000002", "/subject/multiview/s000002.glb"]
    paths += ["/subject/multiview/s000002/expressions", "/lightmaps/..%2f..%2foutside%2fpanorama"]
    for path in paths:
        answer = ask.get(path)
        if SECRET in answer.content:
            raise AssertionError(f"{path} answers with the secret")
        if answer.status_code >= 500 and answer.status_code != 501:
            raise AssertionError(f"{path} answers with {answer.status_code}")
    library.close()


RUNS: dict[str, Callable[[Place], None]] = {
    "status": command("status", "{out}"),
    "verify": command("verify", "{out}"),
    "query": command("query", "{out}", "SELECT * FROM manifest LIMIT 3", "--format", "table"),
    "show": command("show", "{out}", SHOT, "--output", "{target}/shot.png"),
    "sheet": command("sheet", "{out}", "--output", "{target}/sheet.png"),
    "sheet --portraits": command("sheet", "{out}", "--portraits", "--output", "{target}/p.png"),
    "export": command("export", "{out}", "--output", "{target}/export"),
    "rerender": command("rerender", "{out}", SHOT),
    "plan --like": command("plan", "demo", "--like", "{out}"),
    "open_dataset": reading,
    "Shots": training,
    "browse": browsing,
}


# ---------------------------------------------------------------- one run


@dataclass
class Outcome:
    """What became of a run."""

    said: str
    raised: str
    stuck: bool
    seconds: float
    megabytes: float
    opened: list[str]


def run(work: Callable[[], None], place: Place, seconds: float, cwd: Path) -> Outcome:
    """Do it in a child with limits; what it opened is what Python's own audit hooks see."""
    said, notes = place.root / "said", place.root / "notes"
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        _child(work, place, said, notes, cwd)
    stuck = False
    while True:
        found, status, used = os.wait4(child, os.WNOHANG)
        if found:
            break
        if time.monotonic() - start > seconds:
            stuck = True
            os.kill(child, signal.SIGKILL)
            _, status, used = os.wait4(child, 0)
            break
        time.sleep(0.01)
    lines = notes.read_text(errors="replace").splitlines() if notes.exists() else []
    raised = "\n".join(line[2:] for line in lines if line.startswith("! "))
    if os.WIFSIGNALED(status) and not stuck:
        raised += f"killed by signal {os.WTERMSIG(status)}"
    opened = [line[2:] for line in lines if line.startswith("< ")]
    text = said.read_text(errors="surrogateescape") if said.exists() else ""
    for path in (said, notes):
        path.unlink(missing_ok=True)
    took = time.monotonic() - start
    return Outcome(text, raised, stuck, took, used.ru_maxrss / 1e3, opened)


def _child(work: Callable[[], None], place: Place, said: Path, notes: Path, cwd: Path) -> None:
    """Never returns."""
    try:
        os.chdir(cwd)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        os.environ |= {
            "SYNTHGEN_CACHE": str(place.target / "cache"),
            "TMPDIR": str(place.root / "tmp"),
            "COLUMNS": "150",
        }
        tempfile.tempdir = None
        handle = os.open(said, os.O_WRONLY | os.O_CREAT)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        log = os.open(notes, os.O_WRONLY | os.O_CREAT)
        outside = str(place.outside)

        def look(event: str, arguments: tuple[Any, ...]) -> None:
            if (
                event == "open"
                and isinstance(arguments[0], str)
                and outside in os.path.realpath(arguments[0])
            ):
                os.write(log, f"< {arguments[0]}\n".encode(errors="replace"))

        sys.addaudithook(look)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        try:
            work()
        except SystemExit:
            pass
        except BaseException as error:
            trace = traceback.format_exc().splitlines()
            where = " / ".join(line.strip() for line in trace if line.strip().startswith("File"))
            text = (
                f"! {type(error).__name__}: {' '.join(str(error).split())[:200]} ({where[-160:]})"
            )
            os.write(log, f"{text}\n".encode(errors="replace"))
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    finally:
        os._exit(0)


def state(*folders: Path) -> dict[str, tuple[Any, ...]]:
    """Every file of folders by its content, or by its kind."""
    found = {}
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            seen = path.lstat()
            plain = path.is_file() and not path.is_symlink() and seen.st_size < 1 << 26
            content = hashlib.sha256(path.read_bytes()).hexdigest() if plain else ""
            found[str(path)] = (seen.st_mode, seen.st_size, content)
    return found


def age(folder: Path) -> dict[Path, int]:
    """Make every file of a folder look unread for long, so that reading one shows."""
    ages = {}
    for path in folder.rglob("*"):
        if path.is_file():
            seen = path.stat()
            os.utime(path, ns=(seen.st_mtime_ns - 10**12, seen.st_mtime_ns))
            ages[path] = path.stat().st_atime_ns
    return ages


CONTROLS = {chr(c) for c in (*range(0x20), *range(0x7F, 0xA0))} - {"\n", "\t", "\r"}


def make_place(base: Path, root: Path, spoil: Callable[[Place], None]) -> Place:
    place = Place(root)
    for name in ("outside", "target", "cwd", "tmp"):
        (root / name).mkdir(parents=True)
    shutil.copytree(base, place.out)
    (place.outside / "secret.txt").write_bytes(SECRET)
    key = SHOT.split("/")[1]
    secret = tar_entry(f"{key}.meta.json", SECRET) + tar_entry(f"{key}.rgb_00.png", SECRET)
    (place.outside / "secret.tar").write_bytes(secret)
    shutil.copy(base / "environments" / "city.exr", place.outside / "panorama.exr")
    in_child(lambda: spoil(place))
    return place


def in_child(work: Callable[[], object]) -> None:
    """Do it in a child: this process must stay without threads, which a fork would lose."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)
    if os.waitpid(child, 0)[1]:
        raise RuntimeError("see above")


def try_datasets(
    base: Path, work: Path, wanted: list[str], seconds: float
) -> tuple[list[str], int]:
    findings: list[str] = []
    runs, slowest, largest = 0, (0.0, ""), (0.0, "")
    kinds = {n: k for n, k in KINDS.items() if not wanted or any(w in n for w in wanted)}
    for number, (name, spoil) in enumerate(kinds.items()):
        place = make_place(base, work / f"{number}", spoil)
        kept = (place.out, place.outside, place.root / "cwd", place.root / "tmp")
        after = state(*kept)
        for what, read in RUNS.items():
            before = after
            shutil.rmtree(place.target)
            place.target.mkdir()
            ages = age(place.outside)
            outcome = run(lambda read=read, place=place: read(place), place, seconds, kept[2])
            touched = [p.name for p, then in ages.items() if p.stat().st_atime_ns != then]
            runs += 1
            slowest = max(slowest, (outcome.seconds, f"{name}, {what}"))
            largest = max(largest, (outcome.megabytes, f"{name}, {what}"))
            found = []
            if outcome.stuck:
                found.append("does not end")
            if outcome.raised or "Traceback (most recent call last)" in outcome.said:
                found.append(f"traceback: {outcome.raised[:300]}")
            if (after := state(*kept)) != before:
                changed = [p for p in after | before if after.get(p) != before.get(p)]
                found.append(f"changes {changed[:3]}")
            read_outside = sorted({*touched, *outcome.opened})
            if read_outside and (name not in LINKS or what == "browse"):
                found.append(f"reads outside: {read_outside[:3]}")
            if SECRET.decode() in outcome.said or any(
                SECRET in p.read_bytes() for p in place.target.rglob("*") if p.is_file()
            ):
                found.append("tells the secret")
            if obeyed := CONTROLS & set(outcome.said):
                found.append(f"sends the terminal {sorted(obeyed)}")
            if outcome.megabytes > HELD:
                found.append(f"holds {outcome.megabytes:.0f} MB")
            findings += found
            for each in found:
                print(f"{name}: {what}: {each}".encode("unicode_escape").decode(), flush=True)
        shutil.rmtree(place.root)
    print(f"slowest: {slowest[0]:.1f} s, {slowest[1]}; largest: {largest[0]:.0f} MB, {largest[1]}")
    return findings, runs


# ---------------------------------------------------------------- hostile conditions

CONDITIONS = (
    "true; COPY (SELECT 1) TO '{outside}/written'",
    "true); COPY (SELECT 1) TO '{outside}/written'; --",
    "true) UNION ALL SELECT content, 'a/b/c', 0, 0 FROM read_text('{outside}/secret.txt') --",
    "EXISTS (SELECT * FROM read_text('{outside}/secret.txt'))",
    "EXISTS (FROM read_blob('{outside}/secret.txt'))",
    "EXISTS (FROM read_csv('{outside}/secret.txt'))",
    "EXISTS (FROM '{outside}/secret.txt')",
    "EXISTS (FROM read_json('{outside}/secret.txt'))",
    "EXISTS (FROM parquet_scan('{outside}/secret.txt'))",
    "EXISTS (FROM glob('{outside}/*'))",
    "EXISTS (FROM sniff_csv('{outside}/secret.txt'))",
    "EXISTS (FROM read_text('/etc/passwd'))",
    "EXISTS (FROM query('FROM read_text(''{outside}/secret.txt'')'))",
    "EXISTS (FROM query_table('{outside}/secret.txt'))",
    "EXISTS (FROM duckdb_settings())",
    "EXISTS (FROM duckdb_secrets())",
    "EXISTS (FROM duckdb_extensions())",
    "EXISTS (FROM pragma_database_list())",
    "EXISTS (FROM information_schema.tables)",
    "EXISTS (FROM sqlite_scan('{outside}/x', 'y'))",
    "EXISTS (FROM postgres_scan('host=localhost', 'a', 'b'))",
    "EXISTS (FROM read_parquet('https://example.org/x.parquet'))",
    "EXISTS (FROM read_parquet('s3://bucket/x.parquet'))",
    "getenv('HOME') <> ''",
    "current_setting('temp_directory') <> ''",
    "(ATTACH '{outside}/written')",
    "(INSTALL httpfs)",
    "(LOAD '{outside}/secret.txt')",
    "(SET memory_limit = '100GB')",
    "(PRAGMA database_list)",
    "(EXPORT DATABASE '{outside}/written')",
    "(IMPORT DATABASE '{outside}')",
    "(CALL dbgen(sf = 10))",
    "(COPY manifest TO '{outside}/written')",
    "(CREATE SECRET (TYPE s3))",
    "(VACUUM)",
    "length(repeat('x', 2000000000)) > 0",
    "length(repeat(repeat('x', 1000000), 100000)) > 0",
    "length(lpad('x', 2000000000, 'y')) > 0",
    "length(rpad('x', 2000000000, 'y')) > 0",
    "len(range(1000000000)) > 0",
    "len(generate_series(1, 1000000000)) > 0",
    "list_sum(range(1000000000)) > 0",
    "len(list_transform(range(100000000), x -> x * x)) > 0",
    "len(list_filter(range(100000000), x -> x % 2 = 0)) > 0",
    "list_reduce(range(100000000), (a, b) -> a + b) > 0",
    "len([i FOR i IN range(100000000) IF i % 3 = 0]) > 0",
    "length(format('{{:1000000000}}', 1)) > 0",
    "length(printf('%1000000000d', 1)) > 0",
    "length(bar(1, 0, 1, 1000000000)) > 0",
    "length(array_to_string(range(100000000), 'x')) > 0",
    "len(string_split(repeat('a,', 100000000), ',')) > 0",
    "len(regexp_extract_all(repeat('a', 100000000), 'a')) > 0",
    "length(regexp_replace(repeat('a', 10000000), 'a', repeat('b', 1000), 'g')) > 0",
    "regexp_matches(repeat('a', 1000000), '(a?){{1000}}a{{1000}}')",
    "length(replace(repeat('a', 10000000), 'a', repeat('b', 1000))) > 0",
    "levenshtein(repeat('a', 100000), repeat('b', 100000)) > 0",
    "length(translate(repeat('a', 1000000000), 'a', 'b')) > 0",
    "factorial(33) * factorial(33) * factorial(33) > 0",
    "2 ** 100000000 > 0",
    "length(to_json(range(100000000))) > 0",
    "length(hex(repeat('x', 1000000000))) > 0",
    "length(bin(repeat('x', 300000000))) > 0",
    "length(to_base64(repeat('x', 1000000000)::BLOB)) > 0",
    "('1' || repeat('0', 1000000000))::HUGEINT > 0",
    "len(flatten(list_transform(range(10000), x -> range(100000)))) > 0",
    "(SELECT count(*) FROM range(1000000) a, range(1000000) b WHERE hash(a, b) = 1) > 0",
    "(SELECT count(*) FROM manifest a, manifest b, manifest c, manifest d, manifest e, manifest f,"
    " manifest g, manifest h WHERE hash(a.key, h.key) = 1) > 0",
    "(WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT max(n) FROM t) > 0",
    "(WITH RECURSIVE t(s) AS (SELECT 'x' UNION ALL SELECT s || s FROM t) FROM t) = ''",
    "(SELECT max(length(x)) FROM (SELECT key || key AS x FROM manifest)) > 0",
    "(SELECT length(string_agg(repeat('x', 100000000), '')) FROM manifest) > 0",
    "(SELECT len(list(range(10000000))) FROM manifest) > 0",
    "(SELECT count(*) FROM manifest ORDER BY repeat(key, 10000000)) > 0",
    "(SELECT approx_quantile(x, 0.5) FROM (SELECT unnest(range(100000000)) x)) > 0",
    "(SELECT count(DISTINCT x) FROM (SELECT unnest(range(1000000000)) x)) > 0",
    "(" * 3000 + "true" + ")" * 3000,
    " AND ".join(["true"] * 600),
    "NOT " * 990 + "true",
    "key IN (" + ",".join(["'x'"] * 900) + ")",
    "'" + "x" * 30_000 + "' = key",
    "key = '\0'",
    "sleep(100)",
    "json_serialize_sql(repeat('(', 100000)) = ''",
    "nextval('x') > 0",
    "uuid()::VARCHAR = '' OR random() > 2 OR getvariable('x') = 1",
    "COLUMNS(*) = COLUMNS(*)",
    "#1 = 1",
    "? = 1",
    "$x = 1",
)


def try_conditions(base: Path, work: Path, limit: float) -> tuple[list[str], int]:
    """Through the page, whose limits hold; and through the user's own ways, which must not leak."""
    findings: list[str] = []
    beyond, largest = (0.0, ""), (0.0, "")
    place = make_place(base, work / "sql", lambda place: None)
    sandbox.SECONDS = limit
    kept = (place.out, place.outside, place.root / "cwd", place.root / "tmp")

    def page(where: str) -> None:
        app = create(Library(Folder(place.out)), Thumbnails(place.target), token=None, port=7)
        start = time.monotonic()
        answer = TestClient(app, base_url="http://localhost").get(
            "/api/shots", params={"where": where}
        )
        print(f"{time.monotonic() - start:.3f} seconds")
        print(answer.status_code, answer.content[:2000])
        if answer.status_code >= 500:
            raise AssertionError(answer.text[:100])

    def own(where: str) -> None:
        threading_interrupt(limit)
        with contextlib.suppress(StorageError, ValueError, KeyboardInterrupt, MemoryError):
            open_dataset(place.out, where=where)

    def queried(where: str) -> None:
        threading_interrupt(limit)
        with contextlib.suppress(StorageError, KeyboardInterrupt, MemoryError):
            print(manifest.query(place.out, f"SELECT key FROM manifest WHERE {where}").rows[:3])

    after = state(*kept)
    for condition in CONDITIONS:
        where = condition.format(outside=place.outside) if len(condition) < 500 else condition
        for what, ask in (("page", page), ("open_dataset", own), ("query", queried)):
            before, ages = after, age(place.outside)
            patience = 60.0 if what == "page" else limit + 1
            work_ = lambda ask=ask, where=where: ask(where)  # noqa: E731
            outcome = run(work_, place, patience, kept[2])
            touched = [p.name for p, then in ages.items() if p.stat().st_atime_ns != then]
            found = []
            after = state(*kept)
            if after != before or touched or outcome.opened:
                found.append(f"escapes: {touched} {outcome.opened[:2]}")
            if SECRET.decode() in outcome.said or "root:x:0" in outcome.said:
                found.append("tells the secret")
            if what == "page":
                asked = re.match(r"([\d.]+) seconds", outcome.said)
                late = (float(asked[1]) if asked else outcome.seconds) - limit
                beyond = max(beyond, (late, where[:60]))
                largest = max(largest, (outcome.megabytes, where[:60]))
                if outcome.stuck or late > 2:
                    found.append(f"takes {late:.1f} s more than its limit")
                if outcome.megabytes > HELD:
                    found.append(f"holds {outcome.megabytes:.0f} MB")
                if outcome.raised:
                    found.append(f"traceback: {outcome.raised[:200]}")
            findings += found
            for each in found:
                print(f"where {where[:60]}: {what}: {each}".encode("unicode_escape").decode())
    print(f"latest: {beyond[0]:+.1f} s, {beyond[1]}; largest: {largest[0]:.0f} MB, {largest[1]}")
    return findings, len(CONDITIONS)


def threading_interrupt(seconds: float) -> None:
    """Ctrl-C after a while."""
    signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGINT))
    signal.setitimer(signal.ITIMER_REAL, seconds)


# ---------------------------------------------------------------- all

_MODULES = (
    *("OpenEXR", "OpenImageIO", "torch", "rich.table", "rich.progress", "typer.rich_utils"),
    *("synthgen.farm.preflight", "synthgen.farm.rerender", "synthgen.farm.recorded"),
    *("synthgen.farm.estimate", "synthgen.farm.calibration", "synthgen.publish.verify"),
    *("synthgen.publish.export", "synthgen.publish.answers", "synthgen.pictures.sheet"),
    *("synthgen.pictures.shot_sheet", "totalediting.data.shots", "assets_procedural.body.head"),
)


@contextlib.contextmanager
def dataset() -> Iterator[tuple[Path, Path]]:
    """A small dataset of the fake renderer, and a folder to work in."""
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        job = fake_renderer.small_job()
        in_child(lambda: render_job(job, work / "base", workers=1, renderer=fake_renderer.RENDERER))
        yield work / "base", work


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", action="append", default=[], help="only kinds that hold this")
    parser.add_argument("--seconds", type=float, default=30.0, help="that a run may take")
    parser.add_argument("--limit", type=float, default=2.0, help="seconds of the page's queries")
    parser.add_argument("--no-sql", action="store_true", help="leave the conditions out")
    parser.add_argument("--only-sql", action="store_true", help="leave the datasets out")
    arguments = parser.parse_args()
    rows: list[tuple[object, ...]] = []
    findings: list[str] = []
    with dataset() as (base, work):
        for name in _MODULES:  # once, and not in every child
            import_module(name)
        if not arguments.only_sql:
            found, runs = try_datasets(base, work, arguments.kind, arguments.seconds)
            kinds = sum(not arguments.kind or any(w in n for w in arguments.kind) for n in KINDS)
            rows.append(("hostile datasets", kinds, runs, *counts(found)))
            findings += found
        if not arguments.no_sql and not arguments.kind:
            found, conditions = try_conditions(base, work, arguments.limit)
            rows.append(("hostile conditions", conditions, 3 * conditions, *counts(found)))
            findings += found
    print()
    report.table(("what", "kinds", "runs", *(name for name, _ in SORTS)), rows)
    sys.exit(bool(findings))


SORTS = (
    ("escapes", ("changes", "reads outside", "tells", "escapes")),
    ("tracebacks", ("traceback",)),
    ("stuck or late", ("does not end", "takes")),
    ("terminal", ("sends the terminal",)),
    ("too much memory", ("holds",)),
)


def counts(findings: list[str]) -> list[int]:
    """Findings by sort."""
    return [sum(f.startswith(starts) for f in findings) for _, starts in SORTS]


if __name__ == "__main__":
    main()
