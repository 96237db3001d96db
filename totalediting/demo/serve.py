"""Starting the page: what may connect, what may be fetched, and where uploads lie meanwhile."""

from __future__ import annotations

import ipaddress
import os
import secrets
import signal
import socket
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from totalediting.demo.playground import MOST_BYTES, Playground
from totalediting.editing.editor import Editor
from totalediting.errors import InputError

# Everything comes from this server; Gradio's page has scripts and styles of its own in the text.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "font-src 'self' data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'self'; frame-ancestors 'none'"
)
USER = "guest"
"""Who logs in where others can connect."""


def serve(host: str, port: int, say: Callable[[str], None], editor: Editor | None = None) -> None:
    """Serve the page until interrupted. `say` gets lines for the user.

    Raises:
        ModuleNotFoundError: Gradio is not installed.
        InputError: the address cannot be had.
        NetworkError: as `Editor.load`.
    """
    # Its default would leave the folder; uvicorn passes it on.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    with tempfile.TemporaryDirectory(prefix="totalediting-demo-") as folder:
        # Read when Gradio is imported: it tells nobody of its use, and keeps uploads in here.
        os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
        os.environ["GRADIO_TEMP_DIR"] = folder
        import fastapi  # pyright: ignore[reportMissingImports]
        import gradio  # pyright: ignore[reportMissingImports]
        import uvicorn

        from totalediting.demo import page

        listening = _listening(host, port)
        made = Path(folder) / "made"
        made.mkdir()
        blocks = page.build(Playground(editor or Editor.load(), made))
        local = _is_loopback(host)
        password = None if local else secrets.token_urlsafe(12)
        shown = f"[{host}]" if ":" in host else host
        address = f"http://{shown}:{listening.getsockname()[1]}/"
        app = gradio.mount_gradio_app(
            fastapi.FastAPI(openapi_url=None),
            blocks,
            "/",
            auth=None if password is None else (USER, password),
            max_file_size=MOST_BYTES,
            show_error=False,
            footer_links=[],
            theme=page.THEME,
            css=page.CSS,
            ssr_mode=False,
        )
        say(f"{address} (Ctrl+C to stop)")
        if password is not None:
            say(f"others can connect: user {USER}, password {password}")
        config = uvicorn.Config(
            _Guard(app, local), log_level="error", access_log=False, server_header=False
        )
        with listening:
            uvicorn.Server(config).run(sockets=[listening])


class _Guard:
    """Adds what the page may do to every answer; on loopback, answers to its names alone."""

    def __init__(self, app: Any, local: bool) -> None:
        self.app, self.local = app, local

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        host = dict(scope["headers"]).get(b"host", b"").decode("latin-1")
        if self.local and not _is_loopback(host.rsplit(":", 1)[0]):
            await send({"type": "http.response.start", "status": 403, "headers": []})
            await send({"type": "http.response.body", "body": b"this page answers on localhost"})
            return

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [
                    *message["headers"],
                    (b"content-security-policy", _POLICY.encode()),
                    (b"x-content-type-options", b"nosniff"),
                    (b"referrer-policy", b"no-referrer"),
                ]
            await send(message)

        await self.app(scope, receive, with_headers)


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"--port: {host} {port}: {reason}; choose another, or 0") from None
