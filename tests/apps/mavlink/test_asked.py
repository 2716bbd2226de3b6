"""Commands as a table: COMMAND_LONG and COMMAND_INT in, what the deck is asked for out."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.agent.guided import ChangeHeading, ChangeHeight, FlyAround, FlyTo
from m100link.apps.agent.messages import Limits, State
from m100link.apps.mavlink.translator.codec import Message
from m100link.apps.mavlink.translator.commands import Commands, read_command
from m100link.apps.mavlink.translator.deck import Deck
from m100link.apps.mavlink.translator.modes import Mode, Phase
from m100link.apps.mavlink.translator.numbers import Result
from m100link.apps.mavlink.translator.orders import Flight, GoHome, Halt, Land, TakeOff, Wish
from m100link.apps.mavlink.translator.parameters import Parameters
from m100link.apps.mavlink.translator.peers import Peer
from m100link.apps.mavlink.translator.telemetry import Rates
from tests.apps.mavlink.conftest import world_of
from tests.known import Known, position

NAN = math.nan
near: Any = pytest.approx
PEER = Peer(("127.0.0.1", 14550), 245, 190)
TAKE_OFF, LAND, HOME, ORBIT, REPOSITION, SPEED = 22, 21, 20, 34, 192, 178
GLOBAL, LOCAL_NED, RELATIVE, GLOBAL_INT, RELATIVE_INT = 0, 1, 3, 5, 6
NOWHERE = 0x7FFFFFFF
# The ground is at 87.65 - 12.34 = 75.31 m.
NORTH, EAST = 10.5, -20.25


class Asked:
    """Somebody asks; what becomes of it is kept."""

    def __init__(self, known: Known | None = None) -> None:
        self.wishes: list[Wish] = []
        self.texts: list[str] = []
        self.fenced: list[tuple[float, float, float]] = []
        self.firsts: list[int | None] = []
        self.orders: list[Any] = []
        self.other: Peer | None = None
        deck = SimpleNamespace(
            wish=self._wish,
            phase=Phase.AIRBORNE,
            other_operator=lambda peer: self.other,
            has_setpoint=lambda *_: True,
            is_flown_by_aircraft=True,
            flies_mission=True,
            orders=self.orders,
        )
        world = world_of(known or Known(position(latitude=NORTH, longitude=EAST)))
        self.commands = Commands(
            world,
            cast(Deck, deck),
            Parameters(world, 1),
            Rates(world),
            tell=lambda _, text: self.texts.append(text),
            request=lambda *_: False,
            mission=self._mission,
            fence=self._fence,
        )

    def _wish(self, wish: Wish, now: float) -> Result:
        self.wishes.append(wish)
        return Result.ACCEPTED

    def _mission(self, peer: Peer, first: int | None) -> Wish | None:
        self.firsts.append(first)
        return Wish(Mode.MISSION, None, peer)

    def _fence(self, *place: float) -> str:
        self.fenced.append(cast("tuple[float, float, float]", place))
        return ""

    def ask(self, message: Message) -> Result | None:
        return self.commands.carry_out(read_command(message, PEER), 1.0)


def long(command: int, *given: float) -> Message:
    values = (*given, *(NAN,) * (7 - len(given)))
    fields: dict[str, Any] = {f"param{place}": one for place, one in enumerate(values, 1)}
    return Message("COMMAND_LONG", fields | {"command": command})


def whole(command: int, frame: int, x: int, y: int, z: float, *four: float) -> Message:
    values = (*four, *(NAN,) * (4 - len(four)))
    fields: dict[str, Any] = {f"param{place}": one for place, one in enumerate(values, 1)}
    more = {"command": command, "frame": frame, "x": x, "y": y, "z": z}
    return Message("COMMAND_INT", fields | more)


def to(height: float, speed: float = 5.0, yaw: float | None = None) -> FlyTo:
    return FlyTo(10.5001, -20.2501, near(height), speed, yaw)


X, Y = 105_001_000, -202_501_000

TABLE: list[tuple[Message, Mode, object]] = [
    (
        long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, 80.31),
        Mode.TAKEOFF,
        TakeOff(near(5.0)),
    ),
    (long(TAKE_OFF), Mode.TAKEOFF, TakeOff(2.5)),
    (long(TAKE_OFF, 0, 0, 0, 0, 0, 0, 0.0), Mode.TAKEOFF, TakeOff(2.5)),
    (whole(TAKE_OFF, RELATIVE, 0, 0, 6.0), Mode.TAKEOFF, TakeOff(near(6.0))),
    (whole(TAKE_OFF, RELATIVE_INT, 0, 0, 6.0), Mode.TAKEOFF, TakeOff(near(6.0))),
    (whole(TAKE_OFF, GLOBAL_INT, 0, 0, 85.31), Mode.TAKEOFF, TakeOff(near(10.0))),
    (long(LAND), Mode.LAND, Land()),
    (long(HOME), Mode.RTL, GoHome()),
    (long(REPOSITION), Mode.HOLD, Halt()),
    # radians, clockwise from north
    (long(REPOSITION, -1, 0, 0, 0.5), Mode.GOTO, ChangeHeading(near(28.6479, abs=1e-3))),
    (
        long(REPOSITION, -1, 1, 0, NAN, NAN, NAN, 95.31),
        Mode.GOTO,
        ChangeHeight(near(20.0)),
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
    (whole(REPOSITION, GLOBAL, NOWHERE, NOWHERE, NAN), Mode.HOLD, Halt()),
    # m, m/s; a positive radius is clockwise
    (
        long(ORBIT, 15.0, 3.0, 0, NAN, 10.5001, -20.2501, 95.31),
        Mode.ORBIT,
        FlyAround(10.5001, -20.2501, near(20.0), 15.0, 3.0, 200.0, clockwise=True),
    ),
    (
        long(ORBIT, -7.0, NAN, 0, NAN, 10.5001, -20.2501, 95.31),
        Mode.ORBIT,
        FlyAround(10.5001, -20.2501, near(20.0), 7.0, 2.0, 200.0, clockwise=False),
    ),
    (
        whole(ORBIT, RELATIVE_INT, X, Y, 95.31, 15.0, 3.0),
        Mode.ORBIT,
        FlyAround(10.5001, -20.2501, near(20.0), 15.0, 3.0, 200.0, clockwise=True),
    ),
    (
        long(ORBIT, 15.0, 3.0),
        Mode.ORBIT,
        FlyAround(near(NORTH), near(EAST), near(12.34), 15.0, 3.0, 200.0),
    ),
]


@pytest.mark.parametrize(("message", "mode", "order"), TABLE)
def test_what_a_command_asks_for(message: Message, mode: Mode, order: object) -> None:
    asked = Asked()
    assert asked.ask(message) is Result.ACCEPTED, asked.texts
    [wish] = asked.wishes
    found = wish.order.legs[0] if isinstance(wish.order, Flight) else wish.order
    assert (wish.mode, wish.peer) == (mode, PEER)
    assert found == order
    if isinstance(found, FlyTo):
        assert asked.fenced == [(10.5001, -20.2501, 0.0)]
    if isinstance(found, FlyAround):
        assert asked.fenced == [(found.latitude_deg, found.longitude_deg, found.radius)]


def test_a_speed_is_that_of_the_flights_that_come() -> None:
    asked = Asked()
    assert asked.ask(long(SPEED, 1, 3.5)) is Result.ACCEPTED
    asked.ask(long(REPOSITION, -1, 1, 0, NAN, 10.5001, -20.2501, 95.31))
    asked.ask(long(REPOSITION, 2.0, 1, 0, NAN, 10.5001, -20.2501, 95.31))
    speeds = [cast(Any, wish.order).legs[0].speed for wish in asked.wishes]
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
    ],
)
def test_what_cannot_be_flown_as_it_is_said_is_denied(message: Message) -> None:
    asked = Asked()
    assert asked.ask(message) is Result.DENIED
    assert asked.wishes == []


MODE, CURRENT, START, PAUSE, ARM, STANDARD = 176, 224, 300, 193, 400, 262


@pytest.mark.parametrize(
    ("given", "mode", "order"),
    [
        ((1, 4, 3), Mode.HOLD, Halt()),
        ((129, 4, 6), Mode.LAND, Land()),
        ((1, 4, 5), Mode.RTL, GoHome()),
        ((1, 4, 2), Mode.TAKEOFF, TakeOff(2.5)),
        ((1, 4, 4), Mode.MISSION, None),
        ((1, 6, 0), Mode.OFFBOARD, None),
        ((1, 6), Mode.OFFBOARD, None),
        ((1, 3), Mode.POSCTL, None),
        ((1, 2), Mode.ALTCTL, None),
    ],
)
def test_modes_are_those_of_px4(given: Any, mode: Mode, order: object) -> None:
    asked = Asked()
    assert asked.ask(long(MODE, *given)) is Result.ACCEPTED, asked.texts
    [wish] = asked.wishes
    assert (wish.mode, wish.order) == (mode, order)


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
def test_what_is_no_mode_and_no_number_is_denied(message: Message) -> None:
    asked = Asked()
    assert asked.ask(message) is Result.DENIED
    assert (asked.wishes, asked.firsts) == ([], [])


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
def test_a_mission_begins_with_its_item(message: Message, first: int | None) -> None:
    asked = Asked()
    assert asked.ask(message) is Result.ACCEPTED
    assert asked.firsts == [first]
    assert [wish.mode for wish in asked.wishes] == [Mode.MISSION]


@pytest.mark.parametrize("number", [NAN, -1.0, 0xFFFFFF])
def test_the_rate_of_what_is_no_message_is_not_told(number: float) -> None:
    assert Asked().ask(long(510, number)) is Result.UNSUPPORTED


def test_a_pause_is_a_hold() -> None:
    asked = Asked()
    assert asked.ask(long(PAUSE, 0)) is Result.ACCEPTED
    assert [wish.order for wish in asked.wishes] == [Halt()]


@pytest.mark.parametrize(
    "message", [long(SPEED, 1, 3.0), long(CURRENT, 2), long(START, 0), long(MODE, 1, 4, 4)]
)
def test_while_somebody_else_flies_nothing_of_the_flight_changes(message: Message) -> None:
    asked = Asked()
    asked.other = Peer(("127.0.0.1", 14560), 1, 1)
    assert asked.ask(message) is Result.TEMPORARILY_REJECTED
    assert (asked.wishes, asked.firsts, asked.orders) == ([], [], [])


def test_a_speed_goes_to_the_mission_that_the_aircraft_flies_in_millimetres() -> None:
    asked = Asked()
    assert asked.ask(long(SPEED, 1, 3.25)) is Result.ACCEPTED
    [order] = asked.orders
    assert (order.action.value, order.number) == ("mission_speed", 3250)


@pytest.mark.parametrize(
    "message",
    [
        long(REPOSITION, -1, 1, 0, NAN, 10.5, -20.25, 75.31 + 101.0),
        long(REPOSITION, -1, 1, 0, NAN, 10.5010, -20.25, 90.0),
        long(TAKE_OFF, NAN, NAN, NAN, NAN, NAN, NAN, 75.31 + 101.0),
    ],
)
def test_outside_of_the_envelope_is_denied_at_the_command(message: Message) -> None:
    known = Known(position(latitude=NORTH, longitude=EAST))
    limits = Limits(100.0, 50.0, None, None, NORTH, EAST)
    known.state = State(0.0, connection="connected", limits=limits)
    asked = Asked(known)
    assert asked.ask(message) is Result.DENIED
    assert asked.wishes == []
    assert asked.texts
