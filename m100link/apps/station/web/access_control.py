"""Access control: the token and its substitutes, and the gate before every application."""

from __future__ import annotations

import base64
import hashlib
import hmac
import html
import ipaddress
import logging
import secrets
import time
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, unquote_plus, urlsplit

from m100link.apps.agent.background import SparingLogger

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

COOKIE = "m100link_token"
"""The cookie that stands for the token in a browser; under TLS it begins with ``__Host-``."""

CODE_LIFETIME = 600.0  # seconds in which a code has to be used

_MAX_CODES = 16


class Access:
    """The secrets that clients may show to get in.

    A program shows the token. A browser is sent to an address with a *code* instead: addresses
    stand in histories, and on command lines that everybody on the machine can read. A code works
    once; what the browser keeps then is a cookie from which the token cannot be found.

    ``clock``: seconds of a clock that never goes back.
    """

    def __init__(self, token: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._token, self._clock = token, clock
        self._codes: dict[str, float] = {}

    @property
    def cookie(self) -> str:
        """Value of the cookie. Every port of the station knows it: cookies do not tell ports."""
        return hmac.new(self._token.encode(), b"m100link cookie", hashlib.sha256).hexdigest()

    def cookie_name(self, *, is_secure: bool) -> str:
        """Its name; one that begins with ``__Host-`` cannot be set by other names of a domain."""
        return f"__Host-{COOKIE}" if is_secure else COOKIE

    def set_cookie(self, *, is_secure: bool) -> str:
        more = "; Secure" if is_secure else ""
        name = self.cookie_name(is_secure=is_secure)
        return f"{name}={self.cookie}; HttpOnly; SameSite=Strict; Path=/{more}"

    def is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self._token.encode())

    def has_cookie(self, header: str, *, is_secure: bool) -> bool:
        """Whether a ``Cookie`` header has the right one, whatever stands beside it."""
        wanted = self.cookie_name(is_secure=is_secure)
        pairs = (part.partition("=") for part in header.split(";"))
        values = [value.strip() for name, _, value in pairs if name.strip() == wanted]
        return any(secrets.compare_digest(one.encode(), self.cookie.encode()) for one in values)

    def new_code(self) -> str:
        """A code that works once, within :data:`CODE_LIFETIME`."""
        while len(self._codes) >= _MAX_CODES:
            del self._codes[next(iter(self._codes))]
        code = secrets.token_urlsafe(16)
        self._codes[code] = self._clock() + CODE_LIFETIME
        return code

    def redeem(self, code: str) -> bool:
        """Use a code up; False if there is no such code in force."""
        ends_at = self._codes.pop(code, None)
        return ends_at is not None and self._clock() < ends_at


# -- who may reach the station at all --------------------------------------------------------------
# Web pages can open WebSockets to any address, this one included, and a name in somebody else's DNS
# can point here. So a page opened elsewhere must not get through: the ``Host`` has to be a name of
# this station, and an ``Origin``, which browsers always send and programs do not, has to be a page
# that the station itself served or one that was allowed by name. Where
# a browser says whence and what for it asks (``Sec-Fetch-*``), a page from elsewhere gets nothing:
# not in a frame, not as an image or script. Where it opens an address, a page without scripts asks
# the person in front of it first. Beyond the own machine a token is needed as well.

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


