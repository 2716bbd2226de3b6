"""One aircraft of which everything is known, and no two numbers are alike: for tables of values.

Each front has a table of these values in and its own values out, by the front's specification. The
bytes of the package are by DJI's document; no code of the library makes them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

from m100link.apps.agent import orders
from m100link.apps.agent.client import VehicleView
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import (
    VERSION,
    Ask,
    GuardLimits,
    Hello,
    LeaseChanged,
    Message,
    OrderOutcome,
    Stage,
    State,
    Telemetry,
)
from m100link.apps.agent.orders import LeaseOrder
from m100link.apps.agent.transports import MemoryChannel
from m100link.protocol.firmware import FIRMWARE_3_1, PROFILES
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightPhase,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    Time,
    Velocity,
)
from m100link.telemetry.integrity import Integrity, IntegrityState
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState

ROLL, PITCH, YAW = 10.0, -20.0, -130.0
"""Degrees: right side down, nose down, looks south-west."""

LATITUDE, LONGITUDE = -33.1234567, 151.2345678
"""Degrees, north and east."""


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Scalar first: turned by yaw about down, then pitch about right, then roll about forward."""

    def times(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float, float]:
        return (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        )

    half = [math.radians(one) / 2 for one in (roll, pitch, yaw)]
    about = [
        (math.cos(half[0]), math.sin(half[0]), 0.0, 0.0),
        (math.cos(half[1]), 0.0, math.sin(half[1]), 0.0),
        (math.cos(half[2]), 0.0, 0.0, math.sin(half[2])),
    ]
    return times(times(about[2], about[1]), about[0])


