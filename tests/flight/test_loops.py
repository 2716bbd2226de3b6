"""Closed loops over the virtual aircraft: they arrive, say so, and stop whatever happens."""

from __future__ import annotations

import asyncio
import inspect
import math
import pydoc
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from random import Random
from typing import Any, assert_type

import pytest

from m100link import (
    Arrival,
    AuthorityLost,
    Control,
    Envelope,
    FlightPhase,
    GuardRefused,
    Guards,
    NoAuthority,
    NotObserved,
    Position,
    Setpoint,
    SetpointsIgnored,
    TaskRefused,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.guidance import Guidance, GuidanceProgress, _Settling
from m100link.flight.loops import ClosedLoops, _towards
from m100link.geodesy import LocalFrame
from m100link.missions.patterns import survey
from m100link.protocol import PROFILES, encode_telemetry
from m100link.protocol.commands.control import Move
from m100link.sim import AircraftSettings, LineFaults
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from tests.rig import FIRMWARES, Rig, rig

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)


@asynccontextmanager
async def flying(
    guards: Guards | None = None, **options: Any
) -> AsyncIterator[tuple[Rig, Control]]:
    async with rig(**options) as flown, flown.aircraft.control(guards=guards) as control:
        await control.take_off()
        yield flown, control


Loop = Callable[[Control], Awaitable[object]]
AWAY = Setpoint.velocity(north=-9.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def fly(**target: float) -> Loop:
    return lambda control: control.fly_to(**target)  # type: ignore[arg-type]


def climb(height: float) -> Loop:
    return lambda control: control.climb_to(height)


def turn(yaw_deg: float) -> Loop:
    return lambda control: control.turn_to(yaw_deg)


def orbit(**circle: float) -> Loop:
    return lambda control: control.orbit(**circle)  # type: ignore[arg-type]


async def PATH(control: Control) -> None:  # noqa: N802 (a loop like those that are made above)
    await control.fly_path([(20.0, 0.0, 3.0), (20.0, 10.0, 3.0)], speed=3.0)


def heading(flown: Rig) -> float:
    return math.degrees(flown.virtual.vehicle.flight.dynamics.yaw)


@each_firmware
@pytest.mark.parametrize(
    ("north", "east", "up"), [(5, 0, 0), (0, -5, 2), (30, 40, 10), (-3, 3, -0.5), (0, 0, 0)]
)
async def test_fly_to_an_offset_arrives_and_hovers_there(
    firmware: str, north: float, east: float, up: float
) -> None:
    async with flying(firmware=firmware) as (flown, control):
        (n0, e0), h0 = flown.virtual.position, flown.virtual.height
        arrival = await control.fly_to(north=north, east=east, up=up)
        n1, e1 = flown.virtual.position
        assert math.hypot(n1 - n0 - north, e1 - e0 - east) < 0.6
        assert flown.virtual.height - h0 == pytest.approx(up, abs=0.6)
        assert arrival.distance_m <= 0.5
        assert abs(arrival.height_error_m) <= 0.5
        await flown.assert_hovers()


async def test_fly_to_a_place_by_latitude_and_longitude() -> None:
    async with flying() as (flown, control):
        position = flown.aircraft.state.get(Position)
        assert position is not None
        there = LocalFrame(position.latitude_deg, position.longitude_deg).to_geodetic(12.0, -7.0)
        await control.fly_to(latitude_deg=there[0], longitude_deg=there[1], height=6.0)
        assert flown.virtual.position == pytest.approx((12.0, -7.0), abs=0.6)
        assert flown.virtual.height == pytest.approx(6.0, abs=0.6)


async def test_fly_to_keeps_its_heading_or_takes_the_one_that_is_wanted() -> None:
    async with flying(settings=AircraftSettings(heading_deg=70.0)) as (flown, control):
        await control.fly_to(north=5, east=5, up=1)
        assert heading(flown) == pytest.approx(70.0, abs=3)
        arrival = await control.fly_to(north=-5, east=-5, up=0, yaw_deg=-170)
        assert heading(flown) == pytest.approx(-170, abs=6)
        assert abs(arrival.heading_error_deg) <= 5


@pytest.mark.parametrize("seed", range(3))
async def test_fly_to_in_wind_with_noisy_sensors(seed: int) -> None:
    settings = AircraftSettings(wind_north=4.0, wind_east=-3.0, gusts=1.0, noise=1.0)
    async with flying(settings=settings, seed=seed) as (flown, control):
        await control.fly_to(north=15, east=10, up=3, tolerance_m=1.0)
        assert flown.virtual.position == pytest.approx((15, 10), abs=2.5)


async def test_progress_counts_down() -> None:
    seen: list[GuidanceProgress] = []
    async with flying() as (_, control):
        await control.fly_to(north=10, east=0, up=0, progress=seen.append)
    assert seen[0].distance_m == pytest.approx(10, abs=0.2)
    assert seen[-1].distance_m <= 0.5
    assert [p.elapsed for p in seen] == sorted(p.elapsed for p in seen)


async def test_what_remains_has_the_sign_of_the_way_to_go() -> None:
    """Metres to the place, metres up, degrees clockwise: negative is down, and to the left."""

    async def of(loop: Callable[..., Awaitable[object]], *target: object, **options: Any) -> Any:
        seen: list[GuidanceProgress] = []
        with pytest.raises(NotObserved):
            await loop(*target, **options, timeout=0.03, progress=seen.append)
        found = seen[0]
        return found.distance_m, found.height_error_m, found.heading_error_deg

    async with flying() as (flown, control):
        assert control.state.position is not None
        high, nose = control.state.position.height_m, heading(flown)
        places = {
            (3.0, 4.0, 2.0): (5.0, 2.0, 0.0),
            (0.0, -6.0, -0.5): (6.0, -0.5, 0.0),
        }
        for (north, east, up), wanted in places.items():
            there = {"north": north, "east": east, "up": up}
            assert await of(control.fly_to, **there) == pytest.approx(wanted, abs=0.15)
            point = north, east, high + up
            found = await of(control.fly_path, [point], speed=2.0)
            assert found == pytest.approx(wanted, abs=0.15)
        for up in (2.0, -0.5):
            found = await of(control.climb_to, high + up)
            assert found == pytest.approx((0.0, up, 0.0), abs=0.15)
        for turned in (90.0, -100.0):
            to = math.remainder(nose + turned, 360.0)
            assert await of(control.turn_to, to) == pytest.approx((0.0, 0.0, turned), abs=6.0)
            found = await of(control.fly_to, north=0.0, east=0.0, up=0.0, yaw_deg=to)
            assert found == pytest.approx((0.0, 0.0, turned), abs=12.0)
        circle = {"center_north": 5.0, "center_east": 0.0, "turns": 2.0}
        assert await of(control.orbit, **circle) == pytest.approx((0.0, 0.0, 720.0), abs=0.2)


async def test_a_far_place_is_asked_for_ten_metres_at_a_time() -> None:
    """The autopilot flies larger offsets no faster, and a wrong position must not matter."""
    async with flying() as (flown, control):
        with pytest.raises(NotObserved):
            await control.fly_to(north=60, east=-80, up=0, timeout=0.3)
        offsets = [(move.roll_or_x, move.pitch_or_y) for move in list(flown.moves)[1:8]]
        assert offsets == [pytest.approx((6.0, -8.0), abs=0.05)] * 7


@pytest.mark.parametrize(
    "target",
    [
        {},
        {"north": 1.0},
        {"north": 1.0, "east": 1.0},
        {"north": 1.0, "east": 1.0, "up": 0.0, "height": 3.0},
        {"latitude_deg": 22.0, "longitude_deg": 113.0},
        {"north": math.nan, "east": 0.0, "up": 0.0},
        {"north": 0.0, "east": 0.0, "up": -50.0},
        {"latitude_deg": 95.0, "longitude_deg": 0.0, "height": 3.0},
    ],
    ids=str,
)
async def test_a_target_that_is_none_is_refused_before_anything_moves(
    target: dict[str, float],
) -> None:
    async with flying() as (flown, control):
        with pytest.raises(UsageError):
            await control.fly_to(**target)  # type: ignore[arg-type]
        assert len(flown.moves) == 0


async def test_what_does_not_arrive_in_time_says_what_remains_and_hovers() -> None:
    async with flying() as (flown, control):
        with pytest.raises(NotObserved, match="did not arrive within 3 s") as caught:
            await control.fly_to(north=100, east=0, up=0, timeout=3)
        assert "m of height" in caught.value.seen
        assert "flight_status IN_AIR" in caught.value.seen
        assert caught.value.situation["flight_status"] == "IN_AIR"
        await flown.assert_hovers()


async def test_a_position_that_is_not_sent_is_reported_after_half_a_second() -> None:
    async with flying() as (flown, control):
        flown.virtual.set_rates(position=0)
        await asyncio.sleep(1.0)
        before = len(flown.moves)
        with pytest.raises(TelemetryStalled, match="the position is needed"):
            async with asyncio.timeout(0.6):
                await control.fly_to(north=5, east=0, up=0)
        assert len(flown.moves) == before


async def test_a_position_that_stops_on_the_way_stops_the_aircraft() -> None:
    async with flying() as (flown, control):
        asyncio.get_running_loop().call_later(2.0, lambda: flown.virtual.set_rates(position=0))
        with pytest.raises((TelemetryStalled, GuardRefused)):
            await control.fly_to(north=50, east=0, up=0)
        flown.assert_stopped_in_order()
        await flown.assert_hovers()


@pytest.mark.parametrize(
    ("loop", "target", "option"),
    [
        (fly(north=60, east=0, up=0), "60 m from the start", "max_radius_m"),
        (fly(north=0, east=0, up=15), "a height of 16.2 m", "max_height_m"),
        (climb(15), "a height of 15.0 m", "max_height_m"),
        (orbit(center_north=15, center_east=0), "30 m from the start", "max_radius_m"),
        (orbit(center_north=8, center_east=0, speed=2.5), "a speed of 2.5 m/s", "max_speed_m_s"),
    ],
    ids=["far", "up", "climb", "circle", "speed"],
)
async def test_a_target_outside_the_envelope_is_refused_before_anything_moves(
    loop: Loop, target: str, option: str
) -> None:
    guards = Guards(envelope=Envelope(max_radius_m=20, max_height_m=10, max_speed_m_s=2))
    async with flying(guards) as (flown, control):
        with pytest.raises(GuardRefused) as caught:
            await loop(control)
        assert target in caught.value.seen
        ends, unit = ("allows", "m/s") if "speed" in target else ("ends at", "m")
        assert caught.value.seen.endswith(f"the envelope {ends} {caught.value.limit:g} {unit}")
        assert option in caught.value.off
        assert len(flown.moves) == 0


async def test_a_target_inside_the_envelope_by_its_place_is_flown_to_from_outside() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=20), integrity=False)
    async with flying(guards) as (flown, control):
        flown.virtual.vehicle.flight.dynamics.place(40.0, 0.0, 3.0)
        await asyncio.sleep(0.1)
        await control.fly_to(north=-25, east=0, up=0)
        assert flown.virtual.position == pytest.approx((15, 0), abs=0.6)


