"""What may run in a page of the console."""

from __future__ import annotations

import base64
import hashlib
from typing import Any

import pytest

pytest.importorskip("starlette")
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse

from m100link.apps.station.console.app import Policy

pytestmark = pytest.mark.anyio

HOST = "127.0.0.1:8080"


async def rules_of(response: Response, *videos: str) -> tuple[dict[str, list[str]], bytes]:
    """The policy of an answer, by its directives, and the answer's body."""
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    scope: dict[str, Any] = {"type": "http", "method": "GET", "path": "/", "query_string": b""}
    scope |= {"headers": [(b"host", HOST.encode())], "asgi": {"spec_version": "2.4"}}
    await Policy(response, videos)(scope, receive, send)
    told = dict(sent[0]["headers"]).get(b"content-security-policy", b"").decode()
    pairs = (part.split() for part in told.split(";") if part.strip())
    body = b"".join(message.get("body", b"") for message in sent[1:])
    return {name: values for name, *values in pairs}, body


def hash_of(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


async def test_scripts_of_the_page_as_it_was_sent_run_and_no_others() -> None:
    page = (
        '<script type="importmap">{"a": 1}</script><SCRIPT>one()\n</SCRIPT>'
        '<script defer src="/x.js"></script><script type="module">import "/y.js"</script>'
    )
    rules, body = await rules_of(HTMLResponse(page))
    assert rules["script-src"] == [
        "'self'",
        "'unsafe-eval'",
        *map(hash_of, ('{"a": 1}', "one()\n", 'import "/y.js"')),
    ]
    assert rules["connect-src"] == ["'self'", f"ws://{HOST}", f"wss://{HOST}"]
    for name in ("base-uri", "form-action", "frame-src", "object-src", "frame-ancestors"):
        assert rules[name] == ["'none'"]
    assert body.decode() == page


async def test_a_page_reaches_the_origins_of_videos_for_pictures_and_connections_alone() -> None:
    camera = "http://camera.test:8889"
    plain, _ = await rules_of(HTMLResponse("<p>"))
    rules, _ = await rules_of(HTMLResponse("<p>"), camera)
    for name in ("img-src", "connect-src"):
        assert rules.pop(name) == [*plain.pop(name), camera]
    assert rules == plain


async def test_a_page_in_pieces_is_judged_as_a_whole() -> None:
    async def pieces() -> Any:
        for piece in ("<scr", "ipt>tw", "o()</scri", "pt>"):
            yield piece

    rules, body = await rules_of(StreamingResponse(pieces(), media_type="text/html"))
    assert hash_of("two()") in rules["script-src"]
    assert body == b"<script>two()</script>"


async def test_what_is_no_page_passes_as_it_is() -> None:
    rules, body = await rules_of(PlainTextResponse("<script>x</script>"))
    assert rules == {}
    assert body == b"<script>x</script>"
