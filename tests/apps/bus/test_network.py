"""Which keys a pattern names, and what waits on its way out and in."""

from __future__ import annotations

import asyncio
from collections import Counter
from functools import partial
from typing import Any
from unittest.mock import Mock

import anyio
import pytest

from m100link.apps.bus import network
from m100link.apps.bus.network import (
    AT_ONCE,
    TURN,
    Bundle,
    Inbox,
    Outlet,
    PollingReader,
    Ring,
    ThreadQueue,
)
from m100link.sim.clock import virtual_clock_loop
from tests.apps.bus.memory import fits


@pytest.mark.parametrize(
    ("pattern", "key", "does"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/c", False),
        ("a/*/c", "a/b/c", True),
        ("a/*/c", "a/b/b/c", False),
        ("a/*", "a", False),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("**/c", "a/b/c", True),
        ("a/**/c", "a/c", True),
        ("a/**/c", "a/b/d", False),
        ("*", "a/b", False),
        ("**", "a", True),
        ("a/**/c", "a/b/b/c", True),
        ("a/**/c", "a/c/b", False),
        ("a/b", "a/b/c", False),
    ],
)
def test_words_and_stars(pattern: str, key: str, does: bool) -> None:
    assert fits(pattern, key) is does


# -- what waits on its way out goes together, none too late and none lost; and on its way in -------


pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class Sink(Outlet):
    def __init__(self) -> None:
        self.sent: list[tuple[float, bytes]] = []

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        self.sent.append((anyio.current_time(), payload))

    def is_wanted(self) -> bool:
        return True

    def close(self) -> None:
        """Nothing is held."""


async def test_messages_go_together_and_none_later_than_it_may() -> None:
    one, sink = Bundle(asyncio.get_running_loop()), Sink()
    slow, fast = (partial(one.put, within, sink.put, str.encode) for within in (0.1, 0.02))
    begin = anyio.current_time()
    slow("0")
    await anyio.sleep(0.05)
    slow("1")
    assert sink.sent == []
    await anyio.sleep(0.04)
    fast("2")
    await anyio.sleep(0.02)
    slow("3")
    fast("4")
    await anyio.sleep(0.5)
    at = [round(when - begin, 3) for when, _ in sink.sent]
    assert [payload for _, payload in sink.sent] == [b"0", b"1", b"2", b"3", b"4"]
    assert at == [0.1, 0.1, 0.1, 0.13, 0.13]


async def test_many_go_in_pieces_and_in_their_order() -> None:
    sink = Sink()
    one = Bundle(asyncio.get_running_loop())
    for number in range(1000):
        one.put(0.02, sink.put, str.encode, str(number))
    await anyio.sleep(0.1)
    assert [payload for _, payload in sink.sent] == [b"%d" % number for number in range(1000)]
    assert list(Counter(at for at, _ in sink.sent).values()) == [256, 256, 256, 232]


async def test_what_is_made_later_is_made_as_it_goes_and_harms_no_other() -> None:
    sink = Sink()
    put = partial(Bundle(asyncio.get_running_loop()).put, 0.02, sink.put)
    begin = anyio.current_time()

    def late() -> bytes:
        return b"%.3f" % (anyio.current_time() - begin)

    def wrong() -> bytes:
        raise ValueError("nothing can be made of it")

    put(late)
    put(wrong)
    put(bytes)  # of which nothing goes
    put(str.encode, "last")
    await anyio.sleep(0.1)
    assert [payload for _, payload in sink.sent] == [b"0.020", b"last"]
    Sink.put_later(sink, late)  # where nothing waits it is made at once
    assert sink.sent[-1][1] == b"0.100"


class Channel:
    def __init__(self) -> None:
        self.has: list[int] = []
        self.is_closed = False

    def try_recv(self) -> int | None:
        if self.is_closed:
            raise EOFError
        return self.has.pop(0) if self.has else None

    def close(self) -> None:
        self.is_closed = True


