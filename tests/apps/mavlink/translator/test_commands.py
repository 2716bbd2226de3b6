"""Commands: as a table of what the manager is asked for, and as flights."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.messages import GuardLimits, State
from m100link.apps.mavlink.translator.codec import LAYOUTS, MavlinkMessage, Peer
from m100link.apps.mavlink.translator.commands import COMMANDS, CommandProtocol
from m100link.apps.mavlink.translator.flight_mode_manager import FlightModeManager
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult, MissionResult
from m100link.apps.mavlink.translator.orders import (
    FlightSequence,
    HoldPosition,
    LandInPlace,
    ModeRequest,
    ReturnToLaunch,
    TakeOffAndClimb,
    read_command,
)
from m100link.apps.mavlink.translator.parameters import ParameterProtocol
from m100link.apps.mavlink.translator.payload import Payload
from m100link.apps.mavlink.translator.telemetry import Rates
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode, VehiclePhase
from m100link.geodesy import LocalFrame
from m100link.protocol.records import FlightStatus, Position
from tests.apps.mavlink.conftest import Ground, Rig, world_of
from tests.apps.mavlink.translator.test_missions import Exchange, waypoint
from tests.known import Known, position

pytestmark = pytest.mark.anyio

NAN = math.nan
near: Any = pytest.approx
PEER = Peer(("127.0.0.1", 14550), 245, 190)
TAKE_OFF, LAND, HOME, ORBIT, REPOSITION, SPEED = 22, 21, 20, 34, 192, 178
GLOBAL, LOCAL_NED, RELATIVE, GLOBAL_INT, RELATIVE_INT = 0, 1, 3, 5, 6
NOWHERE = 0x7FFFFFFF
# The ground is at 87.65 - 12.34 = 75.31 m.
NORTH, EAST = 10.5, -20.25


Place = tuple[float, float]


class Asked:
    """Somebody asks; what becomes of it is kept."""

    def __init__(self, known: Known | None = None) -> None:
        self.requests: list[ModeRequest] = []
        self.texts: list[str] = []
        self.fenced: list[tuple[Place | None, Place, float]] = []
        self.firsts: list[int | None] = []
        self.orders: list[Any] = []
        self.other: Peer | None = None
        manager = SimpleNamespace(
            request_mode=self._request,
            phase=VehiclePhase.AIRBORNE,
            is_others=lambda *_: self.other is not None,
            has_setpoint=lambda *_: True,
            is_flown_by_aircraft=True,
            flies_mission=True,
            orders=self.orders,
        )
        world = world_of(known or Known(position(latitude=NORTH, longitude=EAST)))
        self.commands = CommandProtocol(
            world,
            cast(FlightModeManager, manager),
            ParameterProtocol(world, 1).values,
            Rates(world),
            tell=lambda _, text: self.texts.append(text),
            request=lambda *_: False,
            mission=self._mission,
            payload=cast(Payload, None),
            fence=self._fence,
        )

    def _request(self, request: ModeRequest, now: float) -> MavResult:
        self.requests.append(request)
        return MavResult.ACCEPTED

    def _mission(self, peer: Peer, first: int | None) -> ModeRequest | None:
        self.firsts.append(first)
        return ModeRequest(Mode.MISSION, None, peer)

    def _fence(self, begin: Place | None, end: Place, radius: float) -> str:
        self.fenced.append((begin, end, radius))
        return ""

    def ask(self, message: MavlinkMessage) -> MavResult | None:
        return self.commands.carry_out(read_command(message, PEER), 1.0)


def long(command: int, *given: float) -> MavlinkMessage:
    values = (*given, *(NAN,) * (7 - len(given)))
    fields: dict[str, Any] = {f"param{place}": one for place, one in enumerate(values, 1)}
    return MavlinkMessage("COMMAND_LONG", fields | {"command": command})


def whole(command: int, frame: int, x: int, y: int, z: float, *four: float) -> MavlinkMessage:
    values = (*four, *(NAN,) * (4 - len(four)))
    fields: dict[str, Any] = {f"param{place}": one for place, one in enumerate(values, 1)}
    more = {"command": command, "frame": frame, "x": x, "y": y, "z": z}
    return MavlinkMessage("COMMAND_INT", fields | more)


def to(height: float, speed: float = 5.0, yaw: float | None = None) -> orders.FlyTo:
    return orders.FlyTo(10.5001, -20.2501, near(height), speed, yaw)


X, Y = 105_001_000, -202_501_000

TABLE: list[tuple[MavlinkMessage, Mode, object]] = [
    (
        long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, 80.31),
        Mode.TAKEOFF,
        TakeOffAndClimb(near(5.0)),
    ),
    (long(TAKE_OFF), Mode.TAKEOFF, TakeOffAndClimb(2.5)),
    (long(TAKE_OFF, 0, 0, 0, 0, 0, 0, 0.0), Mode.TAKEOFF, TakeOffAndClimb(2.5)),
    (whole(TAKE_OFF, RELATIVE, 0, 0, 6.0), Mode.TAKEOFF, TakeOffAndClimb(near(6.0))),
    (whole(TAKE_OFF, RELATIVE_INT, 0, 0, 6.0), Mode.TAKEOFF, TakeOffAndClimb(near(6.0))),
    (whole(TAKE_OFF, GLOBAL_INT, 0, 0, 85.31), Mode.TAKEOFF, TakeOffAndClimb(near(10.0))),
    (long(LAND), Mode.LAND, LandInPlace()),
    (long(HOME), Mode.RTL, ReturnToLaunch()),
    (long(REPOSITION), Mode.HOLD, HoldPosition()),
    # radians, clockwise from north
    (long(REPOSITION, -1, 0, 0, 0.5), Mode.GOTO, orders.ChangeHeading(near(28.6479, abs=1e-3))),
    (
        long(REPOSITION, -1, 1, 0, NAN, NAN, NAN, 95.31),
        Mode.GOTO,
        orders.ChangeHeight(near(20.0)),
    ),
    (long(REPOSITION, -1, 1, 0, NAN, 10.5001, -20.2501, 95.31), Mode.GOTO, to(20.0)),
    (long(REPOSITION, 3.0, 1, 0, NAN, 10.5001, -20.2501, 95.31), Mode.GOTO, to(20.0, 3.0)),
    (
        long(REPOSITION, -1, 1, 0, 4.0, 10.5001, -20.2501, 95.31),
        Mode.GOTO,
        to(20.0, yaw=near(-130.8169, abs=1e-3)),
    ),
    (long(REPOSITION, -1, 1, 0, NAN, 10.5001, -20.2501, NAN), Mode.GOTO, to(12.34)),
    (whole(REPOSITION, GLOBAL, X, Y, 95.31, -1), Mode.GOTO, to(20.0)),
    (whole(REPOSITION, GLOBAL_INT, X, Y, 95.31, -1), Mode.GOTO, to(20.0)),
    (whole(REPOSITION, RELATIVE, X, Y, 15.0, -1), Mode.GOTO, to(15.0)),
    (whole(REPOSITION, RELATIVE_INT, X, Y, 15.0, -1), Mode.GOTO, to(15.0)),
    (whole(REPOSITION, GLOBAL, NOWHERE, NOWHERE, NAN), Mode.HOLD, HoldPosition()),
    # m, m/s; a positive radius is clockwise
    (
        long(ORBIT, 15.0, 3.0, 0, NAN, 10.5001, -20.2501, 95.31),
        Mode.ORBIT,
        orders.FlyAround(10.5001, -20.2501, near(20.0), 15.0, 3.0, 200.0, clockwise=True),
    ),
    (
        long(ORBIT, -7.0, NAN, 0, NAN, 10.5001, -20.2501, 95.31),
        Mode.ORBIT,
        orders.FlyAround(10.5001, -20.2501, near(20.0), 7.0, 2.0, 200.0, clockwise=False),
    ),
    *(  # 2 m/s where no speed is given, or none to fly at
        (
            long(ORBIT, 15.0, speed, 0, NAN, 10.5001, -20.2501, 95.31),
            Mode.ORBIT,
            orders.FlyAround(10.5001, -20.2501, near(20.0), 15.0, 2.0, 200.0, clockwise=True),
        )
        for speed in (0.0, -3.0)
    ),
    (
        whole(ORBIT, RELATIVE_INT, X, Y, 95.31, 15.0, 3.0),
        Mode.ORBIT,
        orders.FlyAround(10.5001, -20.2501, near(20.0), 15.0, 3.0, 200.0, clockwise=True),
    ),
    (
        long(ORBIT, 15.0, 3.0),
        Mode.ORBIT,
        orders.FlyAround(near(NORTH), near(EAST), near(12.34), 15.0, 3.0, 200.0),
    ),
]


@pytest.mark.parametrize(("message", "mode", "order"), TABLE)
def test_what_a_command_asks_for(message: MavlinkMessage, mode: Mode, order: object) -> None:
    asked = Asked()
    assert asked.ask(message) is MavResult.ACCEPTED, asked.texts
    [request] = asked.requests
    found = request.order.legs[0] if isinstance(request.order, FlightSequence) else request.order
    assert (request.mode, request.peer) == (mode, PEER)
    assert found == order
    if isinstance(found, orders.FlyTo):
        assert asked.fenced == [(None, (10.5001, -20.2501), 0.0)]
    if isinstance(found, orders.FlyAround):
        assert asked.fenced == [(None, (found.latitude_deg, found.longitude_deg), found.radius)]


def test_a_speed_is_that_of_the_flights_that_come() -> None:
    asked = Asked()
    assert asked.ask(long(SPEED, 1, 3.5)) is MavResult.ACCEPTED
    asked.ask(long(REPOSITION, -1, 1, 0, NAN, 10.5001, -20.2501, 95.31))
    asked.ask(long(REPOSITION, 2.0, 1, 0, NAN, 10.5001, -20.2501, 95.31))
    speeds = [cast(Any, request.order).legs[0].speed for request in asked.requests]
    assert speeds == [3.5, 2.0]


@pytest.mark.parametrize(
    "message",
    [
        long(SPEED, 2, 3.0),
        long(SPEED, 1, 0.0),
        long(SPEED, 1, -1.0),
        long(SPEED, 1, 10.1),
        long(SPEED, 1, NAN),
        long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, 75.0),
        whole(TAKE_OFF, RELATIVE, 0, 0, -1.0),
        long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, math.inf),
        whole(TAKE_OFF, LOCAL_NED, 0, 0, 100.0),
        long(REPOSITION, -1, 1, 0, NAN, 0.0, 0.0, 95.0),
        long(REPOSITION, -1, 1, 0, NAN, 89.5, 0.0, 95.0),
        long(REPOSITION, -1, 1, 0, NAN, 10.0, 180.5, 95.0),
        long(REPOSITION, -1, 1, 0, math.inf, 10.0, 20.0, 95.0),
        whole(REPOSITION, LOCAL_NED, 100_000, 50_000, -5.0, -1),
        whole(REPOSITION, LOCAL_NED, 100_000, 50_000, NAN, -1),
        whole(REPOSITION, 10, X, Y, 15.0, -1),
        whole(REPOSITION, 10, X, Y, NAN, -1),
        whole(ORBIT, LOCAL_NED, 100_000, 50_000, NAN, 15.0, 2.0),
        long(ORBIT, 0.0, 2.0),
        long(ORBIT, NAN, 2.0),
        long(ORBIT, 0.4, 2.0),
    ],
)
def test_what_cannot_be_flown_as_it_is_said_is_denied(message: MavlinkMessage) -> None:
    asked = Asked()
    assert asked.ask(message) is MavResult.DENIED
    assert asked.requests == []


def test_the_present_height_of_an_aircraft_that_tells_none_is_not_flown_to() -> None:
    known = Known()
    del known.items[Position]
    asked = Asked(known)
    to_a_place = long(REPOSITION, -1, 1, 0, NAN, 10.5001, -20.2501, NAN)
    assert asked.ask(to_a_place) is MavResult.DENIED
    assert asked.requests == []
    assert "the height is unknown" in asked.texts[-1]
    to_a_place = whole(REPOSITION, GLOBAL, X, Y, 95.31, -1)
    assert asked.ask(to_a_place) is MavResult.DENIED
    assert "an altitude in frame 0 cannot be flown to" in asked.texts[-1]
    for altitude in (95.31, 75.0):  # the latter is below the ground, where that is at 87.65 m
        up = long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, altitude)
        assert asked.ask(up) is MavResult.DENIED
        assert "the altitude of the ground is unknown" in asked.texts[-1]
    standing = Asked(Known(FlightStatus(1)))
    assert standing.ask(up) is MavResult.DENIED
    assert "take-off to -12.7 m above the ground" in standing.texts[-1]
    known.state = replace(known.state, firmware="3.1")
    assert asked.ask(long(195)) is MavResult.DENIED
    assert "gimbal: the place is missing" in asked.texts[-1]


MODE, CURRENT, START, PAUSE, ARM, STANDARD = 176, 224, 300, 193, 400, 262


@pytest.mark.parametrize(
    ("given", "mode", "order"),
    [
        ((1, 4, 3), Mode.HOLD, HoldPosition()),
        ((129, 4, 6), Mode.LAND, LandInPlace()),
        ((1, 4, 5), Mode.RTL, ReturnToLaunch()),
        ((1, 4, 2), Mode.TAKEOFF, TakeOffAndClimb(2.5)),
        ((1, 4, 4), Mode.MISSION, None),
        ((1, 6, 0), Mode.OFFBOARD, None),
        ((1, 6), Mode.OFFBOARD, None),
        ((1, 3), Mode.POSCTL, None),
        ((1, 2), Mode.ALTCTL, None),
    ],
)
def test_modes_are_those_of_px4(given: Any, mode: Mode, order: object) -> None:
    asked = Asked()
    assert asked.ask(long(MODE, *given)) is MavResult.ACCEPTED, asked.texts
    [request] = asked.requests
    assert (request.mode, request.order) == (mode, order)


@pytest.mark.parametrize(
    "message",
    [
        long(MODE, NAN, 4, 3),
        long(MODE, 1, NAN, 3),
        long(MODE, 256, 4, 3),
        long(MODE, 1, -1, 3),
        long(MODE, 8, 4, 3),
        long(MODE, 1, 1, 0),
        long(MODE, 1, 4, 99),
        long(STANDARD, 99),
        long(STANDARD, NAN),
        long(ARM, 2),
        long(ARM, NAN),
        long(CURRENT, -1),
        long(CURRENT, NAN),
    ],
)
def test_what_is_no_mode_and_no_number_is_denied(message: MavlinkMessage) -> None:
    asked = Asked()
    assert asked.ask(message) is MavResult.DENIED
    assert (asked.requests, asked.firsts) == ([], [])


@pytest.mark.parametrize(
    ("message", "first"),
    [
        (long(CURRENT, 0), 0),
        (long(CURRENT, 4), 4),
        (long(START, 3), 3),
        (long(START, 0), None),
        (long(START), None),
        (long(PAUSE, 1), None),
    ],
)
def test_a_mission_begins_with_its_item(message: MavlinkMessage, first: int | None) -> None:
    asked = Asked()
    assert asked.ask(message) is MavResult.ACCEPTED
    assert asked.firsts == [first]
    assert [request.mode for request in asked.requests] == [Mode.MISSION]


@pytest.mark.parametrize("number", [NAN, -1.0, 0xFFFFFF])
def test_the_rate_of_what_is_no_message_is_not_reported(number: float) -> None:
    assert Asked().ask(long(510, number)) is MavResult.UNSUPPORTED


def test_a_pause_is_a_hold() -> None:
    asked = Asked()
    assert asked.ask(long(PAUSE, 0)) is MavResult.ACCEPTED
    assert [request.order for request in asked.requests] == [HoldPosition()]


@pytest.mark.parametrize(
    "message", [long(SPEED, 1, 3.0), long(CURRENT, 2), long(START, 0), long(MODE, 1, 4, 4)]
)
def test_while_somebody_else_flies_nothing_of_the_flight_changes(message: MavlinkMessage) -> None:
    asked = Asked()
    asked.other = Peer(("127.0.0.1", 14560), 1, 1)
    assert asked.ask(message) is MavResult.TEMPORARILY_REJECTED
    assert (asked.requests, asked.firsts, asked.orders) == ([], [], [])


def test_a_speed_goes_to_the_mission_that_the_aircraft_flies_in_millimetres() -> None:
    asked = Asked()
    assert asked.ask(long(SPEED, 1, 3.25)) is MavResult.ACCEPTED
    [order] = asked.orders
    assert order.order == orders.SetMissionSpeed(3.25)


@pytest.mark.parametrize(
    "message",
    [
        long(REPOSITION, -1, 1, 0, NAN, 10.5, -20.25, 75.31 + 101.0),
        long(REPOSITION, -1, 1, 0, NAN, 10.5010, -20.25, 90.0),
        long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, 75.31 + 101.0),
    ],
)
def test_outside_of_the_envelope_is_denied_at_the_command(message: MavlinkMessage) -> None:
    known = Known(position(latitude=NORTH, longitude=EAST))
    limits = GuardLimits(100.0, 50.0, None, None, NORTH, EAST)
    known.state = State(0.0, connection="connected", limits=limits)
    asked = Asked(known)
    assert asked.ask(message) is MavResult.DENIED
    assert asked.requests == []
    assert asked.texts


# -- what commands fly: a place, a height, a circle; and what is refused at the command ------------

FRAME = LocalFrame(22.5431, 113.9589)


def place(north: float, east: float) -> tuple[float, float]:
    return FRAME.to_geodetic(north, east)


async def reposition(
    ground: Ground, frame: int, x: float = NAN, y: float = NAN, z: float = NAN, yaw: float = NAN
) -> MavResult:
    """DO_REPOSITION as COMMAND_INT, which names its frame."""
    known = len(ground.heard)
    whole = [0x7FFFFFFF if math.isnan(one) else round(one * 1e7) for one in (x, y)]
    ground.send(
        "COMMAND_INT",
        command=MavCommand.DO_REPOSITION,
        target_system=1,
        target_component=1,
        frame=frame,
        param1=-1.0,
        param2=1.0,
        param4=yaw,
        x=whole[0],
        y=whole[1],
        z=z,
    )
    [ack] = [one for one in ground.heard[known:] if one.name == "COMMAND_ACK"]
    return MavResult(ack["result"])


@pytest.mark.parametrize("frame", [0, 3, 5, 6])
async def test_a_place_is_flown_to_in_every_frame(rig: Rig, ground: Ground, frame: int) -> None:
    await ground.fly(6.0)
    sea_level = rig.ground_altitude if frame in (0, 5) else 0.0
    where = place(12.0, -9.0)
    assert (
        await reposition(ground, frame, *where, sea_level + 9.0, math.pi / 2) is MavResult.ACCEPTED
    )
    await rig.until(lambda: math.dist(rig.aircraft.position, (12.0, -9.0)) < 1.0)
    await anyio.sleep(3.0)
    assert rig.height == pytest.approx(9.0, abs=1.0)
    assert ground.last("GLOBAL_POSITION_INT")["hdg"] == pytest.approx(9000, abs=500)


async def test_no_place_and_no_height_is_a_pause(rig: Rig, ground: Ground) -> None:
    await ground.fly(6.0)
    assert await reposition(ground, 6, *place(60.0, 0.0), 6.0) is MavResult.ACCEPTED
    await rig.until(lambda: rig.speed > 2.0)
    assert await ground.ask(MavCommand.DO_REPOSITION, -1, 1, 0) is MavResult.ACCEPTED
    await anyio.sleep(4.0)
    assert rig.speed < 0.1


async def test_a_height_alone_and_a_heading_alone(rig: Rig, ground: Ground) -> None:
    await ground.fly(4.0)
    assert await reposition(ground, 6, z=9.0) is MavResult.ACCEPTED
    await rig.until(lambda: abs(rig.height - 9.0) < 0.5)
    assert await reposition(ground, 6, yaw=-math.pi / 2) is MavResult.ACCEPTED
    await rig.until(lambda: abs(ground.last("GLOBAL_POSITION_INT")["hdg"] - 27000) < 500)


@pytest.mark.parametrize("radius", [10.0, -10.0])
async def test_a_circle_is_flown_and_held(rig: Rig, ground: Ground, radius: float) -> None:
    await ground.fly(6.0)
    where = place(20.0, 0.0)
    args = (radius, 3.0, 0.0, NAN, *where, rig.ground_altitude + 8.0)
    assert await ground.ask(MavCommand.DO_ORBIT, *args) is MavResult.ACCEPTED
    await rig.until(lambda: ground.mode is Mode.ORBIT)
    await anyio.sleep(15.0)
    turned = []
    for _ in range(30):
        north, east = rig.aircraft.position
        turned.append(math.atan2(east, north - 20.0))
        assert math.hypot(north - 20.0, east) == pytest.approx(10.0, abs=1.0)
        await anyio.sleep(0.1)
    step = math.remainder(turned[1] - turned[0], math.tau)
    assert (step > 0) == (radius > 0)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await anyio.sleep(4.0)
    assert rig.speed < 0.1


@pytest.mark.parametrize(
    ("x", "y", "z"),
    [
        (*place(500.0, 0.0), 5.0),
        (*place(5.0, 0.0), 90.0),
        (*place(5.0, 0.0), -20.0),
        (0.0, 0.0, 5.0),
        (91.0, 0.0, 5.0),
        (*place(5.0, 0.0), math.inf),
    ],
)
async def test_a_target_that_is_not_flown_to_is_denied_at_once(
    rig: Rig, ground: Ground, x: float, y: float, z: float
) -> None:
    await ground.fly(5.0)
    assert await reposition(ground, 6, x, y, z) is MavResult.DENIED
    await anyio.sleep(1.0)
    assert rig.speed < 0.1
    assert len(ground.texts.splitlines()) > 3


async def test_a_take_off_beyond_the_envelope_is_denied_on_the_ground(
    rig: Rig, ground: Ground
) -> None:
    await ground.arm()
    args = (0, 0, 0, NAN, NAN, NAN, rig.ground_altitude + 80.0)
    assert await ground.ask(MavCommand.NAV_TAKEOFF, *args) is MavResult.DENIED
    await rig.until(lambda: "the envelope ends at 50 m" in ground.texts.replace("\n", ""))
    await anyio.sleep(3.0)
    assert not rig.motors_on


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("given", [NAN, math.inf, -math.inf, -1e30, 3e38])
async def test_numbers_that_are_none_move_nothing(
    rig: Rig, ground: Ground, command: int, given: float
) -> None:
    ground.command(command, *[given] * 7)
    await anyio.sleep(1.0)
    assert ground.all("COMMAND_ACK")
    assert rig.height < 0.1


@pytest.mark.parametrize("mode", [mode for mode, row in MODES.items() if row.is_selectable])
async def test_no_mode_moves_an_aircraft_that_is_not_armed(
    rig: Rig, ground: Ground, mode: Mode
) -> None:
    await ground.set_mode(mode)
    await anyio.sleep(12.0)
    assert not rig.motors_on
    assert not ground.armed()


async def test_another_speed_is_flown_with(rig: Rig, ground: Ground) -> None:
    await ground.fly(5.0)
    assert await ground.ask(MavCommand.DO_CHANGE_SPEED, 1, 2.0) is MavResult.ACCEPTED
    assert await reposition(ground, 6, *place(40.0, 0.0), 5.0) is MavResult.ACCEPTED
    speeds: list[float] = []
    for _ in range(60):
        await anyio.sleep(0.1)
        speeds.append(rig.speed)
    assert max(speeds) == pytest.approx(2.0, abs=0.4)


async def test_sticks_move_it_and_let_go_when_they_are_silent(rig: Rig, ground: Ground) -> None:
    await ground.fly(5.0)

    async def hold(seconds: float, **sticks: int) -> None:
        for _ in range(int(seconds / 0.05)):
            ground.send("MANUAL_CONTROL", target=1, **({"z": 500} | sticks))
            await anyio.sleep(0.05)

    assert await ground.set_mode(Mode.POSCTL) is MavResult.DENIED, "nobody holds the sticks"
    await hold(0.2)
    assert await ground.set_mode(Mode.POSCTL) is MavResult.ACCEPTED
    await hold(3.0, x=600)
    assert ground.mode is Mode.POSCTL
    assert rig.aircraft.position[0] > 3.0
    assert rig.speed == pytest.approx(3.0, abs=0.5)
    await hold(3.0)
    assert rig.speed < 0.1
    await hold(2.0, z=1000)
    assert rig.height > 7.0
    await hold(0.5, y=1000)
    await anyio.sleep(4.0)
    assert rig.speed < 0.1
    await rig.until(lambda: ground.mode is Mode.HOLD)


@pytest.mark.parametrize("mode", [Mode.POSCTL, Mode.ALTCTL])
async def test_an_axis_that_is_not_there_is_not_a_full_one(
    rig: Rig, ground: Ground, mode: Mode
) -> None:
    await ground.fly(5.0)
    none = dict.fromkeys("xyzr", 0x7FFF)
    ground.send("MANUAL_CONTROL", target=1, **none)
    assert await ground.set_mode(mode) is MavResult.ACCEPTED
    for _ in range(40):
        ground.send("MANUAL_CONTROL", target=1, **none)
        await anyio.sleep(0.05)
    assert ground.mode is mode
    assert rig.speed < 0.1
    assert rig.height == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize("command", sorted(COMMANDS))
@pytest.mark.parametrize("given", [math.inf, -math.inf, 3e38, -3e38, 1e-45])
async def test_no_number_of_a_command_is_too_much_for_it(
    rig: Rig, ground: Ground, command: int, given: float
) -> None:
    """Whatever it is, the command is answered, and nothing leaves the ground by it."""
    for number in range(7):
        parameters = [NAN] * 7
        parameters[number] = given
        assert await ground.ask(command, *parameters) is not MavResult.FAILED
    assert await ground.ask(command, *[given] * 7) is not MavResult.FAILED
    await anyio.sleep(1.0)
    assert not rig.motors_on


@pytest.mark.parametrize("frame", [0, 3, 5, 6])
async def test_a_take_off_is_as_high_as_its_frame_says(
    rig: Rig, ground: Ground, frame: int
) -> None:
    await ground.arm()
    sea_level = rig.ground_altitude if frame in (0, 5) else 0.0
    ground.send(
        "COMMAND_INT",
        command=MavCommand.NAV_TAKEOFF,
        target_system=1,
        target_component=1,
        frame=frame,
        z=sea_level + 4.0,
    )
    await rig.until(lambda: rig.height > 3.6)
    await anyio.sleep(3.0)
    assert rig.height == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize("frame", [0, 3, 5, 6])
async def test_the_altitude_of_a_circle_is_above_sea_level_whatever_its_frame_says(
    rig: Rig, ground: Ground, frame: int
) -> None:
    """MAVSDK names the relative frame, and means above sea level; PX4 does not read the frame."""
    await ground.fly(5.0)
    latitude, longitude = (round(one * 1e7) for one in place(10.0, 0.0))
    fields = {"command": MavCommand.DO_ORBIT, "target_system": 1, "target_component": 1}
    around = {"param1": 6.0, "param2": 2.0, "x": latitude, "y": longitude}
    ground.send("COMMAND_INT", **fields, **around, frame=frame, z=rig.ground_altitude + 9.0)
    await rig.until(lambda: ground.mode is Mode.ORBIT)
    await rig.until(lambda: abs(rig.height - 9.0) < 0.5)


@pytest.mark.parametrize("asked", [NAN, math.inf, -math.inf])
async def test_a_message_without_a_number_is_denied(ground: Ground, asked: float) -> None:
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, asked) is MavResult.DENIED


@pytest.mark.parametrize(
    ("asked_us", "told_us", "least", "most"),
    [(40_000, 40_000, 24, 26), (500_000, 500_000, 2, 2), (-1, -1, 0, 0), (0, 50_000, 18, 21)],
)
async def test_an_interval_is_one_of_microseconds(
    ground: Ground, asked_us: int, told_us: int, least: int, most: int
) -> None:
    """-1 is never, and 0 as often as by default: 20 a second."""
    attitude = LAYOUTS["ATTITUDE"].number
    assert (
        await ground.ask(MavCommand.SET_MESSAGE_INTERVAL, attitude, asked_us) is MavResult.ACCEPTED
    )
    known = len(ground.all("ATTITUDE"))
    await anyio.sleep(1.0)
    assert least <= len(ground.all("ATTITUDE")) - known <= most
    assert await ground.ask(MavCommand.GET_MESSAGE_INTERVAL, attitude) is MavResult.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == told_us
    assert ground.last("MESSAGE_INTERVAL")["message_id"] == attitude


async def test_capabilities_are_the_version(ground: Ground) -> None:
    """MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, which older stations ask."""
    assert not ground.all("AUTOPILOT_VERSION")
    assert await ground.ask(520, 1.0) is MavResult.ACCEPTED
    assert len(ground.all("AUTOPILOT_VERSION")) == 1


@pytest.mark.parametrize("number", [-1.0, NAN, math.inf, -0.5])
async def test_an_item_of_no_number_is_not_gone_on_from(ground: Ground, number: float) -> None:
    plan = [waypoint(10.0, 0.0), waypoint(20.0, 0.0)]
    assert await Exchange(ground).upload(plan) is MissionResult.ACCEPTED
    assert await ground.ask(MavCommand.DO_SET_MISSION_CURRENT, 1.0) is MavResult.ACCEPTED
    assert await ground.ask(MavCommand.DO_SET_MISSION_CURRENT, number) is MavResult.DENIED


@pytest.mark.parametrize(
    ("given", "least", "most"), [(2.0, 1.5, 2.2), (NAN, 3.0, 5.5), (-1.0, 3.0, 5.5)]
)
async def test_a_speed_that_is_none_is_that_of_the_parameter(
    rig: Rig, ground: Ground, given: float, least: float, most: float
) -> None:
    """MPC_XY_CRUISE, 5 m/s; -1 says so by the definition, and so does what is no number."""
    await ground.fly(5.0)
    where = *place(60.0, 0.0), rig.ground_altitude + 5.0
    assert (
        await ground.ask(MavCommand.DO_REPOSITION, math.inf, 1, 0, NAN, *where) is MavResult.DENIED
    )
    circle = 10.0, math.inf, 0.0, NAN
    assert await ground.ask(MavCommand.DO_ORBIT, *circle, *where) is MavResult.DENIED
    assert (
        await ground.ask(MavCommand.DO_REPOSITION, given, 1, 0, NAN, *where) is MavResult.ACCEPTED
    )
    await anyio.sleep(5.0)
    assert least <= rig.speed <= most
