"""Following a target that moves: fed by an iterator, or told by the program."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator

import pytest

from m100link import (
    BadValue,
    GuardRefused,
    M100Error,
    MissionAborted,
    MissionProgress,
    MissionRunning,
    Started,
    Stopped,
    Target,
    UsageError,
)
from tests.flight.missions.foreign import assert_rests, foreign, orders, spot
from tests.rig import NORTH

pytestmark = pytest.mark.anyio


async def walk(seconds: float, *, speed: float = 2.0, every: float = 0.5) -> AsyncIterator[Target]:
    """Somebody walks east, 10 m north of the aircraft."""
    for step in range(int(seconds / every)):
        yield Target(*spot(10.0, speed * step * every))
        await asyncio.sleep(every)


async def test_it_follows_until_the_source_ends_and_hovers() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.follow_target(walk(20.0)) as mission:
            with pytest.raises(MissionRunning):
                control.send(NORTH)
            events = [e async for e in mission if not isinstance(e, MissionProgress)]
        assert [type(event) for event in events] == [Started, Stopped]
        assert there.missions.east == pytest.approx(39.0, abs=1.5)
        assert there.missions.north == pytest.approx(0.0, abs=0.5), "it keeps its distance"
        assert 30 < len(orders(there, 0x33)) < 45
        assert orders(there, 0x31) == [(0x31, 0)]
        await assert_rests(there)


async def test_a_program_may_tell_the_target_itself() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.follow_target(Target(*spot(10.0, 0.0))) as mission:
            for east in range(20):
                assert mission.set_target(Target(*spot(10.0, float(east))))
                await asyncio.sleep(0.3)
            assert mission.target == Target(*spot(10.0, 19.0))
            await mission.pause()
            await mission.resume()
        assert there.missions.east == pytest.approx(19.0, abs=3.0)
        assert orders(there, 0x31, 0x32) == [(0x32, 0), (0x32, 0), (0x31, 0)]


async def test_ten_targets_a_second_are_sent_at_most() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.follow_target(walk(3.0, every=0.01, speed=1.0)) as mission:
            await asyncio.sleep(5.0)
            await mission.stop()
        assert 45 < len(orders(there, 0x33)) < 52


async def test_leaving_the_block_ends_the_feeding() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.follow_target(walk(1000.0)):
            await asyncio.sleep(5.0)
        sent = len(orders(there, 0x33))
        await asyncio.sleep(5.0)
        assert len(orders(there, 0x33)) == sent
        await assert_rests(there)


async def test_a_source_in_which_something_was_cancelled_ends_it() -> None:
    async def source() -> AsyncIterator[Target]:
        yield Target(*spot(10.0, 0.0))
        inner = asyncio.create_task(asyncio.sleep(100.0))
        asyncio.get_running_loop().call_later(2.0, inner.cancel)
        await inner

    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(M100Error, match="was cancelled"):
            async with asyncio.timeout(10.0), control.follow_target(source()) as mission:
                async for _ in mission:
                    pass
        assert orders(there, 0x31) == [(0x31, 0)]
        await assert_rests(there)


async def empty() -> AsyncIterator[Target]:
    targets: list[Target] = []
    for target in targets:
        yield target


async def test_a_source_without_a_target_begins_nothing() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(UsageError, match="before the first"):
            async with control.follow_target(empty()):
                pytest.fail("entered")
        assert orders(there) == []


async def failing() -> AsyncIterator[Target]:
    yield Target(*spot(10.0, 0.0))
    await asyncio.sleep(1.0)
    raise ZeroDivisionError("a bug in the source")


async def jumping() -> AsyncIterator[Target]:
    yield Target(*spot(0.0, 0.0))
    await asyncio.sleep(1.0)
    yield Target(*spot(0.0, 140.0))
    await asyncio.sleep(1.0)
    yield Target(*spot(0.0, -140.0))


async def leaving() -> AsyncIterator[Target]:
    yield Target(*spot(0.0, 140.0))
    await asyncio.sleep(1.0)
    yield Target(*spot(0.0, 160.0))


@pytest.mark.parametrize(
    ("source", "error", "match"),
    [
        (failing, M100Error, "a bug in the source"),
        (jumping, UsageError, "28. m from the one before"),
        (leaving, GuardRefused, "the target"),
    ],
)
async def test_a_source_that_fails_stops_it_and_the_program_is_told(
    source: object, error: type[Exception], match: str
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(error, match=match):
            async with control.follow_target(source()) as mission:  # type: ignore[operator]
                async for _ in mission:
                    pass
        assert orders(there, 0x31) == [(0x31, 0)]
        await assert_rests(there)


async def test_one_that_the_aircraft_gives_up_is_raised() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(MissionAborted) as caught:
            async with control.follow_target(Target(*spot(10.0, 0.0))) as mission:
                await asyncio.sleep(1.0)
                there.missions.break_off(0xB1)
                async for _ in mission:
                    pass
        assert caught.value.code == 0xB1


async def test_a_cancellation_stops_it() -> None:
    async with foreign() as (there, aircraft):

        async def program() -> None:
            async with (
                aircraft.control() as control,
                control.follow_target(walk(1000.0)) as mission,
            ):
                async for _ in mission:
                    pass

        task = asyncio.create_task(program())
        await asyncio.sleep(5.0)
        assert there.missions.flying
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_rests(there)


async def test_below_five_metres_nothing_is_sent_and_the_remedy_is_to_climb() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.missions.height = 1.2
        await asyncio.sleep(0.5)
        with pytest.raises(UsageError, match=r"1\.2 m") as caught:
            async with control.follow_target(Target(*spot(10.0, 0.0))):
                pytest.fail("entered")
        assert "control.climb_to(6)" in caught.value.remedy
        assert orders(there) == []


@pytest.mark.parametrize(
    ("target", "field", "limit"),
    [
        (Target(95.0, 4.31), "latitude_deg", "-90 to 90 °"),
        (Target(52.1, math.nan), "longitude_deg", "-180 to 180 °"),
        (Target(52.1, 4.31, 1e5), "altitude_m", "0 to 65535 m"),
    ],
)
async def test_what_is_no_place_is_told_in_the_units_of_the_program(
    target: Target, field: str, limit: str
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(BadValue, match=field) as caught:
            async with control.follow_target(target):
                pytest.fail("entered")
        assert caught.value.limit == limit
        assert caught.value.value is getattr(target, field)
        assert not orders(there)
