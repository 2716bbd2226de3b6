"""A circle that the aircraft flies by itself."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import AsyncIterator, Callable
from itertools import islice
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock, MagicMock, call

import pytest

from m100link import (
    BadValue,
    GuardRefused,
    M100Error,
    MissionAborted,
    MissionProgress,
    MissionRefused,
    MissionRunning,
    NotObserved,
    Started,
    Stopped,
    Target,
    UsageError,
)
from m100link.flight.missions import hotpoint
from m100link.flight.missions.hotpoint import HotpointFlight, largest_rate
from m100link.geodesy import LocalFrame
from m100link.protocol.commands.hotpoint import HotpointSetRate
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
    ("rate", "clockwise", "is_confirmed"),
    [(8.0, 0, True), (8.0, 1, False), (-8.0, 0, False), (8.1, 0, False)],
)
async def test_a_stored_circle_confirms_a_rate_with_its_direction(
    rate: float, clockwise: int, *, is_confirmed: bool
) -> None:
    sent: list[Any] = []

    async def send(
        request: object, _: object, confirms: Callable[[Any], bool], *__: object
    ) -> None:
        sent.extend((request, confirms(SimpleNamespace(angular_rate=rate, clockwise=clockwise))))

    one: Any = SimpleNamespace(_is_clockwise=True, _radius=20.0, _track=None, _send=send)
    one._check, one._turns = (lambda *_: None), lambda: iter(())
    await HotpointFlight.set_rate(one, 8.0, clockwise=False)
    assert sent == [HotpointSetRate(0, 8.0), is_confirmed]
    assert not one._is_clockwise


@pytest.mark.parametrize(("radius", "is_confirmed"), [(25.0, True), (25.1, False)])
async def test_a_stored_circle_confirms_a_radius(radius: float, *, is_confirmed: bool) -> None:
    one: Any = SimpleNamespace(_rate=8.0, _track=None, _check=MagicMock(), _send=AsyncMock())
    await HotpointFlight.set_radius(one, 25.0)
    confirms = one._send.mock_calls[0].args[2]
    assert confirms(SimpleNamespace(radius=radius)) is is_confirmed
    assert one._check.mock_calls == [call(25.0, 8.0)]


def test_a_circle_is_judged_by_its_speed() -> None:
    one: Any = SimpleNamespace(_context=MagicMock(), _centre=(22.5, 113.9))
    one._request = SimpleNamespace(altitude=12.0)
    HotpointFlight._check(one, 20.0, 9.0)  # nine degrees of 20 m are pi metres
    one._context.guards.check_target.assert_called_once_with(
        "the hotpoint", (22.5, 113.9), height=12.0, radius=20.0, speed=pytest.approx(math.pi)
    )


def test_turns_around_the_centre_are_positive_clockwise(monkeypatch: pytest.MonkeyPatch) -> None:
    centre = LocalFrame(22.5, 113.9)
    bearings: list[float | None] = [100.0, 130.0, 120.0, None, 170.0, -170.0]
    found = []
    for bearing in bearings:
        angle = math.radians(bearing or 0.0)
        north, east = 20.0 * math.cos(angle), 20.0 * math.sin(angle)
        latitude, longitude = centre.to_geodetic(north, east)
        there = SimpleNamespace(latitude_deg=latitude, longitude_deg=longitude)
        found.append(None if bearing is None else there)
    monkeypatch.setattr(hotpoint, "known", MagicMock(side_effect=found))
    one: Any = SimpleNamespace(_context=MagicMock(), _centre=(22.5, 113.9))
    turns = list(islice(HotpointFlight._turns(one), len(bearings)))
    assert turns == pytest.approx([0.0, 30.0, -10.0, 0.0, 0.0, 20.0], abs=0.01)


@pytest.mark.parametrize(
    ("radius", "most"), [(5.0, 30.0), (19.0, 30.0), (50.0, 11.46), (100.0, 5.73), (500.0, 1.146)]
)
def test_the_largest_rate_is_ten_metres_a_second(radius: float, most: float) -> None:
    assert largest_rate(radius) == pytest.approx(most, rel=1e-3)
    hotpoint._require_rate(largest_rate(radius), radius)
    with pytest.raises(UsageError, match=rf"would be {math.radians(33.0) * radius:.1f} m/s"):
        hotpoint._require_rate(33.0, radius)


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


# -- following a target that moves: fed by an iterator, or by the program --------------------------


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
        with pytest.raises(M100Error, match="was cancelled") as caught:
            async with asyncio.timeout(10.0), control.follow_target(source()) as mission:
                async for _ in mission:
                    pass
        assert isinstance(caught.value.__cause__, asyncio.CancelledError)
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
async def test_a_source_that_fails_stops_it_and_the_program_gets_the_error(
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
async def test_what_is_no_place_is_reported_in_the_units_of_the_program(
    target: Target, field: str, limit: str
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(BadValue, match=field) as caught:
            async with control.follow_target(target):
                pytest.fail("entered")
        assert caught.value.limit == limit
        assert caught.value.value is getattr(target, field)
        assert not orders(there)
