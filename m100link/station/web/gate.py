"""Who may reach the station at all: checked before a socket is accepted or a page is sent.

Web pages can open WebSockets to any address, this one included, and a name in somebody else's DNS
can point here. So a page opened elsewhere must not get through: the ``Host`` has to be a name of
this station, and an ``Origin``, which browsers always send and programs do not, has to be a page
that the station itself served or one that was allowed by name. Where
a browser says whence and what for it asks (``Sec-Fetch-*``), nothing comes from elsewhere but a
page that is opened for itself: not in a frame, not as an image or script. Beyond the own machine a
token is needed as well.
"""

from __future__ import annotations

import ipaddress
import logging
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from m100link.station.web.logs import SparingLogger

__all__ = ["COOKIE", "Gate", "host_of", "is_loopback"]

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "m100link_token"
"""The cookie that keeps a browser's token, so that it leaves the address bar."""

_FRAMES = ("iframe", "frame", "embed", "object", "fencedframe")
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def is_loopback(host: str) -> bool:
    """Whether an address to bind reaches this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"  # any other name may mean anything


def host_of(header: str) -> str:
    """Host name of a ``Host`` header, without the port; empty if it cannot be one."""
    try:
        parts = urlsplit(f"//{header}")
        _ = parts.port
    except ValueError:
        return ""
    if parts.path or parts.query or parts.fragment or "@" in header or "\\" in header:
        return ""
    name = (parts.hostname or "").lower()
    return f"[{name}]" if ":" in name else name


class Gate:
    """Lets requests through to an ASGI application, or answers them itself.

    Args:
        app: The application.
        hosts: Names that this station goes by, besides those of the loopback interface.
        origins: Pages that may connect, such as ``http://127.0.0.1:8000``; ``null`` is a page
            opened from a file, and any sandboxed frame of any page.
        token: When set, nothing works without it.

    Attributes:
        refused: Requests turned away.
    """

    def __init__(
        self,
        app: App,
        *,
        hosts: Iterable[str] = (),
        origins: Iterable[str] = (),
        token: str | None = None,
    ) -> None:
        self._app = app
        self._hosts = {*_LOOPBACK, *(host.lower() for host in hosts)}
        self._origins = {origin.rstrip("/").lower() for origin in origins}
        self._token = token
        self.refused = 0
        self._log = SparingLogger(logging.getLogger("m100link.station"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request, then pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        why = self._objection(scope, headers)
        if why is not None:
            self.refused += 1
            self._log.warning("refused %s: %s", scope.get("client"), why)
            await _refuse(scope, receive, send, why)
            return
        if self._token is not None and _query_token(scope) is not None:
            send = self._with_cookie(scope, send)
        await self._app(scope, receive, send)

    def _objection(self, scope: Scope, headers: dict[str, list[str]]) -> str | None:
        hosts = headers.get("host", [])
        if len(hosts) != 1 or host_of(hosts[0]) not in self._hosts:
            return "this station does not go by that name (Host); see --allow-host"
        origins = headers.get("origin", [])
        if len(origins) > 1 or (origins and not self._is_welcome(origins[0], hosts[0], scope)):
            return "pages from elsewhere may not connect (Origin); see --allow-origin"
        if not origins and _is_fetched_elsewhere(scope, headers):
            return "from other pages this one can only be opened for itself (Sec-Fetch)"
        if self._token is not None and not self._has_token(scope, headers):
            return "a token is needed: ?token=…, a Bearer header or the cookie"
        return None

    def _is_welcome(self, origin: str, host: str, scope: Scope) -> bool:
        origin = origin.lower()
        if origin in self._origins:
            return True
        secure = scope["scheme"] in ("https", "wss")
        return origin == f"{'https' if secure else 'http'}://{host.lower()}"

    def _has_token(self, scope: Scope, headers: dict[str, list[str]]) -> bool:
        given = [_query_token(scope)]
        for header in headers.get("authorization", []):
            kind, _, value = header.partition(" ")
            given.append(value.strip() if kind.lower() == "bearer" else None)
        for header in headers.get("cookie", []):
            given.append(_cookie_token(header))
        wanted = (self._token or "").encode()
        return any(secrets.compare_digest(one.encode(), wanted) for one in given if one is not None)

    def _with_cookie(self, scope: Scope, send: Send) -> Send:
        secure = "; Secure" if scope["scheme"] in ("https", "wss") else ""
        cookie = f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/{secure}"

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = [*message.get("headers", []), (b"set-cookie", cookie.encode("ascii"))]
                message = {**message, "headers": headers}
            await send(message)

        return sending


def _headers(scope: Scope) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return headers


def _is_fetched_elsewhere(scope: Scope, headers: dict[str, list[str]]) -> bool:
    """Whether a page of another site asks, or any page asks for a frame; programs say neither."""
    site, mode, dest, purpose = (
        ",".join(headers.get(name, []))
        for name in ("sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest", "sec-purpose")
    )
    if dest in _FRAMES:
        return True
    if "sec-fetch-site" not in headers or site in ("same-origin", "none"):
        return False
    is_opened = (mode, dest, scope.get("method")) == ("navigate", "document", "GET")
    return not is_opened or "prefetch" in purpose


def _query_token(scope: Scope) -> str | None:
    query = parse_qs(scope.get("query_string", b"").decode("latin-1"), max_num_fields=20)
    return query["token"][0] if "token" in query else None


def _cookie_token(header: str) -> str | None:
    try:
        cookies: SimpleCookie = SimpleCookie(header)
    except CookieError:
        return None
    return cookies[COOKIE].value if COOKIE in cookies else None


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str) -> None:
    """403; a WebSocket is refused before it is accepted."""
    if scope["type"] == "websocket":
        await receive()  # websocket.connect
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": f"{why}\n".encode()})
