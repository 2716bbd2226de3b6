"""Content Security Policy of the console's pages: a second line, should text ever become markup.

The browser runs scripts of the station's own files, and those in the page as the station sent it:
the header has the hash of each. It does not run scripts that get into a page later, such as a
handler in an attribute or a ``<script>`` in a text.

NiceGUI and Vue build functions from texts that come over the page's own socket, so
``'unsafe-eval'`` has to stay. The policy does not stop an attacker that writes into that socket.
"""

from __future__ import annotations

import base64
import hashlib
import re

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["Policy"]

_INLINE = re.compile(rb"<script\b(?![^>]*\ssrc\s*=)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)

_RULES = (
    "default-src 'self'; base-uri 'none'; form-action 'none'; frame-src 'none'; object-src 'none'; "
    "frame-ancestors 'none'; img-src 'self' data: blob:; media-src 'self' data: blob:; "
    # Looks alone: attributes of style are everywhere in it.
    "font-src 'self' data:; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self'{sockets}; script-src 'self' 'unsafe-eval'{hashes}"
)


class Policy:
    """An ASGI application whose pages carry the policy.

    Args:
        app: The application.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; keep a page until it is whole."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start: Message = {}
        body = bytearray()

        async def keep_pages(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = message
                if _is_page(message):
                    return
            elif _is_page(start):
                body.extend(message.get("body", b""))
                if message.get("more_body", False):
                    return
                headers = MutableHeaders(raw=start["headers"])
                headers["content-security-policy"] = _rules(bytes(body), Headers(scope=scope))
                await send(start)
                message = {"type": "http.response.body", "body": bytes(body)}
            await send(message)

        await self._app(scope, receive, keep_pages)


def _is_page(start: Message) -> bool:
    kind = Headers(raw=start.get("headers", [])).get("content-type", "")
    return kind.startswith("text/html")


def _rules(page: bytes, asked: Headers) -> str:
    found = (hashlib.sha256(script).digest() for script in _INLINE.findall(page))
    hashes = "".join(f" 'sha256-{base64.b64encode(one).decode()}'" for one in found)
    # Not every browser takes 'self' for a socket of the same host. The gate has checked the name.
    host = asked.get("host", "")
    return _RULES.format(sockets=f" ws://{host} wss://{host}", hashes=hashes)
