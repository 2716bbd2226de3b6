"""So much at once, so much per second."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from m100link.apps.station.web.limits import ConnectionLimit, PageRateLimit, to_evict

# -- connections that ask nothing do not keep those out that ask -----------------------------------


@dataclass(eq=False)
class Visitor:
    peer: str = "a"
    is_answered: bool = True
    is_out: bool = field(default=False)

    def turn_out(self) -> None:
        self.is_out = True


def enter(door: ConnectionLimit, *visitors: Visitor) -> None:
    for one in visitors:
        door.enter(one)


def test_the_longest_idle_of_a_peer_goes_for_its_newcomer() -> None:
    door = ConnectionLimit(per_peer=3)
    old = [Visitor(), Visitor(is_answered=False), Visitor(), Visitor("b")]
    enter(door, *old)
    new = Visitor()
    enter(door, new)
    assert [one.is_out for one in (*old, new)] == [True, False, False, False, False]
    door.answered(old[2])
    enter(door, Visitor())
    assert new.is_out  # it came later, but the other one asked something since
    assert not old[2].is_out


def test_a_newcomer_is_turned_out_where_all_are_busy() -> None:
    door = ConnectionLimit(per_peer=2)
    enter(door, Visitor(is_answered=False), Visitor(is_answered=False))
    new = Visitor()
    enter(door, new)
    assert new.is_out
    assert len(door) == 2


def test_beyond_the_total_the_peer_with_the_most_loses_one() -> None:
    door = ConnectionLimit(per_peer=10, total=5)
    many, few = [Visitor("a") for _ in range(4)], Visitor("b")
    enter(door, *many, few, Visitor("c"))
    assert [one.is_out for one in many] == [True, False, False, False]
    assert not few.is_out
    assert len(door) == 5


def test_a_client_that_left_does_not_count() -> None:
    door = ConnectionLimit(per_peer=1)
    for _ in range(10):
        one = Visitor()
        enter(door, one)
        door.leave(one)
        door.leave(one)  # twice is once
        assert not one.is_out
    assert len(door) == 0


# -- whose place a newcomer gets -------------------------------------------------------------------


@dataclass(eq=False)
class Guest:
    heard_at: float
    peer: str = "a"
    has_spoken: bool = True
    subscribes: bool = False


def test_one_address_has_32_places_and_all_have_128() -> None:
    door = ConnectionLimit()
    enter(door, *(Visitor("a") for _ in range(33)))
    assert len(door) == 32
    enter(door, *(Visitor(str(number)) for number in range(200)))
    assert len(door) == 128


@pytest.mark.parametrize(
    ("guest", "is_due"),
    [
        (Guest(99.51, has_spoken=False), False),
        (Guest(99.5, has_spoken=False), True),  # half a second
        (Guest(90.1), False),
        (Guest(90.0), True),  # ten seconds
    ],
)
def test_when_a_place_is_due(guest: Guest, is_due: bool) -> None:
    assert to_evict([guest], "a", 100.0) is (guest if is_due else None)


def test_nobody_goes_while_all_talk() -> None:
    assert to_evict([], "a", 100.0) is None
    assert to_evict([Guest(95.0), Guest(99.0), Guest(99.9, has_spoken=False)], "a", 100) is None


def test_first_who_never_said_anything() -> None:
    mute = Guest(99.0, has_spoken=False)
    guests = [Guest(0.0), Guest(99.4, has_spoken=False), mute]
    assert to_evict(guests, "a", 100.0) is mute


def test_then_one_of_the_address_with_the_most() -> None:
    longest = Guest(98.0, subscribes=True)
    guests = [Guest(99.0), longest, Guest(99.5), Guest(10.0, peer="b")]
    assert to_evict(guests, "c", 100.0) is longest
    assert to_evict(guests, "b", 100.0) is longest
    assert to_evict(guests[:2] + guests[3:], "b", 100.0) is guests[3]  # as many as that


def test_then_who_was_silent_for_long_and_gets_nothing() -> None:
    guests = [Guest(10.0, subscribes=True), Guest(89.0), Guest(88.0), Guest(91.0)]
    assert to_evict(guests, "a", 100.0) is guests[2]
    assert to_evict(guests[:1], "a", 100.0) is guests[0]


# -- dear answers come one at a time ---------------------------------------------------------------

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


async def ask(turnstile: PageRateLimit, path: str = "/", kind: str = "http") -> int:
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
    turnstile = PageRateLimit(pages, "/")
    assert await asyncio.gather(*(ask(turnstile) for _ in range(4))) == [200] * 4
    ends = [end for _, end in pages.times]
    begins = [begin for begin, _ in pages.times[1:]]
    for end, begin in zip(ends, begins, strict=False):
        assert begin - end == pytest.approx(0.3)


async def test_a_pause_has_an_end() -> None:
    pages = Pages(takes=5.0)
    turnstile = PageRateLimit(pages, "/")
    await asyncio.gather(ask(turnstile), ask(turnstile))
    (_, end), (begin, _) = pages.times
    assert begin - end == pytest.approx(1.0)


async def test_what_costs_little_does_not_wait() -> None:
    pages = Pages(takes=0.1)
    turnstile = PageRateLimit(pages, "/")
    await asyncio.gather(*(ask(turnstile, "/script.js") for _ in range(50)))
    await asyncio.gather(*(ask(turnstile, "/", "websocket") for _ in range(50)))
    begins = {begin for begin, _ in pages.times}
    assert len(begins) == 2


async def test_a_client_that_comes_while_too_many_wait_is_asked_to_come_again() -> None:
    turnstile = PageRateLimit(Pages(), "/")
    statuses = await asyncio.gather(*(ask(turnstile) for _ in range(13)))
    assert sorted(statuses) == [200] * 9 + [503] * 4, "one is built, and eight wait"
    assert await ask(turnstile) == 200
    waiting = [asyncio.create_task(ask(turnstile)) for _ in range(9)]
    await asyncio.sleep(0)
    sent: list[Any] = []

    async def send(message: Message) -> None:
        sent.append(message)

    await turnstile({"type": "http", "path": "/"}, None, send)  # type: ignore[arg-type]  # unread
    headers = dict(sent[0]["headers"])
    assert headers[b"retry-after"] == b"1"
    assert headers[b"content-type"] == b"text/html; charset=utf-8"
    assert b'http-equiv="refresh" content="1"' in sent[1]["body"]
    for task in waiting:
        task.cancel()
    await asyncio.gather(*waiting, return_exceptions=True)


async def test_a_client_that_reads_slowly_keeps_nobody_waiting() -> None:
    pages = Pages(takes=0.1, reads=30.0)
    turnstile = PageRateLimit(pages, "/")
    await asyncio.gather(ask(turnstile), ask(turnstile))
    (_, end), (begin, _) = pages.times
    assert begin - end == pytest.approx(0.3)


@pytest.mark.parametrize("after", [0.05, 0.15, 0.45])
async def test_a_client_that_leaves_leaves_the_turn_to_the_next(after: float) -> None:
    turnstile = PageRateLimit(Pages(takes=0.1), "/")
    first: asyncio.Task[Any] = asyncio.create_task(ask(turnstile))
    second: asyncio.Task[Any] = asyncio.create_task(ask(turnstile))
    await asyncio.sleep(after)
    for task in (first, second):
        task.cancel()
    await asyncio.gather(first, second, return_exceptions=True)
    async with asyncio.timeout(2):
        assert await ask(turnstile) == 200


async def test_a_page_that_fails_leaves_the_turn_to_the_next() -> None:
    turnstile = PageRateLimit(Pages(), "/broken")
    for _ in range(2):
        with pytest.raises(RuntimeError):
            await ask(turnstile, "/broken")
