"""Guards: refused before a byte is sent, with name, measured value and limit; off by their name."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link import (
    Attitude,
    Battery,
    Control,
    Envelope,
    FlightPhase,
    GuardRefused,
    Guards,
    Position,
    ReferenceFrame,
    Setpoint,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.guards import GuardKeeper
from m100link.geodesy import LocalFrame
from m100link.sim import AssistantSettings
from m100link.telemetry.state import AircraftState
from tests.rig import NORTH, Rig, rig

pytestmark = pytest.mark.anyio

TILT = Setpoint.tilt(roll_deg=0, pitch_deg=-5, up=0, yaw_rate_deg_s=0)
OFFSET = Setpoint.position_offset(north=5, east=0, up=0, yaw_rate_deg_s=0)
CLIMB = Setpoint.velocity(north=0, east=0, up=1, yaw_rate_deg_s=0)


CLIMB_BY_TILT = Setpoint.tilt(roll_deg=0, pitch_deg=0, up=1, yaw_rate_deg_s=0)
THRUST = Setpoint.tilt(roll_deg=0, pitch_deg=0, thrust_percent=45, yaw_rate_deg_s=0)


def velocity(north: float = 0.0, east: float = 0.0, up: float = 0.0) -> Setpoint:
    return Setpoint.velocity(north=north, east=east, up=up, yaw_rate_deg_s=0)


def put(flown: Rig, north: float = 0.0, east: float = 0.0, height: float = 5.0) -> None:
    """Hovering there, as if it had flown there."""
    flight = flown.virtual.vehicle.flight
    flight.start_motors()
    flight.dynamics.place(north, east, height)
    flight.phase = FlightPhase.IN_AIR


def position(flown: Rig) -> Position:
    found = flown.aircraft.state.get(Position)
    assert found is not None
    return found


def pretend(flown: Rig, value: tuple[Any, ...]) -> None:
    """Telemetry says so from now on, whatever the aircraft sends."""
    kind = type(value)
    state: Any = flown.aircraft.state
    get, fresh = state.get, state.fresh

    def pretended(record: type[Any], **given: float | None) -> Any:
        found = fresh(record, **given)
        return value if found is not None and record is kind else found

    state.fresh = pretended
    state.get = lambda record: value if record is kind else get(record)


@asynccontextmanager
async def hovering(
    guards: Guards | None = None, **options: Any
) -> AsyncIterator[tuple[Rig, Control]]:
    # Here aircraft are put where they could not have flown to.
    guards = replace(guards or Guards(), integrity=False)
    async with rig(**options) as flown:
        put(flown)
        await asyncio.sleep(0.1)
        async with flown.aircraft.control(guards=guards) as control:
            yield flown, control


def refusal(flown: Rig, control: Control, setpoint: Setpoint) -> GuardRefused:
    """The refusal of a setpoint; nothing of it was sent."""
    sent = control.setpoints_sent
    with pytest.raises(GuardRefused) as caught:
        control.send(setpoint)
    assert control.setpoints_sent == sent
    return caught.value


# -- GPS ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("health", [0, 1, 2])
@pytest.mark.parametrize("setpoint", [NORTH, OFFSET], ids=["velocity", "position offset"])
async def test_velocity_and_position_need_gps(setpoint: Setpoint, health: int) -> None:
    async with hovering() as (flown, control):
        flown.virtual.gps_health = health
        await asyncio.sleep(0.1)
        error = refusal(flown, control, setpoint)
        assert (error.guard, error.measured, error.limit) == ("gps", health, 3)
        assert f"GPS health is {health}, 3 is needed" in error.seen
        assert error.off == "Guards(gps=False) with Guidance"
        assert str(error).endswith("wait for GPS, or fly tilt setpoints, or " + error.off)


async def test_gps_health_3_is_enough_and_tilt_needs_none() -> None:
    async with hovering() as (flown, control):
        flown.virtual.gps_health = 3
        await asyncio.sleep(0.1)
        control.send(NORTH)
        flown.virtual.gps_health = 0
        await asyncio.sleep(0.1)
        control.send(TILT)


async def test_a_position_item_that_is_not_sent_is_said_to_be_so() -> None:
    async with rig() as flown:
        flown.virtual.set_rates(position=0)
        put(flown)
        await asyncio.sleep(1.5)
        async with flown.aircraft.control() as control:
            error = refusal(flown, control, NORTH)
        assert (error.guard, error.measured) == ("gps", None)
        assert "unknown" in error.seen
        assert "position item" in error.cause


async def test_gps_guard_off_by_its_name() -> None:
    async with hovering(Guards(gps=False)) as (flown, control):
        flown.virtual.gps_health = 0
        await asyncio.sleep(0.1)
        control.send(NORTH)


# -- battery --------------------------------------------------------------------------------------


async def test_battery_below_its_floor_refuses_take_off_and_setpoints_but_never_landing() -> None:
    async with rig() as flown:
        flown.virtual.battery_percent = 18.9
        await asyncio.sleep(1.1)
        async with flown.aircraft.control() as control:
            with pytest.raises(GuardRefused, match="19 %, the floor is 20 %") as caught:
                await control.take_off()
            assert (caught.value.guard, caught.value.measured, caught.value.limit) == (
                ("battery_floor_percent", 19, 20)
            )
            assert "charge" in caught.value.remedy
            put(flown)
            error = refusal(flown, control, TILT)
            assert error.guard == "battery_floor_percent"
            assert "land" in error.remedy
            await control.land()
            assert flown.virtual.height == 0.0


async def test_the_usual_program_is_refused_a_take_off_with_a_low_battery() -> None:
    """connect, activate, control, take off: the battery item has not come yet."""
    async with rig(activated=False) as flown:
        flown.virtual.battery_percent = 15
        await flown.aircraft.activate(flown.virtual.credentials)
        async with flown.aircraft.control() as control:
            with pytest.raises(GuardRefused, match="15 %, the floor is 20 %"):
                await control.take_off()
        assert not flown.is_running


async def test_the_usual_program_takes_off_as_soon_as_the_battery_is_known() -> None:
    async with rig(activated=False) as flown:
        await flown.aircraft.activate(flown.virtual.credentials)
        async with flown.aircraft.control() as control:
            await control.take_off()
            assert flown.phase is FlightPhase.IN_AIR


@pytest.mark.parametrize(
    ("item", "guard", "off"),
    [
        ("battery", "battery_floor_percent", Guards(battery_floor_percent=None)),
        ("position", "gps", Guards(gps=False, envelope=None)),
    ],
)
async def test_a_take_off_is_refused_when_what_a_guard_compares_does_not_come(
    item: str, guard: str, off: Guards
) -> None:
    assistant = AssistantSettings(rates_hz={item: 0})
    async with rig(assistant=assistant) as flown, flown.aircraft.control() as control:
        began_at = flown.now
        with pytest.raises(GuardRefused, match=f"the {item} item has never come") as caught:
            await control.take_off()
        assert (caught.value.guard, caught.value.measured) == (guard, None)
        assert flown.now - began_at == pytest.approx(1.5, abs=0.05)
        assert not flown.is_running
    async with rig(assistant=assistant) as flown, flown.aircraft.control(guards=off):
        began_at = flown.now
        await GuardKeeper(off, flown.aircraft.state).admit_take_off()
        assert flown.now == began_at


async def test_what_has_never_come_is_waited_for_from_the_beginning_of_control_alone() -> None:
    """A look from outside of a block, before any time was noted, waits for nothing."""
    keeper = GuardKeeper(
        Guards(), cast(Any, SimpleNamespace(get=lambda _: None, fresh=lambda *_, **__: None))
    )
    assert asyncio.get_running_loop().time() < 0.5, "as after the start of a computer"
    assert not keeper._may_still_come(Battery)
    keeper.start()
    assert keeper._may_still_come(Battery)
    await asyncio.sleep(2.0)
    assert not keeper._may_still_come(Battery)


async def test_the_envelope_alone_needs_the_height_for_a_take_off() -> None:
    assistant = AssistantSettings(rates_hz={"position": 0})
    guards = Guards(gps=False)
    async with rig(assistant=assistant) as flown, flown.aircraft.control(guards=guards) as control:
        with pytest.raises(GuardRefused) as caught:
            await control.take_off()
        assert caught.value.guard == "envelope"


async def test_a_battery_item_that_stopped_is_no_charge() -> None:
    async with hovering() as (flown, control):
        flown.virtual.set_rates(battery=0)
        await asyncio.sleep(3.9)
        control.send(TILT)
        await asyncio.sleep(1.5)
        error = refusal(flown, control, TILT)
        assert (error.guard, error.measured) == ("battery_floor_percent", None)
        assert "the battery item is" in error.seen
        assert "s old" in error.seen


async def test_a_battery_item_that_never_came_has_a_second_and_a_half() -> None:
    async with rig(assistant=AssistantSettings(rates_hz={"battery": 0})) as flown:
        put(flown)
        async with flown.aircraft.control() as control:
            control.send(TILT)
            await asyncio.sleep(1.6)
            assert "has never come" in refusal(flown, control, TILT).seen


@pytest.mark.parametrize("percent", [101, 255])
async def test_a_charge_that_is_impossible_is_unknown(percent: int) -> None:
    async with hovering() as (flown, control):
        pretend(flown, Battery(percent))
        assert "impossible" in refusal(flown, control, TILT).seen


async def test_a_charge_at_the_floor_is_not_below_it() -> None:
    async with hovering(Guards(battery_floor_percent=30)) as (flown, control):
        pretend(flown, Battery(30))
        control.send(TILT)
        pretend(flown, Battery(29))
        assert refusal(flown, control, TILT).measured == 29


async def test_going_home_is_never_refused() -> None:
    async with hovering(Guards(envelope=Envelope(max_height_m=2.0))) as (flown, control):
        flown.virtual.battery_percent = 15
        flown.virtual.vehicle.flight.dynamics.place(60.0, 0.0, 20.0)
        await asyncio.sleep(1.1)
        assert refusal(flown, control, TILT).guard == "battery_floor_percent"
        await control.go_home()
        assert flown.virtual.height == 0.0


async def test_battery_guard_off_by_its_name() -> None:
    async with hovering(Guards(battery_floor_percent=None)) as (flown, control):
        flown.virtual.battery_percent = 15
        await asyncio.sleep(1.1)
        control.send(TILT)


# -- envelope -------------------------------------------------------------------------------------


def test_a_refusal_has_the_target_without_the_name_of_the_flight() -> None:
    """A name may have any words: a ground station's text is not cut out of the sentence."""
    with pytest.raises(GuardRefused) as caught:
        Envelope(max_radius_m=150.0).check("a flight to the well", far=600.2)
    said = "600 m from the start was refused: the envelope ends at 150 m"
    assert caught.value.outside == said
    assert caught.value.seen == f"a flight to the well to {said}"