@pytest.mark.parametrize("cost", [0.0, TURN / 100])
async def test_a_ring_is_looked_at_until_it_is_closed(
    monkeypatch: pytest.MonkeyPatch, cost: float
) -> None:
    """A ring that was full is looked at again at once, and after a part of several turns too."""
    channel, found = Channel(), list[int]()
    await anyio.sleep(0.02 - anyio.current_time() % 0.02)  # all readers look at the same moments
    clock = 0.0
    monkeypatch.setattr(network, "perf_counter", lambda: clock)

    def take(one: int) -> None:
        nonlocal clock
        clock += cost
        if one == 3:
            raise ValueError("what one message leads to does not happen to the next one")
        found.append(one)

    ring = Ring(channel, lambda one: (one,), AT_ONCE, EOFError)
    looks = PollingReader(channel, ring, take, 0.02)
    channel.has = list(range(2 * AT_ONCE))
    await anyio.sleep(0.019)
    assert found == []  # they wait for others
    await anyio.sleep(0.002)
    assert found == [one for one in range(2 * AT_ONCE) if one != 3]
    channel.has = [7]
    looks.close()
    looks.close()
    await anyio.sleep(1.0)
    assert len(found) == 2 * AT_ONCE - 1
    assert Ring(channel, int, 9, EOFError).take() == []


async def test_one_wake_up_serves_all_readers() -> None:
    looked: list[list[float]] = [[], []]
    readers = []
    for its in looked:
        ring = Mock(take=lambda its=its: its.append(round(anyio.current_time(), 6)) or [])
        readers.append(PollingReader(Sink(), ring, print, 0.05))
        await anyio.sleep(0.013)
    await anyio.sleep(1.0)
    assert looked[0] == looked[1]
    assert 19 <= len(looked[0]) <= 21
    clock: Any = asyncio.get_running_loop()
    clock._jumping.now += 0.12  # the program stood: it is looked at once for the looks left out
    await anyio.sleep(1.0)
    assert looked[0] == looked[1]
    assert 39 <= len(looked[0]) <= 41
    for one in readers:
        one.close()


async def test_of_too_much_in_a_queue_the_oldest_is_lost() -> None:
    found: list[int] = []
    queue = ThreadQueue(asyncio.get_running_loop(), found.append, 5)
    await anyio.to_thread.run_sync(partial(list, map(queue.put, range(3))))
    await anyio.sleep(0.1)
    assert found == [0, 1, 2]
    for number in range(10):
        queue.put(number)
    await anyio.sleep(0.1)
    assert found == [0, 1, 2, 5, 6, 7, 8, 9]


async def test_what_is_first_waits_behind_no_flood_and_is_not_lost_for_one() -> None:
    found: list[int] = []
    queue = ThreadQueue(asyncio.get_running_loop(), found.append, 5, lambda one: one < 0)
    for number in (1, 2, -1, *range(3, 100), -2):
        queue.put(number)
    await anyio.sleep(0.1)
    assert found == [-1, -2, 95, 96, 97, 98, 99]


@pytest.mark.parametrize(("cost", "turns"), [(0.0, 1), (0.004, 50), (0.006, 100), (1.0, 100)])
async def test_what_is_dear_to_read_leaves_turns_to_others(
    monkeypatch: pytest.MonkeyPatch, cost: float, turns: int
) -> None:
    """The clock is the processor's: on virtual time nothing takes any."""
    clock = 0.0
    taken: list[int] = []
    loop = asyncio.get_running_loop()

    def take(one: int) -> None:
        nonlocal clock
        clock += cost
        taken.append(one)

    class Full(Inbox[tuple[int]]):
        found: tuple[tuple[int], ...] = tuple((number,) for number in range(100))

        def take(self) -> list[tuple[int]]:
            found, self.found = self.found, ()
            return list(found)

    monkeypatch.setattr(network, "perf_counter", lambda: clock)
    queue = ThreadQueue(loop, take, 1000)
    for number in range(100):
        queue.put(number)
    looks = PollingReader(Sink(), Full(), take, 1e-10)
    passes = 0
    while len(taken) < 200:
        began, passes = clock, passes + 1
        await asyncio.sleep(0)
        assert clock - began <= 2 * (TURN + cost)  # one turn of each of the two
    assert turns <= passes <= turns + 1
    assert sorted(taken) == sorted([*range(100), *range(100)])
    looks.close()
