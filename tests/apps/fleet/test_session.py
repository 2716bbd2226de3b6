"""A session of a fleet over loopback: its router, programs that wait for it, and errors."""

from __future__ import annotations

from contextlib import AsyncExitStack

import anyio
import pytest

from m100link.apps.fleet.client import open_fleet
from m100link.errors import NoRouter, PortBusy, UsageError
from tests.apps.bus.pair import free_place, until

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_no_router_is_reported_with_a_remedy() -> None:
    with pytest.raises(UsageError, match="no router answered") as caught:
        async with open_fleet("client", connect=(free_place(),)):
            pass
    assert "fleet router" in caught.value.remedy
    assert "--identity" in caught.value.remedy
    place = free_place().replace("tcp/", "tls/")
    with pytest.raises(NoRouter, match="no router answered") as caught:
        async with open_fleet("client", connect=(place,)):
            pass
    assert caught.value.remedy.startswith("give --identity")
    assert place in caught.value.remedy


async def test_a_port_that_is_taken_and_an_option_that_cannot_be() -> None:
    place = free_place()
    async with open_fleet("router", listen=(place,)):
        with pytest.raises(PortBusy, match="no router can be here") as caught:
            async with open_fleet("router", listen=(place,)):
                pass
        assert place in caught.value.remedy
    with pytest.raises(UsageError, match="cannot be in a session"):
        async with open_fleet("router", options={"mode": '"captain"'}):
            pass


@pytest.mark.smoke
async def test_a_patient_program_waits_for_the_router() -> None:
    place = free_place()
    async with AsyncExitStack() as stack:

        async def late() -> None:
            async with open_fleet("client", connect=(place,), is_patient=True) as session:
                token = session.declare("m/late/live")
                await until(done.is_set)
                token.close()

        done = anyio.Event()
        async with anyio.create_task_group() as group:
            group.start_soon(late)
            await anyio.sleep(0.2)
            await stack.enter_async_context(open_fleet("router", listen=(place,)))
            watcher = await stack.enter_async_context(open_fleet("client", connect=(place,)))
            seen: list[str] = []
            watcher.watch("m/*/live", lambda key, _: seen.append(key))
            await until(lambda: seen)
            done.set()


@pytest.mark.parametrize("is_patient", [False, True], ids=["pilot", "agent"])
async def test_a_program_that_begins_while_the_first_of_two_routers_is_dead_comes_to_the_second(
    is_patient: bool,
) -> None:
    dead, place = free_place(), free_place()
    async with open_fleet("router", listen=(place,)):
        one = open_fleet("client", connect=(dead, place), is_patient=is_patient)
        async with one as session, open_fleet("client", connect=(place,)) as watcher:
            seen: list[str] = []
            watcher.watch("m/*/live", lambda key, _: seen.append(key))
            token = session.declare("m/a1/live")
            await until(lambda: seen)
            token.close()


async def test_a_router_that_begins_a_moment_later_is_waited_for() -> None:
    place = free_place()
    async with AsyncExitStack() as stack, anyio.create_task_group() as group:

        async def begin() -> None:
            await anyio.sleep(0.5)
            await stack.enter_async_context(open_fleet("router", listen=(place,)))

        group.start_soon(begin)
        async with open_fleet("client", connect=(place,)):
            pass


async def test_when_one_of_two_routers_ends_everybody_meets_at_the_other() -> None:
    places = free_place(), free_place()
    async with AsyncExitStack() as stack:
        first = open_fleet("router", listen=places[:1])
        await first.__aenter__()
        await stack.enter_async_context(open_fleet("router", listen=places[1:]))
        one = await stack.enter_async_context(open_fleet("client", connect=places))
        other = await stack.enter_async_context(open_fleet("client", connect=places))
        heard: list[bytes] = []
        other.subscribe("m/a", lambda key, payload: heard.append(payload))
        outlet = one.publish("m/a")
        for end in (None, first):
            if end is not None:
                await end.__aexit__(None, None, None)
                heard.clear()

            def told() -> bool:
                outlet.put(b"x")
                return bool(heard)

            await until(told)


async def test_programs_at_two_linked_routers_meet() -> None:
    one, other = free_place(), free_place()
    async with AsyncExitStack() as stack:
        # The first looks for one that is not there yet.
        await stack.enter_async_context(open_fleet("router", listen=(one,), connect=(other,)))
        agent = await stack.enter_async_context(open_fleet("client", connect=(one,)))
        for held in (
            agent.declare("m/a1/live"),
            agent.serve("m/a1/cmd", lambda question: question.answer("m/a1/cmd", b"done")),
        ):
            stack.callback(held.close)
        await stack.enter_async_context(open_fleet("router", listen=(other,), connect=(one,)))
        pilot = await stack.enter_async_context(open_fleet("client", connect=(other,)))
        seen: list[str] = []
        pilot.watch("m/*/live", lambda key, _: seen.append(key))
        await until(lambda: seen)
        [answer] = await pilot.ask("m/a1/cmd", timeout=2.0)
        assert answer.payload == b"done"
