"""Who may reach the station at all: checked before a socket is accepted or a page is sent.

Web pages can open WebSockets to any address, this one included, and a name in somebody else's DNS
can point here. So a page opened elsewhere must not get through: the ``Host`` has to be a name of
this station, and an ``Origin``, which browsers always send and programs do not, has to be a page
that the station itself served or one that was allowed by name. Where
a browser says whence and what for it asks (``Sec-Fetch-*``), a page from elsewhere gets nothing:
not in a frame, not as an image or script. Where it opens an address, a page without scripts asks
the person in front of it first. Beyond the own machine a token is needed as well.
"""

from __future__ import annotations

import base64
import hashlib
import html
import ipaddress
import logging
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any
from urllib.parse import parse_qs, unquote_plus, urlsplit

from m100link.apps.station.web.access import Access
from m100link.apps.station.web.logs import SparingLogger

__all__ = ["Gate", "host_of", "is_loopback"]

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

_MAX_FIELDS = 20
_SECRETS = frozenset(("token", "code"))
_FRAMES = ("iframe", "frame", "embed", "object", "fencedframe")
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")

_LOOKS = (
    ":root{color-scheme:dark light}body{font:1.1rem/1.5 system-ui,sans-serif;max-width:34rem;"
    "margin:15vh auto;padding:0 1.5rem}a{display:inline-block;padding:.75rem 0}"
)
# Nothing here has an id, takes the focus or runs: only a press on the link goes on.
_QUESTION = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>m100link: open the station?</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_LOOKS}</style></head>
<body><h1>Open this ground station?</h1>
<p>Another page opened this address. It belongs to a ground station, which can fly an aircraft.
Go on only if you wanted to come here.</p>
<p lang="de">Eine andere Seite hat diese Adresse geöffnet. Sie gehört zu einer Bodenstation, die ein
Fluggerät fliegen kann. Nur weitergehen, wenn das gewollt war.</p>
<p><a href="{{}}">Open the station · <span lang="de">Bodenstation öffnen</span></a></p></body>
</html>
"""
_QUESTION_POLICY = (
    "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    f"style-src 'sha256-{base64.b64encode(hashlib.sha256(_LOOKS.encode()).digest()).decode()}'"
)


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
        access: When set, nothing works without the token or what stands for it.

    Attributes:
        access: As given.
        refused: Requests turned away.
    """

    def __init__(
        self,
        app: App,
        *,
        hosts: Iterable[str] = (),
        origins: Iterable[str] = (),
        access: Access | None = None,
    ) -> None:
        self._app = app
        self._hosts = {*_LOOPBACK, *(host.lower() for host in hosts)}
        self._origins = {origin.rstrip("/").lower() for origin in origins}
        self.access = access
        self.refused = 0
        self._log = SparingLogger(logging.getLogger(__name__))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request, then pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        why = self._objection(scope, headers)
        if why is None and _comes_from_elsewhere(headers):
            await _ask_first(scope, send)
            return
        if why is None and self.access is not None:
            why = _objection_to_secret(self.access, scope, headers)
        if why is not None:
            self.refused += 1
            self._log.warning("refused %s: %s", scope.get("client"), why)
            await _refuse(scope, receive, send, why)
            return
        if self.access is not None and scope.get("method") == "GET" and _has_secret(scope):
            await _send_on(scope, send, self.access)
            return
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
        return None

    def _is_welcome(self, origin: str, host: str, scope: Scope) -> bool:
        origin = origin.lower()
        if origin in self._origins:
            return True
        secure = scope["scheme"] in ("https", "wss")
        return origin == f"{'https' if secure else 'http'}://{host.lower()}"


def _headers(scope: Scope) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return headers


def _told(headers: dict[str, list[str]], name: str) -> str:
    return ",".join(headers.get(name, []))


def _comes_from_elsewhere(headers: dict[str, list[str]]) -> bool:
    """Whether a page of another origin asks, and not for itself; programs do not say it."""
    site = _told(headers, "sec-fetch-site")
    is_told = "sec-fetch-site" in headers and "origin" not in headers
    return is_told and site not in ("same-origin", "none")