@pytest.mark.parametrize(
    "loop",
    [fly(north=1, east=0, up=0), climb(3), turn(90), orbit(center_north=5, center_east=0), PATH],
    ids=["fly_to", "climb_to", "turn_to", "orbit", "fly_path"],
)
async def test_on_the_ground_a_loop_is_refused_before_anything_moves(loop: Loop) -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        with pytest.raises(UsageError, match="on the ground") as caught:
            await loop(control)
        assert "take_off()" in caught.value.remedy
        assert "STANDBY" in caught.value.seen
        assert len(flown.moves) == 0


@pytest.mark.parametrize(
    "second",
    [fly(north=1, east=0, up=0), climb(3), turn(90), orbit(center_north=5, center_east=0), PATH],
    ids=["fly_to", "climb_to", "turn_to", "orbit", "fly_path"],
)
async def test_a_second_loop_is_refused_and_leaves_the_first_alone(second: Loop) -> None:
    async with flying() as (flown, control):
        first = asyncio.create_task(control.fly_to(north=10, east=0, up=0))
        await asyncio.sleep(1.0)
        with pytest.raises(UsageError, match="another closed loop is flying: fly_to"):
            await second(control)
        await first
        assert flown.virtual.position == pytest.approx((10, 0), abs=0.6)
        await second(control)


