"""A line that takes no more while setpoints are sent: the block ends, and says so."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from m100link import AckTimeout, LineBlocked
from m100link.flight.block import BLOCKED_S
from m100link.flight.stop_path import StopAction
from m100link.link import MemoryTransport
from tests.rig import FIRMWARES, NORTH, Rig, rig

pytestmark = pytest.mark.anyio


def reader(flown: Rig) -> MemoryTransport:
    """The aircraft's end of the cable."""
    here = flown.aircraft.link._transport
    assert isinstance(here, MemoryTransport)
    assert here._peer is not None
    return here._peer


@contextmanager
def blocked(flown: Rig) -> Iterator[None]:
    """The aircraft reads nothing, and the buffers in between are full; what it sends arrives."""
    end, link = reader(flown), flown.aircraft.link
    end.pause_reading()
    while link.push(bytes(1000)):
        pass
    end._inbox.clear()  # only its pressure is wanted: what arrives later is the program's own
    try:
        yield
    finally:
        end.resume_reading()
        link.resume_writing()


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_a_line_that_takes_no_setpoint_ends_the_block(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(LineBlocked, match=r"took no setpoint for 0\.5 s") as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly(control)
                with blocked(flown):
                    began_at, count = flown.now, len(flown.moves)
                    try:
                        await flown.fly_on(control)
                    finally:
                        assert flown.now - began_at < BLOCKED_S + 0.05
                        assert len(flown.moves) == count
                        await asyncio.sleep(0.1)
        assert "stands still" in caught.value.cause
        assert flown.is_released, "the line drained again in time for the release"
        flown.assert_stopped_in_order()
        await flown.assert_hovers()


@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_a_line_that_never_drains_ends_the_block_in_bounded_time(stop: StopAction) -> None:
    async with rig() as flown:
        ended_at = 0.0
        with pytest.raises(LineBlocked):
            async with flown.aircraft.control(stop=stop) as control:
                await control.take_off()
                await flown.fly(control)
                reader(flown).pause_reading()
                while flown.aircraft.link.push(bytes(1000)):
                    pass
                ended_at = flown.now
                await flown.fly_on(control)
        # A landing without an answer is ordered again for a minute: the aircraft may hear one.
        assert flown.now - ended_at < (66.0 if stop == "land" else 6.0)
        age = flown.aircraft.state.newest_age
        assert age is not None
        assert age < 0.1, "telemetry went on"
        with pytest.raises(AckTimeout) as caught:
            await flown.aircraft.send_to_mobile(b"x")
        assert "does not take bytes" in caught.value.cause
        await flown.assert_hovers()
        began_at = flown.now
        await flown.aircraft.aclose()
        assert flown.now - began_at < 1.1


async def test_a_line_that_is_busy_for_a_moment_costs_setpoints_and_nothing_else() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            for _ in range(5):
                with blocked(flown):
                    await flown.fly(control, BLOCKED_S - 0.1)
                await flown.fly(control, 0.1)
            assert flown.aircraft.link.statistics().dropped_writes >= 5 * 15
        flown.assert_stopped_in_order()


async def test_drops_long_ago_are_not_counted_to_those_of_now() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            for _ in range(3):
                with blocked(flown):
                    control.send(NORTH, lifetime=0.02)
                    await asyncio.sleep(0.3)
                await asyncio.sleep(5.0)