def _is_fetched_elsewhere(scope: Scope, headers: dict[str, list[str]]) -> bool:
    """Whether a page of another origin asks for more than to be opened, or any for a frame."""
    dest = _told(headers, "sec-fetch-dest")
    if dest in _FRAMES:
        return True
    # Of a page that is opened through the console's own worker a browser says "empty"; "navigate"
    # is what no script can ask for.
    mode = _told(headers, "sec-fetch-mode")
    is_opened = mode == "navigate" and dest in ("document", "empty")
    is_opened = is_opened and scope.get("method") == "GET"
    is_ahead = "prefetch" in _told(headers, "sec-purpose")
    return _comes_from_elsewhere(headers) and (not is_opened or is_ahead)


def _is_secure(scope: Scope) -> bool:
    return scope["scheme"] in ("https", "wss")


def _query(scope: Scope) -> dict[str, list[str]]:
    """Fields of the query.

    Raises:
        ValueError: There are too many.
    """
    text = scope.get("query_string", b"").decode("latin-1")
    return parse_qs(text, max_num_fields=_MAX_FIELDS)


def _has_secret(scope: Scope) -> bool:
    return not _query(scope).keys().isdisjoint(_SECRETS)


def _objection_to_secret(access: Access, scope: Scope, headers: dict[str, list[str]]) -> str | None:
    try:
        query = _query(scope)
    except ValueError:
        return f"an address has at most {_MAX_FIELDS} query fields"
    if "token" in query and access.is_token(query["token"][0]):
        return None
    for header in headers.get("authorization", []):
        kind, _, value = header.partition(" ")
        if kind.lower() == "bearer" and access.is_token(value.strip()):
            return None
    secure = _is_secure(scope)
    if any(access.has_cookie(header, is_secure=secure) for header in headers.get("cookie", [])):
        return None
    # A code is used up by a page that a person opens, not by what looks at it ahead.
    is_opened = scope.get("method") == "GET" and "sec-purpose" not in headers
    if "code" in query and is_opened:
        if access.redeem(query["code"][0]):
            return None
        return "this address was used already, or is too old: open the station with ?token=…"
    return "a token is needed: ?token=…, a Bearer header or the cookie"


def _path(scope: Scope) -> str:
    # Two slashes, or a slash and a backslash, would begin the name of another host.
    return "/" + str(scope.get("raw_path", b"/").decode("latin-1")).lstrip("/\\")


async def _ask_first(scope: Scope, send: Send) -> None:
    """A page with a link to what was asked for: opened by it, the station's own page asks."""
    query = scope.get("query_string", b"").decode("latin-1")
    address = f"{_path(scope)}?{query}" if query else _path(scope)
    headers = [
        (b"content-type", b"text/html; charset=utf-8"),
        (b"content-security-policy", _QUESTION_POLICY.encode("ascii")),
        (b"cache-control", b"no-store"),
        (b"vary", b"sec-fetch-site"),
    ]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    body = _QUESTION.replace("{}", html.escape(address))
    await send({"type": "http.response.body", "body": body.encode()})


async def _send_on(scope: Scope, send: Send, access: Access) -> None:
    """To the same page by an address without secrets: the cookie stands for them from now on."""
    path = _path(scope)
    fields = scope["query_string"].decode("latin-1").split("&")
    rest = "&".join(one for one in fields if unquote_plus(one.partition("=")[0]) not in _SECRETS)
    location = f"{path}?{rest}" if rest else path
    headers = [
        (b"location", location.encode("latin-1")),
        (b"set-cookie", access.set_cookie(is_secure=_is_secure(scope)).encode("ascii")),
        (b"cache-control", b"no-store"),
        (b"content-length", b"0"),
    ]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str) -> None:
    """403; a WebSocket is refused before it is accepted."""
    if scope["type"] == "websocket":
        await receive()  # websocket.connect
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"cache-control", b"no-store"),
        (b"connection", b"close"),  # nothing more of it is read
    ]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": f"{why}\n".encode()})