LOOPS = pytest.mark.parametrize(
    ("name", "loop"),
    [
        ("fly_to", fly(north=20, east=0, up=0)),
        ("climb_to", climb(8)),
        ("turn_to", turn(170)),
        ("orbit", orbit(center_north=5, center_east=0)),
        ("fly_path", PATH),
    ],
)


@LOOPS
async def test_nothing_else_steers_while_a_loop_flies(name: str, loop: Loop) -> None:
    async with flying() as (flown, control):
        first = asyncio.ensure_future(loop(control))
        await asyncio.sleep(1.0)
        frames = len(flown.moves)
        with pytest.raises(UsageError, match=f"a closed loop is flying: {name}"):
            control.send(AWAY)
        with pytest.raises(UsageError, match=name):
            async with control.hold(AWAY):
                pytest.fail("entered")
        with pytest.raises(UsageError, match=name):
            await control.follow(lambda _: AWAY)
        with pytest.raises(UsageError, match=f"a raw movement command .*{name}"):
            control.send_raw_move_as_expert(Move(0x4B, -9.0, 0.0, 0.0, 0.0))
        assert not first.done()
        await first
        assert len(flown.moves) > frames + 10
        assert all(move.roll_or_x > -9.0 for move in flown.moves)
        control.send(AWAY)