async def test_a_height_beyond_the_envelope_is_refused() -> None:
    async with hovering() as (flown, control):
        error = refusal(
            flown,
            control,
            Setpoint.tilt(roll_deg=0, pitch_deg=0, height=50.1, yaw_rate_deg_s=0),
        )
        assert (error.guard, error.limit) == ("envelope", 50.0)
        assert error.measured == pytest.approx(5.0, abs=0.1)
        assert "50.1 m" in error.seen
        control.send(Setpoint.tilt(roll_deg=0, pitch_deg=0, height=50, yaw_rate_deg_s=0))


async def test_above_the_envelope_climbing_and_thrust_are_refused_descending_is_not() -> None:
    guards = Guards(envelope=Envelope(max_height_m=10))
    async with hovering(guards) as (flown, control):
        put(flown, height=10.5)
        await asyncio.sleep(0.1)
        error = refusal(flown, control, CLIMB)
        assert error.measured == pytest.approx(10.5, abs=0.1)
        thrust = Setpoint.tilt(roll_deg=0, pitch_deg=0, thrust_percent=45, yaw_rate_deg_s=0)
        assert refusal(flown, control, thrust).guard == "envelope"
        control.send(velocity(up=-1))
        control.send(velocity(up=0))


@pytest.mark.parametrize(
    ("setpoint", "what"),
    [(CLIMB_BY_TILT, "a setpoint that climbs"), (THRUST, "thrust")],
    ids=["climb", "thrust"],
)
async def test_without_a_height_nothing_climbs(setpoint: Setpoint, what: str) -> None:
    """The item stops at 5 m; a program that believes it flies to the Moon."""
    async with hovering(Guards(envelope=Envelope(max_height_m=10))) as (flown, control):
        flown.virtual.set_rates(position=0)
        await asyncio.sleep(1.5)
        error = refusal(flown, control, setpoint)
        assert (error.guard, error.measured, error.limit) == ("envelope", None, 10)
        assert error.seen.startswith(f"{what} was refused: the position item is 1.")
        assert "max_height_m=math.inf" in error.off
        control.send(Setpoint.tilt(roll_deg=0, pitch_deg=0, up=-1, yaw_rate_deg_s=0))
        control.send(Setpoint.tilt(roll_deg=0, pitch_deg=0, height=9, yaw_rate_deg_s=0))


