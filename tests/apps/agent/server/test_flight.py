"""What flies within one control block: setpoints, one task, one program."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from functools import partial
from inspect import Signature, signature
from typing import Any, get_args

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.lease import Flown, LeaseRefused
from m100link.apps.agent.messages import Event, EventTopic
from m100link.apps.agent.orders import GuidedOrder
from m100link.apps.agent.server.authority import HoldingState
from m100link.apps.agent.server.mission import look_at
from m100link.errors import (
    BadSetpoint,
    GuardRefused,
    M100Error,
    MissionRefused,
    MissionRunning,
    NoAuthority,
    NotObserved,
    TaskRefused,
    UsageError,
)
from m100link.flight.control import Control
from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, Waypoint, WaypointPlan
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import Rig, airborne, guided, mission, pattern_of

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
EAST = Setpoint.velocity(north=0.0, east=1.0, up=0.0, yaw_rate_deg_s=0.0)


async def go_east(control: Control, send: Callable[[Setpoint], None]) -> None:
    async for _ in control.ticks():
        send(EAST)


def east(rig: Rig) -> float:
    return float(list(rig.aircraft.autopilot.received_movements)[-1].pitch_or_y)


async def test_a_stick_ends_a_program_and_letting_go_of_it_does_not(rig: Rig) -> None:
    await airborne(rig)
    rig.holding.require().start_pattern("east", go_east)
    await anyio.sleep(0.5)
    assert (pattern_of(rig), east(rig)) == ("east", 1.0)
    rig.agent.steer(rig.token, NORTH.neutral())
    await anyio.sleep(0.1)
    assert (pattern_of(rig), east(rig)) == ("east", 1.0)
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.05)
    assert (pattern_of(rig), east(rig)) == (None, 0.0)


async def test_one_program_ends_another(rig: Rig) -> None:
    await airborne(rig)
    rig.holding.require().start_pattern("first", go_east)
    rig.holding.require().start_pattern("second", go_east)
    await anyio.sleep(0.1)
    assert pattern_of(rig) == "second"
    told = [event.text for event in rig.agent.journal.events]
    assert "first ended: second was asked for" in told


async def test_a_program_that_is_over_says_so_and_makes_way(rig: Rig) -> None:
    async def briefly(control: Control, send: Callable[[Setpoint], None]) -> None:
        send(EAST)
        await anyio.sleep(0.1)

    await airborne(rig)
    rig.holding.require().start_pattern("briefly", briefly)
    await anyio.sleep(0.05)
    assert rig.holding.require().flown is Flown.PROGRAM
    await anyio.sleep(0.1)
    assert pattern_of(rig) is None
    assert [one.text for one in rig.agent.journal.events][-2:] == [
        "briefly begins",
        "briefly is done",
    ]


async def test_a_program_whose_setpoint_is_refused_ends_with_the_reason(rig: Rig) -> None:
    async def too_high(control: Control, send: Callable[[Setpoint], None]) -> None:
        async for _ in control.ticks():
            send(Setpoint.tilt(roll_deg=0, pitch_deg=0, height=500, yaw_rate_deg_s=0))

    await airborne(rig)
    rig.holding.require().start_pattern("too high", too_high)
    await anyio.sleep(0.5)
    assert pattern_of(rig) is None
    ends = [one.text for one in rig.agent.journal.events if one.text.startswith("too high ended")]
    assert len(ends) == 1
    assert "500" in ends[0]


async def test_a_program_that_fails_is_over(rig: Rig) -> None:
    async def fails(control: Control, send: Callable[[Setpoint], None]) -> None:
        send(EAST)
        raise MemoryError

    await airborne(rig)
    rig.holding.require().start_pattern("east", fails)
    await anyio.sleep(0.5)
    assert (pattern_of(rig), east(rig)) == (None, 0.0)
    assert rig.agent.journal.events[-1].text == "east ended: the agent failed"


async def test_a_refused_setpoint_stops_what_flew_before(rig: Rig) -> None:
    await airborne(rig)
    rig.agent.steer(rig.token, EAST, 1.0)
    await anyio.sleep(0.1)
    assert east(rig) == 1.0
    with pytest.raises((GuardRefused, BadSetpoint)):
        rig.agent.steer(
            rig.token, Setpoint.tilt(roll_deg=0, pitch_deg=0, height=500, yaw_rate_deg_s=0)
        )
    await anyio.sleep(0.05)
    assert east(rig) == 0.0


async def test_what_halts_is_a_neutral_from_its_first_frame_on(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    await airborne(rig)
    flying = rig.holding.require()
    rig.agent.steer(rig.token, EAST, 1.0)
    sent: list[Setpoint] = []
    monkeypatch.setattr(flying._control, "send", lambda setpoint, **_: sent.append(setpoint))
    flying.hover("enough")
    assert sent == [Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)]


@pytest.mark.parametrize(("order", "off"), [(orders.Land(), 26.0), (orders.GoHome(), 0.0)])
async def test_each_order_of_the_autopilot_ends_where_it_says(
    rig: Rig, order: orders.Order, off: float
) -> None:
    """26 m east of where it took off, it comes down there, or where it took off."""
    await airborne(rig)
    while rig.aircraft.position[1] < 25.0:
        rig.agent.steer(rig.token, EAST)
        await anyio.sleep(0.02)
    await anyio.sleep(3.0)
    await rig.agent.ask(order, rig.token)
    assert rig.aircraft.height < 0.1
    assert rig.aircraft.position[1] == pytest.approx(off, abs=1.5)


async def test_one_task_at_a_time(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.ask, orders.TakeOff(), rig.token)
        await anyio.sleep(0.5)
        with pytest.raises(TaskRefused, match="land was asked for during take off"):
            await rig.agent.ask(orders.Land(), rig.token)


async def test_a_task_that_the_aircraft_refuses_is_an_error_in_the_journal(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    with pytest.raises(TaskRefused):
        await rig.agent.ask(orders.Land(), rig.token)  # it stands on the ground
    *_, begins, ends = rig.agent.journal.events
    assert (begins.level, begins.text) == ("info", "land begins")
    assert (ends.level, ends.text.split(" (")[0]) == (
        "error",
        "land: land was refused: received and rejected",
    )


async def test_a_block_that_ends_ends_what_used_it(rig: Rig) -> None:
    await airborne(rig)
    flying = rig.holding.require()
    rig.holding.require().start_pattern("east", go_east)
    await anyio.sleep(0.1)
    await rig.agent.ask(orders.Release(), rig.token)
    assert flying.pattern is None
    assert not flying.has_authority
    with pytest.raises(NoAuthority):
        flying.steer(NORTH)
    await anyio.sleep(0.5)
    assert east(rig) == 0.0


# -- missions -------------------------------------------------------------------------------------


def away(rig: Rig, *north: float, at_end: AtEnd = AtEnd.HOVER) -> WaypointPlan:
    position = rig.agent.connection.require_aircraft().state.position
    assert position is not None
    frame = LocalFrame(position.latitude_deg, position.longitude_deg)
    points = [Waypoint(*frame.to_geodetic(one, 0), height=6) for one in north]
    return WaypointPlan(points, speed=5, at_end=at_end)


def speed(rig: Rig) -> float:
    return float(rig.aircraft.vehicle.flight.dynamics.speed)


@pytest.fixture
async def waypoints() -> AsyncIterator[Rig]:
    """An aircraft in the air, whose firmware flies missions."""
    async with Rig(firmware="3.1").running() as one:
        await airborne(one)
        yield one


async def test_a_client_that_waits_for_the_end_of_a_mission_hears_that_it_was_flown(
    waypoints: Rig,
) -> None:
    rig, begun = waypoints, []
    await mission(rig, away(rig, 10, 20), begun=lambda: begun.append(speed(rig)))
    assert begun
    assert rig.aircraft.position[0] == pytest.approx(20, abs=1.0)
    assert not rig.holding.require().mission.is_flying


@pytest.mark.parametrize("how", ["hover", "stop", "mission stop", "pilot", "lease"])
async def test_a_client_that_waits_for_the_end_of_a_mission_hears_what_ended_it(
    waypoints: Rig, how: str
) -> None:
    rig = waypoints
    async with anyio.create_task_group() as group:

        async def wait() -> None:
            with pytest.raises(NotObserved, match="was stopped"):
                await mission(rig, away(rig, 60, 80), begun=lambda: None)
            group.cancel_scope.cancel()

        group.start_soon(wait)
        await rig.until(lambda: speed(rig) > 3.0)
        await end_by(rig, how)
        await anyio.sleep(10.0)
    await anyio.sleep(3.0)
    assert speed(rig) < 0.1


async def test_a_stop_of_a_mission_makes_way_for_what_comes_next(waypoints: Rig) -> None:
    rig = waypoints
    await mission(rig, away(rig, 60, 80))
    with pytest.raises(MissionRunning):
        await rig.agent.ask(orders.TakeOff(), rig.token)
    await rig.agent.ask(orders.StopMission(), rig.token)
    await rig.agent.ask(orders.Land(), rig.token)
    assert rig.aircraft.height < 0.1


@pytest.mark.parametrize("order", [orders.Land(), orders.GoHome()])
@pytest.mark.parametrize("part", ["upload", "way", "of another program"])
async def test_a_way_down_stops_the_mission_that_flies(
    waypoints: Rig, order: orders.Order, part: str
) -> None:
    """An operator who holds Land is not told to stop the mission first."""
    rig = waypoints
    place = rig.aircraft.position[:2]
    flying = rig.holding.require()
    if part == "of another program":
        aircraft = rig.agent.connection.require_aircraft()
        flight = flying._control.waypoint_mission(away(rig, 60, 80))
        async with flight:
            await anyio.sleep(2.0)
            flight.detach()
        await rig.until(lambda: aircraft.mission.is_running)
    else:
        work = rig.agent.background.spawn(mission(rig, away(rig, 60, 80)), "mission")
        work.add_done_callback(look_at)
    await rig.until(lambda: flying.mission.is_flying if part == "upload" else speed(rig) > 1.0)
    before = rig.aircraft.position[:2]
    await rig.agent.ask(order, rig.token)
    assert rig.aircraft.height < 0.1
    wanted = before if isinstance(order, orders.Land) else place
    assert math.dist(rig.aircraft.position[:2], wanted) < 3.0
    assert not flying.mission.is_flying
    assert not rig.agent.connection.require_aircraft().mission.is_running


async def test_a_way_down_that_was_planned_refuses_another(waypoints: Rig) -> None:
    rig = waypoints
    await mission(rig, away(rig, 20, 30, at_end=AtEnd.LAND))
    await rig.until(lambda: rig.holding.require().mission.is_landing, within=60.0)
    with pytest.raises(MissionRunning):
        await rig.agent.ask(orders.GoHome(), rig.token)
    await rig.until(lambda: rig.aircraft.height < 0.1, within=60.0)


@pytest.mark.parametrize("after", [0.0, 0.02, 0.05, 0.1, 0.3])
async def test_stop_ends_a_landing_that_waits_for_the_stop_of_a_mission(
    waypoints: Rig, after: float
) -> None:
    rig = waypoints
    await mission(rig, away(rig, 60, 80))
    await rig.until(lambda: speed(rig) > 1.0)
    rig.aircraft.line.stall(to_aircraft=False)  # the answer to the stop waits
    height = rig.aircraft.height
    landing = rig.agent.background.spawn(rig.agent.ask(orders.Land(), rig.token), "landing")
    landing.add_done_callback(look_at)
    await anyio.sleep(after)
    stop = rig.agent.background.spawn(rig.agent.stop(), "stop")
    stop.add_done_callback(look_at)
    await anyio.sleep(0.2)
    rig.aircraft.line.stall(to_host=False, to_aircraft=False)
    await anyio.sleep(15.0)
    assert landing.done()
    assert rig.aircraft.height == pytest.approx(height, abs=0.5)
    assert speed(rig) < 0.1


async def test_a_stop_ends_a_mission_that_has_not_begun(waypoints: Rig) -> None:
    rig = waypoints
    async with anyio.create_task_group() as group:

        async def begin() -> None:
            with pytest.raises(M100Error):
                await mission(rig, away(rig, 60, 80))

        group.start_soon(begin)
        await anyio.sleep(0.02)
        assert rig.holding.require().mission.is_flying
        with pytest.raises(UsageError, match="has not begun yet") as refused:
            await rig.agent.ask(orders.PauseMission(), rig.token)
        assert refused.value.remedy == "stop the mission, or wait until it has begun"
        await rig.agent.ask(orders.StopMission(), rig.token)
        assert not rig.holding.require().mission.is_flying
    await anyio.sleep(5.0)
    assert speed(rig) < 0.1


@pytest.mark.parametrize("halts_first", [False, True])
@pytest.mark.parametrize("by", ["mission", "program"])
@pytest.mark.parametrize("after", [0.2, 1.0, 2.0])
async def test_stop_ends_a_take_off_that_a_mission_or_a_program_began(
    by: str, after: float, *, halts_first: bool
) -> None:
    """On the ground, or on its way up, it rises no further."""
    async with Rig(firmware="3.1").running() as rig:
        await rig.agent.ask(orders.Obtain(), rig.token)
        if by == "mission":
            upload = orders.UploadPlan.of(away(rig, 60, 80))
            await rig.agent.ask(upload, rig.token)
            start = rig.agent.ask(orders.StartMission(upload.digest, take_off=True), rig.token)
            rig.agent.background.spawn(start, "mission")
        else:
            await rig.agent.ask(orders.FlyPattern(2), rig.token)
        await anyio.sleep(after)
        if halts_first:
            await rig.agent.ask(orders.Halt("a tab"))
        height = rig.aircraft.height
        await rig.agent.ask(orders.Stop())
        await anyio.sleep(10.0)
        assert rig.aircraft.height < height + 0.4
        assert not rig.holding.has_authority


@pytest.mark.parametrize("at_end", [AtEnd.GO_HOME, AtEnd.LAND])
async def test_stop_ends_the_way_to_the_ground_behind_a_mission(
    waypoints: Rig, at_end: AtEnd
) -> None:
    rig = waypoints
    await mission(rig, away(rig, 30, 40, at_end=at_end))
    await rig.until(lambda: rig.holding.require().mission.is_landing, within=60.0)
    await anyio.sleep(1.0)
    received, told = rig.aircraft.autopilot.received_commands, list[bool]()
    before = len(list(received))

    def hear(event: Event) -> None:
        if event.topic is EventTopic.STOPPED:  # a slow listener would delay what comes next
            told.append(len(list(received)) > before)

    rig.agent.journal.on_event.append(hear)
    await rig.agent.stop()
    assert told == [True], "the stop had left"
    await anyio.sleep(3.0)
    height = rig.aircraft.height
    await anyio.sleep(10.0)
    assert rig.aircraft.height == pytest.approx(height, abs=0.3)
    assert height > 2.0
    assert speed(rig) < 0.1


# What has to be so in each part of a flight that takes off, flies and lands; what the state tells.
PARTS: dict[str, tuple[Callable[[Rig], bool], str | None]] = {
    "upload": (lambda rig: rig.holding.require().mission.is_flying, None),
    "motors": (lambda rig: bool(rig.holding.require().seen_task), "take off"),
    "climb": (lambda rig: rig.aircraft.height > 0.4, "take off"),
    "start": (lambda rig: rig.aircraft.height > 0.9 and not rig.holding.require().seen_task, None),
    "way": (lambda rig: speed(rig) > 3.0, None),
    "home": (lambda rig: rig.holding.require().mission.is_landing, "go home"),
    "land": (lambda rig: rig.holding.require().mission.is_landing, "land"),
}
GOES_ON = {
    (how, part): to
    for how in ("hover", "mission stop", "lease")
    # A take-off of the autopilot ends at 1.2 m, and a way down that was planned on the ground. What
    # gives authority back ends the take-off: a loss of the lease, and a mission stop on the ground.
    for part, to in {"motors": 1.2, "climb": 1.2, "home": 0.0, "land": 0.0}.items()
    if to == 0.0 or how == "hover" or (how, part) == ("mission stop", "climb")
}


async def end_by(rig: Rig, how: str) -> None:
    if how == "stop":
        await rig.agent.stop()
    elif how == "hover":
        rig.agent.hover("somebody")
    elif how == "mission stop":
        await rig.agent.ask(orders.StopMission(), rig.token)
    elif how == "pilot":
        rig.aircraft.vehicle.remote.set_mode("P")
    else:
        rig.renewing.cancel()
        rig.agent.leases.release(rig.token, rig.agent.now)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["stop", "hover", "mission stop", "pilot", "lease"])
@pytest.mark.parametrize("part", PARTS)
async def test_a_flight_from_take_off_to_landing_ends_in_each_of_its_parts(
    part: str, how: str
) -> None:
    """It brakes, and nothing begins that came after; only the autopilot's task goes on."""
    is_there, task = PARTS[part]
    async with Rig(firmware="3.1").running() as rig:
        await rig.agent.ask(orders.Obtain(), rig.token)
        at_end = AtEnd.GO_HOME if part == "home" else AtEnd.LAND
        upload = orders.UploadPlan.of(away(rig, 20, 40, at_end=at_end))
        await rig.agent.ask(upload, rig.token)
        start = rig.agent.ask(orders.StartMission(upload.digest, take_off=True), rig.token)
        rig.agent.background.spawn(start, "mission")
        await rig.until(lambda: is_there(rig), within=60.0)
        assert rig.holding.require().seen_task == task
        height, place = rig.aircraft.height, rig.aircraft.position
        await end_by(rig, how)
        await anyio.sleep(45.0 if part == "home" else 15.0)
        to = GOES_ON.get((how, part))
        expected = height if to is None else to
        assert rig.aircraft.height == pytest.approx(expected, abs=1.3 if part == "home" else 0.7)
        home = 0.0, 0.0
        there = home if (to, part) == (0.0, "home") else place[:2]
        assert math.dist(rig.aircraft.position[:2], there) < (3.0 if part == "way" else 0.5)
        assert speed(rig) < 0.1