@LOOPS
async def test_stop_and_a_task_end_the_loop_that_flies(name: str, loop: Loop) -> None:
    """Otherwise its next setpoint would come 20 ms later; a task ends it although it is refused."""
    async with flying() as (flown, control):
        flight = asyncio.ensure_future(loop(control))
        await asyncio.sleep(1.0)
        await control.stop()
        with pytest.raises(NotObserved, match=f"{name} was stopped"):
            await flight
        await asyncio.sleep(0.5)
        flown.assert_stopped_in_order()
        await flown.assert_hovers()
        flight = asyncio.ensure_future(loop(control))
        await asyncio.sleep(0.2)
        with pytest.raises(TaskRefused, match="take off was refused"):
            await control.take_off()
        with pytest.raises(NotObserved, match=f"{name} was stopped"):
            await flight
        await control.climb_to(3.0)


@pytest.mark.parametrize("order", ["stop", "take_off"])
async def test_what_ends_an_orbit_between_its_two_flights_ends_it(order: str) -> None:
    """It hovers for 0.3 s where the circle begins; a stop then was forgotten, and it circled on."""
    async with flying() as (flown, control):
        circle = asyncio.ensure_future(control.orbit(center_north=5, center_east=0, radius=4.5))
        await asyncio.sleep(0.5)
        while control._guidance.flying:  # noqa: ASYNC110 - no event tells of it
            await asyncio.sleep(0.01)
        assert not circle.done()
        if order == "stop":
            await control.stop()
        else:
            with pytest.raises(TaskRefused, match="take off was refused"):
                await control.take_off()
        with pytest.raises(GuardRefused):  # another call that does not fly revives nothing
            await control.climb_to(500.0)
        with pytest.raises(NotObserved, match=r"orbit was stopped; .* \+360° remain"):
            await circle
        await flown.assert_hovers()


async def test_a_program_that_cancels_a_loop_may_steer_at_once() -> None:
    async with flying() as (flown, control):
        flight = asyncio.create_task(control.fly_to(north=20, east=0, up=0))
        await asyncio.sleep(1.0)
        flight.cancel()
        control.send(AWAY)
        await flown.fly(control, 1.0)
        assert flight.cancelled()


async def test_a_loop_whose_block_is_over_says_that_and_not_that_it_flies() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            flight = asyncio.create_task(control.fly_to(north=20, east=0, up=0))
            await asyncio.sleep(1.0)
        with pytest.raises(NoAuthority, match="over with this block"):
            control.send(AWAY)
        with pytest.raises(NoAuthority):
            await flight
        await flown.assert_hovers()


def test_the_loops_are_methods_of_control_with_their_own_words() -> None:
    """For help(), the manual and editors, which look at the class."""
    shown = pydoc.plain(pydoc.render_doc(Control))
    without_space = "".join(shown.replace("|", " ").split())  # from 3.13 on long lines are cut
    for name in ("fly_to", "fly_path", "climb_to", "turn_to", "orbit"):
        mine, its = getattr(Control, name), getattr(ClosedLoops, name)
        assert inspect.iscoroutinefunction(mine)
        assert (mine.__doc__, inspect.signature(mine)) == (its.__doc__, inspect.signature(its))
        assert f"async{name}(self" in without_space


async def what_mypy_knows(control: Control) -> None:
    """Never called: the types are what is tested."""
    assert_type(await control.fly_to(north=1.0, east=0.0, up=0.0), Arrival)
    await control.fly_to(nrth=1.0)  # type: ignore[call-arg]  # no such argument


