"""A supervised line whose answers are late: what is repeated is carried out once all the same."""

from __future__ import annotations

import asyncio
from collections import Counter, deque

import pytest

import m100link
from m100link.testing import ConnectableAircraft
from tests.aircraft.test_supervising import Cable, S, supervised

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": m100link.sim.VirtualClockEventLoop}


async def test_a_repeat_is_no_second_command_though_the_line_is_looked_at() -> None:
    """An aircraft forgets at a version query what it has answered."""
    end = ConnectableAircraft(seed=1, firmware="1.0")
    end.vehicle.app.received = received = deque[bytes]()
    async with supervised(Cable(end)) as one:
        aircraft = await one.connected()
        end.set_faults(m100link.sim.LineFaults(delay=0.35))  # each is repeated after 0.5 s
        for number in range(60):
            await aircraft.send_to_mobile(b"%d" % number)
            await asyncio.sleep(0.05)
        assert one.state is S.CONNECTED
    counted = Counter(received)
    assert len(counted) == 60
    assert [data for data, times in counted.items() if times > 1] == []


async def test_a_line_on_which_nothing_is_heard_is_lost_while_requests_wait() -> None:
    end = ConnectableAircraft(seed=1, firmware="1.0")
    async with supervised(Cable(end)) as one:
        aircraft = await one.connected()
        end.stall_line()

        async def ask() -> None:
            while True:
                try:
                    await aircraft.send_to_mobile(b"x")
                except m100link.AckTimeout:
                    continue

        asking = asyncio.ensure_future(ask())
        async with asyncio.timeout(60.0):
            while one.state is S.CONNECTED:  # noqa: ASYNC110 - virtual time
                await asyncio.sleep(0.1)
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)


async def test_a_line_that_is_asked_without_a_pause_is_looked_at_all_the_same() -> None:
    """One that was switched off and on meanwhile is not active any more: somebody has to see."""
    end = ConnectableAircraft(seed=1, firmware="1.0")
    async with supervised(Cable(end)) as one:
        aircraft = await one.connected()
        end.set_faults(m100link.sim.LineFaults(delay=0.15))

        async def ask(number: int) -> None:
            await asyncio.sleep(0.05 * number)
            while True:
                await aircraft.send_to_mobile(b"x")

        asking = [asyncio.ensure_future(ask(number)) for number in range(4)]
        await asyncio.sleep(1.0)
        one.round_trip = -1.0
        await asyncio.sleep(15.0)
        assert one.round_trip > 0.0
        for task in asking:
            task.cancel()
        await asyncio.gather(*asking, return_exceptions=True)