async def test_a_mission_that_the_aircraft_refuses_after_its_take_off_hovers_there() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await rig.agent.ask(orders.Obtain(), rig.token)
        upload = orders.UploadPlan.of(away(rig, 20, 40))
        await rig.agent.ask(upload, rig.token)
        async with anyio.create_task_group() as group:

            async def drain() -> None:
                await rig.until(lambda: rig.aircraft.height > 0.4)
                rig.aircraft.battery_percent = 25  # missions do not start at it

            group.start_soon(drain)
            start = orders.StartMission(upload.digest, take_off=True)
            with pytest.raises(MissionRefused):
                await rig.agent.ask(start, rig.token)
        await anyio.sleep(5.0)
        assert rig.aircraft.height == pytest.approx(1.2, abs=0.2)
        assert math.hypot(*rig.aircraft.position[:2]) < 0.5
        assert rig.holding.require().seen_task is None
        await rig.agent.ask(orders.Land(), rig.token)
        assert rig.aircraft.height < 0.1


async def test_a_guided_flight_begins_is_reported_and_ends_for_a_program(rig: Rig) -> None:
    await airborne(rig)
    flying, began = rig.holding.require(), list[str]()
    order = orders.ChangeHeight(20.0)
    flight = rig.agent.background.spawn(flying.guide(order, lambda: began.append("now")), "flight")
    await rig.until(lambda: began == ["now"])
    await anyio.sleep(0.5)
    flown: object = guided(rig)
    assert flown is order
    assert flying.flown is Flown.GUIDED
    rig.holding.require().start_pattern("east", go_east)
    await anyio.sleep(0.5)
    assert flight.done()
    assert (guided(rig), pattern_of(rig), east(rig)) == (None, "east", 1.0)
    height = rig.aircraft.height
    await anyio.sleep(2.0)
    assert rig.aircraft.height == pytest.approx(height, abs=0.3)