async def test_a_place_that_was_lost_allows_no_movement_but_standing_still() -> None:
    async with hovering(Guards(gps=False)) as (flown, control):
        control.send(TILT)
        flown.virtual.set_rates(position=0)
        await asyncio.sleep(1.5)
        for setpoint in (TILT, NORTH, OFFSET):
            assert refusal(flown, control, setpoint).guard == "envelope"
        control.send(NORTH.neutral())


@pytest.mark.parametrize(
    "impossible",
    [
        {"latitude_rad": math.nan},
        {"longitude_rad": math.inf},
        {"longitude_rad": 7.0},
        {"latitude_rad": math.radians(89.5)},
        {"latitude_rad": -2.0},
        {"height_m": math.nan},
    ],
    ids=str,
)
async def test_an_impossible_position_is_an_unknown_one(impossible: dict[str, Any]) -> None:
    async with hovering() as (flown, control):
        pretend(flown, position(flown)._replace(**impossible))
        error = refusal(flown, control, NORTH)
        assert (error.guard, error.measured) == ("gps", None)
        error = refusal(flown, control, CLIMB_BY_TILT)
        assert (error.guard, error.measured) == ("envelope", None)
        with pytest.raises(TelemetryStalled, match="position"):
            await control.fly_to(north=1, east=0, up=0)


async def test_the_radius_is_measured_from_the_first_position_that_is_possible() -> None:
    async with rig() as flown:
        put(flown, north=100)
        await asyncio.sleep(0.1)
        real = position(flown)
        pretend(flown, real._replace(latitude_rad=math.nan))
        async with flown.aircraft.control(
            guards=Guards(envelope=Envelope(max_radius_m=50))
        ) as control:
            pretend(flown, real)
            control.send(velocity(north=1))


async def test_a_receiver_that_jumps_to_the_other_side_of_the_earth_is_outside() -> None:
    async with hovering() as (flown, control):
        real = position(flown)
        there = -real.latitude_rad, real.longitude_rad - math.pi
        pretend(flown, real._replace(latitude_rad=there[0], longitude_rad=there[1]))
        assert refusal(flown, control, NORTH).limit == 150
        with pytest.raises(GuardRefused):
            await control.fly_to(
                latitude_deg=math.degrees(there[0]), longitude_deg=math.degrees(there[1]), height=5
            )


@pytest.mark.parametrize(
    "impossible", [Attitude(math.nan, 0.0, 0.0, 0.0), Attitude(0.0, 0.0, 0.0, 0.0)]
)
async def test_an_impossible_attitude_is_an_unknown_heading(impossible: Attitude) -> None:
    async with hovering(Guards(envelope=Envelope(max_radius_m=50))) as (flown, control):
        put(flown, north=60)
        await asyncio.sleep(0.1)
        pretend(flown, impossible)
        forward = Setpoint.velocity(forward=1, right=0, up=0, yaw_rate_deg_s=0)
        assert refusal(flown, control, forward).guard == "envelope"
        with pytest.raises(TelemetryStalled, match="heading"):
            await control.turn_to(90)