async def test_a_flight_status_that_stopped_on_the_ground_does_not_forbid_a_flight() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        flown.virtual.set_rates(flight_status=0)
        await control.take_off()
        assert flown.aircraft.state.flight_status is not None
        assert flown.aircraft.state.flight_status.phase is FlightPhase.STANDBY
        await control.fly_to(north=3, east=0, up=0)


async def test_a_loop_that_is_landed_on_the_way_says_so_and_stops() -> None:
    async with flying() as (flown, control):
        asyncio.get_running_loop().call_later(1.0, flown.virtual.vehicle.flight.land)
        with pytest.raises(NotObserved, match="ended on the ground") as caught:
            await control.turn_to(90, tolerance_deg=-1, timeout=60)
        assert caught.value.situation["flight_status"] == "STANDBY"
        assert "landed" in caught.value.cause


async def test_cancelling_a_loop_stops_the_aircraft() -> None:
    async with flying() as (flown, control):
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(3.0):
                await control.fly_to(north=100, east=0, up=0)
        await asyncio.sleep(0.5)
        flown.assert_stopped_in_order()
        await flown.assert_hovers()


async def test_the_pilot_ends_a_loop() -> None:
    with pytest.raises(AuthorityLost):
        async with flying() as (flown, control):
            asyncio.get_running_loop().call_later(2.0, flown.virtual.leave_f)
            await control.fly_to(north=100, east=0, up=0)


@each_firmware
@pytest.mark.parametrize("height", [8.0, 0.8])
async def test_climb_to(firmware: str, height: float) -> None:
    async with flying(firmware=firmware) as (flown, control):
        before = flown.virtual.position
        arrival = await control.climb_to(height)
        assert flown.virtual.height == pytest.approx(height, abs=0.35)
        assert abs(arrival.height_error_m) <= 0.3
        assert flown.virtual.position == pytest.approx(before, abs=0.2)


@pytest.mark.parametrize(
    "loop",
    [
        *(fly(north=0, east=0, up=-6.0, timeout=2.0), fly(north=0, east=0, up=6.0, timeout=2.0)),
        *(fly(north=6, east=0, up=0, timeout=2.0), fly(north=0, east=-6, up=0, timeout=2.0)),
        fly(north=0, east=0, up=0, yaw_deg=120.0, timeout=2.0),
        fly(north=0, east=0, up=0, yaw_deg=-120.0, timeout=2.0),
        lambda control: control.fly_path([(0.1, 0.0, 4.0)], speed=4.0, timeout=2.0),
        lambda control: control.fly_path([(0.1, 0.0, 16.0)], speed=4.0, timeout=2.0),
        lambda control: control.climb_to(4.0, timeout=2.0),
        lambda control: control.climb_to(16.0, timeout=2.0),
        lambda control: control.turn_to(120.0, timeout=2.0),
        lambda control: control.turn_to(-120.0, timeout=2.0),
    ],
)
async def test_one_that_does_not_move_has_not_arrived(loop: Loop) -> None:
    """What remains counts with either sign: neither below nor above is there."""
    async with flying(Guards(integrity=False)) as (flown, control):
        await control.climb_to(10.0)
        motion = flown.virtual.vehicle.flight.dynamics
        motion.airframe = replace(
            motion.airframe, vertical_speed=0.0, yaw_rate_deg=0.0, velocity_gain=0.0, drag=0.0
        )
        with pytest.raises(NotObserved, match="did not arrive"):
            await loop(control)


@pytest.mark.parametrize(("age", "settles"), [(0.4, False), (0.6, True)])
async def test_a_velocity_of_long_ago_keeps_none_from_settling(age: float, settles: bool) -> None:
    """Of half a second ago or older: the item may be switched off, and time has to do."""
    state = AircraftState(asyncio.get_running_loop().time)
    value = encode_telemetry({"velocity": (8.0, 0.0, 0.0)}, PROFILES["1.0"])
    settling = _Settling(state)
    for _ in range(200):
        state.update(Sample(value, PROFILES["1.0"], asyncio.get_running_loop().time() - age))
        has_settled = settling.update(is_within=True)
        await asyncio.sleep(0.02)
    assert has_settled is settles


