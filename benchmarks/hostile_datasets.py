"""Kinds of datasets made to do harm, for torture_foreign.py: each spoils a sound one."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import shutil
import socket
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import duckdb
import numpy as np

from synthgen.dataset import manifest, open_dataset
from synthgen.dataset.codecs import encode_json, encode_npz, encode_png
from synthgen.dataset.shards import read_sample, tar_entry

SECRET = b"nobody shall read this: 5f3a9c"
SHOT = "multiview/s000002_p01"
OWNED = "\x1b]0;owned\x07\x1b[2J[/x][bold]\u202e\x9b31m"


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
