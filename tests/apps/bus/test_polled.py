"""zenoh itself, over loopback: what waits to be taken, and floods that cost the oldest."""

from __future__ import annotations

from contextlib import AsyncExitStack
from time import monotonic
from typing import Any

import anyio
import pytest

from m100link.apps.bus.network import Inbox
from m100link.apps.bus.session import Opening, ZenohBus, open_session
from m100link.errors import UsageError
from tests.apps.bus.pair import opening, two, until
from tests.waiting import PATIENCE

zenoh: Any = pytest.importorskip("zenoh", reason="the extra ros2 is not installed")

pytestmark = pytest.mark.anyio

MOST_BYTES = 32768


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def some(inbox: Inbox[Any]) -> list[Any]:
    found: list[Any] = []

    def look() -> bool:
        found.extend(inbox.take())
        return bool(found)

    await until(look)
    return found


async def test_what_goes_out_comes_in() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        assert one.session != other.session
        tokens = other.changes("@ros2_lv/**")
        token = one.declare("@ros2_lv/0/here")
        assert [(c.key, c.is_there) for c in await some(tokens)] == [("@ros2_lv/0/here", True)]
        token.close()
        assert [(c.key, c.is_there) for c in await some(tokens)] == [("@ros2_lv/0/here", False)]
        outlet, inbox = one.publish("0/a"), other.inbox("0/a", 8)
        await until(outlet.is_wanted)
        outlet.put(b"payload", b"attachment")
        assert [(r.payload, r.attachment) for r in await some(inbox)] == [
            (b"payload", b"attachment")
        ]
        for number in range(100):
            outlet.put(b"%d" % number, b"")
        outlet.put(b"last", b"")
        found: list[bytes] = []

        def has_last() -> bool:
            found.extend(one.payload for one in inbox.take())
            return found[-1:] == [b"last"]

        await until(has_last)


async def test_what_is_too_long_is_not_read() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack, largest=MOST_BYTES)
        outlet, inbox = one.publish("0/a"), other.inbox("0/a", 8)
        await until(outlet.is_wanted)
        seen: list[int] = []

        async def sizes_until(size: int, last: int) -> None:
            """Send until it comes: what is sent is dropped where the network is slow."""
            with anyio.fail_after(PATIENCE):
                while seen[-1:] != [last]:
                    outlet.put(bytes(size), b"")
                    await anyio.sleep(0.02)
                    seen.extend(len(one.payload) for one in inbox.take())

        await sizes_until(MOST_BYTES, MOST_BYTES)
        await sizes_until(MOST_BYTES + 1, 0)
        for _ in range(5):
            outlet.put(bytes(4 << 20), b"")  # zenoh does not put it together
        await sizes_until(1, 1)
        assert set(seen) == {MOST_BYTES, 0, 1}


async def test_a_ring_that_is_filled_meanwhile_has_an_end() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        outlet, inbox = one.publish("0/a"), other.inbox("0/a", 8)
        await until(outlet.is_wanted)
        ends_at = anyio.current_time() + 2.0

        def flood() -> None:
            while monotonic() < ends_at:
                for _ in range(100):
                    outlet.put(b"x", b"")

        async with anyio.create_task_group() as group:
            group.start_soon(anyio.to_thread.run_sync, flood)
            while monotonic() < ends_at:
                assert len(inbox.take()) <= 8
                await anyio.sleep(0.001)


async def test_who_comes_late_gets_what_was_latched() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        outlet = one.publish("0/latched", kept=1)
        outlet.put(b"old", b"")
        outlet.put(b"new", b"1")
        late = zenoh.ext.declare_advanced_subscriber(
            other._session,
            "0/latched",
            zenoh.handlers.RingChannel(8),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
        await until(lambda: (found := late.try_recv()) and bytes(found.payload) == b"new")


async def test_a_request_is_answered_or_dropped() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        inbox = one.questions("0/service", 4)
        querier: Any = other._session.declare_querier("0/service", timeout=1000.0 * PATIENCE)
        await until(lambda: querier.matching_status.matching)

        def ask(payload: bytes) -> Any:
            return querier.get(zenoh.handlers.FifoChannel(8), payload=payload, attachment=b"a")

        answers = ask(b"question")
        [request] = await some(inbox)
        assert (request.payload, request.attachment) == (b"question", b"a")
        request.answer(request.key, b"answer", b"b")
        [reply] = await anyio.to_thread.run_sync(list, answers)
        assert (bytes(reply.ok.payload), bytes(reply.ok.attachment)) == (b"answer", b"b")
        answers = ask(b"junk")
        [request] = await some(inbox)
        request.drop()
        assert await anyio.to_thread.run_sync(list, answers) == []


async def test_a_question_by_a_pattern_says_so() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        inbox = one.questions("0/service", 4)
        querier: Any = other._session.declare_querier("0/service", timeout=1000.0 * PATIENCE)
        await until(lambda: querier.matching_status.matching)
        ring = zenoh.handlers.FifoChannel(8)
        answers = other._session.get("0/*", ring, payload=b"question", timeout=PATIENCE)
        [request] = await some(inbox)
        assert (request.key, request.payload) == ("0/*", b"question")
        request.drop()
        assert await anyio.to_thread.run_sync(list, answers) == []


async def test_a_probe_is_answered_by_who_has_what_it_asks_for() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack, adminspace_enabled=True)

        def probe(by: ZenohBus, session: str) -> Inbox[bool]:
            return by.probe(f"@/{session}/*", timeout=2.0)

        nobody = [probe(other, one.session), probe(one, "abcdef")]
        asked: list[Inbox[bool]] = []

        def answers() -> bool:
            asked.append(probe(one, other.session))
            nobody.append(probe(other, one.session))
            return any(any(inbox.take()) for inbox in asked)

        await until(answers)
        assert not any(inbox.take() for inbox in nobody)


async def test_nothing_is_raised_when_the_session_has_ended() -> None:
    async with open_session(opening("peer")) as bus:
        outlet = bus.publish("0/a")
        inbox = bus.probe("@/abcdef/*", timeout=2.0)
    outlet.put(b"", b"")
    assert inbox.take() == []


async def test_what_is_kept_needs_a_session_with_stamps() -> None:
    plain = dict(opening("peer").options) | {"timestamping/enabled": "false"}
    async with open_session(Opening("a test", "x", plain)) as bus:
        bus.publish("0/a").close()
        with pytest.raises(UsageError, match="keeps nothing") as caught:
            bus.publish("0/a", kept=1)
    assert "timestamping" in caught.value.remedy