@pytest.mark.parametrize("vertical_down", [False, True])
@pytest.mark.parametrize(
    "loop",
    [
        lambda control: control.climb_to(25.0, tolerance_m=15.0),
        lambda control: control.climb_to(3.0, tolerance_m=15.0),
        lambda control: control.fly_to(north=20, east=0, up=0, tolerance_m=15.0),
        lambda control: control.fly_to(north=0, east=-20, up=0, tolerance_m=15.0),
    ],
    ids=["up", "down", "north", "west"],
)
async def test_nothing_has_arrived_that_still_moves(loop: Loop, vertical_down: bool) -> None:
    """Where the tolerance is wide, the speed tells: up and down, of either sign on the wire."""
    settings = AircraftSettings(vertical_down=vertical_down)
    async with flying(settings=settings) as (flown, control):
        await control.climb_to(12.0)
        await loop(control)
        motion = flown.virtual.vehicle.flight.dynamics
        assert abs(motion.velocity_up) < 0.35
        assert motion.speed < 0.35


@each_firmware
@pytest.mark.parametrize(("start", "end"), [(0, 90), (170, -170), (-90, 90), (10, 5)])
async def test_turn_to_takes_the_short_way(firmware: str, start: float, end: float) -> None:
    settings = AircraftSettings(heading_deg=start)
    async with flying(firmware=firmware, settings=settings) as (flown, control):
        began = flown.now
        arrival = await control.turn_to(end)
        assert abs(math.remainder(heading(flown) - end, 360)) <= 2.5
        assert abs(arrival.heading_error_deg) <= 2.0
        assert flown.now - began < 8.0


# -- frames, speeds, paths, circles elsewhere ------------------------------------------------------


async def test_legs_in_one_frame_do_not_add_up_what_each_missed() -> None:
    async with flying(settings=AircraftSettings(noise=1.0), seed=3) as (flown, control):
        home, (n0, e0) = control.local_frame(), flown.virtual.position
        for _ in range(4):
            for north, east in ((4, 0), (4, 4), (0, 4), (0, 0)):
                await control.fly_to(north=north, east=east, height=3.0, frame=home)
        n1, e1 = flown.virtual.position
        assert math.hypot(n1 - n0, e1 - e0) < 1.0


@pytest.mark.parametrize("speed", [0.5, 2.0, 6.0])
async def test_fly_to_is_not_faster_than_ordered(speed: float) -> None:
    fastest = 0.0

    def look(_: GuidanceProgress) -> None:
        nonlocal fastest
        fastest = max(fastest, flown.speed)

    async with flying() as (flown, control):
        arrival = await control.fly_to(north=12, east=5, up=2, speed=speed, progress=look)
        assert arrival.distance_m <= 0.5
        assert fastest < speed * 1.1 + 0.05
        assert fastest > min(speed, 3.0) * 0.8
        await flown.assert_hovers()


@pytest.mark.parametrize("speed", [0.0, -1.0, 11.0, math.nan])
async def test_a_speed_that_cannot_be_flown_is_refused(speed: float) -> None:
    async with flying(Guards(envelope=None)) as (flown, control):
        with pytest.raises(UsageError, match="cannot be flown"):
            await control.fly_to(north=1, east=0, up=0, speed=speed)
        with pytest.raises(UsageError, match="cannot be flown"):
            await control.fly_path([(5, 0, 3)], speed=speed)
        assert len(flown.moves) == 0


@each_firmware
async def test_a_path_is_flown_through_its_rounded_corners(firmware: str) -> None:
    points = [(15.0, 0.0, 4.0), (15.0, 15.0, 6.0), (0.0, 15.0, 4.0)]
    track: list[tuple[float, float]] = []
    async with flying(firmware=firmware) as (flown, control):
        n0, e0 = flown.virtual.position

        def look(_: GuidanceProgress) -> None:
            north, east = flown.virtual.position
            track.append((north - n0, east - e0))

        arrival = await control.fly_path(points, speed=3.0, corner_radius=4.0, progress=look)
        assert arrival.distance_m <= 0.5
        assert arrival.elapsed < 30
        assert track[-1] == pytest.approx((0, 15), abs=0.7)
        # A corner of 90° rounded by 4 m is passed at 4·(√2 − 1) m.
        for corner in ((15.0, 0.0), (15.0, 15.0)):
            nearest = min(math.dist(place, corner) for place in track)
            assert nearest == pytest.approx(4 * (math.sqrt(2) - 1), abs=0.9)
        assert flown.virtual.height == pytest.approx(4.0, abs=0.6)
        await flown.assert_hovers()


