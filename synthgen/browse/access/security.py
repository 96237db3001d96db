"""Who may connect, and what the page may do: hosts, the token, and the headers of every answer.

On the loopback interface the name of the host is checked, so that a page of another site cannot
ask through a name that it lets point here. Elsewhere a token is asked for, in the address once and
in a cookie from then on.
"""

from __future__ import annotations

import ipaddress
import secrets
from typing import Any
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

# Everything comes from this server; pictures that the page makes itself are blobs.
_POLICY = (
    "default-src 'self'; img-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


def is_loopback(host: str) -> bool:
    """Whether an address to listen on is this machine's own."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """A token that cannot be guessed."""
    return secrets.token_urlsafe(24)


class Guard:
    """Lets requests through to `app`: the right host, the token if one is set, our own pages.

    The right host is this machine, or `public`, the name of a proxy. With a token, it may come in
    the cookie or as `?token=`; a page that is opened with it in the address gets the cookie and is
    sent to the address without it.
    """

    def __init__(
        self, app: ASGIApp, token: str | None, port: int, public: str | None = None
    ) -> None:
        self.app, self.token, self.public = app, token, public
        # Cookies are shared by all ports of a host.
        self.cookie = f"synthgen_browse_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        answer = self._refusal(request)

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        await (answer or self.app)(scope, receive, with_headers)

    def _refusal(self, request: Request) -> Response | None:
        host = request.headers.get("host", "")
        ours = _local_name(host) or (self.public is not None and _name(host) == self.public)
        if self.token is None and not ours:
            return _error("this server answers on localhost only", 403)
        # A browser says where a request comes from. Other sites may link to the page, no more:
        # neither frame it nor make it work.
        site = request.headers.get("sec-fetch-site", "same-origin")
        if site not in ("same-origin", "none") and not (
            request.method == "GET"
            and request.url.path == "/"
            and request.headers.get("sec-fetch-mode") == "navigate"
            and request.headers.get("sec-fetch-dest") == "document"
        ):
            return _error("requests from other sites are refused", 403)
        # Older browsers do not say so, but whose page sends what changes something.
        origin = request.headers.get("origin")
        own = origin is None or origin.split("://")[-1] == request.headers.get("host", "")
        if request.method not in ("GET", "HEAD") and not own:
            return _error("requests from other sites are refused", 403)
        if self.token is None:
            return None
        given = request.query_params.get("token")
        if given is not None and _equal(given, self.token):
            return self._with_cookie(request) if request.url.path == "/" else None
        if _equal(request.cookies.get(self.cookie, ""), self.token):
            return None
        return _error("this server requires a token: open the address that it printed", 401)

    def _with_cookie(self, request: Request) -> Response:
        rest = [(k, v) for k, v in parse_qsl(request.url.query, True) if k != "token"]
        target = "/" + (f"?{urlencode(rest)}" if rest else "")
        answer = RedirectResponse(target, 303)
        answer.set_cookie(self.cookie, str(self.token), httponly=True, samesite="strict")
        return answer


def _local_name(host: str) -> bool:
    return is_loopback(_name(host))


def _name(host: str) -> str:
    return host.rsplit(":", 1)[0] if not host.endswith("]") else host


def _equal(a: str, b: str) -> bool:
    return secrets.compare_digest(a.encode(), b.encode())


def _error(text: str, status: int) -> Response:
    return JSONResponse({"error": text}, status)


def plain_header(text: Any, limit: int = 200) -> str:
    """A text as the value of a header: printable ASCII on one line."""
    line = " ".join(str(text).split())[:limit]
    return "".join(c if " " <= c <= "~" else "?" for c in line)