def in_body(north: float, east: float, down: float) -> tuple[float, float, float]:
    """A vector of the ground, as the known aircraft has it: forward, right, down.

    By the rows of the matrix that turns ground into body, from the angles.
    """
    r, p, y = (math.radians(one) for one in (ROLL, PITCH, YAW))
    sr, cr, sp, cp, sy, cy = *_both(r), *_both(p), *_both(y)
    rows = (
        (cp * cy, cp * sy, -sp),
        (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    )
    forward, right, below = (a * north + b * east + c * down for a, b, c in rows)
    return forward, right, below


def _both(angle: float) -> tuple[float, float]:
    return math.sin(angle), math.cos(angle)


GRAVITY_M_S2 = 9.80665


def felt() -> tuple[float, float, float]:
    """What an accelerometer feels, m/s²: acceleration less gravity, forward, right, down."""
    return in_body(1.5, -2.5, -0.7 - GRAVITY_M_S2)


def position(
    *,
    latitude: float = LATITUDE,
    longitude: float = LONGITUDE,
    altitude: float = 87.65,
    height: float = 12.34,
    health: int | None = 4,
) -> Position:
    return Position(math.radians(latitude), math.radians(longitude), altitude, height, health)


CONNECTED = State(0.0, connection="connected", has_authority=True)


def seen(telemetry: AircraftState | None, at: float | None = None, **more: Any) -> VehicleView:
    """The view of a front that hears a connected agent, unless ``more`` says otherwise.

    By default it is of now by the clock of the telemetry.
    """
    if at is None:
        at = 0.0 if telemetry is None else telemetry._clock()
    given: dict[str, Any] = {"heard_at": at, "is_gone": False, "state": CONNECTED}
    return VehicleView(at, telemetry=telemetry, **{"holder": LeaseChanged(0, ""), **given, **more})


class Known:
    """What an agent would tell; each item can be taken away, or be another one."""

    def __init__(self, *values: Any) -> None:
        self.items: dict[type[Any], Any] = {type(one): one for one in (*EVERYTHING, *values)}
        self.state = State(0.0, connection="connected", discards=77)
        self.holder = LeaseChanged(0, "")
        self.telemetry: AircraftState | None = cast(AircraftState, self)
        self.is_connected = True
        self.has_authority = False
        self.newest_age: float | None = 0.0
        self.within: dict[type[Any], float | None] = {}
        self.ages: dict[type[Any], float] = {}  # s; of all others 0
        self.integrity = Integrity(IntegrityState.GOOD, "", 0.25, 0.375)

    @property
    def newest_at(self) -> float | None:
        return None if self.newest_age is None else -self.newest_age

    @property
    def believed_status(self) -> FlightStatus | None:
        found: FlightStatus | None = self.items.get(FlightStatus)
        return found

    @property
    def view(self) -> VehicleView:
        """At the time 0."""
        connection = "connected" if self.is_connected else "lost"
        state = replace(self.state, connection=connection, has_authority=self.has_authority)
        return VehicleView(0.0, 0.0, False, state, self.holder, self.telemetry)

    def get(self, record: type[Any]) -> Any:
        return self.items.get(record)

    def received_at(self, record: type[Any]) -> float | None:
        return -self.ages.get(record, 0.0) if record in self.items else None

    def fresh(
        self, record: type[Any], *, within: float | None = None, now: float | None = None
    ) -> Any:
        if now is not None:
            assert (now, within) != (0.0, None)
            self.within[record] = within
        is_old = within is not None and self.ages.get(record, 0.0) > within
        return None if is_old else self.items.get(record)

    def without(self, *records: type[Any]) -> Known:
        for one in records:
            del self.items[one]
        return self

    def limited(self, speed: float) -> Known:
        self.state = State(0.0, limits=GuardLimits(max_speed_m_s=speed))
        return self

    def doubted(self, state: IntegrityState) -> Known:
        self.integrity = Integrity(state, "seen", 4.5, 0.375)
        return self

    def flown(self) -> Known:
        self.holder, self.has_authority = LeaseChanged(3, "mavlink"), True
        return self


EVERYTHING = (
    Time(123_457, 987_654_321, 1, 400),
    Attitude(*quaternion(ROLL, PITCH, YAW)),
    Acceleration(1.5, -2.5, 0.7),
    Velocity(3.21, -1.57, 0.84, 7),
    AngularVelocity(0.11, -0.23, 0.37),
    position(),
    Magnetometer(313.0, -1127.0, 851.0),
    RemoteControl(1000, -2000, 3000, -4000, 8000, -4545),
    Gimbal(4.5, -37.25, 118.75, 6),
    FlightStatus(FlightPhase.IN_AIR),
    Battery(63),
    ControlDevice(0x1A, 6),
)
"""As firmware 3.1 tells it, in the order of the document: ground north, east, up; body FRD."""

BITS = {type(one): bit for bit, one in enumerate(EVERYTHING)}


def package(
    firmware: str = "3.1", *, without: Sequence[type[Any]] = (), changed: Sequence[Any] = ()
) -> bytes:
    """The value of a telemetry command: the flag word and the items, by DJI's document.

    Args:
        firmware: ``1.0``, ``2.3`` or ``3.1``.
        without: Records that it does not have.
        changed: Records in the place of those above.
    """
    sent = {kind for kind, layouts in _WIRE.items() if {"", firmware} & layouts.keys()}
    unknown = [type(one).__name__ for one in EVERYTHING if type(one) not in _WIRE]
    assert not unknown, f"_WIRE in tests/known.py has no row for {unknown}"
    has = {type(one): one for one in (*EVERYTHING, *changed) if type(one) in sent - {*without}}
    flags = sum(1 << BITS[kind] for kind in has)
    kinds = sorted(has, key=BITS.__getitem__)
    return struct.pack("<H", flags) + b"".join(_wire(has[kind], firmware) for kind in kinds)


def sample(
    firmware: str = "3.1",
    *,
    at: float = 0.0,
    without: Sequence[type[Any]] = (),
    changed: Sequence[Any] = (),
) -> Sample:
    """That package, come at a time of the loop, s."""
    value = package(firmware, without=without, changed=changed)
    return Sample(value, PROFILES[firmware], at)


STICKS_ALONE = struct.pack("<H5h", 1 << BITS[RemoteControl], 1000, -2000, 3000, -4000, 8000)
"""A package of the remote by the tables of the document (1.0-document), which have no gear."""

_WIRE: dict[type[Any], dict[str, str]] = {
    Time: {"1.0": "I", "2.3": "I", "3.1": "IIB"},
    Attitude: {"": "4f"},
    Acceleration: {"": "3f"},
    Velocity: {"1.0": "3f", "2.3": "3fB", "3.1": "3fB"},
    AngularVelocity: {"": "3f"},
    Position: {"": "2d2fB"},
    Magnetometer: {"": "3h"},
    RemoteControl: {"": "6h"},
    Gimbal: {"1.0": "3f", "2.3": "3f", "3.1": "3fB"},
    FlightStatus: {"": "B"},
    Battery: {"": "B"},
    ControlDevice: {"1.0": "B", "2.3": "B", "3.1": "BB"},
}
"""Little-endian and packed, by firmware, or "" for each; one that is not there does not send it."""


def _wire(record: Any, firmware: str) -> bytes:
    layouts = _WIRE[type(record)]
    form = layouts.get(firmware) or layouts[""]
    values = list(record)
    if type(record) is ControlDevice:
        values = values[::-1] if form == "BB" else values[:1]  # the mode goes first
    if type(record) is Magnetometer:
        values = [round(value) for value in values]
    values = values[: len(struct.unpack("<" + form, bytes(struct.calcsize("<" + form))))]
    return struct.pack("<" + form, *values)


MISSION, POINT, HOTPOINT = "<BffBBBBBBddf16x", "<BddffhhB8xBHB16B16h", "<BddddfBBB11x"
"""Values of 0x03/0x10, 0x11 and 0x20 by DJI's document of ground stations; places in radians."""


def rates(ask: Ask) -> tuple[int, ...]:
    """What an order to turn the gimbal sends: tenths of a degree per second, and flags."""
    assert isinstance(ask.order, orders.TurnGimbal)
    return struct.unpack("<3hB", ask.order.rates.value(FIRMWARE_3_1))


def angles(ask: Ask) -> tuple[int, ...]:
    """What an order to point the gimbal sends: tenths of a degree, mode, tenths of a second."""
    assert isinstance(ask.order, orders.PointGimbal)
    return struct.unpack("<3hBB", ask.order.angles.value(FIRMWARE_3_1))


"""Of 0x01/0x1A and 0x1B: yaw, roll, pitch in 0.1 °; flags, or mode and 0.1 s."""


class KnownAgent:
    """The agent's end of a way to a front: it does all that is asked, and keeps what it was asked.

    Args:
        channel: That end.
        state: Where it stands; ``has_authority`` follows what is asked.

    Attributes:
        heard: What the front sent, in order.
        version: What the aircraft says of itself.
        is_slow: Whether nothing that is asked for is done yet.
    """

    def __init__(self, channel: MemoryChannel, state: State | None = None) -> None:
        self._channel = channel
        self.state = state or State(
            0.0, connection="connected", firmware="3.1", is_activated=True, has_authority=True
        )
        self.heard: list[Message] = []
        self.version, self.is_slow = "", False
        channel.open(self._hear, lambda _: None)
        self.tell(Hello(VERSION, "known", 0.0), self.state)

    def tell(self, *messages: Message) -> None:
        """Let the front hear these."""
        for message in messages:
            if isinstance(message, State):
                self.state = message
            self._channel.send(message)

    def tell_package(self, at: float, firmware: str = "3.1", **options: Sequence[Any]) -> None:
        """A package of the known aircraft; the options are those of :func:`package`."""
        self.tell(Telemetry(package(firmware, **options), firmware, at))

    def asked(self, kind: type[Any]) -> list[Any]:
        """All of that kind that the front sent; questions but for those about the lease."""
        if issubclass(kind, orders.Order):
            asks = [one for one in self.heard if isinstance(one, Ask)]
            return [one.order for one in asks if isinstance(one.order, kind)]
        found = [one for one in self.heard if isinstance(one, kind)]
        return [one for one in found if not isinstance(getattr(one, "order", None), LeaseOrder)]

    def _hear(self, message: Message) -> None:
        self.heard.append(message)
        identity = getattr(message, "id", 0)
        order = message.order if isinstance(message, Ask) else None
        if isinstance(order, LeaseOrder):
            is_over, name = isinstance(order, orders.ReleaseLease), getattr(order, "name", "")
            self.tell(LeaseChanged(0, "") if is_over else LeaseChanged(7, name))
            self.tell(OrderOutcome(identity, Stage.DONE, lease=Lease(name, "token", 7)))
            return
        if isinstance(order, orders.Obtain | orders.Release):
            self.tell(replace(self.state, has_authority=isinstance(order, orders.Obtain)))
        if identity and not self.is_slow:
            number = round(1000 * getattr(order, "speed", 0.0))
            self.tell(OrderOutcome(identity, Stage.DONE, text=self.version, number=number))