# -- flights to where somebody points: they arrive, and end as soon as nobody wants them -----------


class Pointing:
    """An aircraft that hovers at 10 m, and somebody who points."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        aircraft = rig.agent.connection.require_aircraft()
        position = aircraft.state.position
        assert position is not None
        self.frame = LocalFrame(position.latitude_deg, position.longitude_deg)
        self.began: list[GuidedOrder] = []
        self.start = rig.aircraft.position

    def place(self, north: float, east: float, **values: Any) -> orders.FlyTo:
        wanted: dict[str, Any] = {"height": 10.0} | values
        return orders.FlyTo(*self.frame.to_geodetic(north, east), **wanted)

    def circle(self, north: float, east: float, **values: Any) -> orders.FlyAround:
        wanted: dict[str, Any] = {"height": 10.0, "radius": 10.0} | values
        return orders.FlyAround(*self.frame.to_geodetic(north, east), **wanted)

    async def fly(self, order: GuidedOrder) -> None:
        await self.rig.agent.ask(order, self.rig.token, lambda: self.began.append(order))

    def begin(self, order: GuidedOrder) -> asyncio.Task[M100Error | None]:
        async def flight() -> M100Error | None:
            try:
                await self.fly(order)
            except M100Error as error:
                return error
            return None

        return asyncio.create_task(flight())

    async def under_way(self, order: GuidedOrder, seconds: float = 3.0) -> Any:
        flight = self.begin(order)
        await anyio.sleep(seconds)
        assert guided(self.rig) is order
        assert self.speed > 0.5
        return flight

    @property
    def speed(self) -> float:
        dynamics = self.rig.aircraft.vehicle.flight.dynamics
        return math.hypot(dynamics.velocity_north, dynamics.velocity_east)

    def off(self, north: float, east: float) -> float:
        """Metres from a place, on the virtual aircraft itself."""
        n, e = self.rig.aircraft.position
        return math.hypot(n - self.start[0] - north, e - self.start[1] - east)

    async def assert_hovers(self, *, within: float = 3.0) -> None:
        assert guided(self.rig) is None
        await anyio.sleep(within)
        assert self.speed < 0.1
        place = self.rig.aircraft.position
        await anyio.sleep(5.0)
        assert math.dist(place, self.rig.aircraft.position) < 0.2


@pytest.fixture
async def pointing(rig: Rig) -> Pointing:
    await airborne(rig)
    await rig.agent.ask(orders.ChangeHeight(10.0), rig.token)
    return Pointing(rig)


def told(pointing: Pointing) -> list[str]:
    return [event.text for event in pointing.rig.agent.journal.events]


# -- there ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("north", "east", "speed"), [(40, 0, 5), (-20, 30, 8), (3, -2, 2)])
async def test_it_lands_within_a_metre_of_the_click(
    pointing: Pointing, north: float, east: float, speed: float
) -> None:
    order = pointing.place(north, east, height=12.0, speed=speed)
    await pointing.fly(order)
    assert pointing.began == [order]
    assert pointing.off(north, east) < 1.0
    assert pointing.rig.aircraft.height == pytest.approx(12.0, abs=1.0)
    assert told(pointing)[-2:] == ["flight to a place begins", "flight to a place is done"]
    await pointing.assert_hovers(within=0.5)


async def test_height_heading_and_orbit(pointing: Pointing) -> None:
    await pointing.fly(orders.ChangeHeight(14.0))
    assert pointing.rig.aircraft.height == pytest.approx(14.0, abs=0.5)
    await pointing.fly(orders.ChangeHeading(360.0 + 270.0))
    yaw = math.degrees(pointing.rig.aircraft.vehicle.flight.dynamics.yaw)
    assert yaw == pytest.approx(-90.0, abs=2.5)
    flight = pointing.begin(pointing.circle(20.0, 0.0, radius=10.0, speed=3.0, turns=0.5))
    await anyio.sleep(12.0)
    assert pointing.off(20.0, 0.0) == pytest.approx(10.0, abs=1.0)
    assert await flight is None


async def test_the_rest_is_reported(pointing: Pointing) -> None:
    order = pointing.place(60, 0, speed=5.0, yaw_deg=90.0)
    await pointing.under_way(order, 4.0)
    flying = pointing.rig.holding.require()
    found = flying.guiding.current()
    assert isinstance(found, orders.GuidedFlight)
    assert (found.what, found.height, found.yaw_deg) == ("flight to a place", 10.0, 90.0)
    assert (found.latitude_deg, found.longitude_deg) == (order.latitude_deg, order.longitude_deg)
    assert found.distance_m is not None
    assert found.seconds is not None
    assert found.distance_m == pytest.approx(pointing.off(60, 0), abs=0.5)
    began = pointing.rig.agent.now
    await pointing.rig.until(lambda: guided(pointing.rig) is None)
    assert pointing.rig.agent.now - began == pytest.approx(found.seconds, rel=0.25)
    assert flying.guiding.current() is None


@pytest.mark.parametrize(
    ("order", "metres", "seconds"),
    [
        # On the circle already: one turn and a half of 2 pi 10 m at 3 m/s.
        (("circle", 10.0, 0.0, {"radius": 10.0, "speed": 3.0, "turns": 1.5}), 94.2, 31.4),
        # 50 m to it at 3 m/s, then a quarter of 2 pi 10 m at 4 m/s.
        (("circle", 60.0, 0.0, {"radius": 10.0, "speed": 4.0, "turns": 0.25}), 65.7, 20.6),
        (("height", 16.0), 6.0, None),
        (("heading", 120.0), None, None),
    ],
)
async def test_the_rest_is_reported_at_the_beginning(
    pointing: Pointing, order: tuple[Any, ...], metres: float | None, seconds: float | None
) -> None:
    wanted: GuidedOrder
    match order:
        case ("circle", north, east, how):
            wanted = pointing.circle(north, east, **how)
        case ("height", height):
            wanted = orders.ChangeHeight(height)
        case (_, heading):
            wanted = orders.ChangeHeading(heading)
    flight, guiding = pointing.begin(wanted), pointing.rig.holding.require().guiding
    await pointing.rig.until(
        lambda: (one := guiding.current()) is not None and one.seconds is not None
    )
    found = guiding.current()
    assert found is not None
    assert found.distance_m == (None if metres is None else pytest.approx(metres, rel=0.1, abs=0.7))
    began, expected = pointing.rig.agent.now, found.seconds
    assert await flight is None
    took = pointing.rig.agent.now - began
    assert expected == pytest.approx(took, rel=0.35, abs=2.0)
    assert seconds is None or expected == pytest.approx(seconds, rel=0.35)


async def test_a_slow_flight_is_given_the_time_for_it(pointing: Pointing) -> None:
    """Half a metre a second is a minute for thirty metres."""
    await pointing.fly(pointing.place(30, 0, speed=0.5))
    assert pointing.off(30, 0) < 1.0


# -- ended by something else ----------------------------------------------------------------------


async def lose_lease(pointing: Pointing) -> None:
    pointing.rig.agent.leases.release(pointing.rig.token, pointing.rig.agent.now)


async def take_over(pointing: Pointing) -> None:
    rig = pointing.rig
    wanted = rig.agent.leases.ask_take_over("another", rig.agent.now)
    rig.agent.leases.confirm(wanted.token, rig.agent.now)


async def renew_no_more(pointing: Pointing) -> None:
    pointing.rig.renewing.cancel()
    await anyio.sleep(3.2)


async def halt(pointing: Pointing) -> None:
    pointing.rig.agent.hover("somebody pressed stop")


async def stop(pointing: Pointing) -> None:
    await pointing.rig.agent.stop()


async def release(pointing: Pointing) -> None:
    await pointing.rig.agent.ask(orders.Release(), pointing.rig.token)


ENDS: list[tuple[Callable[[Pointing], Any], str]] = [
    (lose_lease, "control changed hands"),
    (take_over, "control changed hands"),
    (renew_no_more, "control changed hands"),
    (halt, "somebody pressed stop"),
    (stop, "stop"),
    (release, "hover was ordered"),
]


@pytest.mark.parametrize(("end", "why"), ENDS, ids=lambda one: getattr(one, "__name__", None))
async def test_it_ends_when_nobody_wants_it(
    pointing: Pointing, end: Callable[[Pointing], Any], why: str
) -> None:
    flight = await pointing.under_way(pointing.place(100, 0), 4.0)
    await end(pointing)
    error = await flight
    assert isinstance(error, NotObserved)
    assert why in error.seen
    assert any(text.endswith(f"ended: {why}") for text in told(pointing))
    await pointing.assert_hovers()


@pytest.mark.parametrize("what", ["circle", "height"])
async def test_so_do_circles_and_climbs(pointing: Pointing, what: str) -> None:
    order = pointing.circle(15, 0, turns=5) if what == "circle" else orders.ChangeHeight(49.0)
    flight = pointing.begin(order)
    await anyio.sleep(5.0)
    dynamics = pointing.rig.aircraft.vehicle.flight.dynamics
    assert pointing.speed + abs(dynamics.velocity_up) > 0.5
    await lose_lease(pointing)
    assert isinstance(await flight, NotObserved)
    await pointing.assert_hovers()


async def test_the_stick_ends_it_and_letting_go_of_it_does_not(pointing: Pointing) -> None:
    flight = await pointing.under_way(pointing.place(0, 100))
    rig = pointing.rig
    rig.agent.steer(rig.token, NORTH.neutral())
    await anyio.sleep(0.2)
    assert guided(rig) is not None
    for _ in range(20):
        rig.agent.steer(rig.token, NORTH, 0.3)
        await anyio.sleep(0.05)
    dynamics = rig.aircraft.vehicle.flight.dynamics
    assert dynamics.velocity_north == pytest.approx(1.0, abs=0.4)
    assert "setpoints took over" in (await flight).seen
    await pointing.assert_hovers()


async def test_the_newest_wins(pointing: Pointing) -> None:
    first = await pointing.under_way(pointing.place(0, 100))
    second = pointing.begin(pointing.place(100, 0))
    third = pointing.begin(pointing.place(5, -20))  # before the second has begun
    for one in (first, second):
        error = await one
        assert isinstance(error, NotObserved)
        assert "another place was pointed at" in error.seen or "was asked for" in error.seen
    assert await third is None
    assert pointing.off(5, -20) < 1.0
    assert len(pointing.began) == 2  # the second never moved anything


async def test_a_program_and_a_guided_flight_end_each_other(pointing: Pointing) -> None:
    rig = pointing.rig

    async def go_north(control: Any, send: Callable[[Setpoint], None]) -> None:
        async for _ in control.ticks():
            send(NORTH)

    rig.holding.require().start_pattern("north", go_north)
    await anyio.sleep(0.5)
    flight = await pointing.under_way(pointing.place(0, 50))
    flying = [pattern_of(rig)]
    rig.holding.require().start_pattern("north", go_north)
    assert isinstance(await flight, NotObserved)
    await anyio.sleep(1.0)
    assert [*flying, pattern_of(rig)] == [None, "north"]
    assert rig.aircraft.vehicle.flight.dynamics.velocity_north > 0.5


async def test_a_landing_that_is_asked_for_meanwhile_lands(pointing: Pointing) -> None:
    flight = await pointing.under_way(pointing.place(100, 0))
    await pointing.rig.agent.ask(orders.Land(), pointing.rig.token)
    assert isinstance(await flight, NotObserved)
    assert pointing.rig.aircraft.height == pytest.approx(0.0, abs=0.1)
    assert guided(pointing.rig) is None


async def test_during_a_task_it_is_refused(pointing: Pointing) -> None:
    landing = asyncio.create_task(pointing.rig.agent.ask(orders.Land(), pointing.rig.token))
    await anyio.sleep(0.5)
    with pytest.raises(TaskRefused, match="flight to a place was asked for during land"):
        await pointing.fly(pointing.place(10, 0))
    await landing


async def test_a_guard_on_the_way_ends_it_with_the_reason(pointing: Pointing) -> None:
    flight = await pointing.under_way(pointing.place(100, 0))
    pointing.rig.aircraft.battery_percent = 15
    error = await flight
    assert isinstance(error, GuardRefused)
    assert error.guard == "battery_floor_percent"
    await pointing.assert_hovers()


async def test_a_target_outside_is_refused_and_what_flew_is_not_wanted_any_more(
    pointing: Pointing,
) -> None:
    flight = await pointing.under_way(pointing.place(50, 0))
    with pytest.raises(GuardRefused, match="the envelope ends at 150 m"):
        await pointing.fly(pointing.place(500, 0))
    assert isinstance(await flight, NotObserved)
    await pointing.assert_hovers()


async def test_the_pilot_who_takes_it_ends_it(pointing: Pointing) -> None:
    flight = await pointing.under_way(pointing.place(100, 0))
    pointing.rig.aircraft.set_rc_mode("P")
    error = await flight
    assert isinstance(error, NotObserved)
    assert "control was lost" in error.seen
    assert "hovers" not in error.seen  # the pilot may fly it anywhere
    await pointing.rig.until(lambda: pointing.rig.holding.state is HoldingState.PAUSED)
    pointing.rig.aircraft.set_rc_mode("F")
    await pointing.rig.until(lambda: pointing.rig.holding.has_authority)
    await pointing.assert_hovers()  # authority comes back, and nothing flies by itself


async def test_a_line_that_is_lost_ends_it(pointing: Pointing) -> None:
    flight = await pointing.under_way(pointing.place(100, 0))
    pointing.rig.aircraft.unplug()
    error = await flight
    assert isinstance(error, M100Error)
    assert "hovers" not in error.seen  # nobody sees it
    await anyio.sleep(3.0)
    assert pointing.speed < 0.1


# -- refused --------------------------------------------------------------------------------------


async def test_without_the_lease_authority_or_air_nothing_moves(rig: Rig) -> None:
    with pytest.raises(LeaseRefused):
        await rig.agent.ask(orders.ChangeHeight(5.0), "wrong")
    with pytest.raises(NoAuthority):
        await rig.agent.ask(orders.ChangeHeight(5.0), rig.token)
    await rig.agent.ask(orders.Obtain(), rig.token)
    with pytest.raises(UsageError, match="on the ground"):
        await rig.agent.ask(orders.ChangeHeight(5.0), rig.token)
    assert not rig.aircraft.autopilot.received_movements


async def test_while_a_mission_flies_it_is_refused() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await airborne(rig)
        position = rig.agent.connection.require_aircraft().state.position
        assert position is not None
        frame = LocalFrame(position.latitude_deg, position.longitude_deg)
        points = [Waypoint(*frame.to_geodetic(north, 0), height=12) for north in (20, 40)]
        await mission(rig, WaypointPlan(points))
        with pytest.raises(MissionRunning):
            await rig.agent.ask(orders.ChangeHeight(20.0), rig.token)


# -- each guided order, and the closed loop that flies it ------------------------------------------


LOOPS: dict[type[orders.Order], tuple[GuidedOrder, str, dict[str, Any]]] = {
    orders.FlyTo: (
        orders.FlyTo(22.6, -113.9, 14.0, 4.0, -45.0),
        "fly_to",
        {
            **{"latitude_deg": 22.6, "longitude_deg": -113.9, "height": 14.0},
            **{"speed": 4.0, "yaw_deg": -45.0},
        },
    ),
    orders.FlyAround: (
        orders.FlyAround(22.6, -113.9, 14.0, 12.0, 3.0, 0.5, clockwise=False),
        "orbit",
        {
            **{"center_north": 0.0, "center_east": 0.0, "radius": 12.0, "height": 14.0},
            **{"speed": 3.0, "turns": 0.5, "clockwise": False},
        },
    ),
    orders.ChangeHeight: (orders.ChangeHeight(6.5), "climb_to", {"height": 6.5}),
    orders.ChangeHeading: (orders.ChangeHeading(200.0), "turn_to", {"yaw_deg": -160.0}),
}
"""By hand: each order, the loop that flies it, and what that is given: metres, degrees, m/s."""


@pytest.mark.parametrize("kind", get_args(orders.GuidedOrder), ids=lambda kind: kind.__name__)
async def test_each_guided_order_is_foreseen_and_flown_by_its_own_loop(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, kind: type[orders.Order]
) -> None:
    assert kind in LOOPS, f"LOOPS of this file has no row for {kind.__name__}"
    order, loop, values = LOOPS[kind]
    await airborne(rig)
    control = rig.holding.require().guiding._control
    flown = list[tuple[str, dict[str, Any]]]()

    async def fly(name: str, called: Signature, *given: object, **named: object) -> None:
        flown.append((name, dict(called.bind(*given, **named).arguments)))

    for _, name, _ in LOOPS.values():
        monkeypatch.setattr(control, name, partial(fly, name, signature(getattr(control, name))))
    await rig.agent.ask(order, rig.token)
    [(name, given)] = flown
    frame, timeout = given.pop("frame", None), given.pop("timeout")
    assert (name, {**given, **values}) == (loop, given)
    assert given.keys() - values.keys() <= {"progress", "approach"}
    if isinstance(order, orders.FlyAround):
        assert (frame.latitude_deg, frame.longitude_deg) == (22.6, -113.9)
    else:
        assert timeout >= 30.0, "a gust may hold up a flight of a second, too"
        assert frame is None


@pytest.mark.parametrize("order", [orders.TakeOff(), orders.StartMotors(), orders.StopMotors()])
async def test_an_order_that_does_nothing_in_flight_ends_the_setpoint_before_it(
    rig: Rig, order: orders.Order
) -> None:
    await airborne(rig)
    for wait in (0.3, 0.305, 0.31, 0.315):  # also where the period of a frame gets no second one
        rig.agent.steer(rig.token, EAST, 1.0)
        await anyio.sleep(wait)
        assert east(rig) == 1.0
        work = rig.agent.background.spawn(rig.agent.ask(order, rig.token), "order")
        await anyio.sleep(0.04)
        assert east(rig) == 0.0
        with anyio.move_on_after(5.0):
            await asyncio.wait([work])
        assert work.exception() is not None or isinstance(order, orders.StartMotors)
        assert east(rig) == 0.0
