"""What reads a hostile dataset, for torture_foreign.py, each in a child with limits."""

from __future__ import annotations

import contextlib
import hashlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hostile_datasets import SECRET, SHOT, Place
from starlette.testclient import TestClient

from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library
from synthgen.cli import main as synthgen
from synthgen.dataset import open_dataset
from synthgen.dataset.folder import StorageError
from synthgen.dataset.shards import tar_entry

MEMORY = 12 << 30
"""Bytes of addresses that a run may take; what is held is counted beside it."""


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
