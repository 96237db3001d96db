"""Asking the server of `synthgen browse` without a network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from starlette.testclient import TestClient

from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.browse.table.snapshot import Library


def client(out: Path, cache: Path, library: Library | None = None, **options: Any) -> TestClient:
    """A client of a server over `out` with its thumbnails in `cache`."""
    library = library or Library(Folder(out))
    app = create(library, Thumbnails(cache, **options), token=None, port=0)
    return TestClient(app, base_url="http://localhost")


def selected(ask: TestClient, **query: Any) -> list[str]:
    """The keys of a selection, page by page."""
    query = {k: v if isinstance(v, str) else json.dumps(v) for k, v in query.items()}
    keys: list[str] = []
    while True:
        answer = ask.get("/api/shots", params=query | {"offset": len(keys), "limit": 3}).json()
        keys += [f"{row['subset']}/{row['key']}" for row in answer["rows"]]
        if len(keys) >= answer["total"]:
            assert len(keys) == answer["total"]
            return keys
