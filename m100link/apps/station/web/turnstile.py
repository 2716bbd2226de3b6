"""Dear answers one at a time, with a pause after each: whoever flies is served in between.

Building a page holds up the event loop, and with it the keys of whoever flies. One page costs a few
lost key repeats, which the lifetime of a setpoint bridges; one after the other they would cost the
flight. So each is followed by a pause that is some times as long as it took, however fast the
machine is. Who comes while too many wait is told to come again.
"""

from __future__ import annotations

import asyncio

from m100link.apps.station.web.gate import App, Message, Receive, Scope, Send

__all__ = ["PAUSE", "PLACES", "Turnstile"]

PAUSE = 3.0
"""Length of the pause after an answer, in times that it took."""

LONGEST_PAUSE = 1.0
"""Seconds that a pause lasts at most."""

PLACES = 8
"""How many may wait."""

_BUSY = (
    b'<!doctype html><meta http-equiv="refresh" content="1"><title>m100link</title>'
    b"<p>Many ask for this page at once. It is asked for again by itself.</p>"
)


class Turnstile:
    """Lets requests for one path through to an ASGI application one at a time.

    Args:
        app: The application.
        path: What is dear; everything else passes at once.

    Attributes:
        turned_away: Requests that were told to come again.
    """

    def __init__(self, app: App, path: str) -> None:
        self._app = app
        self._path = path
        self._waiting = 0
        self._turn = asyncio.Lock()
        self._opens_at = 0.0
        self.turned_away = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Wait for a turn, if this needs one."""
        if scope["type"] != "http" or scope["path"] != self._path:
            await self._app(scope, receive, send)
        elif self._waiting >= PLACES:
            self.turned_away += 1
            await _send_away(send)
        else:
            await self._take_turn(scope, receive, send)

    async def _take_turn(self, scope: Scope, receive: Receive, send: Send) -> None:
        clock = asyncio.get_running_loop().time
        self._waiting += 1
        try:
            await self._turn.acquire()
        finally:
            self._waiting -= 1
        try:
            await asyncio.sleep(max(0.0, self._opens_at - clock()))
        except BaseException:
            self._turn.release()
            raise
        began, is_over = clock(), False

        def end() -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                now = clock()
                self._opens_at = now + min(PAUSE * (now - began), LONGEST_PAUSE)
                self._turn.release()

        async def send_built(message: Message) -> None:
            end()  # how fast its client reads is no matter of the others
            await send(message)

        try:
            await self._app(scope, receive, send_built)
        finally:
            end()


async def _send_away(send: Send) -> None:
    headers = [
        (b"content-type", b"text/html; charset=utf-8"),
        (b"retry-after", b"1"),
        (b"content-length", str(len(_BUSY)).encode()),
    ]
    await send({"type": "http.response.start", "status": 503, "headers": headers})
    await send({"type": "http.response.body", "body": _BUSY})