async def test_without_a_heading_an_offset_may_lead_anywhere() -> None:
    async with hovering(Guards(envelope=Envelope(max_radius_m=50))) as (flown, control):
        put(flown, north=45)
        await asyncio.sleep(0.1)
        pretend(flown, Attitude(math.nan, 0.0, 0.0, 0.0))
        ahead = Setpoint.position_offset(forward=10, right=0, up=0, yaw_rate_deg_s=0)
        assert refusal(flown, control, ahead).measured == pytest.approx(55, abs=0.2)


async def test_climbing_for_ever_ends_at_the_envelope() -> None:
    guards = Guards(envelope=Envelope(max_height_m=10))
    async with rig() as flown:
        put(flown)
        await asyncio.sleep(0.1)
        with pytest.raises(GuardRefused):
            async with flown.aircraft.control(guards=guards) as control:
                async for _ in control.ticks():
                    control.send(CLIMB)
        await flown.assert_hovers()
        assert flown.virtual.height < 11.5


async def test_speed_is_measured_over_both_axes() -> None:
    guards = Guards(envelope=Envelope(max_speed_m_s=5))
    async with hovering(guards) as (flown, control):
        error = refusal(flown, control, velocity(north=4, east=4))
        assert (error.guard, error.limit) == ("envelope", 5)
        assert error.measured == pytest.approx(5.657, abs=0.001)
        control.send(velocity(north=3, east=4))


@pytest.mark.parametrize(
    "outward",
    [
        velocity(north=0.01),
        velocity(north=1),
        TILT,
        Setpoint.velocity(forward=1, right=0, up=0, yaw_rate_deg_s=0),
        OFFSET,
    ],
    ids=["slowly", "velocity", "tilt", "forward", "position offset"],
)
async def test_outside_the_radius_nothing_leads_further_away(outward: Setpoint) -> None:
    guards = Guards(envelope=Envelope(max_radius_m=50))
    async with hovering(guards) as (flown, control):
        put(flown, north=51)
        await asyncio.sleep(0.1)
        error = refusal(flown, control, outward)
        assert (error.guard, error.limit) == ("envelope", 50)
        assert isinstance(error.measured, float)
        assert error.measured >= 51 - 0.1


@pytest.mark.parametrize(
    "back",
    [
        velocity(north=-1),
        velocity(north=-0.005),
        velocity(east=1),
        Setpoint.tilt(roll_deg=0, pitch_deg=5, up=0, yaw_rate_deg_s=0),
        Setpoint.tilt(roll_deg=0, pitch_deg=0, up=0, yaw_rate_deg_s=0),
        Setpoint.position_offset(north=-30, east=0, up=0, yaw_rate_deg_s=0),
    ],
    ids=["velocity back", "slowly back", "velocity along", "tilt back", "level", "offset back"],
)
async def test_outside_the_radius_every_way_back_is_open(back: Setpoint) -> None:
    guards = Guards(envelope=Envelope(max_radius_m=50))
    async with hovering(guards) as (flown, control):
        put(flown, north=100)
        await asyncio.sleep(0.1)
        control.send(back)


async def test_an_offset_that_would_end_outside_is_refused_from_inside() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=50))
    async with hovering(guards) as (flown, control):
        put(flown, north=30)
        await asyncio.sleep(0.1)
        error = refusal(
            flown,
            control,
            Setpoint.position_offset(north=25, east=0, up=0, yaw_rate_deg_s=0),
        )
        assert error.measured == pytest.approx(55, abs=0.2)
        assert "55 m from the start" in error.seen


async def test_body_frame_directions_turn_with_the_nose() -> None:
    """The nose points south: forward leads back, backwards leads away."""
    guards = Guards(envelope=Envelope(max_radius_m=50))
    async with hovering(guards) as (flown, control):
        flown.virtual.vehicle.flight.dynamics.place(60.0, 0.0, 5.0, 180.0)
        await asyncio.sleep(0.1)
        control.send(Setpoint.velocity(forward=1, right=0, up=0, yaw_rate_deg_s=0))
        refusal(
            flown,
            control,
            Setpoint.velocity(forward=-1, right=0, up=0, yaw_rate_deg_s=0),
        )


async def test_ground_frame_tilt_is_judged_in_the_ground_frame() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=50))
    async with hovering(guards, firmware="3.1") as (flown, control):
        flown.virtual.vehicle.flight.dynamics.place(60.0, 0.0, 5.0, 180.0)
        await asyncio.sleep(0.1)
        refusal(
            flown,
            control,
            Setpoint.tilt(
                roll_deg=0, pitch_deg=-5, up=0, yaw_rate_deg_s=0, frame=ReferenceFrame.GROUND
            ),
        )


async def test_the_radius_is_measured_from_where_control_was_obtained() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=50))
    async with hovering(guards) as (flown, control):
        put(flown, north=60)  # before any setpoint was sent
        await asyncio.sleep(0.1)
        assert refusal(flown, control, velocity(north=1)).guard == "envelope"


async def test_coordinates_without_reception_are_not_taken_for_the_start() -> None:
    """Before its first fix a receiver says anything."""
    async with rig() as flown:
        flown.virtual.gps_health = 0
        put(flown, north=5000)
        await asyncio.sleep(0.1)
        async with flown.aircraft.control() as control:
            control.send(TILT)
            flown.virtual.gps_health = 5
            put(flown)
            await asyncio.sleep(0.1)
            control.send(NORTH)


