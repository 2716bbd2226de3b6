"""A circle that the aircraft flies by itself."""

from __future__ import annotations

import asyncio
import math
import struct
from typing import Any

import pytest

from m100link import (
    BadValue,
    GuardRefused,
    MissionAborted,
    MissionProgress,
    MissionRefused,
    MissionRunning,
    NotObserved,
    Started,
    Stopped,
    UsageError,
)
from m100link.flight.missions.hotpoint import largest_rate
from tests.flight.foreign_aircraft import STANDBY
from tests.flight.missions.foreign import assert_rests, foreign, orders, spot
from tests.rig import NORTH

pytestmark = pytest.mark.anyio

NORTH_DEG, EAST_DEG = spot(30.0, 0.0)
CIRCLE: dict[str, Any] = {
    "latitude_deg": NORTH_DEG,
    "longitude_deg": EAST_DEG,
    "height": 20.0,
    "radius": 20.0,
    "rate_deg_s": 10.0,
}


async def test_it_circles_until_the_block_is_left() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.hotpoint(**CIRCLE) as circle:
            await asyncio.sleep(20.0)
            assert there.missions.flying == "hotpoint"
            assert circle.distance_m is not None
            assert abs(circle.distance_m - 20.0) < 0.5
            assert circle.rate_deg_s == 10.0
            assert circle.largest_radius == 500.0
            assert abs(there.missions.height - 20.0) < 0.1, "above the take-off point"
            with pytest.raises(MissionRunning, match="hotpoint"):
                control.send(NORTH)
        await assert_rests(there)
        control.send(NORTH)


async def test_what_is_sent_is_what_was_asked_for() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.hotpoint(**CIRCLE, clockwise=False) as circle:
            await circle.pause()
            assert circle.is_paused
            await circle.resume()
            await circle.stop()
            events = [e async for e in circle if not isinstance(e, MissionProgress)]
        assert isinstance(events[0], Started)
        assert isinstance(events[-1], Stopped)
        start = there.missions.orders[0]
        values = struct.unpack("<BddddfBBB11x", start.value)
        assert values[0] == 0
        assert values[1:3] == (math.radians(NORTH_DEG), math.radians(EAST_DEG))
        assert values[3:] == (20.0, 20.0, 10.0, 0, 4, 1)
        assert orders(there, 0x21, 0x22) == [(0x22, 0), (0x22, 0), (0x21, 0)]


@pytest.mark.parametrize("loss", [0.0, 0.3])
async def test_radius_and_rate_are_sent_until_the_aircraft_shows_them(loss: float) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.hotpoint(**CIRCLE) as circle:
            there.loss = loss
            await circle.set_radius(25.0)
            assert there.missions.circle[3] == 25.0
            await circle.set_rate(8.0)
            assert there.missions.circle[4] == 8.0
            await circle.reset_heading()
            there.loss = 0.0
            await asyncio.sleep(0.1)
        assert {answer for number, answer in orders(there) if number in (0x23, 0x24, 0x25)} == {
            None
        }


async def test_what_nobody_shows_is_not_said_to_be_so() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.hotpoint(**CIRCLE) as circle:
            await asyncio.sleep(10.0)
            there.missions._unconfirmed = lambda number, value: None  # type: ignore[method-assign] # deaf
            with pytest.raises(NotObserved, match="nothing shows it"):
                await circle.set_radius(40.0, timeout=5.0)
            await circle.set_radius(40.0, wait=False)
            assert 3 < len(orders(there, 0x24)) < 10


@pytest.mark.parametrize(
    ("radius", "most"), [(5.0, 30.0), (19.0, 30.0), (50.0, 11.46), (100.0, 5.73), (500.0, 1.146)]
)
def test_the_largest_rate_is_ten_metres_a_second(radius: float, most: float) -> None:
    assert largest_rate(radius) == pytest.approx(most, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"rate_deg_s": 29.0}, UsageError),
        ({"radius": 4.0}, BadValue),
        ({"radius": 501.0, "rate_deg_s": 0.5}, BadValue),
        ({"height": 4.0}, BadValue),
        ({"latitude_deg": math.nan}, BadValue),
        ({"height": 51.0}, GuardRefused),
        ({"radius": 130.0, "rate_deg_s": 1.0}, GuardRefused),
    ],
)
async def test_what_cannot_be_flown_is_refused_before_a_byte(
    change: dict[str, float], error: type[Exception]
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(error):
            async with control.hotpoint(**{**CIRCLE, **change}):
                pytest.fail("entered")
        assert orders(there) == []


async def test_a_change_that_leaves_the_envelope_or_the_limits_is_not_sent() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.hotpoint(**CIRCLE) as circle:
            with pytest.raises(GuardRefused):
                await circle.set_radius(130.0)
            with pytest.raises(UsageError):
                await circle.set_rate(29.0)
            with pytest.raises(BadValue):
                await circle.set_radius(1.0)
        assert orders(there, 0x23, 0x24) == []


async def test_on_the_ground_it_is_refused() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.status = STANDBY
        await asyncio.sleep(0.2)
        with pytest.raises(UsageError, match="on the ground"):
            async with control.hotpoint(**CIRCLE):
                pytest.fail("entered")


async def test_a_refusal_has_its_code() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.missions.answers[0x20] = 0xD8
        with pytest.raises(MissionRefused) as caught:
            async with control.hotpoint(**CIRCLE):
                pytest.fail("entered")
        assert caught.value.code == 0xD8
        assert "GPS" in str(caught.value)


@pytest.mark.parametrize("is_pushing", [True, False])
async def test_a_circle_that_ends_was_broken_off(is_pushing: bool) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.missions.is_pushing = is_pushing
        with pytest.raises(MissionAborted):
            async with control.hotpoint(**CIRCLE) as circle:
                await asyncio.sleep(1.0)
                there.missions.break_off(0xD9)
                async for _ in circle:
                    pass
        assert orders(there, 0x21) == []


async def test_an_exception_stops_it() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(ZeroDivisionError):
            async with aircraft.control() as control, control.hotpoint(**CIRCLE):
                await asyncio.sleep(1.0)
                raise ZeroDivisionError
        assert orders(there, 0x21) == [(0x21, 0)]
        await assert_rests(there)


@pytest.mark.parametrize(
    ("name", "value", "limit"),
    [
        ("height", 3.0, "5 to 500 m"),
        ("radius", 2.0, "5 to 500 m"),
        ("rate_deg_s", 50.0, "0 to 30 °/s"),
        ("latitude_deg", 91.0, "-90 to 90 °"),
        ("longitude_deg", -181.0, "-180 to 180 °"),
        ("start", 7, "4 nearest"),
        ("heading", 9, "1 to_centre"),
    ],
)
async def test_what_cannot_be_sent_is_named_as_the_call_names_it(
    name: str, value: float, limit: str
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(BadValue, match=name) as caught:
            circle: dict[str, Any] = {**CIRCLE, name: value}
            async with control.hotpoint(**circle):
                pytest.fail("entered")
        assert caught.value.field == name
        assert caught.value.value == pytest.approx(value)
        assert limit in caught.value.limit
        assert orders(there) == []
