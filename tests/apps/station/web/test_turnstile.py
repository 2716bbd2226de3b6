"""Dear answers come one at a time, and in between there is time for others."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from m100link.apps.station.web.gate import Message, Receive, Scope, Send
from m100link.apps.station.web.turnstile import PLACES, Turnstile

pytestmark = pytest.mark.anyio


class Pages:
    """An application that takes its time, and notes when it did."""

    def __init__(self, takes: float = 0.1, reads: float = 0.0) -> None:
        self.takes, self.reads = takes, reads
        self.times: list[tuple[float, float]] = []

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()
        await asyncio.sleep(self.takes)
        self.times.append((began, loop.time()))
        if scope["path"] == "/broken":
            raise RuntimeError("a page that cannot be built")
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await asyncio.sleep(self.reads)
        await send({"type": "http.response.body", "body": b""})


async def ask(turnstile: Turnstile, path: str = "/", kind: str = "http") -> int:
    """The status of an answer."""
    answers: list[Message] = []

    async def send(message: Message) -> None:
        answers.append(message)

    async def receive() -> Message:
        return {}

    await turnstile({"type": kind, "path": path}, receive, send)
    return int(answers[0]["status"])


async def test_each_page_is_followed_by_a_pause_as_long_as_it_deserves() -> None:
    pages = Pages(takes=0.1)
    turnstile = Turnstile(pages, "/")
    assert await asyncio.gather(*(ask(turnstile) for _ in range(4))) == [200] * 4
    ends = [end for _, end in pages.times]
    begins = [begin for begin, _ in pages.times[1:]]
    for end, begin in zip(ends, begins, strict=False):
        assert begin - end == pytest.approx(0.3), "three times as long as it took"


async def test_a_pause_has_an_end() -> None:
    pages = Pages(takes=5.0)
    turnstile = Turnstile(pages, "/")
    await asyncio.gather(ask(turnstile), ask(turnstile))
    (_, end), (begin, _) = pages.times
    assert begin - end == pytest.approx(1.0)


async def test_what_costs_little_does_not_wait() -> None:
    pages = Pages(takes=0.1)
    turnstile = Turnstile(pages, "/")
    await asyncio.gather(*(ask(turnstile, "/script.js") for _ in range(50)))
    await asyncio.gather(*(ask(turnstile, "/", "websocket") for _ in range(50)))
    begins = {begin for begin, _ in pages.times}
    assert len(begins) == 2


async def test_who_comes_while_too_many_wait_is_told_to_come_again() -> None:
    assert PLACES == 8
    turnstile = Turnstile(Pages(), "/")
    statuses = await asyncio.gather(*(ask(turnstile) for _ in range(PLACES + 5)))
    assert sorted(statuses) == [200] * (PLACES + 1) + [503] * 4
    assert turnstile.turned_away == 4
    assert await ask(turnstile) == 200


async def test_a_client_that_reads_slowly_keeps_nobody_waiting() -> None:
    pages = Pages(takes=0.1, reads=30.0)
    turnstile = Turnstile(pages, "/")
    await asyncio.gather(ask(turnstile), ask(turnstile))
    (_, end), (begin, _) = pages.times
    assert begin - end == pytest.approx(0.3)


@pytest.mark.parametrize("after", [0.05, 0.15, 0.45])
async def test_who_leaves_leaves_the_turn_to_the_next(after: float) -> None:
    turnstile = Turnstile(Pages(takes=0.1), "/")
    first: asyncio.Task[Any] = asyncio.create_task(ask(turnstile))
    second: asyncio.Task[Any] = asyncio.create_task(ask(turnstile))
    await asyncio.sleep(after)
    for task in (first, second):
        task.cancel()
    await asyncio.gather(first, second, return_exceptions=True)
    async with asyncio.timeout(2):
        assert await ask(turnstile) == 200


async def test_a_page_that_fails_leaves_the_turn_to_the_next() -> None:
    turnstile = Turnstile(Pages(), "/broken")
    for _ in range(2):
        with pytest.raises(RuntimeError):
            await ask(turnstile, "/broken")
