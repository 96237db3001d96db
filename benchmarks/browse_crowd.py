"""`synthgen browse` under a crowd: many clients at once, then some beside slow and half-open ones.

    python benchmarks/browse_crowd.py [--dataset DIR] [--clients 200] [--seconds 60] [--slow 200]

Without DIR a dataset of 8 people at 256² is made with the tests' renderer, in a temporary folder.
Each client asks for what the page asks for (rows, counts, thumbnails, shots, passes, values,
geometry), one thing after another over one connection, each time with another filter. Of the slow
ones a quarter each sends nothing, a byte of a head per second, a body that stops, and asks for
files that it does not read. Prints requests per second, errors, percentiles of the time to an
answer, and the memory of the server; exits with 1 if there was an error, or a slow client was
not sent away.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import socket
import sys
import tempfile
import time
import urllib.parse
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import report
from browse import Server

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

import fake_renderer

from synthgen.dataset import open_dataset
from synthgen.farm.local import render_job

RANGES = ("camera_yaw", "head_yaw", "person_age_years")
PASSES = ("albedo", "depth", "normal", "parts")
SENT_AWAY = 60.0
"""Seconds after which no slow client may be left."""
ANSWER = 60.0  # seconds that a client waits


@dataclass
class Crowd:
    """What clients met."""

    seconds: list[float] = field(default_factory=list)
    """To each answer."""
    errors: Counter[str] = field(default_factory=Counter)
    memory: list[float] = field(default_factory=list)
    """Megabytes of the server, each second."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--slow", type=int, default=200)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.dataset or Path(temporary) / "dataset"
        if options.dataset is None:
            job = fake_renderer.small_job(resolution=256)
            render_job(job, folder, workers=1, renderer=fake_renderer.RENDERER)
        server = Server(folder)
        try:
            return asyncio.run(measure(server, folder, options))
        finally:
            server.close()


async def measure(server: Server, folder: Path, options: argparse.Namespace) -> int:
    """Print the tables."""
    port = int(server.address.rstrip("/").rpartition(":")[2])
    keys = open_dataset(folder).keys()
    process = server.process.pid
    await crowd(port, keys, process, 1, 2.0)  # what is loaded once
    found = {
        "one client": await crowd(port, keys, process, 1, 5.0),
        f"{options.clients} clients": await crowd(
            port, keys, process, options.clients, options.seconds
        ),
    }
    slow = [asyncio.create_task(until_sent_away(kind, port, keys)) for kind in each(options.slow)]
    await asyncio.sleep(1.0)
    beside = f"10 clients beside {len(slow)} slow ones"
    found[beside] = await crowd(port, keys, process, 10, options.seconds)
    left = Counter[str]()
    gone: dict[str, list[float]] = {}
    for kind, seconds in await asyncio.gather(*slow):
        gone.setdefault(kind, []).append(seconds)
        left[kind] += seconds >= SENT_AWAY
    found["one client again"] = await crowd(port, keys, process, 1, 5.0)
    times = ("median, ms", "95 %, ms", "99 %, ms", "worst, ms")
    memory = ("memory at first, MB", "at most, MB", "at last, MB")
    report.table(
        ("who asks", "answers", "per second", "errors", *times, *memory),
        [row(name, each) for name, each in found.items()],
    )
    report.table(
        ("slow client", "number", "first sent away after, s", "last, s"),
        [
            (kind, len(times), f"{min(times):.0f}", f"{max(times):.0f}")
            for kind, times in gone.items()
        ],
    )
    for each_of in found.values():
        for error, count in each_of.errors.most_common(5):
            print(f"{count} times {error}")
    print(f"The server held at most {report.peak(process=process):.0f} MB.")
    return 1 if left.total() or any(f.errors for f in found.values()) else 0


def row(name: str, found: Crowd) -> list[str]:
    """A row of the table."""
    times = sorted(found.seconds)
    shares = [times[min(int(p * len(times)), len(times) - 1)] for p in (0.5, 0.95, 0.99, 1.0)]
    held = (found.memory[0], max(found.memory), found.memory[-1])
    rate = len(times) / len(found.memory)
    figures = [f"{len(times):,}", f"{rate:.0f}", str(found.errors.total())]
    return [name, *figures, *(f"{1000 * t:.0f}" for t in shares), *(f"{m:.0f}" for m in held)]


# ---------------------------------------------------------------- clients of the page


async def crowd(port: int, keys: list[str], process: int, clients: int, seconds: float) -> Crowd:
    """Let so many clients ask one thing after another for so long."""
    found, end = Crowd(), time.monotonic() + seconds
    work = [client(port, asked(keys, i), end, found) for i in range(clients)]

    async def watch() -> None:
        while time.monotonic() < end:
            found.memory.append(report.resident(process))
            await asyncio.sleep(1.0)

    await asyncio.gather(watch(), *work)
    found.memory.append(report.resident(process))
    return found


