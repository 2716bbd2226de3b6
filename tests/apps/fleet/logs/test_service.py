"""The agent's end: who asks is answered, within limits, and nothing that comes harms it."""

from __future__ import annotations

import random
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.logs.service import LogService
from m100link.apps.fleet.logs.words import (
    MOST_PIECE,
    LogReply,
    unpack_reply,
)
from m100link.apps.fleet.payloads import AskShow, LogQuestion, OrderMessage, Outcome, What, pack
from m100link.errors import NotAllowed, UsageError
from tests.apps.fleet.logs.conftest import FIRST, KEYS, Road, bytes_of

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def serving(road: Road, **options: Any) -> AsyncIterator[LogService]:
    service = road.service(**options)
    async with anyio.create_task_group() as group:
        group.start_soon(service.run)
        await anyio.sleep(0.001)
        yield service
        group.cancel_scope.cancel()


async def asked(road: Road, question: LogQuestion, **changes: Any) -> tuple[LogReply, bytes]:
    order = road.asker().around(question)
    order = replace(order, **changes)
    [answer] = await road.here.ask(KEYS.log, pack(order), timeout=600.0)
    assert answer.key == KEYS.log
    return unpack_reply(answer.payload)


async def test_a_piece_comes_under_the_key_of_the_aircraft(road: Road) -> None:
    async with serving(road):
        reply, data = await asked(road, LogQuestion(What.PIECE, FIRST, 10, 20))
        assert data == bytes_of(300_000)[10:30]
        assert (reply.name, reply.outcome, reply.size) == ("a1", Outcome.OK, 300_000)


async def test_what_is_not_there_or_not_for_it_is_refused_with_its_reason(road: Road) -> None:
    missing = LogQuestion(What.PIECE, FIRST.replace("2026", "2025"), 0, 5)
    async with serving(road):
        reply, _ = await asked(road, missing)
        assert reply.outcome is Outcome.REFUSED
        assert reply.fault is not None
        assert isinstance(reply.fault.error(), UsageError)
        reply, _ = await asked(road, LogQuestion(What.AUDIT, "", 1))
        assert (reply.outcome, reply.fault and reply.fault.seen) == (
            Outcome.REFUSED,
            "a1 writes no audit log",
        )
        reply, _ = await asked(road, LogQuestion(What.LIST), aircraft="a2")
        assert reply.outcome is Outcome.NOT_ALLOWED
        reply, _ = await asked(road, LogQuestion(What.LIST), order=AskShow("r"))
        assert reply.outcome is Outcome.REFUSED


async def test_a_client_that_may_not_watch_gets_nothing(road: Road) -> None:
    def verify(order: OrderMessage, boot: str) -> None:
        raise NotAllowed("bert may not watch a1")

    async with serving(road, verify=verify):
        for what in What:
            reply, data = await asked(road, LogQuestion(what, FIRST, 0, 10))
            assert (reply.outcome, data) == (Outcome.NOT_ALLOWED, b"")


async def test_so_many_bytes_a_second_leave_it_and_an_early_client_hears_when(road: Road) -> None:
    began = anyio.current_time()
    left, told = 0, []
    async with serving(road, rate=100_000.0):

        async def fetch() -> None:
            nonlocal left
            while anyio.current_time() - began < 20.0:
                reply, data = await asked(road, LogQuestion(What.PIECE, FIRST, 0, 20_000))
                left += len(data)
                if reply.again_s:
                    assert data == b""
                    told.append(reply.again_s)
                    await anyio.sleep(reply.again_s)

        async with anyio.create_task_group() as group:
            for _ in range(10):
                group.start_soon(fetch)
    took = anyio.current_time() - began
    assert left <= 100_000 * took + 60_000
    assert left > 50_000 * took
    assert told
    assert max(told) < 1.5


