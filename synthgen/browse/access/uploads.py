"""Bodies of requests: bounded each and in total, and not waited for without end."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from starlette.requests import Request

from synthgen.browse.folder import Refused

IN_FLIGHT = 256 << 20
"""Bytes that all uploads together may hold."""
PATIENCE = 30.0
"""Seconds without a byte after which an upload is given up."""
_DRAINED = 64 << 20  # bytes of a refused body that are read away, so that the answer arrives


class Uploads:
    """The uploads of a server, all in its one event loop."""

    def __init__(self) -> None:
        self.held = 0

    async def read(self, request: Request, most: int) -> bytes:
        """The body of a request; `Refused` if it is larger than `most`, too slow, or too many are
        being sent at once."""
        declared = request.headers.get("content-length", "")
        pieces, content = _pieces(request), bytearray()
        try:
            if declared.isdigit() and int(declared) > most:
                raise _too_large(most)
            async for piece in pieces:
                if len(content) + len(piece) > most:
                    raise _too_large(most)
                if self.held + len(piece) > IN_FLIGHT:
                    raise Refused("too many uploads at once; try again in a moment", 503)
                self.held += len(piece)
                content += piece
            return bytes(content)
        except Refused:
            # An answer before the body has been read would be lost in a reset connection.
            drained = 0
            async for piece in pieces:
                drained += len(piece)
                if drained > _DRAINED:
                    break
            raise
        finally:
            self.held -= len(content)


def _too_large(most: int) -> Refused:
    return Refused(f"the file is larger than {most >> 20} MB; make the panorama smaller", 413)


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    stream = request.stream()
    while True:
        try:
            piece = await asyncio.wait_for(anext(stream), PATIENCE)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise Refused(f"nothing came for {PATIENCE:g} s; send the file again", 408) from None
        yield piece
