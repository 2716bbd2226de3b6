"""zenoh itself, over loopback: what goes out comes in, and floods cost the oldest."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from time import monotonic
from typing import Any

import anyio
import pytest

from m100link.errors import UsageError
from m100link.ros2.bus import MOST_BYTES, Inbox, ZenohBus, open_bus
from tests.waiting import PATIENCE

zenoh: Any = pytest.importorskip("zenoh", reason="the extra ros2 is not installed")

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def until(predicate: Callable[[], object]) -> None:
    with anyio.fail_after(PATIENCE):
        while not predicate():  # noqa: ASYNC110 - other threads bring it
            await anyio.sleep(0.01)


async def some(inbox: Inbox[Any]) -> list[Any]:
    found: list[Any] = []

    def look() -> bool:
        found.extend(inbox.take())
        return bool(found)

    await until(look)
    return found


async def two(stack: AsyncExitStack, *, second: str = "") -> tuple[ZenohBus, ZenohBus]:
    """Two sessions, one of which listens where the other one connects."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = json.dumps([f"tcp/127.0.0.1:{probe.getsockname()[1]}"])
    first = {"ZENOH_CONFIG_OVERRIDE": f"listen/endpoints={place};connect/endpoints=[]"}
    other = {"ZENOH_CONFIG_OVERRIDE": f"connect/endpoints={place};{second}"}
    return (
        await stack.enter_async_context(open_bus(first)),
        await stack.enter_async_context(open_bus(other)),
    )


async def test_what_goes_out_comes_in() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        assert one.session != other.session
        tokens = other.watch("@ros2_lv/**")
        one.declare("@ros2_lv/0/here")
        assert [(c.key, c.is_there) for c in await some(tokens)] == [("@ros2_lv/0/here", True)]
        outlet, inbox = one.publish("0/a"), other.subscribe("0/a", 8)
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
        one, other = await two(stack)
        outlet, inbox = one.publish("0/a"), other.subscribe("0/a", 8)
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
        outlet, inbox = one.publish("0/a"), other.subscribe("0/a", 8)
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
        inbox = one.serve("0/service", 4)
        querier: Any = other._session.declare_querier("0/service", timeout=1000.0 * PATIENCE)
        await until(lambda: querier.matching_status.matching)

        def ask(payload: bytes) -> Any:
            return querier.get(zenoh.handlers.FifoChannel(8), payload=payload, attachment=b"a")

        answers = ask(b"question")
        [request] = await some(inbox)
        assert (request.payload, request.attachment) == (b"question", b"a")
        request.answer(b"answer", b"b")
        [reply] = await anyio.to_thread.run_sync(list, answers)
        assert (bytes(reply.ok.payload), bytes(reply.ok.attachment)) == (b"answer", b"b")
        answers = ask(b"junk")
        [request] = await some(inbox)
        request.drop()
        assert await anyio.to_thread.run_sync(list, answers) == []


async def test_who_asks_all_services_at_once_asks_none() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        inbox = one.serve("0/service", 4)
        querier: Any = other._session.declare_querier("0/service", timeout=1000.0 * PATIENCE)
        await until(lambda: querier.matching_status.matching)
        ring = zenoh.handlers.FifoChannel(8)
        answers = other._session.get("0/*", ring, payload=b"question", timeout=PATIENCE)
        [request] = await some(inbox)
        assert request.payload == b""
        request.drop()
        assert await anyio.to_thread.run_sync(list, answers) == []


async def test_a_session_with_an_admin_space_answers_and_no_other_one() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack, second="adminspace/enabled=true")
        nobody = [other.ask(one.session), one.ask("abcdef")]
        asked: list[Inbox[bool]] = []

        def answers() -> bool:
            asked.append(one.ask(other.session))
            nobody.append(other.ask(one.session))
            return any(any(inbox.take()) for inbox in asked)

        await until(answers)
        assert not any(inbox.take() for inbox in nobody)


async def test_nothing_is_raised_when_the_session_has_ended() -> None:
    async with open_bus({"ZENOH_CONFIG_OVERRIDE": "connect/endpoints=[]"}) as bus:
        outlet = bus.publish("0/a")
        inbox = bus.ask("abcdef")
    outlet.put(b"", b"")
    assert inbox.take() == []


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ZENOH_SESSION_CONFIG_URI", "/nowhere/session.json5"),
        ("ZENOH_CONFIG_OVERRIDE", "mode"),
        ("ZENOH_CONFIG_OVERRIDE", 'mode="nonsense"'),
        ("ZENOH_CONFIG_OVERRIDE", "connect/endpoints=[7]"),
        ("ZENOH_CONFIG_OVERRIDE", 'listen/endpoints=["tcp/127.0.0.1:1:2"]'),
    ],
)
async def test_a_configuration_that_cannot_be_is_told(variable: str, value: str) -> None:
    with pytest.raises(UsageError) as refusal:
        async with open_bus({variable: value}):
            pass
    assert variable in str(refusal.value) or value.partition("=")[0] in str(refusal.value)


async def test_a_file_is_taken_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "session.json5"
    path.write_text('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:1"], timeout_ms: 100}}')
    with pytest.raises(UsageError, match="no session"):  # as a client it needs a router at once
        async with open_bus({"ZENOH_SESSION_CONFIG_URI": str(path)}):
            pass
