"""The addresses that `synthgen browse` answers, by GET where nothing else is said.

    /, /assets/…                                    the page
    /api/dataset                                    name, counts, columns, environments, revision
    /api/shots?<selection>&offset=&limit=           a page of rows, and how many there are
    /api/counts?<selection>&columns=&pairs=         facets and histograms, of all columns or some
    /api/selection?<selection>                      SQL, Python and command that choose the same
    /rows?<selection>&format=                       keys, csv or parquet of a selection, a download
    /api/shot/{subset}/{shot}                       metadata, members, siblings, command, broken
    /api/subject/{subset}/{subject}                 shots and cameras
    /thumbnail/{subset}/{shot}?environment=&size=   JPEG; SVG with X-Broken where there is none
    /pass/{subset}/{shot}/{pass}?environment=       PNG, as `synthgen show` draws it
    /values/{subset}/{shot}/{pass}?environment=     numbers, see `decoded`
    /member/{subset}/{shot}/{name}                  bytes as stored
    /subject/{subset}/{subject}.glb                 the mesh
    /subject/{subset}/{subject}/expressions         numbers, see `subjects`
    /lightmaps/{environment}?height=                numbers, see `light`; POST /lightmaps of a file
    /api/tags, /api/tags/undo                       see `tagging`

A selection is what `selection` says. Numbers are raw and little-endian, their shape and type in
X-Shape ("480,640,3") and X-Type. Errors are {"error": one line} with a 4xx status: 400 for a
bad request, 401 without the token, 404 for what is not there, 422 for bytes that are damaged.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from PIL import Image
from starlette.applications import Starlette
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from synthgen.browse import dataset
from synthgen.browse.access.public import TakingTurns
from synthgen.browse.access.security import Guard, plain_header
from synthgen.browse.access.uploads import Uploads
from synthgen.browse.folder import Folder, Refused, name
from synthgen.browse.shot import light, samples, shot_page, subjects
from synthgen.browse.shot.decoded import Decoder
from synthgen.browse.shot.runs import PREFIX, Beside
from synthgen.browse.shot.samples import Broken, Sample
from synthgen.browse.shot.thumbnails import SIZES, Thumbnails
from synthgen.browse.table import counts, exports, selection, shots
from synthgen.browse.table.sandbox import ROWS
from synthgen.browse.table.selection import Selection
from synthgen.browse.table.snapshot import Library, Snapshot
from synthgen.browse.tagging import Tagging
from synthgen.dataset.folder import StorageError
from synthgen.dataset.tags import tags_folder

_ASSETS = files("synthgen.browse") / "assets"
_DOWNLOADS = {
    "keys": ("keys.txt", "text/plain; charset=utf-8"),
    "csv": ("rows.csv", "text/csv; charset=utf-8"),
    "parquet": ("rows.parquet", "application/vnd.apache.parquet"),
}
# An address does not say which bytes it stands for, so before long it is asked about again.
_BRIEFLY = {"Cache-Control": "private, max-age=60"}


class Answer(JSONResponse):
    """JSON of whatever a dataset holds: NaN becomes null, and half characters are escaped."""

    def render(self, content: Any) -> bytes:
        try:
            return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
        except ValueError:
            return json.dumps(_finite(content), separators=(",", ":")).encode()


class Server:
    """The handlers, with what they share: the folder, its snapshots, the cache of thumbnails."""

    def __init__(
        self, library: Library, thumbnails: Thumbnails, tagging: Tagging, beside: Beside | None
    ) -> None:
        self.library, self.thumbnails, self.tagging = library, thumbnails, tagging
        self.beside = beside
        self.decoder, self.uploads = Decoder(), Uploads()
        self.folder: Folder = library.folder

    def page(self, request: Request) -> Response:
        return FileResponse(str(_ASSETS / "index.html"), headers={"Cache-Control": "no-cache"})

    def dataset(self, request: Request) -> Response:
        pictures = self.beside.run.pictures if self.beside else ()
        return Answer(dataset.describe(self.library.snapshot(), pictures))

    def shots(self, request: Request) -> Response:
        snapshot, chosen = self._chosen(request)
        offset = selection.number(request.query_params, "offset", 0, 0, 10**9)
        limit = selection.number(request.query_params, "limit", 60, 0, ROWS)
        total, rows = shots.page(snapshot, chosen, offset, limit)
        health = samples.Health(self.folder)
        for row in rows:
            reason = health.reason(row)
            row["broken"] = reason and self.folder.without_paths(reason)
        self.tagging.mark(rows)
        self.library.answered()
        return Answer({"total": total, "rows": rows, "revision": snapshot.revision})

    def counts(self, request: Request) -> Response:
        snapshot, chosen = self._chosen(request)
        wanted = request.query_params.get("columns")
        names = None if wanted is None else [n for n in wanted.split(",") if n]
        answer = counts.count(snapshot, chosen, names) | {"tags": []}
        wanted = request.query_params.get("pairs", "").split(",")[:8]
        answer["pairs"] = counts.pairs(snapshot, chosen, [pair for pair in wanted if ":" in pair])
        if snapshot.in_memory:
            rows = replace(chosen, kept=None).rows(snapshot)
            answer["tags"] = self.tagging.count(snapshot, rows)
        return Answer(answer)

    def selection(self, request: Request) -> Response:
        snapshot, chosen = self._chosen(request)
        own = {column for column in snapshot.columns if column.startswith(PREFIX)}
        if own and any(column in str(chosen) for column in own):
            # Errors of a run are columns of this page alone.
            chosen = exports.by_key(snapshot, chosen)
        place = self.tagging.place
        tags_in = None if place == tags_folder() or self.folder.hidden else str(place)
        return Answer(exports.describe(self.folder.shown, chosen, tags_in))

    def rows(self, request: Request) -> Response:
        snapshot, chosen = self._chosen(request)
        form = request.query_params.get("format", "csv")
        if form not in _DOWNLOADS:
            raise Refused(f"format {form[:40]}: must be one of {', '.join(_DOWNLOADS)}", 400)
        ending, kind = _DOWNLOADS[form]
        name = re.sub(r"[^\w.-]+", "_", snapshot.info.get("name") or "dataset", flags=re.ASCII)
        headers = {"Content-Disposition": f'attachment; filename="{name[:80]}-{ending}"'}
        if form == "parquet":
            folder = exports.as_parquet(snapshot, chosen)
            path = Path(folder.name) / "rows.parquet"
            done = BackgroundTask(folder.cleanup)
            return FileResponse(path, headers=headers, media_type=kind, background=done)
        pieces = (exports.keys if form == "keys" else exports.as_csv)(snapshot, chosen)
        return StreamingResponse(pieces, headers=headers, media_type=kind)

    def thumbnail(self, request: Request) -> Response:
        environment = selection.number(request.query_params, "environment", 0, 0, 99)
        size = selection.number(request.query_params, "size", 160, 1, SIZES[-1])
        try:
            picture = self.thumbnails.get(self._sample(request), environment, size)
        except Broken as reason:
            return _broken_picture(self.folder.without_paths(str(reason)), size)
        return Response(picture, headers=_BRIEFLY, media_type="image/jpeg")

    def shot(self, request: Request) -> Response:
        row, snapshot = self._row(request), self.library.snapshot()
        answer = shot_page.describe(self.folder, snapshot, self.decoder, row)
        self.tagging.mark([answer])
        if self.beside is not None:
            answer["errors"] = self.beside.of(f"{answer['subset']}/{answer['key']}")
        return Answer(answer)

    def picture(self, request: Request) -> Response:
        environment = selection.number(request.query_params, "environment", 0, 0, 99)
        wanted = request.path_params["pass"]
        if self.beside is not None and wanted.startswith(PREFIX):
            row = self._row(request, ("subset", "key", "split"))
            place = f"{row['subset']}/{row['key']}", str(row["split"])
            drawn = self.beside.picture(*place, wanted.removeprefix(PREFIX))
        else:
            drawn = self.decoder.picture(self._sample(request), wanted, environment)
        buffer = io.BytesIO()
        # Quick rather than small: it is drawn for one look.
        Image.fromarray(drawn).save(buffer, "PNG", compress_level=1)
        return Response(buffer.getvalue(), headers=_BRIEFLY, media_type="image/png")

    def values(self, request: Request) -> Response:
        environment = selection.number(request.query_params, "environment", 0, 0, 99)
        wanted = request.path_params["pass"]
        return _array(self.decoder.values(self._sample(request), wanted, environment))

    def member(self, request: Request) -> Response:
        sample = self._sample(request)
        member = sample.member(request.path_params["name"])
        file_name = plain_header(f"{sample.key}.{member.name}").replace('"', "_").replace("\\", "_")
        headers = {
            "Content-Disposition": f'attachment; filename="{file_name}"',
            "Content-Length": str(member.size),
            "Content-Security-Policy": "sandbox",
        }
        return StreamingResponse(
            sample.stream(member), headers=headers, media_type="application/octet-stream"
        )

    def lightmaps(self, request: Request) -> Response:
        height = selection.number(request.query_params, "height", 32, *light.HEIGHTS)
        return _array(light.of_dataset(self.folder, request.path_params["environment"], height))

    async def bake(self, request: Request) -> Response:
        height = selection.number(request.query_params, "height", 32, *light.HEIGHTS)
        content = await self.uploads.read(request, light.LARGEST_UPLOAD)
        return _array(await run_in_threadpool(light.of_upload, content, height))

    def tags(self, request: Request) -> Response:
        return Answer(self.tagging.describe())

    async def tag(self, request: Request) -> Response:
        return Answer(await self.tagging.change(request, self.uploads))

    async def undo_tag(self, request: Request) -> Response:
        return Answer(await self.tagging.undo(request))

    def refused(self, request: Request, error: Exception) -> Response:
        status = error.status if isinstance(error, Refused) else 409
        return Answer({"error": self.folder.without_paths(str(error))}, status)

    def broken(self, request: Request, error: Exception) -> Response:
        reason = self.folder.without_paths(str(error))
        headers = {"X-Broken": plain_header(reason)}
        return Answer({"error": f"broken: {reason}"}, 422, headers=headers)

    def subject(self, request: Request) -> Response:
        return Answer(subjects.describe(*self._subject(request)))

    def mesh(self, request: Request) -> Response:
        content = subjects.mesh(*self._subject(request))
        return Response(content, headers=_BRIEFLY, media_type="model/gltf-binary")

    def expressions(self, request: Request) -> Response:
        return _array(subjects.expressions(*self._subject(request)))

    def _chosen(self, request: Request) -> tuple[Snapshot, Selection]:
        snapshot = self.library.snapshot()
        chosen = selection.parse(request.query_params, snapshot)
        return snapshot, self.tagging.kept(snapshot, chosen)

    def _subject(self, request: Request) -> tuple[Folder, Snapshot, str, str]:
        subset = name(request.path_params["subset"], "subset")
        subject = name(request.path_params["subject"], "subject")
        return self.folder, self.library.snapshot(), subset, subject

    def _sample(self, request: Request) -> Sample:
        return Sample(self.folder, self._row(request, shots.PLACE))

    def _row(self, request: Request, wanted: tuple[str, ...] = ()) -> dict[str, Any]:
        subset = name(request.path_params["subset"], "subset")
        key = name(request.path_params["shot"], "key")
        return shots.row(self.library.snapshot(), subset, key, wanted)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _array(array: np.ndarray) -> Response:
    """An array as its bytes, little-endian, with its shape and type in the headers."""
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    headers = _BRIEFLY | {
        "X-Shape": ",".join(map(str, array.shape)),
        "X-Type": array.dtype.name,
    }
    return Response(array.tobytes(), headers=headers, media_type="application/octet-stream")


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


def _unknown(request: Request, error: Exception) -> Response:
    status = getattr(error, "status_code", 404)
    return Answer({"error": getattr(error, "detail", "no such address")}, status)


def create(
    library: Library,
    thumbnails: Thumbnails,
    token: str | None,
    port: int,
    tagging: Tagging | None = None,
    public: str | None = None,
    beside: Beside | None = None,
) -> Starlette:
    """The application; `token` is asked of every request if given, `port` names its cookie.

    Without `tagging`, the user's own tags are shown and none are changed. `public` is the name of a
    proxy's host: everybody may ask then, in turns, and nothing is written. `beside` is a run to be
    shown.
    """
    limits = [] if public is None else [Middleware(TakingTurns)]
    server = Server(library, thumbnails, tagging or Tagging(library, tags_folder(), None), beside)

    def get(path: str, handler: Callable[[Request], Response]) -> Route:
        return Route(path, handler, methods=["GET"])

    return Starlette(
        routes=[
            get("/", server.page),
            get("/api/dataset", server.dataset),
            get("/api/shots", server.shots),
            get("/api/counts", server.counts),
            get("/api/selection", server.selection),
            get("/rows", server.rows),
            get("/thumbnail/{subset}/{shot}", server.thumbnail),
            get("/api/shot/{subset}/{shot}", server.shot),
            get("/pass/{subset}/{shot}/{pass}", server.picture),
            get("/values/{subset}/{shot}/{pass}", server.values),
            get("/member/{subset}/{shot}/{name}", server.member),
            get("/lightmaps/{environment}", server.lightmaps),
            Route("/lightmaps", server.bake, methods=["POST"]),
            get("/api/tags", server.tags),
            Route("/api/tags", server.tag, methods=["POST"]),
            Route("/api/tags/undo", server.undo_tag, methods=["POST"]),
            get("/api/subject/{subset}/{subject}", server.subject),
            get("/subject/{subset}/{subject}.glb", server.mesh),
            get("/subject/{subset}/{subject}/expressions", server.expressions),
            Mount("/assets", StaticFiles(directory=str(_ASSETS))),
        ],
        middleware=[Middleware(Guard, token=token, port=port, public=public), *limits],
        exception_handlers={
            Refused: server.refused,
            StorageError: server.refused,
            Broken: server.broken,
            HTTPException: _unknown,
        },
    )