def asked(keys: list[str], seed: int) -> Iterator[str]:
    """Addresses as the page asks for them, without end."""
    rng = random.Random(seed)

    def chosen() -> str:
        name = rng.choice(RANGES)
        ranges = json.dumps({name: [rng.uniform(-1.0, 0.0), None]})
        return urllib.parse.urlencode({"ranges": ranges, "sort": rng.choice(RANGES)})

    makers: list[Callable[[str], str]] = [
        lambda key: "/",
        lambda key: "/api/dataset",
        lambda key: f"/api/shots?{chosen()}&limit=60",
        lambda key: f"/api/counts?{chosen()}&columns=split,kind,view",
        lambda key: f"/thumbnail/{key}?size={rng.choice((96, 160, 240))}",
        lambda key: f"/api/shot/{key}",
        lambda key: f"/pass/{key}/{rng.choice(PASSES)}",
        lambda key: f"/values/{key}/{rng.choice(PASSES)}",
        lambda key: f"/member/{key}/geometry.npz",
    ]
    weights = [1, 1, 4, 2, 20, 2, 4, 1, 1]
    while True:
        yield rng.choices(makers, weights)[0](rng.choice(keys))


async def client(port: int, paths: Iterator[str], end: float, found: Crowd) -> None:
    """Ask for one after another; a connection that fails is an error, and made anew."""
    writer = None
    while time.monotonic() < end:
        path, start = next(paths), time.monotonic()
        try:
            if writer is None:
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(request("GET", path).encode())
            status = await asyncio.wait_for(answer(reader), ANSWER)
            found.seconds.append(time.monotonic() - start)
            if status != 200:
                found.errors[f"{status}: {path.split('?')[0].split('/')[1]}"] += 1
        except (OSError, EOFError, TimeoutError) as error:
            found.errors[f"{type(error).__name__}: {path.split('?')[0].split('/')[1]}"] += 1
            if writer is not None:
                writer.close()
            writer = None
    if writer is not None:
        writer.close()


def request(method: str, path: str, *headers: str) -> str:
    """The head of a request."""
    return "\r\n".join([f"{method} {path} HTTP/1.1", "Host: localhost", *headers, "", ""])


async def answer(reader: asyncio.StreamReader) -> int:
    """Read an answer to its end; gives its status."""
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
    lines = dict(line.split(": ", 1) for line in head.split("\r\n")[1:] if line)
    await reader.readexactly(int(lines["content-length"]))
    return int(head.split()[1])


# ---------------------------------------------------------------- slow clients


async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, key: str) -> None:
    await reader.read()


async def trickling(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, key: str) -> None:
    for byte in request("GET", "/api/dataset", "X: " + "x" * 1000):
        writer.write(byte.encode())
        with suppress(TimeoutError):
            await asyncio.wait_for(reader.read(), 1.0)
            return


async def stopping(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, key: str) -> None:
    writer.write(request("POST", "/lightmaps", "Content-Length: 1000000").encode() + b"#?RADIANCE")
    await reader.read()


async def deaf(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, key: str) -> None:
    """Ask for more than the sockets' buffers hold, and read none of it."""
    writer.transport.pause_reading()  # pyright: ignore[reportAttributeAccessIssue]
    with suppress(OSError):
        while True:  # until the connection is reset
            writer.write(request("GET", f"/values/{key}/normal").encode())
            await asyncio.sleep(0.2)
            await asyncio.wait_for(writer.drain(), 1.0)


SLOW: dict[str, Callable[..., Coroutine[Any, Any, None]]] = {
    "sends nothing": silent,
    "sends a byte of a head per second": trickling,
    "sends a part of a body": stopping,
    "reads no answer": deaf,
}


def each(number: int) -> list[str]:
    """So many kinds of slow clients, in turn."""
    return [list(SLOW)[i % len(SLOW)] for i in range(number)]


async def until_sent_away(kind: str, port: int, keys: list[str]) -> tuple[str, float]:
    """Be slow until the server ends the connection; gives after how many seconds."""
    connection = socket.create_connection(("127.0.0.1", port))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    reader, writer = await asyncio.open_connection(sock=connection)
    start = time.monotonic()
    with closing(writer), suppress(TimeoutError, OSError, EOFError):
        await asyncio.wait_for(SLOW[kind](reader, writer, keys[0]), SENT_AWAY)
    return kind, time.monotonic() - start


@contextmanager
def closing(writer: asyncio.StreamWriter) -> Iterator[None]:
    try:
        yield
    finally:
        writer.transport.abort()


if __name__ == "__main__":
    sys.exit(main())
