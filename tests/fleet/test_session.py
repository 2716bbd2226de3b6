"""A session of a fleet over loopback: its router, who waits for that, and what is told without."""

from __future__ import annotations

from contextlib import AsyncExitStack

import anyio
import pytest

from m100link.errors import UsageError
from m100link.fleet.session import open_fleet
from tests.bus.pair import free_place, until

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_no_router_is_told_with_what_to_do() -> None:
    with pytest.raises(UsageError, match="no router answered") as caught:
        async with open_fleet("client", connect=(free_place(),)):
            pass
    assert "fleet router" in caught.value.remedy


async def test_a_port_that_is_taken_and_an_option_that_cannot_be() -> None:
    place = free_place()
    async with open_fleet("router", listen=(place,)):
        with pytest.raises(UsageError, match="no router can be here"):
            async with open_fleet("router", listen=(place,)):
                pass
    with pytest.raises(UsageError, match="cannot be in a session"):
        async with open_fleet("router", options={"mode": '"captain"'}):
            pass


async def test_who_is_patient_waits_for_the_router() -> None:
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