async def test_envelope_off_by_its_name() -> None:
    async with hovering(Guards(envelope=None)) as (flown, control):
        put(flown, north=500, height=80)
        await asyncio.sleep(0.1)
        control.send(velocity(north=10, up=4))


@pytest.mark.parametrize("name", ["max_height_m", "max_radius_m", "max_speed_m_s"])
@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_an_envelope_that_allows_nothing_is_no_envelope(name: str, value: float) -> None:
    with pytest.raises(UsageError, match=name):
        Envelope(**{name: value})


class Stand:
    """What an aircraft tells, by plain numbers: the guards alone, without one.

    Attributes:
        place: From where control began, m north and east.
        heading: Of the nose, °.
        height: Above the take-off point, m.
        percent: Charge.
        gps_health: From 0 to 5.
        unknown: Items that have never come.
    """

    def __init__(self, guards: Guards, latency: Any = None) -> None:
        self.start = LocalFrame(-33.0, 151.2)
        self.place, self.heading, self.height, self.percent = (0.0, 0.0), 0.0, 5.0, 90
        self.gps_health = 5
        self.unknown: tuple[type[Any], ...] = ()
        self.keeper = GuardKeeper(guards, cast(AircraftState, self), self.start, latency)

    def fresh(self, record: type[Any], *, within: float) -> Any:
        del within
        if record in self.unknown:
            return None
        if record is Battery:
            return Battery(self.percent)
        if record is Attitude:
            half = math.radians(self.heading) / 2
            return Attitude(math.cos(half), 0.0, 0.0, math.sin(half))
        assert record is Position
        latitude, longitude = map(math.radians, self.start.to_geodetic(*self.place))
        return Position(latitude, longitude, 400.0, self.height, self.gps_health)

    def age(self, record: type[Any]) -> float | None:
        return None if record in self.unknown else 0.0

    def refused_by(self, check: Callable[[], None]) -> str | None:
        try:
            check()
        except GuardRefused as error:
            return error.guard
        return None

    def is_refused(self, check: Callable[[], None]) -> bool:
        return self.refused_by(check) is not None


def along(bearing: float, size: float) -> tuple[float, float]:
    return size * math.cos(math.radians(bearing)), size * math.sin(math.radians(bearing))


def towards(kind: str, bearing: float, heading: float) -> Setpoint:
    """One that leads to a bearing; an offset by 20 m."""
    rest: dict[str, Any] = {"up": 0, "yaw_rate_deg_s": 0}
    ground, body = along(bearing, 1.0), along(bearing - heading, 1.0)
    match kind:
        case "velocity":
            return Setpoint.velocity(north=ground[0], east=ground[1], **rest)
        case "body velocity":
            return Setpoint.velocity(forward=body[0], right=body[1], **rest)
        case "offset":
            return Setpoint.position_offset(north=20 * ground[0], east=20 * ground[1], **rest)
        case "body offset":
            return Setpoint.position_offset(forward=20 * body[0], right=20 * body[1], **rest)
        case "tilt":  # rolls to the right, and flies forward with the nose down
            return Setpoint.tilt(roll_deg=9 * body[1], pitch_deg=-9 * body[0], **rest)
    frame = ReferenceFrame.GROUND
    return Setpoint.tilt(roll_deg=9 * ground[1], pitch_deg=-9 * ground[0], frame=frame, **rest)


KINDS = ["velocity", "body velocity", "offset", "body offset", "tilt", "ground tilt"]


