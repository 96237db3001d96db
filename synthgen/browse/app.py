"""The addresses that `synthgen browse` answers; see docs/browse.md."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from typing import Any
from xml.sax.saxutils import escape

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from synthgen.browse import dataset, samples, selection, shots
from synthgen.browse.folder import Folder, Refused, name
from synthgen.browse.samples import Broken, Sample
from synthgen.browse.sandbox import ROWS
from synthgen.browse.security import Guard, plain_header
from synthgen.browse.snapshot import Library
from synthgen.browse.thumbnails import SIZES, Thumbnails
from synthgen.ledger import StorageError

_ASSETS = files("synthgen.browse") / "assets"


class Server:
    """The handlers, with what they share: the folder, its snapshots, the cache of thumbnails."""

    def __init__(self, library: Library, thumbnails: Thumbnails) -> None:
        self.library, self.thumbnails = library, thumbnails
        self.folder: Folder = library.folder

    def page(self, request: Request) -> Response:
        return FileResponse(str(_ASSETS / "index.html"), headers={"Cache-Control": "no-cache"})

    def dataset(self, request: Request) -> Response:
        return JSONResponse(dataset.describe(self.library.snapshot()))

    def shots(self, request: Request) -> Response:
        snapshot = self.library.snapshot()
        chosen = selection.parse(request.query_params, snapshot)
        offset = selection.number(request.query_params, "offset", 0, 0, 10**9)
        limit = selection.number(request.query_params, "limit", 60, 0, ROWS)
        rows = shots.page(snapshot, chosen, offset, limit)
        health = samples.Health(self.folder)
        for row in rows:
            row["broken"] = health.reason(row)
        found = shots.total(snapshot, chosen)
        return JSONResponse({"total": found, "rows": rows, "revision": snapshot.revision})

    def thumbnail(self, request: Request) -> Response:
        environment = selection.number(request.query_params, "environment", 0, 0, 99)
        size = selection.number(request.query_params, "size", 160, 1, SIZES[-1])
        try:
            picture = self.thumbnails.get(self._sample(request), environment, size)
        except Broken as reason:
            return _broken_picture(str(reason), size)
        # The address does not say which bytes it stands for, so it is asked about again.
        return Response(picture, headers={"Cache-Control": "private, max-age=60"}, media_type="image/jpeg")

    def _sample(self, request: Request) -> Sample:
        return Sample(self.folder, self._row(request))

    def _row(self, request: Request) -> dict[str, Any]:
        subset = name(request.path_params["subset"], "subset")
        key = name(request.path_params["shot"], "key")
        return shots.row(self.library.snapshot(), subset, key)


def _broken_picture(reason: str, size: int) -> Response:
    shown = escape(reason[:200])
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="{size}" '
        f'viewBox="0 0 160 160" role="img"><title>{shown}</title>'
        '<rect width="160" height="160" fill="#3a1d1d"/>'
        '<path d="M60 60l40 40M100 60l-40 40" stroke="#e88" stroke-width="6"/></svg>'
    )
    headers = {"X-Broken": plain_header(reason), "Cache-Control": "no-store"}
    return Response(svg, headers=headers, media_type="image/svg+xml")


def _refused(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, error.status if isinstance(error, Refused) else 409)


def _broken(request: Request, error: Exception) -> Response:
    reason = {"X-Broken": plain_header(error)}
    return JSONResponse({"error": f"broken: {error}"}, 422, headers=reason)


def create(library: Library, thumbnails: Thumbnails, token: str | None, port: int) -> Starlette:
    """The application; `token` is asked of every request if given, `port` names its cookie."""
    server = Server(library, thumbnails)

    def get(path: str, handler: Callable[[Request], Response]) -> Route:
        return Route(path, handler, methods=["GET"])

    return Starlette(
        routes=[
            get("/", server.page),
            get("/api/dataset", server.dataset),
            get("/api/shots", server.shots),
            get("/thumbnail/{subset}/{shot}", server.thumbnail),
            Mount("/assets", StaticFiles(directory=str(_ASSETS))),
        ],
        middleware=[
            Middleware(Guard, token=token, port=port),
            Middleware(GZipMiddleware, minimum_size=2000, compresslevel=3),
        ],
        exception_handlers={Refused: _refused, StorageError: _refused, Broken: _broken},
    )