class AccessControl:
    """Lets requests through to an ASGI application, or answers them itself."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        # Names that this station goes by, besides those of the loopback interface.
        hosts: Iterable[str] = (),
        # Pages that may connect, such as ``http://127.0.0.1:8000``; ``null`` is a page opened from
        # a file, and any sandboxed frame of any page.
        origins: Iterable[str] = (),
        # Ports on which this station serves pages: a page of one may connect to another.
        own_ports: Iterable[int] = (),
        # When set, nothing works without the token or what stands for it.
        access: Access | None = None,
    ) -> None:
        self._app = app
        self._hosts = {*_LOOPBACK, *(host.lower() for host in hosts)}
        self._origins = {origin.rstrip("/").lower() for origin in origins}
        self._own_ports = frozenset(map(str, own_ports))
        self.access = access
        self.refused = 0  # requests turned away
        self._log = SparingLogger(logging.getLogger(__name__))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
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
            return "this station does not have that name (Host); see --allow-host"
        origins = headers.get("origin", [])
        if len(origins) > 1 or (origins and not self._is_welcome(origins[0], hosts[0], scope)):
            return "pages of other sites may not connect (Origin); see --allow-origin"
        if not origins and _is_fetched_elsewhere(scope, headers):
            return "another page can open this one, but not embed or request it (Sec-Fetch)"
        return None

    def _is_welcome(self, origin: str, host: str, scope: Scope) -> bool:
        origin = origin.lower()
        scheme = "https" if _is_secure(scope) else "http"
        if origin in self._origins or origin == f"{scheme}://{host.lower()}":
            return True
        begin, _, rest = origin.partition("://")
        name, _, port = rest.rpartition(":")
        is_ours = begin == scheme and host_of(rest) == name and name in self._hosts
        return is_ours and port in self._own_ports


def _headers(scope: Scope) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return headers


def _header(headers: dict[str, list[str]], name: str) -> str:
    return ",".join(headers.get(name, []))


def _comes_from_elsewhere(headers: dict[str, list[str]]) -> bool:
    """Whether a page of another origin asks, and not for itself; programs do not say it."""
    site = _header(headers, "sec-fetch-site")
    is_complete = "sec-fetch-site" in headers and "origin" not in headers
    return is_complete and site not in ("same-origin", "none")


def _is_fetched_elsewhere(scope: Scope, headers: dict[str, list[str]]) -> bool:
    """Whether a page of another origin asks for more than to be opened, or any for a frame."""
    dest = _header(headers, "sec-fetch-dest")
    if dest in _FRAMES:
        return True
    # Of a page that is opened through the console's own worker a browser says "empty"; "navigate"
    # is what no script can ask for.
    mode = _header(headers, "sec-fetch-mode")
    is_opened = mode == "navigate" and dest in ("document", "empty")
    is_opened = is_opened and scope.get("method") == "GET"
    is_ahead = "prefetch" in _header(headers, "sec-purpose")
    return _comes_from_elsewhere(headers) and (not is_opened or is_ahead)


def _is_secure(scope: Scope) -> bool:
    return scope["scheme"] in ("https", "wss")


def _query(scope: Scope) -> dict[str, list[str]]:
    """Fields of the query. Raises ``ValueError``: there are too many."""
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
    headers = {
        "content-type": "text/html; charset=utf-8",
        "content-security-policy": _QUESTION_POLICY,
        "vary": "sec-fetch-site",
    }
    await answer(send, 200, headers, _QUESTION.replace("{}", html.escape(address)))


async def _send_on(scope: Scope, send: Send, access: Access) -> None:
    """To the same page by an address without secrets: the cookie stands for them from now on."""
    path = _path(scope)
    fields = scope["query_string"].decode("latin-1").split("&")
    rest = "&".join(one for one in fields if unquote_plus(one.partition("=")[0]) not in _SECRETS)
    location = f"{path}?{rest}" if rest else path
    cookie = access.set_cookie(is_secure=_is_secure(scope))
    await answer(send, 303, {"location": location, "set-cookie": cookie})


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str) -> None:
    """403; a WebSocket is refused before it is accepted."""
    if scope["type"] == "websocket":
        await receive()  # websocket.connect
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = {"content-type": "text/plain; charset=utf-8"}
    headers["connection"] = "close"  # nothing more of it is read
    await answer(send, 403, headers, f"{why}\n")


async def answer(send: Send, status: int, headers: Mapping[str, str], text: str = "") -> None:
    """A whole answer, which no browser keeps."""
    body = text.encode()
    fields = {**headers, "cache-control": "no-store", "content-length": str(len(body))}
    raw = [(name.encode(), value.encode("latin-1")) for name, value in fields.items()]
    await send({"type": "http.response.start", "status": status, "headers": raw})
    await send({"type": "http.response.body", "body": body})