async def test_a_path_in_wind_and_noise_looks_ahead() -> None:
    settings = AircraftSettings(wind_north=3.0, wind_east=-2.0, gusts=1.0, noise=1.0)
    async with flying(settings=settings, seed=2) as (flown, control):
        await control.fly_path(
            [(0, 20, 5), (20, 20, 5)], speed=3.0, face_ahead=True, tolerance_m=1.0
        )
        assert flown.virtual.position == pytest.approx((20, 20), abs=2.5)
        assert heading(flown) == pytest.approx(0.0, abs=10)


async def test_a_point_of_a_path_outside_the_envelope_is_refused_before_anything_moves() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=20, max_height_m=10, max_speed_m_s=4))
    async with flying(guards) as (flown, control):
        with pytest.raises(GuardRefused, match=r"point 1 of fly_path to 30 m from the start"):
            await control.fly_path([(5, 0, 3), (30, 0, 3)], speed=2)
        with pytest.raises(GuardRefused, match=r"point 0 of fly_path to a height of 11"):
            await control.fly_path([(5, 0, 11)], speed=2)
        with pytest.raises((GuardRefused, UsageError), match="5 m/s"):
            await control.fly_path([(5, 0, 3)], speed=5)
        with pytest.raises(UsageError):
            await control.fly_path([], speed=2)
        assert len(flown.moves) == 0


async def test_a_survey_over_a_field_is_flown() -> None:
    field = [(0.0, 0.0), (0.0, 12.0), (20.0, 12.0), (20.0, 0.0)]
    seen: list[tuple[float, float]] = []
    async with flying() as (flown, control):
        points = survey(field, spacing=4.0, height=5.0)
        await control.fly_path(
            points, speed=4.0, progress=lambda _: seen.append(flown.virtual.position)
        )
    for north, east, _ in points:
        assert min(math.dist(place, (north, east)) for place in seen) < 1.6


@pytest.mark.parametrize("start_deg", [None, 0.0, 90.0, -135.0])
async def test_an_orbit_elsewhere_begins_where_it_was_ordered(start_deg: float | None) -> None:
    track: list[tuple[float, float]] = []
    async with flying() as (flown, control):
        home, (n0, e0) = control.local_frame(), flown.virtual.position

        def look(_: GuidanceProgress) -> None:
            north, east = flown.virtual.position
            track.append((north - n0 - 10, east - e0 - 10))

        await control.orbit(
            center_north=10,
            center_east=10,
            frame=home,
            radius=6,
            height=6,
            start_deg=start_deg,
            progress=look,
        )
        assert flown.virtual.height == pytest.approx(6, abs=0.6)
    first = math.degrees(math.atan2(track[0][1], track[0][0]))
    wanted = -135.0 if start_deg is None else start_deg  # the aircraft is south-west of it
    assert abs(math.remainder(first - wanted, 360)) < 10
    assert all(abs(math.hypot(*place) - 6) < 0.8 for place in track)


async def test_the_radius_of_a_circle_elsewhere_is_how_far_its_centre_is() -> None:
    """By default; both counted from the origin of the frame, which lies on another side."""
    async with flying() as (flown, control):
        home = control.local_frame()
        north, east = flown.virtual.position
        await control.fly_to(north=3.0, east=0.0, up=5.0)
        began = flown.virtual.position
        await control.orbit(center_north=9.0, center_east=-8.0, frame=home, turns=0.25)
        away = flown.virtual.position[0] - north - 9.0, flown.virtual.position[1] - east + 8.0
        assert math.hypot(*away) == pytest.approx(10.0, abs=0.8)
        assert math.dist(began, flown.virtual.position) == pytest.approx(14.1, abs=1.5)


async def test_a_frame_belongs_to_an_offset() -> None:
    async with flying() as (flown, control):
        home = control.local_frame()
        with pytest.raises(UsageError, match="neither as an offset nor as a place"):
            await control.fly_to(latitude_deg=22.0, longitude_deg=113.0, height=3.0, frame=home)
        with pytest.raises(UsageError, match="neither from here nor above take-off"):
            await control.fly_to(north=1, east=1, up=1, height=3.0, frame=home)
        assert len(flown.moves) == 0


