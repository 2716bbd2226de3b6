"""A virtual aircraft that notes when each movement arrived, and the program's end of its cable."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from itertools import count
from typing import Any

import pytest

from m100link import Aircraft, Control, FlightPhase, Setpoint
from m100link.protocol.commands.control import Move
from m100link.protocol.records import Device
from m100link.sim.vehicle.activation import Grant
from m100link.sim.vehicle.sensors import Sensors
from m100link.sim.virtual import VirtualAircraft
from m100link.testing import ConnectableAircraft

FIRMWARES = ("1.0", "2.3", "3.1")

NORTH = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
STILL = NORTH.neutral()


def know_app(virtual: VirtualAircraft) -> None:
    """It was activated before: it does not ask its server first, for two seconds of each test."""
    app = virtual.credentials
    known = virtual.vehicle.activation.known
    known[app.app_id] = Grant(app.app_id, app.key, app.level)


def put_in_the_air(virtual: VirtualAircraft, height: float = 2.0) -> None:
    """Activated before and hovering at that height, m: saves seconds of time per test."""
    know_app(virtual)
    flight = virtual.vehicle.flight
    flight.start_motors()
    flight.dynamics.place(0.0, 0.0, height)
    flight.phase = FlightPhase.IN_AIR


class TimedMoves(deque[Move]):
    """Movement commands as they arrive, with the time of the event loop."""

    def __init__(self) -> None:
        super().__init__()
        self.times: list[float] = []

    def append(self, move: Move) -> None:
        self.times.append(asyncio.get_running_loop().time())
        super().append(move)


class Rig:
    """Both ends.

    Attributes:
        virtual: The aircraft.
        aircraft: What the program has of it.
        moves: Every movement command that arrived.
    """

    def __init__(self, virtual: ConnectableAircraft, aircraft: Aircraft) -> None:
        self.virtual = virtual
        self.aircraft = aircraft
        self.moves = TimedMoves()
        virtual.autopilot.received_movements = self.moves

    @property
    def now(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def speed(self) -> float:
        return self.virtual.vehicle.flight.dynamics.speed

    @property
    def device(self) -> Device:
        return self.virtual.vehicle.authority.device

    @property
    def phase(self) -> FlightPhase:
        return self.virtual.vehicle.flight.phase

    @property
    def is_running(self) -> bool:
        return self.virtual.vehicle.flight.dynamics.motors_on

    @property
    def is_released(self) -> bool:
        """The aircraft heard that this program does not want control any more."""
        return not self.virtual.vehicle.authority.is_requested and self.device is Device.RC

    def is_neutral(self, move: Move) -> bool:
        """Whether a movement asks for nothing: all values zero, by climb rate and yaw rate."""
        values = (move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw)
        by_rates = move.control_flag & 0b0011_1000 == 0b0000_1000
        return values == (0.0, 0.0, 0.0, 0.0) and by_rates

    async def assert_hovers(self, *, within: float = 4.0) -> None:
        """It comes to rest in the air and stays there; nobody moves it any more."""
        await asyncio.sleep(0.001)  # what is on the line arrives
        count = len(self.moves)
        await asyncio.sleep(within)
        height, (north, east) = self.virtual.height, self.virtual.position
        assert height > 0.5
        assert self.speed < 0.1
        await asyncio.sleep(5.0)
        assert abs(self.virtual.height - height) < 0.1
        assert abs(self.virtual.position[0] - north) < 0.2
        assert abs(self.virtual.position[1] - east) < 0.2
        assert len(self.moves) == count, "setpoints went on after the block"

    def assert_stopped_in_order(self) -> None:
        """What arrived last was 0.3 s of neutral."""
        last = list(self.moves)[-10:]
        assert all(self.is_neutral(move) for move in last), last

    async def fly(self, control: Control, seconds: float = 2.0) -> None:
        """Fly north in a loop of the program's own."""
        async for tick in control.ticks():
            if tick.elapsed >= seconds:
                return
            control.send(NORTH)

    async def fly_on(self, control: Control) -> None:
        """Fly north for ever."""
        async for _ in control.ticks():
            control.send(NORTH)


@asynccontextmanager
async def rig(*, activated: bool = True, **options: Any) -> AsyncIterator[Rig]:
    """A connected (and activated) aircraft; options are those of the virtual one."""
    options.setdefault("seed", 1)
    virtual = ConnectableAircraft(**options)
    print(f"virtual aircraft: {virtual!r}")  # noqa: T201 (pytest shows it when the test fails)
    async with virtual.connect() as aircraft:
        if activated:
            know_app(virtual)
            await aircraft.activate(virtual.credentials)
            # One second: every item that is sent at all has come.
            await asyncio.sleep(1.1)
        yield Rig(virtual, aircraft)
    virtual.stop()


@contextmanager
def wrong_standing() -> Iterator[None]:
    """In the air two flight statuses of three say that it stands."""
    read, told = Sensors._read_flight_status, count()

    def read_wrong(sensors: Sensors) -> tuple[float, ...]:
        return (FlightPhase.STANDBY,) if next(told) % 3 else read(sensors)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sensors, "_read_flight_status", read_wrong)
        yield
