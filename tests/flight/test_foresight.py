"""What is foreseen is what comes: times, distances, and every refusal."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import anyio
import pytest

from m100link import Arrival, Control, Envelope, GuardRefused, Guards, UsageError
from m100link.flight import foresight
from m100link.flight.foresight import (
    Foresight,
    foresee_climb,
    foresee_flight,
    foresee_orbit,
    foresee_turn,
)
from m100link.flight.guards import GuardKeeper
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, Position, quaternion
from tests.rig import Rig, rig

pytestmark = pytest.mark.anyio


class Pilot:
    """A control block, what is foreseen in it, and the flight itself."""

    def __init__(self, flown: Rig, control: Control) -> None:
        self.flown, self.control = flown, control
        state = control.state
        self.state = state
        self.guards = GuardKeeper(
            control.guards, state, control.origin and LocalFrame(*control.origin)
        )
        self.frame = control.local_frame() if control.state.position else LocalFrame(0, 0)

    def place(self, north: float, east: float) -> tuple[float, float]:
        return self.frame.to_geodetic(north, east)

    def foresee_to(self, north: float, east: float, height: float, speed: float) -> Foresight:
        latitude, longitude = self.place(north, east)
        return foresee_flight(
            self.state,
            self.guards,
            latitude_deg=latitude,
            longitude_deg=longitude,
            height=height,
            speed=speed,
        )

    async def fly_to(self, north: float, east: float, height: float, speed: float) -> Arrival:
        latitude, longitude = self.place(north, east)
        return await self.control.fly_to(
            latitude_deg=latitude, longitude_deg=longitude, height=height, speed=speed
        )


@asynccontextmanager
async def flying(guards: Guards | None = None, **options: Any) -> AsyncIterator[Pilot]:
    async with rig(**options) as flown, flown.aircraft.control(guards=guards) as control:
        await control.take_off()
        await control.climb_to(10.0)
        yield Pilot(flown, control)


def near(foreseen: float, flown: float) -> bool:
    """Within 20 %, or a second of what is short."""
    return math.isclose(foreseen, flown, rel_tol=0.2, abs_tol=1.0)


@pytest.mark.parametrize(
    ("north", "east", "height", "speed"),
    [
        (80, 0, 10, 5),
        (-60, 60, 20, 8),
        (10, 0, 10, 2),
        (100, 0, 10, 1),
        (5, 5, 40, 5),
        (0, 2, 10, 5),
    ],
)
async def test_a_flight_takes_what_was_foreseen(
    north: float, east: float, height: float, speed: float
) -> None:
    async with flying() as pilot:
        foreseen = pilot.foresee_to(north, east, height, speed)
        assert foreseen.refusals == ()
        assert foreseen.distance_m == pytest.approx(math.hypot(north, east), abs=0.5)
        assert foreseen.climb_m == pytest.approx(height - 10, abs=0.5)
        assert foreseen.battery_percent == pytest.approx(foreseen.seconds / 10.2, rel=0.01)
        arrival = await pilot.fly_to(north, east, height, speed)
        assert near(foreseen.seconds, arrival.elapsed)


@pytest.mark.parametrize(("radius", "speed", "turns"), [(15, 3, 1), (30, 5, 0.5), (10, 2, 2)])
async def test_an_orbit_takes_what_was_foreseen(radius: float, speed: float, turns: float) -> None:
    async with flying() as pilot:
        latitude, longitude = pilot.place(40.0, 0.0)
        foreseen = foresee_orbit(
            pilot.state,
            pilot.guards,
            latitude_deg=latitude,
            longitude_deg=longitude,
            height=12.0,
            radius=radius,
            speed=speed,
            turns=turns,
        )
        assert foreseen.refusals == ()
        assert foreseen.distance_m == pytest.approx(40 - radius + math.tau * radius * turns, abs=1)
        clock = anyio.current_time
        began = clock()
        await pilot.control.orbit(
            center_north=0.0,
            center_east=0.0,
            frame=LocalFrame(latitude, longitude),
            radius=radius,
            height=12.0,
            speed=speed,
            turns=turns,
        )
        assert math.isclose(foreseen.seconds, clock() - began, rel_tol=0.3)


async def test_a_climb_and_a_turn_take_what_was_foreseen() -> None:
    async with flying() as pilot:
        climb = foresee_climb(pilot.state, pilot.guards, 30.0)
        assert climb.climb_m == pytest.approx(20.0, abs=0.5)
        assert near(climb.seconds, (await pilot.control.climb_to(30.0)).elapsed)
        turn = foresee_turn(pilot.state, pilot.guards, 540.0 + 20.0)
        assert abs(turn.turn_deg) <= 180
        assert near(turn.seconds, (await pilot.control.turn_to(-160.0)).elapsed)


Flight = Callable[[Pilot], tuple[Foresight, Awaitable[object]]]


def to(north: float, east: float, height: float = 10.0, speed: float = 5.0) -> Flight:
    return lambda pilot: (
        pilot.foresee_to(north, east, height, speed),
        pilot.fly_to(north, east, height, speed),
    )


def around(radius: float, speed: float) -> Flight:
    def both(pilot: Pilot) -> tuple[Foresight, Awaitable[object]]:
        frame = LocalFrame(*pilot.place(0.0, 0.0))
        circle: dict[str, Any] = {"height": 10.0, "radius": radius, "speed": speed, "turns": 1.0}
        return foresee_orbit(
            pilot.state,
            pilot.guards,
            latitude_deg=frame.latitude_deg,
            longitude_deg=frame.longitude_deg,
            **circle,
        ), pilot.control.orbit(center_north=0.0, center_east=0.0, frame=frame, **circle)

    return both


def climb(height: float) -> Flight:
    return lambda pilot: (
        foresee_climb(pilot.state, pilot.guards, height),
        pilot.control.climb_to(height),
    )


@pytest.mark.parametrize(
    ("flight", "guard"),
    [
        (to(200, 0), "envelope"),
        (to(10, 0, height=60), "envelope"),
        (to(10, 0, speed=8), "envelope"),
        (to(10, 0, speed=12), "envelope"),
        (to(10, 0, speed=0), None),
        (to(10, 0, height=-1), None),
        (around(160, 5), "envelope"),
        (around(4, 5), None),
        (climb(55), "envelope"),
        (climb(-1), None),
    ],
)
async def test_what_is_refused_was_foreseen_in_the_same_words(
    flight: Flight, guard: str | None
) -> None:
    async with flying(Guards(envelope=Envelope(max_speed_m_s=6))) as pilot:
        foreseen, flown = flight(pilot)
        with pytest.raises((GuardRefused, UsageError)) as caught:
            await flown
        assert caught.value.seen in [one.seen for one in foreseen.refusals]
        assert all(one.remedy for one in foreseen.refusals)
        assert getattr(caught.value, "guard", None) == guard


@pytest.mark.parametrize(
    ("name", "value", "guard"),
    [("battery_percent", 15, "battery_floor_percent"), ("gps_health", 1, "gps")],
)
async def test_a_weak_battery_and_weak_gps_are_foreseen(name: str, value: int, guard: str) -> None:
    async with flying() as pilot:
        setattr(pilot.flown.virtual, name, value)
        await anyio.sleep(2.5)
        foreseen = pilot.foresee_to(10, 0, 10, 5)
        assert [getattr(one, "guard", "") for one in foreseen.refusals] == [guard]
        with pytest.raises(GuardRefused) as caught:
            await pilot.fly_to(10, 0, 10, 5)
        assert caught.value.guard == guard


async def test_a_place_that_is_none_is_foreseen_as_refused() -> None:
    async with flying() as pilot:
        foreseen = foresee_flight(
            pilot.state,
            pilot.guards,
            latitude_deg=95.0,
            longitude_deg=0.0,
            height=10.0,
            speed=5.0,
        )
        assert any("cannot be flown to" in one.seen for one in foreseen.refusals)


async def test_on_the_ground_it_is_refused_and_an_unknown_position_is_reported() -> None:
    async with rig() as flown:
        await anyio.sleep(1.0)
        guards = GuardKeeper(Guards(), flown.aircraft.state)
        (refusal,) = foresee_climb(flown.aircraft.state, guards, 10.0).refusals
        assert "on the ground" in refusal.seen
        flown.virtual.stall_line()
        await anyio.sleep(6.0)
        seen = [one.seen for one in foresee_climb(flown.aircraft.state, guards, 10.0).refusals]
        assert any("the position is needed and is" in one for one in seen)
        assert any("battery" in one for one in seen)


# -- by hand ---------------------------------------------------------------------------------------
# Of speed 5 m/s, the last 10 m are flown at half of what remains per second, to half a metre: that
# takes 2 ln 20 = 5.99 s. A circle is reached at 3 m/s, of which the last 6 m take 2 ln 12 = 4.97 s.


class Standing:
    """An aircraft at a place, in an attitude, with guards that allow all."""

    fastest_m_s = 10.0

    def __init__(self, *records: Any) -> None:
        self.records = {type(one): one for one in records}

    def fresh(self, kind: type[Any], *, within: float | None = None) -> Any:
        del within
        return self.records.get(kind)

    def check(self, *_: object, **__: object) -> None:
        """Allowed."""

    check_round_trip = check_target = check


METRE = math.degrees(1.0 / 6_371_000.0)
LATITUDE, LONGITUDE = 60.0, 20.0
HERE = Position(math.radians(LATITUDE), math.radians(LONGITUDE), 99.0, 12.0, 5)
WEST = Attitude(*quaternion(0.0, 0.0, math.radians(-170.0)))


@pytest.mark.parametrize(
    ("north", "east", "height", "speed", "yaw", "expected"),
    [
        # Distance, climb, turn, and seconds without what stopping takes.
        (50, 0, 12, 5.0, None, (50, 0, 0, 8.0 + 5.99)),
        (0, -50, 12, 5.0, None, (50, 0, 0, 8.0 + 5.99)),
        (-30, 40, 12, 2.5, None, (50, 0, 0, 18.0 + 2 * math.log(10))),
        (3, 4, 12, 5.0, None, (5, 0, 0, 2 * math.log(10))),  # all of it is braking
        (0.3, 0, 12, 5.0, None, (0.3, 0, 0, 0.0)),
        (0.3, 0, 72, 5.0, None, (0.3, 60, 0, 20.0)),  # the longest of the three counts
        (0.3, 0, 3, 5.0, None, (0.3, -9, 0, 3.0)),
        (0.3, 0, 12, 5.0, 100.0, (0.3, 0, -90, 1.0)),  # the short way, past south
        (0.3, 0, 12, 5.0, -80.0, (0.3, 0, 90, 1.0)),
        (50, 0, 72, 5.0, -80.0, (50, 60, 90, 20.0)),
        (50, 0, 12, 0.0, None, (50, 0, 0, 0.0)),
    ],
)
def test_a_flight_takes_the_longest_of_way_climb_and_turn(
    north: float,
    east: float,
    height: float,
    speed: float,
    yaw: float | None,
    expected: tuple[float, float, float, float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(foresight, "require_in_the_air", lambda *_: None)
    monkeypatch.setattr(foresight, "position_of", lambda *_: None)
    monkeypatch.setattr(foresight, "heading_of", lambda *_: None)
    aircraft: Any = Standing(HERE, WEST)
    found = foresee_flight(
        aircraft,
        aircraft,
        latitude_deg=LATITUDE + north * METRE,
        longitude_deg=LONGITUDE + east * METRE / math.cos(math.radians(LATITUDE)),
        height=height,
        speed=speed,
        yaw_deg=yaw,
    )
    distance, climb_m, turn, seconds = expected
    assert found.distance_m == pytest.approx(distance, rel=0.005)
    assert (found.climb_m, found.turn_deg) == pytest.approx((climb_m, turn))
    assert found.seconds == pytest.approx(seconds + 1.5, rel=0.005)
    assert found.battery_percent == pytest.approx(100 * found.seconds / (17 * 60))
    assert bool(found.refusals) is (speed == 0)


@pytest.mark.parametrize(
    ("away", "radius", "turns", "distance", "seconds"),
    [
        (0, 20, 1.0, 20 + 2 * math.pi * 20, 14 / 3 + 4.97 + 2 * math.pi * 20 / 4),
        (50, 20, 0.5, 30 + math.pi * 20, 24 / 3 + 4.97 + math.pi * 20 / 4),
        (21, 20, 2.0, 1 + 4 * math.pi * 20, 2 * math.log(2) + 4 * math.pi * 20 / 4),
    ],
)
def test_an_orbit_takes_the_way_to_its_circle_and_its_rounds(
    away: float,
    radius: float,
    turns: float,
    distance: float,
    seconds: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(foresight, "require_in_the_air", lambda *_: None)
    monkeypatch.setattr(foresight, "position_of", lambda *_: None)
    aircraft: Any = Standing(HERE, WEST)
    place = {"latitude_deg": LATITUDE + away * METRE, "longitude_deg": LONGITUDE}
    found = foresee_orbit(
        aircraft, aircraft, **place, height=12.0, radius=radius, speed=4.0, turns=turns
    )
    assert found.distance_m == pytest.approx(distance, rel=0.01)
    assert found.seconds == pytest.approx(seconds + 1.5, rel=0.01)
    assert found.refusals == ()
    assert foresee_climb(aircraft, aircraft, 42.0).seconds == pytest.approx(10.0 + 1.5)
    assert foresee_turn(aircraft, aircraft, 10.0).turn_deg == pytest.approx(180.0)
    nowhere: Any = Standing()
    assert foresee_climb(nowhere, nowhere, 42.0).climb_m == 0.0
    assert foresee_turn(nowhere, nowhere, 10.0).turn_deg == 0.0