async def test_each_waits_its_turn_for_half_a_second_and_else_hears_how_long(road: Road) -> None:
    """At 100,000 bytes a second: fifty thousand take half of one."""
    service = road.service(rate=100_000.0)
    began = anyio.current_time()

    turns: list[float] = []

    async def turn(size: int) -> None:
        turns.extend((await service._may_go(size), anyio.current_time() - began))

    for size in (50_000, 20_000, 60_000, 1):
        await turn(size)
    assert turns[:6] == pytest.approx([0.0, 0.0, 0.0, 0.5, 0.0, 0.7])
    assert turns[6:] == pytest.approx([0.6, 0.7]), "later than half a second"
    await anyio.sleep(0.7)
    await turn(10_000)
    await turn(10_000)
    assert turns[8:] == pytest.approx([0.0, 1.4, 0.0, 1.5]), "what was not sent is not saved up"


async def test_of_a_flood_few_wait_and_the_rest_is_not_even_read(road: Road) -> None:
    reads = 0

    def verify(order: OrderMessage, boot: str) -> None:
        nonlocal reads
        reads += 1

    async with serving(road, verify=verify, rate=1000.0) as service:
        order = pack(road.asker().around(LogQuestion(What.PIECE, FIRST, 0, 200)))
        async with anyio.create_task_group() as group:
            for _ in range(2000):
                group.start_soon(lambda: road.here.ask(KEYS.log, order, timeout=0.05))
        assert reads < 100
        assert service.dropped > 1900
        await anyio.sleep(5.0)
        assert (await asked(road, LogQuestion(What.PIECE, FIRST, 0, 5)))[1] == bytes_of(300_000)[:5]


async def test_a_digest_is_made_once_for_all_who_ask_and_one_at_a_time(
    road: Road, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[str, int]] = []

    async with serving(road) as service:
        digest = service._directory.digest

        def counted(log: str, length: int, is_wanted: Any) -> bytes:
            made.append((log, length))
            return digest(log, length, is_wanted)

        monkeypatch.setattr(service._directory, "digest", counted)
        question = LogQuestion(What.DIGEST, FIRST, 0, 300_000)
        found: list[bytes] = []

        async def ask() -> None:
            again = 1.0
            while again:
                reply, data = await asked(road, question)
                again = reply.again_s
            found.append(data)

        async with anyio.create_task_group() as group:
            for _ in range(5):
                group.start_soon(ask)
        assert len(set(found)) == 1
        assert len(found[0]) == 32
        assert made == [(FIRST, 300_000)]
        reply, _ = await asked(road, LogQuestion(What.DIGEST, FIRST, 0, 300_001))
        while reply.again_s:
            reply, _ = await asked(road, LogQuestion(What.DIGEST, FIRST, 0, 300_001))
        assert reply.outcome is Outcome.REFUSED


async def test_junk_is_answered_or_dropped_and_ends_nothing(road: Road) -> None:
    chance = random.Random(7)
    good = pack(road.asker().around(LogQuestion(What.PIECE, FIRST, 0, MOST_PIECE)))
    async with serving(road):
        for _ in range(300):
            data = bytearray(good)
            for _ in range(chance.randrange(1, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
            await road.here.ask(KEYS.log, bytes(data[: chance.randrange(1, len(data))]), timeout=1)
        await anyio.sleep(1.0)
        assert (await asked(road, LogQuestion(What.PIECE, FIRST, 0, 5)))[1] == bytes_of(300_000)[:5]


async def test_the_disk_is_waited_for_in_threads_of_their_own_that_end_with_it(road: Road) -> None:
    async with serving(road) as service:
        name = await service._apart(lambda: threading.current_thread().name)
        assert name.startswith("logs of a1")
    with pytest.raises(RuntimeError, match="after shutdown"):
        await service._apart(threading.get_ident)


async def test_its_end_is_that_of_a_digest_that_is_being_made(road: Road) -> None:
    async with serving(road) as service:
        assert service._directory.digest(FIRST, 300_000, lambda: not service._is_ended)
    with pytest.raises(UsageError, match="the agent ends"):
        service._directory.digest(FIRST, 300_000, lambda: not service._is_ended)


async def test_nothing_leaves_at_no_rate(road: Road) -> None:
    for rate in (0.0, -1.0, float("nan")):
        with pytest.raises(UsageError):
            road.service(rate=rate)


async def test_a_pattern_is_answered_under_its_own_key(road: Road) -> None:
    async with serving(road):
        order = pack(road.asker().around(LogQuestion(What.LIST)))
        [answer] = await road.here.ask(Keys("field").log, order, timeout=1.0)
        assert answer.key == KEYS.log