@pytest.mark.parametrize("stands_still", [0.3, 0.9, 3.0])
async def test_a_program_that_stood_still_reads_what_arrived_before_it_calls_it_old(
    stands_still: float,
) -> None:
    async with flying() as (_, control):
        loop = asyncio.get_running_loop()

        def stand_still() -> None:
            loop._jumping.now += stands_still  # type: ignore[attr-defined]

        for after in (0.5, 0.503, 0.511):
            loop.call_later(after, stand_still)
            arrival = await control.fly_to(north=3.0, east=0.0, up=0.0)
            assert arrival.distance_m < 1.0
        stand_still()  # between two of them
        assert (await control.fly_to(north=3.0, east=0.0, up=0.0)).distance_m < 1.0


@pytest.mark.parametrize("bearing_deg", [0, 90, 180, 270])
def test_the_greatest_speed_is_a_setpoint_in_every_direction(bearing_deg: int) -> None:
    """A setpoint takes up to 10 m/s; rounded up it would end the flight."""
    chance = Random(f"fastest {bearing_deg}")
    for _ in range(2_000):
        far, bearing = chance.uniform(25.0, 500.0), math.radians(bearing_deg)
        remaining = far * math.cos(bearing), far * math.sin(bearing)
        made = _towards(remaining, chance.choice((far, math.hypot(*remaining))), 10.0, 0.0, 10.0)
        assert made.mode is not None


SMALL_DEMANDS: dict[str, Callable[[Control], Awaitable[object]]] = {
    "climb": lambda control: control.climb_to(2.5),
    "climb far": lambda control: control.climb_to(30.0),
    "descent": lambda control: control.climb_to(0.5),
    "turn": lambda control: control.turn_to(15.0),
    "way": lambda control: control.fly_to(north=2.0, east=0.0, up=0.0),
    "slow way": lambda control: control.fly_to(north=5.0, east=0.0, up=0.0, speed=0.5),
    "path": lambda control: control.fly_path([(5.0, 0.0, 1.2), (5.0, 5.0, 1.2)], speed=0.5),
    "orbit": lambda control: control.orbit(center_north=5.0, center_east=0.0, speed=0.5),
}


@pytest.mark.parametrize("what", SMALL_DEMANDS)
async def test_a_loop_whose_setpoints_move_nothing_says_so_early(what: str) -> None:
    async with rig() as flown:
        with pytest.raises(SetpointsIgnored) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                flown.virtual.set_faults(LineFaults(deaf=True))
                began_at = flown.now
                try:
                    await SMALL_DEMANDS[what](control)
                finally:
                    took = flown.now - began_at
        assert took < 8.0
        assert "TX of the cable" in caught.value.remedy
        assert flown.virtual.height == pytest.approx(1.2, abs=0.2)


@pytest.mark.parametrize("what", SMALL_DEMANDS)
async def test_the_same_loops_arrive_through_noise_and_gusts(what: str) -> None:
    settings = AircraftSettings(wind_north=4.0, gusts=1.0, noise=1.0)
    async with rig(settings=settings) as flown, flown.aircraft.control() as control:
        await control.take_off()
        await SMALL_DEMANDS[what](control)


async def test_corrections_of_a_slow_flight_are_no_demand() -> None:
    """5 cm a second through noise, whose corrections ask for 20 cm a second to and fro."""
    settings = AircraftSettings(wind_north=4.0, wind_east=2.0, gusts=1.0, noise=1.0)
    async with rig(settings=settings) as flown, flown.aircraft.control() as control:
        await control.take_off()
        with pytest.raises(NotObserved, match="within 15 s"):
            await control.fly_path([(5.0, 0.0, 1.2)], speed=0.05, timeout=15.0)


async def test_a_flight_of_10_cm_a_second_takes_its_time() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        await control.fly_to(north=2.0, east=0.0, up=0.0, speed=0.1)
        assert flown.virtual.position[0] == pytest.approx(2.0, abs=0.6)


def test_no_rest_of_a_way_is_a_zero_with_a_sign() -> None:
    state = AircraftState(lambda: 0.0)
    position = {"position": (0.4, 2.0, 100.0, -0.001, 5)}
    state.update(Sample(encode_telemetry(position, PROFILES["1.0"]), PROFILES["1.0"], 0.0))

    async def hover() -> None: ...

    guidance = Guidance(state, steer=lambda _: None, hover=hover)
    left = guidance._left(GuidanceProgress(0.0, 0.0, -0.01, -0.2))
    assert left == "0.0 m, +0.0 m of height and +0° remain (height_m 0.0, gps_health 5)"
