"""Starting the server: address, token, and the lines that a user sees."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from synthgen.browse.access.public import HOST
from synthgen.browse.access.security import is_loopback, new_token
from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.shot.runs import open_beside
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library, threads
from synthgen.browse.tagging import Tagging
from synthgen.dataset.tags import tags_folder
from synthgen.errors import JobError

HEADER_SECONDS = 20.0
"""What a request's head may take to arrive."""
READER_SECONDS = 30.0
"""For how long a client may take nothing of an answer that waits for it."""


class Patient(H11Protocol):
    """Closes a connection whose request is not there in `HEADER_SECONDS`, however it trickles, or
    whose answer is not read for `READER_SECONDS`."""

    _head_timer: asyncio.TimerHandle | None = None
    _reader_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._await_reader()

    def resume_writing(self) -> None:
        self._forget_reader()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop()
        self._forget_reader()
        super().connection_lost(exc)

    def _watch(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop()
        elif self._head_timer is None:
            self._head_timer = self.loop.call_later(HEADER_SECONDS, self.transport.close)

    def _stop(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _await_reader(self) -> None:
        left = self.transport.get_write_buffer_size()

        def look() -> None:
            if self.transport.get_write_buffer_size() < left:
                self._await_reader()
            else:
                self.transport.abort()

        self._reader_timer = self.loop.call_later(READER_SECONDS, look)

    def _forget_reader(self) -> None:
        if self._reader_timer is not None:
            self._reader_timer.cancel()
            self._reader_timer = None


def serve(
    out: Path,
    host: str,
    port: int,
    cache_megabytes: int,
    say: Callable[[str], None],
    ready: Callable[[str], None] = lambda address: None,
    tags_in: Path | None = None,
    person: str | None = None,
    public: str | None = None,
    run: Path | None = None,
) -> None:
    """Serve a dataset until interrupted. `say` gets lines for the user, `ready` the address.

    `person` gives tags, which are kept in `tags_in` or the user's own folder; without one they
    are only shown. `public` is the host of a proxy for which it listens, see `public`: then nobody
    gives tags, and only those of `tags_in` are shown. `run` is a trained run to show beside it.

    Raises `StorageError` if `out` is no dataset, `JobError` if the address cannot be had.
    """
    if public is not None:
        if not HOST.fullmatch(public):
            raise JobError("--public", "", public, "give the host of the proxy: data.example.org")
        if not is_loopback(host):
            raise JobError("--host", "", host, "with --public it is the proxy that others reach")
        tags_in, person = tags_in or Path(os.devnull), None
    beside = None if run is None else open_beside(run, out)
    added = beside.columns() if beside else {}
    library = Library(Folder(out, hidden=public is not None), threads(), added)
    tagging = Tagging(library, tags_in or tags_folder(), person)
    token = None if is_loopback(host) else new_token()
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise JobError("--port", host, str(port), f"{reason}; choose another, or 0") from None
    port = listening.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{port}/" + (f"?token={token}" if token else "")
    app = create(
        library, Thumbnails(limit=cache_megabytes << 20), token, port, tagging, public, beside
    )
    say(f"{out}: {address} (Ctrl+C to stop)")
    if public:
        say(f"read-only, for a proxy that others reach as {public}")
    if token:
        say("anyone with this address, token included, can see the dataset")
    ready(address)
    # Without a log of requests: the address of the first one holds the token.
    config = uvicorn.Config(
        app, http=Patient, log_level="warning", access_log=False, server_header=False
    )
    try:
        with listening:
            uvicorn.Server(config).run(sockets=[listening])
    finally:
        library.close()