@pytest.mark.parametrize("kind", [*KINDS, "sticks"])
def test_the_radius_holds_on_every_bearing_at_every_heading(kind: str) -> None:
    """Outside, whatever leads away is refused, and whatever leads back is not."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(40):
        stand = Stand(Guards(envelope=Envelope(max_radius_m=50)))
        where, stand.heading = chance.uniform(-180, 180), chance.uniform(-180, 180)
        stand.place = along(where, 60.0)
        # An offset of 20 m leads away from 60 m unless it turns back by more than 99.6°.
        half = 99.6 if "offset" in kind else 90.0
        off = chance.choice([-1, 1]) * chance.uniform(1.0, 179.0)
        if abs(abs(off) - half) < 1.0:
            continue
        if kind == "sticks":
            pitch, roll = along(where + off - stand.heading, 0.5)
            check = partial(stand.keeper.check_sticks, roll, pitch, 0.0, 0.0)
        else:
            check = partial(stand.keeper.check, towards(kind, where + off, stand.heading))
        ends = math.dist(along(where, 60.0), along(where + off, -20.0))
        is_away = ends > 60.0 if "offset" in kind else abs(off) < 90.0
        case = f"seed {seed}: at {where}, {off} off, heading {stand.heading}"
        assert stand.is_refused(check) is is_away, case
        stand.place = along(where, 25.0)
        assert not stand.is_refused(check), case


@pytest.mark.parametrize("kind", ["offset", "body offset"])
def test_an_offset_counts_to_where_it_ends(kind: str) -> None:
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(20):
        where, off, heading = (chance.uniform(-180, 180) for _ in range(3))
        north, east = along(where, 35.0)
        ends = math.hypot(north + along(where + off, 20.0)[0], east + along(where + off, 20.0)[1])
        for limit in (ends - 0.1, ends + 0.1):
            stand = Stand(Guards(envelope=Envelope(max_radius_m=limit)))
            stand.place, stand.heading = (north, east), heading
            check = partial(stand.keeper.check, towards(kind, where + off, heading))
            is_refused = ends > limit and ends >= 35.0
            assert stand.is_refused(check) is is_refused, f"seed {seed}: {where}, {off}, {limit}"


@pytest.mark.parametrize(
    ("sticks", "measured"),
    [
        ((0.3, 0.5, 0.0, 0.0), None),  # 0.583 of 17 m/s: 9.9
        ((-0.5, -0.32, 0.0, 0.0), 10.09),
        ((0.0, 0.6, 0.0, 0.0), 10.2),
        ((0.6, 0.0, 0.0, 0.0), 10.2),
        ((1.0, -1.0, 0.0, 0.0), 24.04),
        ((0.0, 0.0, 1.0, -1.0), None),
    ],
)
def test_sticks_may_fly_17_m_s(
    sticks: tuple[float, float, float, float], measured: float | None
) -> None:
    """The fastest that the maker says, 61 km/h; both axes together."""
    stand = Stand(Guards())
    if measured is None:
        stand.keeper.check_sticks(*sticks)
        return
    with pytest.raises(GuardRefused, match="deflection") as caught:
        stand.keeper.check_sticks(*sticks)
    assert caught.value.measured == pytest.approx(measured, abs=0.01)
    assert caught.value.limit == 10.0


def test_sticks_fly_the_speed_of_the_envelope_and_lead_along_their_diagonal() -> None:
    stand = Stand(Guards(envelope=Envelope(max_speed_m_s=17.0)))
    stand.keeper.check_sticks(0.0, 1.0, 0.0, 0.0)
    stand = Stand(Guards(envelope=Envelope(max_speed_m_s=25.0)))  # they lead north-west
    for bearing, by in ((50.0, None), (40.0, "envelope")):  # where it is, too far away
        stand.place = along(bearing, 151.0)
        assert stand.refused_by(partial(stand.keeper.check_sticks, -1.0, 1.0, 0.0, 0.0)) == by


@pytest.mark.parametrize(("round_trip_s", "by"), [(0.4, None), (0.41, "round_trip_s")])
def test_sticks_are_not_moved_over_a_line_that_is_too_slow(
    round_trip_s: float, by: str | None
) -> None:
    latency = SimpleNamespace(round_trip_s=round_trip_s, is_slow=True)
    stand = Stand(Guards(round_trip_s=0.4), latency)
    assert stand.refused_by(partial(stand.keeper.check_sticks, 0.0, 0.1, 0.0, 0.0)) == by


def test_sticks_climb_and_descend_as_setpoints_do() -> None:
    stand = Stand(Guards())
    stand.height = 51.0
    assert stand.is_refused(partial(stand.keeper.check_sticks, 0.0, 0.0, 0.1, 0.0))
    stand.keeper.check_sticks(0.0, 0.0, -0.1, 0.0)
    stand.keeper.check_sticks(0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        ({"height": 54.9}, None),  # 5 m beyond each limit
        ({"height": 55.1}, (55.1, 50.0)),
        ({"place": along(130.0, 154.9)}, None),
        ({"place": along(130.0, 155.1)}, (155.1, 150.0)),
        # From health 3 on the autopilot holds a position (document 2.2.3.1).
        ({"place": along(130.0, 155.1), "gps_health": 3}, (155.1, 150.0)),
        ({"place": along(130.0, 155.1), "gps_health": 2}, None),
        ({"percent": 20}, None),
        ({"percent": 19}, (19, 20)),
    ],
    ids=str,
)
def test_a_mission_is_ended_5_m_beyond_the_envelope(
    change: dict[str, Any], refused: tuple[float, float] | None
) -> None:
    stand = Stand(Guards())
    for name, value in change.items():
        setattr(stand, name, value)
    if refused is None:
        stand.keeper.check_mission("the mission")
        return
    with pytest.raises(GuardRefused, match="the mission") as caught:
        stand.keeper.check_mission("the mission")
    assert (caught.value.measured, caught.value.limit) == pytest.approx(refused, abs=0.01)


@pytest.mark.parametrize(
    ("check", "by_gps", "without_gps"),
    [
        (lambda keeper: keeper.check_mission("the mission"), "envelope", "envelope"),
        (lambda keeper: keeper.check(velocity(north=1.0)), "gps", "envelope"),
        (lambda keeper: keeper.check(velocity()), "gps", None),  # it stands still
        (lambda keeper: keeper.check(CLIMB), "gps", "envelope"),
        (lambda keeper: keeper.check(velocity(up=-1.0)), "gps", None),
        (lambda keeper: keeper.check(OFFSET), "gps", "envelope"),
        (lambda keeper: keeper.check(TILT), "envelope", "envelope"),
        (lambda keeper: keeper.check(CLIMB_BY_TILT), "envelope", "envelope"),
        (lambda keeper: keeper.check(THRUST), "envelope", "envelope"),
        (lambda keeper: keeper.check_sticks(0.0, 0.0, 0.5, 0.0), "gps", "envelope"),
        (lambda keeper: keeper.check_sticks(0.1, 0.0, 0.0, 0.0), "gps", "envelope"),
    ],
)
def test_a_value_that_a_guard_compares_and_nobody_knows_is_refused(
    check: Callable[[GuardKeeper], None], by_gps: str, without_gps: str | None
) -> None:
    """By the name of that guard; the others, and one that is off, do not ask for the value."""
    floor, place = "battery_floor_percent", Position
    for guards, unknown, expected in (
        (Guards(), place, by_gps),
        (Guards(gps=False), place, without_gps),
        (Guards(gps=False, envelope=None), place, None),
        (Guards(), Battery, floor),
        (Guards(gps=False, envelope=None), Battery, floor),
        (Guards(battery_floor_percent=None), Battery, None),
        (Guards(), Attitude, None),
    ):
        stand = Stand(guards)
        stand.unknown = (unknown,)
        assert stand.refused_by(partial(check, stand.keeper)) == expected, (guards, unknown)


@pytest.mark.parametrize(
    ("setpoint", "height", "measured"),
    [
        (velocity(north=3.0), 5.0, 48.0 + 0.7 * 3.0),
        (velocity(north=2.8), 5.0, None),
        (velocity(north=-9.0), 5.0, None),
        (Setpoint.position_offset(north=1.5, east=0, up=0, yaw_rate_deg_s=0), 5.0, 50.55),
        (Setpoint.position_offset(north=1.1, east=0, up=0, yaw_rate_deg_s=0), 5.0, None),
        # Offsets are flown at 5 m/s at most.
        (Setpoint.position_offset(north=-5, east=-17, up=0, yaw_rate_deg_s=0), 5.0, None),
        (Setpoint.position_offset(north=-5, east=-22, up=0, yaw_rate_deg_s=0), 5.0, 51.81),
        (velocity(up=3.0), 48.0, 48.0),  # to 50.1 m
        (velocity(up=2.8), 48.0, None),
        (velocity(up=-3.0), 50.5, None),
    ],
)
def test_on_a_slow_line_what_is_flown_meanwhile_counts(
    setpoint: Setpoint, height: float, measured: float | None
) -> None:
    """50 m high and wide; 48 m north of the start, and 0.7 s pass until a refusal is felt."""
    guards = Guards(envelope=Envelope(max_height_m=50.0, max_radius_m=50.0))
    for is_slow in (True, False):  # of a quick line nothing is added
        stand = Stand(guards, SimpleNamespace(round_trip_s=0.7, is_slow=is_slow))
        stand.place, stand.height = (48.0, 0.0), height
        if measured is None or not is_slow:
            stand.keeper.check(setpoint)
            continue
        with pytest.raises(GuardRefused) as caught:
            stand.keeper.check(setpoint)
        assert caught.value.measured == pytest.approx(measured, abs=0.02)


@pytest.mark.parametrize(
    ("target", "measured"),
    [
        ({"far": 149.9}, None),
        ({"far": 150.1}, 150.1),
        ({"far": 140.0, "radius": 9.9}, None),
        ({"far": 140.0, "radius": 10.1}, 150.1),
        ({"height": 50.0}, None),
        ({"height": 50.1}, 50.1),
        ({"height": -20.0}, None),
        ({"speed": 10.0}, None),
        ({"speed": 10.1}, 10.1),
    ],
    ids=str,
)
def test_a_target_is_measured_from_where_control_began(
    target: dict[str, float], measured: float | None
) -> None:
    stand = Stand(Guards())
    stand.place = along(20.0, 100.0)  # where it is does not count
    values = dict(target)
    far = values.pop("far", None)
    place = None if far is None else stand.start.to_geodetic(*along(215.0, far))
    check = partial(stand.keeper.check_target, "a flight", place, **values)
    if measured is None:
        check()
        return
    with pytest.raises(GuardRefused) as caught:
        check()
    assert caught.value.measured == pytest.approx(measured, abs=0.01)


def test_the_fastest_setpoint_is_that_of_the_envelope_and_of_the_document() -> None:
    for limit, fastest in [(4.0, 4.0), (10.0, 10.0), (25.0, 10.0)]:
        assert Stand(Guards(envelope=Envelope(max_speed_m_s=limit))).keeper.fastest_m_s == fastest
    assert Stand(Guards(envelope=None)).keeper.fastest_m_s == 10.0


def test_the_usual_envelope_is_50_m_high_150_m_wide_and_10_m_s_fast() -> None:
    """As docs/explanation/safety.md says, with a battery of 20 % and telemetry of a second."""
    assert Guards() == Guards(True, Envelope(50.0, 150.0, 10.0), 20, 1.0, True)


# -- what is being sent is asked about again ------------------------------------------------------


def battery_runs_low(flown: Rig) -> None:
    flown.virtual.battery_percent = 15


def gps_is_lost(flown: Rig) -> None:
    flown.virtual.gps_health = 1


def position_stops(flown: Rig) -> None:
    flown.virtual.set_rates(position=0)


def nothing_happens(flown: Rig) -> None:
    """It flies out of its radius of 20 m."""


@pytest.mark.parametrize(
    ("happening", "guard"),
    [
        (battery_runs_low, "battery_floor_percent"),
        (gps_is_lost, "gps"),
        (position_stops, "gps"),
        (nothing_happens, "envelope"),
    ],
)
async def test_a_setpoint_that_lives_long_ends_when_a_guard_would_refuse_it(
    happening: Callable[[Rig], None], guard: str
) -> None:
    guards = Guards(envelope=Envelope(max_radius_m=20))
    async with hovering(guards) as (flown, control):
        before = len(flown.moves)
        with pytest.raises(GuardRefused) as caught:
            async with control.hold(velocity(north=3), lifetime=60, allow_long_lifetime=True):
                await asyncio.sleep(2.0)
                happening(flown)
                await asyncio.sleep(30.0)
        assert caught.value.guard == guard
        assert math.hypot(*flown.virtual.position) < 25
        flown.assert_stopped_in_order()
        stands = [flown.is_neutral(move) for move in flown.moves][before:]
        assert stands == sorted(stands), "a frame that was refused went out behind its neutral"
        count = len(flown.moves)
        with pytest.raises(GuardRefused):
            control.send(velocity(north=3))
        await asyncio.sleep(1.0)
        assert len(flown.moves) == count
        await flown.assert_hovers()


async def test_a_climb_that_lives_long_ends_at_the_envelope() -> None:
    guards = Guards(envelope=Envelope(max_height_m=10))
    async with hovering(guards) as (flown, control):
        control.send(CLIMB, lifetime=60, allow_long_lifetime=True)
        await asyncio.sleep(30)
        assert flown.virtual.height < 11.5
        flown.assert_stopped_in_order()


async def test_a_hold_that_turned_back_in_time_ends_quietly() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=20))
    async with hovering(guards) as (_, control):
        options: dict[str, Any] = {"lifetime": 60, "allow_long_lifetime": True}
        async with control.hold(velocity(north=3), **options) as hold:
            await asyncio.sleep(15.0)
            with pytest.raises(GuardRefused):
                hold.set(velocity(north=3))
            hold.set(velocity(north=-3))
            await asyncio.sleep(2.0)


async def test_a_hold_that_was_ended_by_a_guard_and_turned_back_ends_quietly() -> None:
    guards = Guards(envelope=Envelope(max_radius_m=20))
    async with hovering(guards) as (flown, control):
        options: dict[str, Any] = {"lifetime": 60, "allow_long_lifetime": True}
        async with control.hold(velocity(north=3), **options) as hold:
            await asyncio.sleep(15.0)
            assert flown.is_neutral(flown.moves[-1]), "the guard ended it"
            hold.set(velocity(north=-3))
            await asyncio.sleep(2.0)


async def test_a_slow_source_hears_at_its_end_that_its_last_setpoint_was_refused() -> None:
    async def source() -> AsyncIterator[Setpoint]:
        yield velocity(north=3)
        await asyncio.sleep(20.0)

    guards = Guards(envelope=Envelope(max_radius_m=20))
    async with hovering(guards) as (flown, control):
        with pytest.raises(GuardRefused):
            await control.follow(source(), lifetime=60, allow_long_lifetime=True)
        assert flown.virtual.position[0] < 25
        await control.follow(lambda _: None)  # one that sends nothing hears nothing of it


async def test_what_stands_still_is_not_refused_again() -> None:
    async with hovering() as (flown, control):
        async with control.hold(NORTH.neutral(), lifetime=60, allow_long_lifetime=True):
            flown.virtual.battery_percent = 15
            await asyncio.sleep(3.0)
            count = len(flown.moves)
            await asyncio.sleep(1.0)
            assert len(flown.moves) >= count + 49


async def test_guards_are_asked_once_for_each_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = 0
    check = GuardKeeper.check

    def counting(self: GuardKeeper, setpoint: Setpoint) -> None:
        nonlocal asked
        asked += 1
        check(self, setpoint)

    monkeypatch.setattr(GuardKeeper, "check", counting)
    async with hovering() as (flown, control):
        await flown.fly(control, 2.0)
        assert len(flown.moves) - 2 <= asked <= len(flown.moves) + 2
        await asyncio.sleep(1.0)
        asked, count = 0, len(flown.moves)
        control.send(NORTH, lifetime=1.0)
        await asyncio.sleep(0.9)
        sent = len(flown.moves) - count
        assert sent - 2 <= asked <= sent + 2


# -- stale telemetry ------------------------------------------------------------------------------


async def test_stale_telemetry_guard_off_by_its_name() -> None:
    guards = Guards(stale_telemetry_s=None, battery_floor_percent=None, envelope=None)
    async with hovering(guards) as (flown, control):
        flown.virtual.line.stall(to_host=True, to_aircraft=False)
        await asyncio.sleep(5.0)
        control.send(TILT)
        flown.virtual.line.stall(to_host=False, to_aircraft=False)


async def test_stale_telemetry_waits_as_long_as_it_is_set() -> None:
    async with rig() as flown:
        put(flown)
        await asyncio.sleep(0.1)
        with pytest.raises(TelemetryStalled):
            async with flown.aircraft.control(guards=Guards(stale_telemetry_s=3.0)):
                start = flown.now
                flown.virtual.line.stall(to_host=True, to_aircraft=False)
                try:
                    await asyncio.sleep(60)
                finally:
                    took = flown.now - start
        assert took == pytest.approx(3.0, abs=0.1)


async def test_neutral_is_never_refused() -> None:
    """The stop path sends it whatever guards say: battery low, GPS gone, outside the envelope."""
    async with rig() as flown:
        put(flown)
        await asyncio.sleep(0.1)
        async with flown.aircraft.control() as control:
            control.send(NORTH)
            flown.virtual.battery_percent = 12
            flown.virtual.gps_health = 0
            await asyncio.sleep(0.1)
        flown.assert_stopped_in_order()
