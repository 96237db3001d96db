"""A spawned process that renders whole subjects and commits them as work files.

Messages to the parent: ("ready",), ("broken", reason), ("done", seconds), ("failed", reason),
("full", reason). The process ends by `os._exit`: Blender may hang at interpreter exit.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import errno
import hashlib
import importlib
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from synthgen.job import JobSpec
from synthgen.ledger import work_file
from synthgen.plan import SubjectPlan
from synthgen.shards import encode, encode_json, replacing, tar_entry, write_atomically
from synthgen.shot import RenderedSubject, inspect

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
Renderer = Callable[[SubjectPlan, JobSpec, Path, str, int], RenderedSubject]


class GateError(RuntimeError):
    """A shot broke a promise of the dataset contract."""


@dataclasses.dataclass(frozen=True)
class Orders:
    """What a worker is told once: everything but the subjects."""

    job: JobSpec
    out: Path
    renderer: str
    device: str
    threads: int
    log: Path


def work(orders: Orders, pipe: Connection) -> None:
    """Entry point of the process: render subjects from `pipe` until it sends None."""
    redirect(orders.log)
    _die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches us too; the parent decides
    try:
        render = load_renderer(orders.renderer)
    except Exception as error:
        traceback.print_exc()
        pipe.send(("broken", reason_of(error)))
        end_process(1)
        return
    pipe.send(("ready",))
    with contextlib.suppress(EOFError, OSError):
        while (subject := pipe.recv()) is not None:
            print(f"--- {subject.subset}/{subject.key}", flush=True)
            pipe.send(_attempt(render, orders, subject))
    end_process(0)


def load_renderer(name: str) -> Renderer:
    """The function that "package.module:function" names.

    Raises `ValueError` for a malformed name, and whatever the import raises.
    """
    module, _, function = name.partition(":")
    if not function:
        raise ValueError(f'renderer {name!r} must be "package.module:function"')
    return getattr(importlib.import_module(module), function)


def _attempt(render: Renderer, orders: Orders, subject: SubjectPlan) -> tuple[Any, ...]:
    start = time.perf_counter()
    try:
        rendered = render(
            subject, orders.job, orders.out / "environments", orders.device, orders.threads
        )
        commit_subject(orders.out, subject, rendered, time.perf_counter() - start)
    except Exception as error:
        traceback.print_exc()
        kind = "full" if is_disk_full(error) else "failed"
        return kind, reason_of(error)
    return "done", time.perf_counter() - start


def commit_subject(
    out: Path, subject: SubjectPlan, rendered: RenderedSubject, seconds: float
) -> None:
    """Gate every shot, then commit mesh, parameters and tar entries, and last the manifest rows.

    `seconds` is what rendering took. Raises `GateError` naming shot and promise.
    """
    from synthgen.manifest import encode_rows, row

    keys = [shot.key for shot in rendered.shots]
    expected = [shot.key for shot in subject.shots]
    if keys != expected:
        raise GateError(f"the renderer returned {len(keys)} shots instead of {len(expected)}")
    folder = out / "subjects" / subject.subset
    mesh = folder / f"{subject.key}.glb"
    tar = work_file(out, subject.subset, subject.key, ".tar")
    rows, position, fields = [], 0, None
    with replacing(tar) as file:
        for shot in rendered.shots:
            start = time.perf_counter()
            problems, figures = inspect(shot)
            if problems:
                raise GateError(f"{shot.key}: {'; '.join(problems)}")
            members, entry = [], position
            for name, content in encode(shot).items():
                entry_bytes = tar_entry(f"{shot.key}.{name}", content)
                members.append({"name": name, "offset": position + 512, "size": len(content)})
                file.write(entry_bytes)
                position += len(entry_bytes)
            names = [m["name"] for m in members]
            if fields not in (None, names):
                raise GateError(f"{shot.key}: other members than the first shot's")
            fields = names
            cost = {
                **shot.cost,
                "store": time.perf_counter() - start,
                "subject": seconds,
            }
            place = {
                "shard": tar.relative_to(out).as_posix(),
                "offset": entry,
                "size": position - entry,
                "members": members,
                "mesh": mesh.relative_to(out).as_posix(),
                "mesh_sha256": hashlib.sha256(rendered.mesh_glb).hexdigest(),
            }
            rows.append(row(shot.meta, figures, cost, place))
        write_atomically(mesh, rendered.mesh_glb)
        write_atomically(mesh.with_suffix(".json"), encode_json(rendered.parameters))
    write_atomically(tar.with_suffix(".json"), encode_rows(rows))


def reason_of(error: BaseException) -> str:
    """One short line for an exception."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else ""
    if isinstance(error, GateError):
        return f"gate: {text}"[:200]
    return f"{type(error).__name__}: {text}"[:200].rstrip(": ")


def is_disk_full(error: BaseException) -> bool:
    return isinstance(error, OSError) and error.errno in DISK_FULL


def redirect(log: Path) -> None:
    """Send both standard streams to the log at the level of file descriptors: Blender writes C."""
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.close(handle)


def _die_with_parent() -> None:
    """End this process when its parent is killed, so that no orphan renders on."""
    parent = os.getppid()
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        ctypes.CDLL(None, use_errno=True).prctl(pr_set_pdeathsig, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def end_process(code: int) -> None:
    """Flush and end at once, past Blender's exit handlers."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
