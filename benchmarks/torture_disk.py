"""Kills, flipped bits and missing files: what is lost, doubled, read wrongly or not mended.

Renders small datasets with the tests' renderer, which needs no Blender, in a temporary folder that
is removed at the end:

    python benchmarks/torture_disk.py [--kills 100] [--flips 500] [--repairs 40] [--blender]

It exits with 1 if a promise is broken, and says which.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import report

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
sys.path.insert(0, str(SUPPORT))

import fake_renderer  # noqa: E402

from assets_procedural.conventions.files import sha256  # noqa: E402
from synthgen.dataset import manifest, open_dataset  # noqa: E402
from synthgen.dataset.folder import DatasetFolder, StorageError  # noqa: E402
from synthgen.dataset.shot import Shot  # noqa: E402
from synthgen.farm.local import render_job  # noqa: E402
from synthgen.farm.repair import repair  # noqa: E402
from synthgen.publish.verify import verify  # noqa: E402

RUN = """
import json
import sys
from pathlib import Path
import fake_renderer
from synthgen.farm import local
if __name__ == "__main__":
    job = fake_renderer.small_job(**json.loads(sys.argv[3]))
    local.render_job(job, Path(sys.argv[1]), workers=2, renderer=sys.argv[2])
"""
BLENDER = "synthgen.stage.render:render_subject"
SMALLER: dict[str, Any] = {
    # On fewer pixels the gate finds the slopes of real heads too coarse.
    "resolution": 128,
    "samples": 4,
    "subsets": {
        "multiview": {"kind": "multiview", "subjects": 3, "environments": 1, "views": 2},
        "video": {"kind": "video", "subjects": 1, "environments": 1, "frames": 2},
    },
}
"""What the job of Blender has otherwise."""
CHECKED = (".png", ".npz")
"""Members with checksums of their own."""


@dataclass
class Trials:
    """What happened, and what should not have."""

    counts: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)

    def expect(self, holds: bool, what: str) -> None:
        if not holds:
            self.broken.append(what)


# ---------------------------------------------------------------- what two runs have in common


def tree(out: Path) -> dict[str, str]:
    """Path -> sha256 of all files."""
    return {p.relative_to(out).as_posix(): sha256(p) for p in out.rglob("*") if p.is_file()}


def content(out: Path) -> tuple[dict[str, str], dict[str, list[dict[str, object]]]]:
    """Shards, panoramas and subjects byte for byte, rows but for what they cost."""
    kept = ("data/", "environments/", "subjects/")
    files = {name: digest for name, digest in tree(out).items() if name.startswith(kept)}
    rows = {}
    for subset in fake_renderer.small_job().subsets:
        table = manifest.read_rows(out / "manifest" / f"{subset}.parquet")
        rows[subset] = [{k: v for k, v in r.items() if not k.startswith("cost_")} for r in table]
    return files, rows


# ---------------------------------------------------------------- kills


def kill(out: Path, renderer: str, other: dict[str, Any], after: float) -> bool:
    """Start a run and kill it after so many seconds; whether it was still running."""
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, str(out), renderer, json.dumps(other)],
        env=os.environ | {"PYTHONPATH": search_path(), "FAKE_SECONDS": "0.3"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
    return process.wait() == -signal.SIGKILL


def search_path() -> str:
    return os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])


def look(out: Path, trials: Trials) -> None:
    """A reader at this very moment: no shot twice, and each readable."""
    try:
        dataset = open_dataset(out)
    except StorageError:
        return
    trials.counts["looks at a dataset in the making"] += 1
    keys = dataset.keys()
    trials.expect(len(keys) == len(set(keys)), f"{out.name}: doubled rows in the making")
    for key in keys:
        dataset.read(key, ("alpha", "meta"))


def campaign(work: Path, kills: int, renderer: str, whole: Path | None, trials: Trials) -> None:
    """Kill runs at random moments; now and then let one finish, and compare."""
    rng = random.Random(1)
    other = SMALLER if renderer == BLENDER else {}
    done = 0
    while done < kills:
        out = work / f"killed-{done}"
        for _ in range(12):
            if done == kills:
                break
            # A second goes by before Python has started.
            longest = 6.0 if renderer != BLENDER else 90.0
            if kill(out, renderer, other, rng.uniform(0.8, longest)):
                done += 1
                if (out / "dataset.json").exists():
                    look(out, trials)
        job = fake_renderer.small_job(**other)
        summary = render_job(job, out, workers=2, renderer=renderer)
        trials.counts["datasets finished after kills"] += 1
        failed = [f"{entry.key}: {entry.reason}" for entry in summary.failed]
        trials.expect(summary.complete and not failed, f"{out.name}: not complete {failed}")
        trials.expect(verify(out) == [], f"{out.name}: {verify(out)[:2]}")
        if whole is not None:
            trials.expect(content(out) == content(whole), f"{out.name}: differs from one run")
        trials.expect(not (out / "work").exists(), f"{out.name}: left {out / 'work'}")
        trials.expect(not list(out.rglob("*.tmp")), f"{out.name}: left temporary files")
        shutil.rmtree(out)
    trials.counts["kills"] += done


# ---------------------------------------------------------------- bits


def kind_of(name: str) -> str:
    """What kind of file it is, for the table."""
    folder, _, rest = name.partition("/")
    return f"{folder}/*.{rest.rpartition('.')[2]}" if rest else name


def flips(whole: Path, work: Path, count: int, trials: Trials) -> dict[str, list[int]]:
    """Flip single bits in every kind of file: kind -> [flips, caught, samples read wrongly where a
    checksum is carried, samples read wrongly elsewhere]."""
    out = work / "flipped"
    shutil.copytree(whole, out)
    rng = np.random.default_rng(2)
    kinds: dict[str, list[str]] = {}
    for name in sorted(tree(out)):
        kinds.setdefault(kind_of(name), []).append(name)
    true = {subset_key(shot): shot for shot in open_dataset(whole)}
    table: dict[str, list[int]] = {kind: [0, 0, 0, 0] for kind in kinds}
    each = -(-count // len(kinds))
    for kind, names in kinds.items():
        for _ in range(each):
            path = out / names[rng.integers(len(names))]
            data = path.read_bytes()
            position, bit = int(rng.integers(len(data))), int(rng.integers(8))
            path.write_bytes(changed(data, position, bit))
            table[kind][0] += 1
            try:
                caught = bool(verify(out, workers=1))
            except StorageError:
                caught = True
            table[kind][1] += caught
            trials.expect(caught, f"{path.relative_to(out)}: bit {bit} of byte {position} missed")
            if kind == "data/*.tar":
                table[kind][2] += read_wrongly(out, true, CHECKED)
                table[kind][3] += read_wrongly(out, true, ("",))
            path.write_bytes(data)
    trials.expect(not any(row[2] for row in table.values()), "a member with a checksum misread")
    trials.expect(verify(out) == [], "flips were not taken back")
    shutil.rmtree(out)
    return table


def changed(data: bytes, position: int, bit: int) -> bytes:
    """With one bit flipped."""
    copy = bytearray(data)
    copy[position] ^= 1 << bit
    return bytes(copy)


def subset_key(shot: Shot) -> str:
    return f"{shot.meta['subset']}/{shot.key}"


def read_wrongly(out: Path, true: dict[str, Shot], endings: tuple[str, ...]) -> int:
    """How many samples read without a complaint and are not what they were."""
    wrong = 0
    try:
        dataset = open_dataset(out)
    except StorageError:
        return 0
    for key, shot in true.items():
        try:
            found = dataset[key]
        except (ValueError, KeyError, OSError):
            continue
        same = np.array_equal(found.rgb, shot.rgb) and all(
            np.array_equal(found.passes[n], shot.passes[n]) for n in ("albedo", "alpha", "parts")
        )
        same = same and all(np.array_equal(found.geometry[n], a) for n, a in shot.geometry.items())
        if "" in endings:
            assert found.hdr is not None and shot.hdr is not None
            same = same and np.array_equal(found.hdr, shot.hdr) and found.meta == shot.meta
            same = same and all(
                np.array_equal(found.passes[n], a, equal_nan=True) for n, a in shot.passes.items()
            )
        wrong += not same
    return wrong


# ---------------------------------------------------------------- structure


def remove(path: Path) -> None:
    path.unlink()


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def append(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\n")


def zeros(path: Path) -> None:
    path.write_bytes(bytes(path.stat().st_size))


ONE = (remove, empty, cut, append, zeros)


def exchange(a: Path, b: Path) -> None:
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)


def structural(out: Path) -> dict[str, Callable[[], object]]:
    """Kind of damage -> what does it, of a small dataset."""
    folder = DatasetFolder(out)
    shards = [f"multiview/train-00000{i}.tar" for i in range(2)]
    first, second = (folder.shard(name) for name in shards)
    subjects = [folder.subject("video", f"s00000{i}") for i in range(2)]
    panoramas = [folder.environment(name) for name in ("city", "night")]
    files = {
        "shard": (first.tar, second.tar),
        "record": (first.record, second.record),
        "part of the manifest": (first.rows, second.rows),
        "mesh": (subjects[0].mesh, subjects[1].mesh),
        "parameters": (subjects[0].parameters, subjects[1].parameters),
        "panorama": (panoramas[0], panoramas[1]),
        "manifest": (folder.manifest("multiview"), folder.manifest("video")),
        "README.md": (folder.card, folder.croissant),
        "croissant.json": (folder.croissant, folder.description),
        "dataset.json": (folder.description, folder.checksums),
        "SHA256SUMS": (folder.checksums, folder.card),
        "copy of dataset.json": (folder.description_copy, folder.croissant),
    }
    found: dict[str, Callable[[], object]] = {}
    for what, (path, other) in files.items():
        for damage in ONE:
            found[f"{what}: {damage.__name__}"] = lambda d=damage, p=path: d(p)
        found[f"{what}: exchange with {other.name}"] = lambda p=path, o=other: exchange(p, o)
        found[f"{what}: overwritten by {other.name}"] = lambda p=path, o=other: shutil.copy(o, p)
    for name in ("data", "environments", "ledger", "manifest", "subjects"):
        found[f"{name}/: remove"] = lambda n=name: shutil.rmtree(out / n)
    for name in ("data/video", "subjects/multiview", "ledger/video"):
        found[f"{name}/: remove"] = lambda n=name: shutil.rmtree(out / n)
    return found


def duplicates(out: Path) -> dict[str, Callable[[], object]]:
    """Files too many, which only their owner may remove."""
    pairs = {
        "data/multiview/train-000000.tar": "data/multiview/train-000009.tar",
        "data/video/train-000000.tar": "data/video/copy.tar",
        "environments/city.exr": "environments/city (1).exr",
        "manifest/video.parquet": "manifest/video2.parquet",
        "ledger/multiview/train-000000.json": "ledger/multiview/train-000009.json",
        "subjects/video/s000000.glb": "subjects/video/s000099.glb",
    }
    return {
        f"{a} duplicated as {b}": (lambda a=a, b=b: shutil.copy(out / a, out / b))
        for a, b in pairs.items()
    }


def structure(whole: Path, work: Path, repairs: int, trials: Trials) -> None:
    """Every kind of damage is caught; of a sample, `--repair` gives the original tree."""
    out = work / "damaged"
    shutil.copytree(whole, out)
    original = tree(whole)
    damages = structural(out)
    sample = set(random.Random(3).sample(sorted(damages), min(repairs, len(damages))))
    for name, damage in (damages | duplicates(out)).items():
        damage()
        trials.counts["kinds of structural damage"] += 1
        try:
            problems = verify(out, workers=1)
        except StorageError as error:
            problems = [str(error)]
        trials.counts["of them caught"] += bool(problems)
        trials.expect(bool(problems), f"{name}: not caught")
        if name in sample:
            trials.counts["repairs"] += 1
            try:
                repair(out, workers=2, renderer=fake_renderer.RENDERER)
                differing = sorted(n for n, _ in set(tree(out).items()) ^ set(original.items()))
                same = not differing and verify(out, workers=1) == []
                trials.counts["of them to the original tree"] += same
                trials.expect(same, f"{name}: repaired, but {differing[:4]} differ")
            except Exception as error:
                trials.expect(False, f"{name}: not repaired ({type(error).__name__}: {error})")
        shutil.rmtree(out)
        shutil.copytree(whole, out)
    shutil.rmtree(out)


# ---------------------------------------------------------------- all of it


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--flips", type=int, default=500)
    parser.add_argument("--repairs", type=int, default=40)
    parser.add_argument("--blender", action="store_true", help="five kills of Blender, too")
    options = parser.parse_args()
    os.environ["PYTHONPATH"] = search_path()
    trials = Trials()
    with tempfile.TemporaryDirectory(prefix="torture-") as name:
        work = Path(name)
        os.environ["TMPDIR"] = tempfile.tempdir = str(work / "temporary")
        (work / "temporary").mkdir()
        whole = work / "whole"
        render_job(fake_renderer.small_job(), whole, workers=2, renderer=fake_renderer.RENDERER)
        start = time.monotonic()
        campaign(work, options.kills, fake_renderer.RENDERER, whole, trials)
        if options.blender:
            campaign(work, 5, BLENDER, None, trials)
        litter = sorted(p.name for p in (work / "temporary").iterdir())
        trials.expect(not litter, f"in the temporary folder after kills: {litter[:5]}")
        trials.counts["seconds for kills"] = round(time.monotonic() - start)
        start = time.monotonic()
        structure(whole, work, options.repairs, trials)
        trials.counts["seconds for structure"] = round(time.monotonic() - start)
        start = time.monotonic()
        table = flips(whole, work, options.flips, trials) if options.flips else {}
        trials.counts["seconds for flips"] = round(time.monotonic() - start)
    report.table(("what", "count"), trials.counts.items())
    header = ("file", "flips", "caught by verify", "read wrongly, checksum", "read wrongly, none")
    totals = [sum(row[i] for row in table.values()) for i in range(4)]
    report.table(header, [(kind, *row) for kind, row in table.items()] + [("all", *totals)])
    for line in trials.broken:
        print(f"broken: {line}")
    print(f"{len(trials.broken)} broken promises")
    return 1 if trials.broken else 0


if __name__ == "__main__":
    sys.exit(main())
