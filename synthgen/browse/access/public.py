"""A page for everybody, behind a proxy: nothing is written, clients take turns, no path is shown.

Each client has a purse that fills again; a request costs what it takes the server, and one that a
purse cannot pay is answered 429 with the seconds to wait. The proxy says who a client is
(X-Forwarded-For, which uvicorn heeds from this machine alone); of IPv6, a client is its /64.
"""

from __future__ import annotations

import ipaddress
import math
import re
import time
from collections import OrderedDict
from collections.abc import Callable

from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

PURSE = 1500.0
"""What a client may spend at once."""
INCOME = 100.0
"""What comes back in a second."""
COSTS = {
    "/assets/": 0.0,
    "/thumbnail/": 1.0,
    "/api/": 5.0,
    "/pass/": 5.0,
    "/member/": 10.0,
    "/values/": 10.0,
    "/subject/": 100.0,
    "/lightmaps/": 100.0,
    "/rows": 500.0,
}
"""By the beginning of a path; others cost 1."""
HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")
"""A name under which the proxy is reached."""
_CLIENTS = 20_000


class TakingTurns:
    """Passes GET and HEAD to `app` from clients that can pay; answers the others itself."""

    def __init__(self, app: ASGIApp, clock: Callable[[], float] = time.monotonic) -> None:
        self.app, self.clock = app, clock
        self._purses: OrderedDict[str, tuple[float, float]] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        answer = None
        if request.method not in ("GET", "HEAD"):
            answer = JSONResponse({"error": "this server is read-only"}, 403)
        elif wait := self._pay(_client(request), cost(request.url.path)):
            answer = JSONResponse(
                {"error": f"too many requests; try again in {wait} s"},
                429,
                headers={"Retry-After": str(wait)},
            )
        await (answer or self.app)(scope, receive, send)

    def _pay(self, client: str, price: float) -> int:
        """Take the price out of a client's purse: 0, or for how many seconds it must wait."""
        now = self.clock()
        left, before = self._purses.pop(client, (PURSE, now))
        left = min(PURSE, left + (now - before) * INCOME)
        paid = left >= price
        self._purses[client] = (left - price if paid else left, now)
        while len(self._purses) > _CLIENTS:  # the least recently seen is a new client again
            self._purses.popitem(last=False)
        return 0 if paid else max(1, math.ceil((price - left) / INCOME))


def cost(path: str) -> float:
    """What a request of a path costs."""
    return next((price for start, price in COSTS.items() if path.startswith(start)), 1.0)


def _client(request: Request) -> str:
    name = request.client.host if request.client else ""
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return name
    if address.version == 6:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return name
