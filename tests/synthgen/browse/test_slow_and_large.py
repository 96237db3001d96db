"""Requests that never end, and bodies that are too large, through a real server on loopback."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import uvicorn

from synthgen.browse import serve as serving
from synthgen.browse.access import uploads
from synthgen.browse.app import create
from synthgen.browse.folder import Folder, Refused
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library


@contextlib.contextmanager
def served(app: Any) -> Iterator[int]:
    """The port of a server as `synthgen browse` runs it."""
    listening = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, http=serving.Patient, log_level="critical"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield listening.getsockname()[1]
    server.should_exit = True
    thread.join()


@pytest.fixture
def port(small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    monkeypatch.setattr(serving, "HEADER_SECONDS", 0.5)
    monkeypatch.setattr(uploads, "PATIENCE", 0.5)
    monkeypatch.setattr("synthgen.browse.shot.light.LARGEST_UPLOAD", 1 << 20)
    library = Library(Folder(small_dataset), 1)
    # Without a token any name of this machine is accepted, whatever the port.
    with served(create(library, Thumbnails(tmp_path), None, 0)) as number:
        yield number
    library.close()


def talk(port: int, *pieces: bytes, pause: float = 0.0) -> bytes:
    """What a server answers until it closes the connection."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
        for piece in pieces:
            try:
                connection.sendall(piece)
            except OSError:
                break
            time.sleep(pause)
        answer = b""
        while True:
            try:
                received = connection.recv(1 << 16)
            except ConnectionResetError:
                return answer
            if not received:
                return answer
            answer += received


def head(length: int) -> bytes:
    return (
        f"POST /lightmaps HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n"
        "Connection: close\r\n\r\n"
    ).encode()


def test_a_silent_connection_is_closed(port: int):
    start = time.monotonic()
    assert talk(port) == b""
    assert time.monotonic() - start < 5


def test_a_head_that_trickles_is_not_waited_for(port: int):
    start = time.monotonic()
    talk(port, *(b"G", b"E", b"T", b" ", b"/", b" ") * 5, pause=0.1)
    assert time.monotonic() - start < 5
    assert b"200 OK" in talk(
        port, b"GET /api/dataset HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    )


@pytest.mark.parametrize("length", [2 << 20, 30 << 20])
def test_a_body_that_is_too_large_gets_its_answer(port: int, length: int):
    answer = talk(port, head(length), *([b"\0" * (1 << 20)] * (length >> 20)))
    assert b" 413 " in answer.split(b"\r\n")[0]
    assert "larger than 1 MB" in json.loads(answer.split(b"\r\n\r\n")[1])["error"]


def test_a_body_that_stops_is_given_up(port: int):
    answer = talk(port, head(1000), b"#?RADIANCE")
    assert b" 408 " in answer.split(b"\r\n")[0]


LONG = 64 << 20  # bytes of an answer, more than the sockets' buffers


async def long_answer(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "http":
        length = (b"content-length", str(LONG).encode())
        await send({"type": "http.response.start", "status": 200, "headers": [length]})
        await send({"type": "http.response.body", "body": bytes(LONG)})


@pytest.mark.parametrize(("pause", "whole"), [(2.0, False), (0.1, True)], ids=["stops", "slow"])
def test_an_answer_that_is_not_read_is_given_up(
    monkeypatch: pytest.MonkeyPatch, pause: float, whole: bool
):
    monkeypatch.setattr(serving, "READER_SECONDS", 0.5)
    with (
        served(long_answer) as port,
        socket.create_connection(("127.0.0.1", port), timeout=10) as connection,
    ):
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        received = 0
        for _ in range(10):  # takes longer than what a reader may stop for
            time.sleep(pause)
            pause = pause if whole else 0.0
            received += len(connection.recv(1 << 20))
        with contextlib.suppress(ConnectionResetError):
            while piece := connection.recv(1 << 20):
                received += len(piece)
    assert (received > LONG) == whole


def test_uploads_are_bounded_together(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(uploads, "IN_FLIGHT", 1500)

    class Request:
        def __init__(self, more: asyncio.Event) -> None:
            self.headers, self.more = {}, more

        async def stream(self) -> AsyncIterator[bytes]:
            yield b"x" * 1000
            await self.more.wait()

    async def two_at_once() -> None:
        shared, ended, going = uploads.Uploads(), asyncio.Event(), asyncio.Event()
        ended.set()
        first = asyncio.create_task(shared.read(cast(Any, Request(going)), 2000))
        await asyncio.sleep(0.01)
        with pytest.raises(Refused) as refused:
            await shared.read(cast(Any, Request(ended)), 2000)
        assert refused.value.status == 503
        going.set()
        assert len(await first) == 1000 and shared.held == 0

    asyncio.run(two_at_once())
